"""IM1, IM2 and IM3: parameter groups fitted in turn (Ding et al. 2015, Section 5).

The equations of IM2 and IM3 stand in :mod:`bayesterra.models.decoupled`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.errors import StudyError, counted
from bayesterra.least_squares.results import FORCES, error_figure
from bayesterra.least_squares.settings import GROUPS, Readings, Settings
from bayesterra.least_squares.solver import Box, ClippedModel, Curve, Formula, Minimum, emulate, minimise
from bayesterra.likelihood.forward import Forward
from bayesterra.models import M1, WheelSoilModel, decoupled
from bayesterra.parameters import CHANNELS, PARAMETERS, SOIL_PARAMETERS
from bayesterra.study.drive import Drive

EVALUATIONS = 100
"""Evaluations per parameter of an inner fit by ``lsqcurvefit``, its limit: 300 for K_s, n0 and n1, on whose valley
floor a search that is to converge may need more; one cut short ends where rounding has it."""


@dataclass(frozen=True)
class Step:
    """Fit of one parameter group to one channel: its values are misfits, relative to the largest reading or in SI."""

    group: str  # ``P_I``, ``P_II`` or ``P_III``
    channel: str  # the channel fitted
    curve: Curve  # its values (m,) at all rows
    measured: FloatArray  # its readings (m,), NaN where not measured
    complete: BoolArray  # (m,) rows in which everything that the curve needs was measured too
    needs: tuple[str, ...]  # the channels behind ``complete``
    relative: bool = True  # False: misfits in SI, as ``lsqcurvefit`` has them

    def columns(self, settings: Settings) -> list[int]:
        """Columns of the free parameters."""
        return settings.free(GROUPS[self.group])

    def run(self, theta: FloatArray, settings: Settings) -> Minimum:
        """Fit the group from its start values, the other parameters as in ``theta`` (p,)."""
        start, columns = theta.copy(), self.columns(settings)
        start[columns] = settings.start[columns]
        box = Box(settings.lower, settings.upper, columns)
        if settings.solver == "lsqcurvefit":
            return emulate(replace(self, relative=False), start, box, evaluations=EVALUATIONS * len(columns))
        return minimise(self, start, box)

    def error(self, theta: FloatArray) -> float:
        """Error figure (16) in percent, NaN without readings."""
        return error_figure(np.where(self.complete, self.measured, np.nan), self.curve.values(theta))

    @property
    def _scale(self) -> float:
        return (float(np.max(np.abs(self.measured[self.complete]))) or 1.0) if self.relative else 1.0

    def values(self, theta: FloatArray) -> FloatArray:
        """Residuals (k,) of the known rows."""
        return (self.curve.values(theta) - self.measured)[self.complete] / self._scale

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """Derivatives (k, p)."""
        return self.curve.jacobian(theta)[self.complete] / self._scale


@dataclass(frozen=True)
class Plan:
    """The steps of a method that the data allow, and what that leaves out."""

    steps: tuple[Step, ...]  # to be fitted, in order
    judged: tuple[Step, ...]  # all steps with readings, for the error figures
    missing: tuple[str, ...]  # parameters that no step can identify
    notes: tuple[str, ...]  # why

    def columns(self, settings: Settings) -> list[int]:
        """Columns of all parameters that the steps fit."""
        return sorted(column for step in self.steps for column in step.columns(settings))


def plan(method: str, steps: Sequence[Step], settings: Settings) -> Plan:
    """Sort out which steps the data allow; StudyError where a step has readings, but fewer than free parameters."""
    wanted = [step for step in steps if step.columns(settings)]
    blind = [step for step in wanted if not step.complete.any()]
    for step in wanted:
        count, free = int(step.complete.sum()), len(step.columns(settings))
        if 0 < count < free:
            raise StudyError(
                f"too few observations for {method}: {CHANNELS[step.channel].symbol} has"
                f" {counted(count, 'reading')}, {counted(free, 'parameter')}"
            )
    missing = {SOIL_PARAMETERS[i] for step in blind for i in step.columns(settings)}
    return Plan(
        tuple(step for step in wanted if step.complete.any()),
        tuple(step for step in steps if step.complete.any()),
        tuple(name for name in SOIL_PARAMETERS if name in missing),
        tuple(_reason(step, settings) for step in blind),
    )


def _reason(step: Step, settings: Settings) -> str:
    symbols = ", ".join(PARAMETERS[SOIL_PARAMETERS[i]].symbol for i in step.columns(settings))
    needs = " and ".join(CHANNELS[name].description for name in step.needs)
    return f"{step.group} ({symbols}) was not identified: no row has {needs}"


MAX_PASSES = 100

STALL = 10
"""Passes without a new smallest change after which the passes are given up."""

_SHEAR = [SOIL_PARAMETERS.index(name) for name in ("c", "phi")]
_ANGLE = {SOIL_PARAMETERS.index(name) for name in ("c1", "c2")}


@dataclass(frozen=True)
class ForceCurve:
    """One force of M1 at all rows, sinkage-driven."""

    model: ClippedModel  # M1 at the rows
    column: int  # index of the force in ``FORCES``
    group: str  # ``P_I``, ``P_II`` or ``P_III``, whose parameters its derivatives are by
    shearless: bool = False  # with τ = 0: F_N is then F_Nσ alone, which the first pass fits

    def values(self, theta: FloatArray) -> FloatArray:
        """Force (m,)."""
        return self.model.values(self._seen(theta))[:, self.column]

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """Derivatives (m, 9); those by parameters of other groups may be 0."""
        own = [SOIL_PARAMETERS.index(name) for name in GROUPS[self.group]]
        return self.model.jacobian(self._seen(theta), own)[:, self.column]

    def _seen(self, theta: FloatArray) -> FloatArray:
        if not self.shearless:
            return theta
        theta = theta.copy()
        theta[_SHEAR] = 0.0
        return theta


def integral_steps(readings: Readings, model: M1) -> list[Step]:
    """The three inner fits of IM1, in the order of Table 17."""
    clipped = ClippedModel(Forward(model, Drive.SINKAGE, readings.conditions, readings.sinkage))
    fitted = {"P_I": "normal_force", "P_II": "resistance_moment", "P_III": "drawbar_pull"}
    return [
        _step(readings, group, channel, ForceCurve(clipped, FORCES.index(channel), group), (channel,))
        for group, channel in fitted.items()
    ]


def _step(readings: Readings, group: str, channel: str, curve: Curve, needs: tuple[str, ...]) -> Step:
    complete = np.all([~np.isnan(readings.forces[name]) for name in needs], axis=0)
    return Step(group, channel, curve, readings.forces[channel], complete, needs)


@dataclass(frozen=True)
class Passes:
    """Parameters (p,) after each pass; whether they rested, each inner fit at a minimum then; evaluations."""

    path: tuple[FloatArray, ...]
    converged: bool
    rested: bool
    evaluations: int = 0


def iterate(plan: Plan, settings: Settings) -> Passes:
    """Pass over the steps until c1 and c2 change by less than delta.

    Where c1 and c2 are not both fitted, the other parameters are judged, by their change in widths of their
    bounds. At least two passes are made, because the first one leaves the shear stress out of F_N.
    """
    passes = [one_pass(plan, settings.start, settings, first=True)]
    changes: list[float] = []
    while len(passes) < MAX_PASSES and len(changes) - (int(np.argmin(changes)) if changes else 0) <= STALL:
        passes.append(one_pass(plan, passes[-1].path[-1], settings, first=False))
        changes.append(_change(passes[-1].path[-1] - passes[-2].path[-1], plan, settings))
        if changes[-1] < settings.delta:
            break
    rested = bool(changes) and changes[-1] < settings.delta
    path = tuple(each.path[-1] for each in passes)
    return Passes(path, rested and passes[-1].converged, rested, sum(each.evaluations for each in passes))


def one_pass(plan: Plan, theta: FloatArray, settings: Settings, *, first: bool) -> Passes:
    """Parameters after fitting every step once."""
    converged, evaluations = True, 0
    for step in plan.steps:
        minimum = (_shearless(step) if first else step).run(theta, settings)
        theta, converged = minimum.theta, converged and minimum.converged
        evaluations += minimum.evaluations
    return Passes((theta,), converged, rested=True, evaluations=evaluations)


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


BOTH = ("normal_force", "resistance_moment")
EQUATIONS: dict[
    str,
    tuple[tuple[str, str, Callable[[decoupled.Complex, decoupled.Contact], decoupled.Complex], tuple[str, ...]], ...],
] = {
    "IM2": (
        ("P_III", "drawbar_pull", decoupled.drawbar_pull_2, ("drawbar_pull", *BOTH)),
        ("P_I", "normal_force", decoupled.normal_force_2, BOTH),
        ("P_II", "resistance_moment", decoupled.resistance_moment_2, BOTH),
    ),
    "IM3": (
        ("P_III", "drawbar_pull", decoupled.drawbar_pull_3, ("drawbar_pull", *BOTH)),
        ("P_I", "normal_force", decoupled.normal_force_3, ("normal_force",)),
        ("P_II", "resistance_moment", decoupled.resistance_moment_3, BOTH),
    ),
}
"""Group, channel, equation and the channels it needs, in the order of the fits."""


def decoupled_steps(method: str, readings: Readings, model: WheelSoilModel) -> list[Step]:
    """The three fits of IM2 or IM3."""
    forces = readings.forces["normal_force"], readings.forces["resistance_moment"]
    at = decoupled.Contact.of(model, readings.conditions, readings.sinkage, *forces)

    def formula(equation: Callable[[decoupled.Complex, decoupled.Contact], decoupled.Complex]) -> Formula:
        return Formula(lambda theta: equation(theta, at))

    return [
        _step(readings, group, channel, formula(equation), needs)
        for group, channel, equation, needs in EQUATIONS[method]
    ]
