"""IM1: groups fitted in turn to the integral model M1 until c1 and c2 stand still (Table 17)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.identification.fits import FORCES
from bayesterra.identification.readings import Readings
from bayesterra.identification.settings import Settings
from bayesterra.identification.steps import Plan, Step
from bayesterra.identification.support import ClippedModel
from bayesterra.likelihood import Forward
from bayesterra.models import M1
from bayesterra.parameters import SOIL_PARAMETERS

MAX_PASSES = 100

STALL = 10
"""Passes without a new smallest change after which the passes are given up."""

_SHEAR = [SOIL_PARAMETERS.index(name) for name in ("c", "phi")]
_ANGLE = {SOIL_PARAMETERS.index(name) for name in ("c1", "c2")}


@dataclass(frozen=True)
class ForceCurve:
    """One force of M1 at all rows, sinkage-driven.

    Parameters
    ----------
    model : M1 at the rows.
    column : index of the force in ``FORCES``.
    shearless : with τ = 0: F_N is then F_Nσ alone, which the first pass fits.
    """

    model: ClippedModel
    column: int
    shearless: bool = False

    def values(self, theta: FloatArray) -> FloatArray:
        """Force (m,)."""
        return self.model.values(self._seen(theta))[:, self.column]

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """Derivatives (m, 9)."""
        return self.model.jacobian(self._seen(theta))[:, self.column]

    def _seen(self, theta: FloatArray) -> FloatArray:
        if not self.shearless:
            return theta
        theta = theta.copy()
        theta[_SHEAR] = 0.0
        return theta


def integral_steps(readings: Readings, model: M1) -> list[Step]:
    """The three inner fits of IM1, in the order of Table 17."""
    clipped = ClippedModel(Forward(model, "sinkage", readings.conditions, readings.sinkage))

    def step(group: str, channel: str) -> Step:
        measured = readings.forces[channel]
        curve = ForceCurve(clipped, FORCES.index(channel))
        return Step(group, channel, curve, measured, ~np.isnan(measured), (channel,))

    return [step("P_I", "normal_force"), step("P_II", "resistance_moment"), step("P_III", "drawbar_pull")]


@dataclass(frozen=True)
class Passes:
    """Parameters (9,) after each pass; whether they came to rest, and with every inner fit at a minimum."""

    path: tuple[FloatArray, ...]
    converged: bool
    rested: bool


def iterate(plan: Plan, settings: Settings) -> Passes:
    """Pass over the steps until c1 and c2 change by less than delta.

    Where c1 and c2 are not both fitted, the other parameters are judged, by their change in widths of their
    bounds. At least two passes are made, because the first one leaves the shear stress out of F_N.
    """
    path = [one_pass(plan, settings.start, settings, first=True)]
    changes: list[float] = []
    while len(path) < MAX_PASSES and len(changes) - _smallest(changes) <= STALL:
        path.append(one_pass(plan, path[-1][0], settings, first=False))
        changes.append(_change(path[-1][0] - path[-2][0], plan, settings))
        if changes[-1] < settings.delta:
            return Passes(tuple(theta for theta, _ in path), path[-1][1], rested=True)
    return Passes(tuple(theta for theta, _ in path), converged=False, rested=False)


def _smallest(changes: list[float]) -> int:
    return int(np.argmin(changes)) if changes else 0


def one_pass(plan: Plan, theta: FloatArray, settings: Settings, *, first: bool) -> tuple[FloatArray, bool]:
    """Parameters after fitting every step once, and whether all of them ended at a minimum."""
    converged = True
    for step in plan.steps:
        minimum = (_shearless(step) if first else step).run(theta, settings)
        theta, converged = minimum.theta, converged and minimum.converged
    return theta, converged


def _shearless(step: Step) -> Step:
    """The step as the first pass makes it: F_N without the shear stress, which is not known yet."""
    if step.group == "P_I" and isinstance(step.curve, ForceCurve):
        return replace(step, curve=replace(step.curve, shearless=True))
    return step


def _change(difference: FloatArray, plan: Plan, settings: Settings) -> float:
    columns = plan.columns(settings)
    if _ANGLE.issubset(columns):
        return float(np.max(np.abs(difference[sorted(_ANGLE)])))
    width = settings.upper - settings.lower
    return float(np.max(np.abs(difference[columns] / width[columns]), initial=0.0))
