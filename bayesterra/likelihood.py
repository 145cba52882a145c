"""Probability of the measurements given soil parameters and noise.

The drive says what is conditioned on and what is an outcome:

``load``      slip and load given; sinkage, drawbar pull and moment are outcomes (the testbed's causality).
``sinkage``   slip and sinkage given; normal force, drawbar pull and moment are outcomes (the paper's way).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesterra.arrays import FloatArray, IntArray, frozen
from bayesterra.data import DRIVE_OUTCOMES, Observations
from bayesterra.models import Conditions, Wheel, WheelSoilModel
from bayesterra.noise import Noise


@dataclass(frozen=True)
class Outcomes:
    """Modelled outcomes of every observation for every parameter set.

    Attributes
    ----------
    values : (n, m, 3) in the order of ``DRIVE_OUTCOMES``, NaN where the model has no answer.
    status : (n,) 0, or the highest :class:`bayesterra.models.Status` among rows without an answer.
    """

    values: FloatArray
    status: IntArray


@dataclass(frozen=True)
class Forward:
    """A model held at the conditions of a table: soil parameters in, outcomes of the drive out.

    Parameters
    ----------
    model : M1, M2 or M3 with its options.
    drive : ``load`` or ``sinkage``.
    conditions : slip and wheel of every row.
    given : load (N) or sinkage (m) of every row, (m,).
    """

    model: WheelSoilModel
    drive: str
    conditions: Conditions
    given: FloatArray

    @classmethod
    def of(
        cls, model: WheelSoilModel, drive: str, observations: Observations, wheels: dict[str, Wheel]
    ) -> Forward:
        """Hold ``model`` at the rows of ``observations``."""
        conditions = Conditions.of([wheels[name] for name in observations.wheel], observations.slip)
        given = observations.load if drive == "load" else observations.values["sinkage"]
        return cls(model, drive, conditions, frozen(given))

    @property
    def outcomes(self) -> tuple[str, ...]:
        """Names along the last axis of the outcomes."""
        return DRIVE_OUTCOMES[self.drive]

    def __call__(self, soil: FloatArray, *, every_row: bool = False) -> Outcomes:
        """Model all rows for soil parameter sets (n, 9).

        A set that fails in one row has no likelihood, so its other rows may be left without an answer too;
        with ``every_row`` each row that has an answer gets it.
        """
        run = self.model.response_at if self.drive == "load" else self.model.forces_at
        values, status = run(soil, self.conditions, self.given, every_row=every_row)
        return Outcomes(values, np.max(status, axis=1).astype(np.int64))


@dataclass(frozen=True)
class Likelihood:
    """Gaussian likelihood of every measured outcome.

    Parameters
    ----------
    forward : the model at the rows that are in the fit.
    observations : those rows.
    noise : noise of each measured outcome.
    """

    forward: Forward
    observations: Observations
    noise: Sequence[Noise]

    @property
    def channels(self) -> tuple[str, ...]:
        """Measured outcomes, the order of :meth:`pointwise`'s last axis."""
        return tuple(noise.channel for noise in self.noise)

    @cached_property
    def measured(self) -> FloatArray:
        """Readings (m, channels), NaN where not measured."""
        return np.column_stack([self.observations.values[name] for name in self.channels])

    @cached_property
    def _columns(self) -> list[int]:
        return [self.forward.outcomes.index(name) for name in self.channels]

    @cached_property
    def _given_sd(self) -> dict[str, FloatArray]:
        none = np.full(len(self.observations), np.nan)
        return {name: self.observations.given_sd.get(name, none) for name in self.channels}

    def predicted(self, outcomes: Outcomes) -> FloatArray:
        """Modelled values of the measured channels, (n, m, channels)."""
        return outcomes.values[:, :, self._columns]

    def scales(self, predicted: FloatArray, noise_values: FloatArray) -> FloatArray:
        """Standard deviations (n, m, channels).

        ``noise_values`` (n, k) are the estimated standard deviations, in the order of the channels that
        have one.
        """
        scale = np.empty(predicted.shape)
        estimated = iter(noise_values.T)
        for i, noise in enumerate(self.noise):
            value = next(estimated) if noise.parameter else None
            scale[:, :, i] = noise.scale(predicted[:, :, i], value, self._given_sd[noise.channel])
        return scale

    def pointwise(self, outcomes: Outcomes, noise_values: FloatArray) -> FloatArray:
        """Log density of every reading, (n, m, channels); 0 where nothing was measured."""
        predicted = self.predicted(outcomes)
        scale = self.scales(predicted, noise_values)
        with np.errstate(over="ignore"):  # forces of 1e200 N have the log density −inf
            standard = (self.measured - predicted) / scale
            density = -0.5 * standard**2 - np.log(scale) - 0.5 * np.log(2 * np.pi)
        return np.where(np.isnan(self.measured), 0.0, density)

    def log_density(self, outcomes: Outcomes, noise_values: FloatArray) -> FloatArray:
        """Log likelihood (n,), −inf where the model has no answer."""
        total = self.pointwise(outcomes, noise_values).sum(axis=(1, 2))
        return np.where(outcomes.status == 0, total, -np.inf)

    def draw(self, outcomes: Outcomes, noise_values: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw readings (n, m, channels) with noise, for every row and measured channel."""
        predicted = self.predicted(outcomes)
        return predicted + self.scales(predicted, noise_values) * rng.standard_normal(predicted.shape)
