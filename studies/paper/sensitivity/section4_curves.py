"""What the statements of Section 4 are checked on: curves over slip, stresses and refitted soils."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike
from paper_wheels import WHEELS
from scipy.optimize import least_squares
from sensitivity.groups import GROUPS, SECTION_4, Group, Setting, soil_array
from sensitivity.influence import relative_change
from sensitivity.responses import error_figures, respond, respond_groups
from sensitivity.shares import Shares, Stresses, group_shares, stress_distributions

from bayesterra.arrays import FloatArray
from bayesterra.models import M1, SOIL_FIELDS

ALL = tuple(GROUPS.values())
NAMES = tuple(GROUPS)
FIG_5 = ("G1", "G2", "G3", "G11", "G14", "G20")
BEARING = ("G2", "G3", "G4", "G5", "G6", "G7")
SHEARING = ("G10", "G11", "G12", "G13", "G14", "G15")
CONTACT = ("G17", "G18", "G19", "G20", "G21", "G22")
"""Groups in which one parameter of P_I, P_II or P_III differs from G1."""
FINE = Setting(WHEELS["Wh31"], 80.0, np.linspace(0.0, 0.6, 61))


@cache
def shares() -> Shares:
    """Components of the forces of all groups at 61 slips from 0 to 0.6."""
    return group_shares(M1(), ALL, FINE)


def part(name: str) -> dict[str, FloatArray]:
    """A component of the forces, N, over the fine slips, by group."""
    return dict(zip(NAMES, getattr(shares(), name), strict=True))


@cache
def _responses() -> FloatArray:
    return respond_groups(M1(), ALL, FINE).values


def curve(outcome: int) -> dict[str, FloatArray]:
    """Sinkage (0), drawbar pull (1) or resistance moment (2) over the fine slips, SI, by group."""
    return dict(zip(NAMES, _responses()[:, :, outcome], strict=True))


@cache
def errors() -> dict[str, FloatArray]:
    """Errors (16) of each group against G1's response at the paper's slips, percent (z, F_DP, M_DR)."""
    values = respond_groups(M1(), ALL, SECTION_4).values
    return dict(zip(NAMES, 100 * error_figures(values, values[0]), strict=True))


def worst(names: tuple[str, ...], outcome: int) -> tuple[float, str]:
    """Greatest error of some groups and whose it is."""
    return max((float(errors()[name][outcome]), name) for name in names)


def least(names: tuple[str, ...], outcome: int) -> tuple[float, str]:
    """Least error of some groups and whose it is."""
    return min((float(errors()[name][outcome]), name) for name in names)


def stresses(names: tuple[str, ...], depth: ArrayLike | None = None) -> Stresses:
    """Stresses at slip 0.2 under 80 N, or at a given sinkage (m), of some groups."""
    groups, setting = [GROUPS[name] for name in names], Setting(WHEELS["Wh31"], 80.0, np.array([0.2]))
    sinkage = respond_groups(M1(), groups, setting).sinkage if depth is None else np.asarray(depth)
    return stress_distributions(M1(), soil_array(groups), setting.wheel, setting.slips, sinkage)


def rises(curves: dict[str, FloatArray], *names: str, beyond: int = 0) -> bool:
    """Whether curves rise from each name to the next at every slip from the row ``beyond`` on."""
    ordered = np.array([curves[name][beyond:] for name in names])
    return bool((np.diff(ordered, axis=0) > 0).all())


def change_per_change(name: str, kind: tuple[str, ...]) -> float:
    """Root mean square over groups of a force's error (16) against G1 per relative change, as in Table 9."""
    curves = part(name)
    reference = curves["G1"]
    figures = [
        np.abs(curves[each] - reference).max() / reference.max() / relative_change(GROUPS[each]) for each in kind
    ]
    return float(np.sqrt(np.mean(np.square(figures))))


def largest_change(name: str, kind: tuple[str, ...]) -> float:
    """Greatest error (16) of a force against G1 over some groups, percent."""
    curves = part(name)
    return max(100 * float(np.abs(curves[each] - curves["G1"]).max() / curves["G1"].max()) for each in kind)


def off_line(y: FloatArray) -> float:
    """Greatest distance of a curve over the fine slips from its straight line, in percent of its maximum."""
    line = np.polynomial.Polynomial.fit(FINE.slips, y, 1)
    return 100 * float(np.abs(y - line(FINE.slips)).max() / y.max())


def off_exponential(y: FloatArray) -> float:
    """The same from a + b (1 − exp(−s/d)), fitted by least squares."""

    def shape(p: FloatArray) -> FloatArray:
        return np.asarray(p[0] + p[1] * (1 - np.exp(-FINE.slips / p[2])))

    start, ends = [y[0], y[-1] - y[0], 0.1], ([0, 0, 1e-3], np.inf)
    found = least_squares(lambda p: shape(p) - y, start, bounds=ends)
    return 100 * float(np.abs(shape(found.x) - y).max() / y.max())


@dataclass(frozen=True)
class Refit:
    """A soil with some parameters given that was fitted to the curves of a group.

    Attributes
    ----------
    values : of the parameters that were free, in field units.
    errors : eq. (16) against the curves of the group, percent (z, F_DP, M_DR).
    """

    values: tuple[float, ...]
    errors: FloatArray


def refit(target: Group, free: dict[str, tuple[float, float]], **given: float) -> Refit:
    """Fit parameters ``free`` (name: bounds, field units) with others ``given``, the rest as in ``target``.

    Load-driven at the paper's slips; least squares of all three outcomes, each over its greatest value.
    """
    goal = respond_groups(M1(), [target], SECTION_4).values[0]
    places = [SOIL_FIELDS.index(name) for name in free]
    values = np.array(target.values)
    values[[SOIL_FIELDS.index(name) for name in given]] = list(given.values())

    def predicted(p: FloatArray) -> FloatArray:
        values[places] = p
        group = Group("trial", tuple(values.tolist()), (), 0, (0.0, 0.0, 0.0))
        return np.asarray(respond(M1(), soil_array([group]), SECTION_4).values[0])

    def residuals(p: FloatArray) -> FloatArray:
        return np.asarray(((predicted(p) - goal) / goal.max(axis=0)).ravel())

    low, high = np.array(list(free.values())).T
    start = np.clip(values[places], low, high)
    found = least_squares(residuals, start, bounds=(low, high), x_scale=high - low)
    return Refit(tuple(found.x.tolist()), 100 * error_figures(predicted(found.x), goal))
