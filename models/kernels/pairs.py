"""Compiled helpers on (parameter set, row) pairs: screening them, and moving them into and out of lanes."""

import numpy as np
from numpy.typing import NDArray

from bayesterra.models.checks import FloatArray
from bayesterra.models.kernels import lanes as at
from bayesterra.models.kernels.compiler import Lanes, Whole, called
from bayesterra.models.kernels.evaluation import M2L, Kind

Codes = NDArray[np.int8]
Plan = tuple[Kind, int, bool]  # model, rows to move on per parameter set, whether good rows of a bad set count
OK, EXPONENT, CONTACT_ANGLE, LOAD, SINKAGE, NORMAL_FORCE = range(6)  # conditions.Status


@called
def screen(theta: FloatArray, rows: FloatArray, plan: Plan, status: Codes) -> None:
    """Fill `status` (n, m) with what the parameters alone decide."""
    n, m = status.shape
    for i in range(n):
        first = OK
        for j in range(m):
            code = _parameter_status(theta[i], rows[j + i * plan[1]])
            status[i, j] = code
            first = code if first == OK else first
        if first != OK and not plan[2]:
            for j in range(m):
                status[i, j] = first if status[i, j] == OK else status[i, j]


@called
def _parameter_status(theta: FloatArray, row: FloatArray) -> int:
    exponent = theta[1] + theta[2] * row[1]
    ratio = theta[6] + theta[7] * row[0]
    if not 0.0 < exponent < np.inf:
        return EXPONENT
    return OK if -1.0 <= theta[8] < ratio < 1.0 else CONTACT_ANGLE


@called
def screen_sinkage(rows: FloatArray, sinkage: FloatArray, plan: Plan, status: Codes) -> None:
    """Mark the pairs whose sinkage does not lie inside (0, r)."""
    n, m = status.shape
    for i in range(n):
        for j in range(m):
            if status[i, j] == OK and not 0.0 < sinkage[i, j] < rows[j + i * plan[1], 2]:
                status[i, j] = SINKAGE


@called
def load_lane(ws: Lanes, lane: int, kind: Kind, theta: FloatArray, row: FloatArray, sinkage: float) -> None:
    """Copy a parameter set, a row and a sinkage into a lane."""
    for q in range(at.PARAMETERS):
        ws[at.INPUTS + q * at.LANES + lane] = theta[q]
    ws[at.Z + lane] = sinkage
    for q in range(at.ROW_COLUMNS):
        ws[at.ROW + q * at.LANES + lane] = row[q]
    if len(kind) == M2L:
        for q in range(at.EFFECT_PARAMETERS):
            ws[at.EFFECTS + q * at.LANES + lane] = theta[at.PARAMETERS + q]
        ws[at.MEAN_LOAD + lane] = row[at.ROW_COLUMNS]


@called
def pad(ws: Lanes, filled: int) -> None:
    """Repeat the first lane in the empty ones, so that they hold valid numbers."""
    for start in range(0, at.SIZE, at.LANES):
        for lane in range(filled, at.LANES):
            ws[start + lane] = ws[start]


@called
def scatter(ws: Lanes, place: Whole, filled: int, out: FloatArray) -> None:
    """Copy results from the lanes to the pairs they belong to."""
    for lane in range(filled):
        for q in range(out.shape[2]):
            out[place[lane, 0], place[lane, 1], q] = ws[at.RESULTS + q * at.LANES + lane]
