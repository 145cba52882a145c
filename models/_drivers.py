"""Compiled loops over (parameter set, row) pairs: pairs are gathered into lanes, evaluated, and scattered."""

import numpy as np

from bayesterra.models._compiled import compiled
from bayesterra.models._lanes import C1, INPUTS, LANES, LOAD, RESULTS, ROW, ROW_COLUMNS, SIZE, X, Z
from bayesterra.models._quadrature import COUNTS
from bayesterra.models._solve import solve
from bayesterra.models._stress import evaluate
from bayesterra.models.checks import FloatArray
from numpy.typing import NDArray

Codes = NDArray[np.int8]
_PARAMETERS = 9
_STEP = 1e-40  # of the complex step: so small that its square vanishes
_EXPONENT, _ANGLE, _LOAD_CODE, _SINKAGE = 1, 2, 3, 4


@compiled
def set_status(theta: FloatArray, row: FloatArray) -> int:
    """Return EXPONENT or CONTACT_ANGLE where parameters `theta` (9,) do not serve `row`, else OK."""
    exponent = theta[1] + theta[2] * row[1]
    ratio = theta[6] + theta[7] * row[0]
    if not exponent > 0.0:
        return _EXPONENT
    return 0 if -1.0 <= theta[8] < ratio < 1.0 else _ANGLE


@compiled
def screen(theta: FloatArray, rows: FloatArray, plan: tuple[int, int, bool], status: Codes) -> None:
    """Fill `status` (n, m) with what the parameters alone decide; `plan` is (model, row step, every row)."""
    n, m = status.shape
    for i in range(n):
        first = 0
        for j in range(m):
            code = set_status(theta[i], rows[j + i * plan[1]])
            status[i, j] = code
            first = code if first == 0 else first
        if first != 0 and not plan[2]:
            for j in range(m):
                status[i, j] = first if status[i, j] == 0 else status[i, j]


@compiled
def load_lane(ws: FloatArray, lane: int, theta: FloatArray, row: FloatArray) -> None:
    """Copy one parameter set and one row into a lane."""
    for q in range(_PARAMETERS):
        ws[INPUTS + q * LANES + lane] = theta[q]
    for q in range(ROW_COLUMNS):
        ws[ROW + q * LANES + lane] = row[q]


@compiled
def pad(ws: FloatArray, filled: int) -> None:
    """Repeat the first lane in the empty ones, so that they hold valid numbers."""
    for start in range(0, SIZE, LANES):
        for lane in range(filled, LANES):
            ws[start + lane] = ws[start]


@compiled
def choose_rule(ws: FloatArray, lane: int) -> int:
    """Return the index of the smallest quadrature rule that serves a lane."""
    return 0


@compiled
def forces(
    theta: FloatArray, rows: FloatArray, sinkage: FloatArray, plan: tuple[int, int, bool], out: FloatArray,
    status: Codes,
) -> None:
    """Fill `out` (n, m, 3 or 11) with the results at `sinkage` (n, m); NaN where `status` is not OK."""
    screen(theta, rows, plan, status)
    n, m, width = out.shape
    ws = np.zeros((len(COUNTS), SIZE))
    filled = np.zeros(len(COUNTS), np.int64)
    place = np.zeros((len(COUNTS), LANES, 2), np.int64)
    for i in range(n):
        for j in range(m):
            row = rows[j + i * plan[1]]
            if status[i, j] == 0 and not 0.0 < sinkage[i, j] < row[2]:
                status[i, j] = _SINKAGE
            if status[i, j] != 0:
                out[i, j, :] = np.nan
                continue
            load_lane(ws[0], filled[0], theta[i], row)
            ws[0, Z + filled[0]] = sinkage[i, j]
            place[0, filled[0], 0] = i
            place[0, filled[0], 1] = j
            filled[0] += 1
            if filled[0] == LANES:
                evaluate(ws[0], plan[0], 0)
                scatter(ws[0], place[0, : filled[0]], out)
                filled[0] = 0
    if filled[0] > 0:
        pad(ws[0], filled[0])
        evaluate(ws[0], plan[0], 0)
        scatter(ws[0], place[0, : filled[0]], out)


@compiled
def scatter(ws: FloatArray, place: NDArray[np.int64], out: FloatArray) -> None:
    """Copy results from the lanes to where they belong."""
    for lane in range(place.shape[0]):
        for q in range(out.shape[2]):
            out[place[lane, 0], place[lane, 1], q] = ws[RESULTS + q * LANES + lane]


@compiled
def response(
    theta: FloatArray, rows: FloatArray, load: FloatArray, plan: tuple[int, int, bool], out: FloatArray,
    status: Codes,
) -> None:
    """Fill `out` (n, m, 3) with sinkage, F_DP and M_DR under `load` (n, m); NaN where `status` is not OK."""
    screen(theta, rows, plan, status)
    n, m = status.shape
    ws = np.zeros(SIZE)
    place = np.zeros((LANES, 2), np.int64)
    filled = 0
    for i in range(n):
        for j in range(m):
            if status[i, j] != 0:
                out[i, j, :] = np.nan
                continue
            load_lane(ws, filled, theta[i], rows[j + i * plan[1]])
            ws[LOAD + filled] = load[i, j]
            place[filled, 0] = i
            place[filled, 1] = j
            filled += 1
            if filled == LANES:
                settle(ws, plan[0], place[:filled], out, status)
                filled = 0
    if filled > 0:
        pad(ws, filled)
        settle(ws, plan[0], place[:filled], out, status)


@compiled
def settle(ws: FloatArray, model: int, place: NDArray[np.int64], out: FloatArray, status: Codes) -> None:
    """Solve the lanes for their sinkage and scatter the responses."""
    solve(ws, model, 0, 0)
    for lane in range(place.shape[0]):
        i, j = place[lane, 0], place[lane, 1]
        if ws[X + lane] < np.inf:
            out[i, j, 0] = ws[Z + lane]
            out[i, j, 1] = ws[RESULTS + LANES + lane]
            out[i, j, 2] = ws[RESULTS + 2 * LANES + lane]
        else:
            out[i, j, :] = np.nan
            status[i, j] = _LOAD_CODE


@compiled
def jacobian(
    theta: FloatArray, rows: FloatArray, sinkage: FloatArray, plan: tuple[int, int, bool], out: FloatArray,
    status: Codes,
) -> None:
    """Fill `out` (n, m, 3, 10) with derivatives of the forces by the parameters and the sinkage, by complex steps."""
    screen(theta, rows, plan, status)
    n, m = status.shape
    ws = np.zeros(SIZE, np.complex128)
    place = np.zeros((LANES, 2), np.int64)
    filled = 0
    for i in range(n):
        for j in range(m):
            row = rows[j + i * plan[1]]
            if status[i, j] == 0 and not 0.0 < sinkage[i, j] < row[2]:
                status[i, j] = _SINKAGE
            if status[i, j] != 0:
                out[i, j] = np.nan
                continue
            load_lane(ws, filled, theta[i], row)
            ws[Z + filled] = sinkage[i, j]
            place[filled, 0] = i
            place[filled, 1] = j
            filled += 1
            if filled == LANES:
                differentiate(ws, plan[0], place[:filled], out)
                filled = 0
    if filled > 0:
        pad(ws, filled)
        differentiate(ws, plan[0], place[:filled], out)


@compiled
def differentiate(ws: FloatArray, model: int, place: NDArray[np.int64], out: FloatArray) -> None:
    """Take one complex step along each input of the lanes and scatter the derivatives."""
    for q in range(_PARAMETERS + 1):
        for lane in range(LANES):
            ws[INPUTS + q * LANES + lane] += 1j * _STEP
        evaluate(ws, model, 0)
        for lane in range(LANES):
            ws[INPUTS + q * LANES + lane] = ws[INPUTS + q * LANES + lane].real
        for lane in range(place.shape[0]):
            for f in range(3):
                out[place[lane, 0], place[lane, 1], f, q] = ws[RESULTS + f * LANES + lane].imag / _STEP
