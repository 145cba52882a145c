"""Compiled polynomials of the forces over log sinkage, for callers that integrate or search along it.

A desk is a workspace of _lanes with room behind it: for a curve, then for whatever the caller needs.
"""

import numpy as np

from bayesterra.models.checks import FloatArray
from bayesterra.models.kernels import lanes as at
from bayesterra.models.kernels.compiler import Lanes, called, inlined
from bayesterra.models.kernels.elementary import exp, log
from bayesterra.models.kernels.evaluation import M1, Kind, evaluate
from bayesterra.models.kernels.pairs import load_lane
from bayesterra.models.kernels.quadrature import ROUGH, choose_rule
from bayesterra.models.kernels.solver import start

DEGREE = at.LANES - 1
CURVE = at.SIZE
MIDDLE, HALF = CURVE, CURVE + 1
LOG_NORMAL, PULL, MOMENT = (CURVE + 2 + i * at.LANES for i in range(3))
CURVE_SIZE = 2 + 3 * at.LANES
FREE = CURVE + CURVE_SIZE

POINTS = -np.cos(np.pi * np.arange(at.LANES) / DEGREE)  # Chebyshev's, with both ends
_POWERS = np.ascontiguousarray(np.linalg.inv(np.vander(POINTS, increasing=True)).T)  # from values to powers of t
_SMALLEST = 1e-300
_BIAS = 0.09  # of the solver's start in log z, which leaves out the shear


@called
def lay(desk: Lanes, kind: Kind, theta: FloatArray, row: FloatArray) -> None:
    """Put one pair into all lanes of a desk."""
    for i in range(at.LANES):
        load_lane(desk, i, kind, theta, row, 0.0)


@called
def trace(desk: Lanes, kind: Kind, rough: bool) -> int:
    """Fill the curve: polynomials in t = (log z - middle)/half of log F_N, F_DP and M_DR over -1 <= t <= 1.

    The curve holds middle and half, the lanes the pair. Returns how many of the eight points, from the
    lowest, lie at or below the highest one where F_N is not positive.
    """
    for i in range(at.LANES):
        desk[at.Z + i] = exp(desk[MIDDLE] + desk[HALF] * POINTS[i])
    which = ROUGH if rough else _rule(desk)
    evaluate(desk, kind, which if len(kind) == M1 else 0)
    idle = 0
    for i in range(at.LANES):
        idle = idle if desk[at.NORMAL + i] > _SMALLEST else i + 1
    for i in range(at.LANES):
        normal = desk[at.NORMAL + i]
        desk[at.F + i] = log(normal if normal > _SMALLEST else _SMALLEST)
    _fit(desk, LOG_NORMAL, at.F)
    _fit(desk, PULL, at.PULL)
    _fit(desk, MOMENT, at.MOMENT)
    return idle


@inlined
def _fit(desk: Lanes, start: int, values: int) -> None:
    """Fill the coefficients from `start` of the polynomial through eight values."""
    for k in range(at.LANES):
        desk[start + k] = 0.0
    for i in range(at.LANES):
        for k in range(at.LANES):
            desk[start + k] += _POWERS[i, k] * desk[values + i]


@called
def _rule(desk: Lanes) -> int:
    """The quadrature rule that serves the lowest and the highest sinkage of a tray."""
    theta, row = (desk[at.INPUTS : at.Z : at.LANES], desk[at.ROW : at.ROW + at.ROW_COLUMNS * at.LANES : at.LANES])
    return max(choose_rule(theta, row, desk[at.Z]), choose_rule(theta, row, desk[at.Z + DEGREE]))


@called
def guess(ws: Lanes, load: float) -> tuple[float, float]:
    """Guess log z at which a pair carries `load`, mostly within 0.2, and d log F_N / d log z there."""
    for i in range(at.LANES):
        ws[at.LOAD + i] = load
    start(ws)
    return float(ws[at.X] + _BIAS), float(ws[at.SLOPE])


@called
def highest(ws: Lanes) -> float:
    """The highest log z of the pair of a tray, just below the wheel's radius."""
    return float(np.log(ws[at.RADIUS] * (1.0 - 1e-9)))


@called
def carrying_from(ws: Lanes, kind: Kind, low: float, high: float, load: float) -> float:
    """A log z where 0 < F_N < `load`, if there is one; F_N <= 0 at `low`, > 0 at `high`."""
    for _ in range(40):
        for i in range(at.LANES):
            ws[at.Z + i] = exp(low + (high - low) * (i + 1.0) / at.LANES)
        evaluate(ws, kind, ROUGH if len(kind) == M1 else 0)
        first = 0
        while first < at.LANES - 1 and ws[at.NORMAL + first] <= _SMALLEST:
            first += 1
        low, high = low + (high - low) * first / at.LANES, low + (high - low) * (first + 1.0) / at.LANES
        if ws[at.NORMAL + first] < load:
            break
    return high
