"""A model held at the conditions of a table: soil in, modelled outcomes of every row out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from bayesterra.arrays import BoolArray, FloatArray, IntArray, frozen
from bayesterra.models import Conditions, Wheel, WheelSoilModel
from bayesterra.models.forces import SINKAGE
from bayesterra.parameters import SoilColumns
from bayesterra.study.drive import Drive
from bayesterra.study.observations import Observations

Codes = NDArray[np.int8]


@dataclass(frozen=True)
class Outcomes:
    """Modelled outcomes of every observation for every parameter set, by channel: ``outcomes["sinkage"]``.

    Attributes
    ----------
    names : the k channels.
    values : (n, m, k), NaN where the model has no answer.
    status : (n,) 0, or the highest :class:`bayesterra.models.Status` among rows without an answer.
    """

    names: tuple[str, ...]
    values: FloatArray
    status: IntArray

    def __getitem__(self, name: str) -> FloatArray:
        """Values (n, m) of a channel, a view."""
        return self.values[:, :, self.names.index(name)]

    def add(self, name: str, amount: FloatArray) -> None:
        """Add to the values of a channel in place."""
        self[name][...] += amount

    def of(self, names: Sequence[str]) -> FloatArray:
        """Values (n, m, channels) of some channels in their order."""
        return self.values[:, :, [self.names.index(name) for name in names]]

    def take(self, chosen: IntArray | slice) -> Outcomes:
        """Those of some parameter sets, also repeatedly."""
        return Outcomes(self.names, self.values[chosen], self.status[chosen])


def soil_at(soil: FloatArray, width: float) -> FloatArray:
    """Soil arrays (n, 16) with the K_s of a wheel of ``width`` (m): k_c/b + k_φ where these are used.

    A modulus that is not positive is NaN: nothing carries the wheel.
    """
    if not _has_moduli(soil):
        return soil
    modulus, under = soil[:, SoilColumns.kc] / width + soil[:, SoilColumns.kphi], soil.copy()
    under[:, SoilColumns.Ks] = np.where(modulus > 0, modulus, np.nan)
    return under


def _has_moduli(soil: FloatArray) -> bool:
    return not bool(np.isnan(soil[:, SoilColumns.kc]).all())


def offset_of(soil: FloatArray) -> FloatArray:
    """Zero error (n, 1) of the sinkage readings, m, among soil arrays (n, 16)."""
    return soil[:, [SoilColumns.sinkage_offset]]


def model_columns(soil: FloatArray, model: WheelSoilModel) -> FloatArray:
    """Columns (n, k) of soil arrays (n, 16) that a model names."""
    return np.take(soil, [SoilColumns[name] for name in model.parameters], axis=1)


@dataclass(frozen=True)
class Forward:
    """A model held at rows: soil parameters in, outcomes of the drive out.

    Parameters
    ----------
    model : one of the models with its options.
    drive : what is given; ``both`` is ``load`` with the normal force among the outcomes.
    conditions : slip and wheel of every row.
    given : load (N) or sinkage (m) of every row, (m,), or of every parameter set and row, (n, m).
    as_read : sinkages are readings, with the zero error of the instrument; else true ones.
    """

    model: WheelSoilModel
    drive: Drive
    conditions: Conditions
    given: FloatArray
    as_read: bool = False

    @classmethod
    def of(
        cls, model: WheelSoilModel, drive: Drive, observations: Observations, wheels: dict[str, Wheel]
    ) -> Forward:
        """Hold ``model`` at the rows of ``observations``, whose sinkages are readings.

        With a latent load that is the one that a row knows best.
        """
        conditions = Conditions.of([wheels[name] for name in observations.wheel], observations.slip)
        return cls(model, drive, conditions, frozen(drive.given(observations)), as_read=True)

    @property
    def outcomes(self) -> tuple[str, ...]:
        """Names along the last axis of the outcomes."""
        return self.drive.outcomes

    def __call__(self, soil: FloatArray, *, every_row: bool = False) -> Outcomes:
        """Model all rows for soil arrays (n, 16).

        A set that fails in one row has no likelihood, so its other rows may be left without an answer too;
        with ``every_row`` each row that has an answer gets it.
        """
        inputs = self.given - offset_of(soil) if self.drive.by_sinkage and self.as_read else self.given
        values, status = self._answers(soil, inputs, every_row)
        if self.drive.latent_load:  # it is what the normal force reads
            force = np.where(np.isnan(values[:, :, SINKAGE]), np.nan, self.given)
            values = np.insert(values, self.outcomes.index("normal_force"), force, axis=2)
        outcomes = Outcomes(self.outcomes, values, np.max(status, axis=1).astype(np.int64))
        if not self.drive.by_sinkage and self.as_read:
            outcomes.add("sinkage", offset_of(soil))
        return outcomes

    def _answers(self, soil: FloatArray, inputs: FloatArray, every_row: bool) -> tuple[FloatArray, Codes]:
        """Answers of the model (n, m, 3), and its status (n, m)."""
        run = self.drive.answers(self.model)
        groups = list(self.by_wheel(soil))
        if len(groups) == 1:
            return run(groups[0][1], self.conditions, inputs, every_row=every_row)
        values = np.empty((len(soil), len(self.conditions.slip), 3))
        status = np.empty(values.shape[:2], dtype=np.int8)
        for rows, theta in groups:
            part = take(self.conditions, rows)
            values[:, rows], status[:, rows] = run(theta, part, inputs[..., rows], every_row=every_row)
        return values, status

    def by_wheel(self, soil: FloatArray) -> Iterator[tuple[BoolArray, FloatArray]]:
        """Rows (m,) that share the parameters of the model, and these (n, k), for soil arrays (n, 16)."""
        if not _has_moduli(soil):
            yield np.ones(len(self.conditions.slip), dtype=np.bool_), model_columns(soil, self.model)
            return
        for width in np.unique(self.conditions.width):
            yield self.conditions.width == width, model_columns(soil_at(soil, float(width)), self.model)

    def row(self, i: int) -> Forward:
        """The same model at row ``i`` only."""
        chosen = np.arange(len(self.conditions.slip)) == i
        return replace(self, conditions=take(self.conditions, chosen), given=self.given[..., chosen])


def take(conditions: Conditions, rows: BoolArray) -> Conditions:
    """The rows of ``conditions`` in ``rows`` (m,)."""
    return Conditions(**{field.name: getattr(conditions, field.name)[rows] for field in fields(conditions)})
