"""Probability of the measurements given soil parameters and noise.

What is conditioned on and what is an outcome the drive says (:mod:`bayesterra.study.drive`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.likelihood.forward import Forward, Outcomes
from bayesterra.study.noise import Noise
from bayesterra.study.observations import Observations


@dataclass(frozen=True)
class Likelihood:
    """Likelihood of every measured outcome, each with independent noise.

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

    @property
    def terms(self) -> tuple[str, ...]:
        """Terms that the log likelihood of a row is the sum of."""
        return self.channels

    @property
    def rows_apart(self) -> bool:
        """True where rows are independent given the parameters, so that the log likelihood sums its terms."""
        return True

    def status(self, soil: FloatArray) -> IntArray:
        """Status (n,) of soil arrays; 0 where every row has an answer."""
        return self.forward(soil).status

    def log_terms(self, soil: FloatArray, noise_values: FloatArray) -> FloatArray:
        """Log density (n, m, terms) of every row's readings; −inf where the model has no answer."""
        outcomes = self.forward(soil)
        terms = self.pointwise(outcomes, noise_values)
        return np.where((outcomes.status == 0)[:, None, None], terms, -np.inf)

    def log_likelihood(self, soil: FloatArray, noise_values: FloatArray) -> FloatArray:
        """Log likelihood (n,) of soil arrays (n, 16); −inf where the model has no answer."""
        return self.log_density(self.forward(soil), noise_values)

    def log_rows(self, soil: FloatArray, noise_values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log likelihood (n,), and log density (n, m) of every row's readings given those of all others.

        Rows are independent here, so the one is the sum of the other; correlated readings are not.
        """
        rows = self.log_terms(soil, noise_values).sum(axis=2)
        return np.asarray(rows.sum(axis=1)), np.asarray(rows)

    def explained(self, soil: FloatArray, noise_values: FloatArray, rng: np.random.Generator) -> Outcomes:
        """Outcomes behind the readings, row by row; nothing is random where the load is known."""
        return self.forward(soil, every_row=True)

    def imagined(self, soil: FloatArray, noise_values: FloatArray, rng: np.random.Generator) -> Outcomes:
        """Outcomes row by row before any reading; as :meth:`explained` where the load is known."""
        return self.forward(soil, every_row=True)

    def beyond(
        self,
        soil: FloatArray,
        noise_values: FloatArray,
        wheel: str | None,
        slip: FloatArray,
        rng: np.random.Generator,
    ) -> FloatArray:
        """Addition to the model's outcomes of a wheel at slips (g,), (n, g, channels): nothing here."""
        return np.zeros((len(soil), len(slip), len(self.channels)))

    def fresh(
        self, forward: Forward, soil: FloatArray, noise_values: FloatArray, rng: np.random.Generator
    ) -> FloatArray:
        """Addition to outcomes and noise of new readings at the rows of ``forward``: nothing here."""
        return np.zeros((len(soil), len(forward.conditions.slip), len(self.channels)))

    @cached_property
    def measured(self) -> FloatArray:
        """Readings (m, channels), NaN where not measured."""
        return np.column_stack([self.observations.values[name] for name in self.channels])

    @cached_property
    def _given_sd(self) -> dict[str, FloatArray]:
        none = np.full(len(self.observations), np.nan)
        return {name: self.observations.given_sd.get(name, none) for name in self.channels}

    def predicted(self, outcomes: Outcomes) -> FloatArray:
        """Modelled values of the measured channels, (n, m, channels)."""
        return outcomes.of(self.channels)

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
            laws = [noise.log_density(standard[:, :, i]) for i, noise in enumerate(self.noise)]
            density = np.stack(laws, axis=2) - np.log(scale)
        return np.where(np.isnan(self.measured), 0.0, density)

    def log_density(self, outcomes: Outcomes, noise_values: FloatArray) -> FloatArray:
        """Log likelihood (n,), −inf where the model has no answer."""
        total = self.pointwise(outcomes, noise_values).sum(axis=(1, 2))
        return np.where(outcomes.status == 0, total, -np.inf)

    def draw(self, outcomes: Outcomes, noise_values: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw readings (n, m, channels) with noise, for every row and measured channel."""
        predicted = self.predicted(outcomes)
        standard = rng.standard_normal(predicted.shape)
        for i, noise in enumerate(self.noise):
            if np.isfinite(noise.dof):
                standard[:, :, i] = noise.draw(predicted.shape[:2], rng)
        return predicted + self.scales(predicted, noise_values) * standard
