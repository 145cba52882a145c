"""The inner fits that the paper's methods are made of: one parameter group, one channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.errors import StudyError
from bayesterra.identification.fits import error_figure
from bayesterra.identification.settings import GROUPS, Settings
from bayesterra.identification.solver import Box, Curve, Minimum, minimise
from bayesterra.parameters import CHANNELS, PARAMETERS, SOIL_PARAMETERS

EVALUATIONS = 100
"""Evaluations per parameter of an inner fit, the limit of ``lsqcurvefit``. A fit whose θm/θ1 is clipped may
need them all, for its sum of squares has a kink there."""


@dataclass(frozen=True)
class Step:
    """Fit of one parameter group to one channel.

    Parameters
    ----------
    group : ``P_I``, ``P_II`` or ``P_III``.
    channel : the channel fitted.
    curve : its values (m,) at all rows.
    measured : its readings (m,), NaN where not measured.
    known : (m,) rows in which everything that the curve needs was measured too.
    needs : the channels behind ``known``.
    """

    group: str
    channel: str
    curve: Curve
    measured: FloatArray
    known: BoolArray
    needs: tuple[str, ...]

    def columns(self, settings: Settings) -> list[int]:
        """Columns of the free parameters."""
        return settings.free(GROUPS[self.group])

    def run(self, theta: FloatArray, settings: Settings) -> Minimum:
        """Fit the group from its start values, the other parameters as in ``theta`` (9,)."""
        start, columns = theta.copy(), self.columns(settings)
        start[columns] = settings.start[columns]
        residual = Misfit(self.curve, self.measured, self.known)
        box = Box(settings.lower, settings.upper, columns)
        return minimise(residual, start, box, evaluations=EVALUATIONS * len(columns))

    def error(self, theta: FloatArray) -> float:
        """Error figure (16) in percent, NaN without readings."""
        return error_figure(np.where(self.known, self.measured, np.nan), self.curve.values(theta))


@dataclass(frozen=True)
class Misfit:
    """Residual of one channel relative to its largest reading."""

    curve: Curve
    measured: FloatArray
    known: BoolArray

    @property
    def _scale(self) -> float:
        return float(np.max(np.abs(self.measured[self.known]))) or 1.0

    def values(self, theta: FloatArray) -> FloatArray:
        """Residuals (k,) of the known rows."""
        return (self.curve.values(theta) - self.measured)[self.known] / self._scale

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """Derivatives (k, 9)."""
        return self.curve.jacobian(theta)[self.known] / self._scale


@dataclass(frozen=True)
class Plan:
    """The steps of a method that the data allow, and what that leaves out.

    Attributes
    ----------
    steps : to be fitted, in order.
    judged : all steps with readings, for the error figures.
    missing : parameters that no step can identify.
    notes : why.
    """

    steps: tuple[Step, ...]
    judged: tuple[Step, ...]
    missing: tuple[str, ...]
    notes: tuple[str, ...]

    def columns(self, settings: Settings) -> list[int]:
        """Columns of all parameters that the steps fit."""
        return sorted(column for step in self.steps for column in step.columns(settings))


def plan(method: str, steps: Sequence[Step], settings: Settings) -> Plan:
    """Sort out which steps the data allow.

    Raises
    ------
    StudyError : a step has readings, but fewer than free parameters.
    """
    wanted = [step for step in steps if step.columns(settings)]
    blind = [step for step in wanted if not step.known.any()]
    for step in wanted:
        if step.known.any():
            _check_count(method, step, len(step.columns(settings)))
    missing = {SOIL_PARAMETERS[i] for step in blind for i in step.columns(settings)}
    return Plan(
        tuple(step for step in wanted if step.known.any()),
        tuple(step for step in steps if step.known.any()),
        tuple(name for name in SOIL_PARAMETERS if name in missing),
        tuple(_reason(step, settings) for step in blind),
    )


def _check_count(method: str, step: Step, free: int) -> None:
    count = int(step.known.sum())
    if count < free:
        raise StudyError(
            f"too few observations for {method}: {CHANNELS[step.channel].symbol} has"
            f" {_counted(count, 'reading')}, {_counted(free, 'parameter')}"
        )


def _reason(step: Step, settings: Settings) -> str:
    symbols = ", ".join(PARAMETERS[SOIL_PARAMETERS[i]].symbol for i in step.columns(settings))
    needs = " and ".join(CHANNELS[name].description for name in step.needs)
    return f"{step.group} ({symbols}) was not identified: no row has {needs}"


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
