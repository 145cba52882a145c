"""Compiled loops over pairs: gathered into trays of eight lanes by the quadrature rule they need.

A pair's result does not depend on its neighbours: lanes never mix, and the rule follows from the pair alone.
"""

from collections.abc import Sequence

import numpy as np

from bayesterra.models.checks import FloatArray
from bayesterra.models.kernels import lanes as at
from bayesterra.models.kernels.compiler import Lanes, Whole, called, compiled
from bayesterra.models.kernels.evaluation import M1, M2L, Kind, evaluate
from bayesterra.models.kernels.pairs import (
    LOAD,
    NORMAL_FORCE,
    OK,
    Codes,
    Plan,
    load_lane,
    pad,
    scatter,
    screen,
    screen_sinkage,
)
from bayesterra.models.kernels.quadrature import ROUGH, RULES, choose_rule
from bayesterra.models.kernels.solver import can_fall, hand_over, refine, rough_search, search_by_grid, start

_STEP = 1e-40  # of the complex step: so small that its square vanishes


@compiled
def forces(
    theta: FloatArray, rows: FloatArray, sinkage: FloatArray, plan: Plan, out: FloatArray, status: Codes
) -> None:
    """Fill `out` (n, m, 3 or 11) with the results at `sinkage` (n, m); NaN where `status` is not OK."""
    screen(theta, rows, plan, status)
    screen_sinkage(rows, sinkage, plan, status)
    trays, filled = np.zeros((RULES, at.SIZE)), np.zeros(RULES, np.int64)
    place = np.zeros((RULES, at.LANES, 2), np.int64)
    for i in range(status.shape[0]):
        for j in range(status.shape[1]):
            if status[i, j] != OK:
                out[i, j, :] = np.nan
                continue
            row = rows[j + i * plan[1]]
            which = _rule(plan[0], theta[i], row, sinkage[i, j])
            lane = filled[which]
            load_lane(trays[which], lane, plan[0], theta[i], row, sinkage[i, j])
            place[which, lane, 0], place[which, lane, 1] = i, j
            filled[which] = lane + 1
            if filled[which] == at.LANES:
                evaluate(trays[which], plan[0], which)
                _give(trays[which], plan[0], place[which], at.LANES, out, status)
                filled[which] = 0
    for which in range(RULES):
        if filled[which] > 0:
            pad(trays[which], filled[which])
            evaluate(trays[which], plan[0], which)
            _give(trays[which], plan[0], place[which], filled[which], out, status)


@called
def _rule(kind: Kind, theta: FloatArray, row: FloatArray, sinkage: float) -> int:
    """Index of the quadrature rule that a pair needs."""
    return choose_rule(theta, row, sinkage) if len(kind) == M1 else 0


@called
def _has_none(ws: Lanes, kind: Kind, lane: int) -> bool:
    """True where (42) has no normal force for a lane."""
    return bool(ws[at.UNDER_ROOT + lane].real < 0.0) if len(kind) == M2L else False


@called
def _give(ws: Lanes, kind: Kind, place: Whole, filled: int, out: FloatArray, status: Codes) -> None:
    """Copy results to the pairs of a tray, and mark those without a normal force."""
    scatter(ws, place, filled, out)
    for lane in range(filled):
        if _has_none(ws, kind, lane):
            i, j = place[lane, 0], place[lane, 1]
            out[i, j, :] = np.nan
            status[i, j] = NORMAL_FORCE


@compiled
def response(theta: FloatArray, rows: FloatArray, load: FloatArray, plan: Plan, out: FloatArray, status: Codes) -> None:
    """Fill `out` (n, m, 3) with z, F_DP, M_DR under `load` (n, m); NaN where `status` (n, m) is not OK."""
    screen(theta, rows, plan, status)
    trays, filled = np.zeros((RULES + 2, at.SIZE)), np.zeros(RULES + 1, np.int64)
    place = np.zeros((RULES + 1, at.LANES, 2), np.int64)
    for i in range(status.shape[0]):
        for j in range(status.shape[1]):
            if status[i, j] != OK:
                out[i, j, :] = np.nan
                continue
            lane = filled[ROUGH]
            load_lane(trays[ROUGH], lane, plan[0], theta[i], rows[j + i * plan[1]], 0.0)
            trays[ROUGH, at.LOAD + lane] = load[i, j]
            place[ROUGH, lane, 0], place[ROUGH, lane, 1] = i, j
            filled[ROUGH] = lane + 1
            if filled[ROUGH] == at.LANES:
                _come_near(theta, rows, plan, (trays, filled, place), out, status)
    if filled[ROUGH] > 0:
        pad(trays[ROUGH], filled[ROUGH])
        _come_near(theta, rows, plan, (trays, filled, place), out, status)
    for which in range(RULES):
        if filled[which] > 0:
            pad(trays[which], filled[which])
            _settle(trays, (plan[0], which, filled[which]), place[which], out, status)


@called
def _come_near(
    theta: FloatArray, rows: FloatArray, plan: Plan, state: tuple[Lanes, Whole, Whole], out: FloatArray, status: Codes
) -> None:
    """Solve the rough tray with few nodes, and pass its lanes on to the trays of the rules they need."""
    trays, filled, place = state
    rough = trays[ROUGH]
    start(rough)
    rough_search(rough, plan[0])
    for lane in range(filled[ROUGH]):
        i, j = place[ROUGH, lane, 0], place[ROUGH, lane, 1]
        row = rows[j + i * plan[1]]
        which = _rule(plan[0], theta[i], row, np.exp(rough[at.X + lane]))
        slot = filled[which]
        load_lane(trays[which], slot, plan[0], theta[i], row, 0.0)
        hand_over(rough, lane, trays[which], slot)
        place[which, slot, 0], place[which, slot, 1] = i, j
        filled[which] = slot + 1
        if filled[which] == at.LANES:
            _settle(trays, (plan[0], which, at.LANES), place[which], out, status)
            filled[which] = 0
    filled[ROUGH] = 0


@called
def _settle(trays: Lanes, how: tuple[Kind, int, int], place: Whole, out: FloatArray, status: Codes) -> None:
    """Finish the solve of a tray, `how` = (model, rule, lanes filled), and scatter the responses."""
    ws, spare = trays[how[1]], trays[ROUGH + 1]
    refine(ws, how[0], how[1])
    for lane in range(how[2]):
        i, j = place[lane, 0], place[lane, 1]
        tray, spot = ws, lane
        if ws[at.X + lane] == np.inf and can_fall(ws, lane, how[0]):
            search_by_grid(ws, lane, how[0], how[1], spare)
            tray, spot = spare, 0
        out[i, j, 0] = tray[at.Z + spot]
        out[i, j, 1] = tray[at.PULL + spot]
        out[i, j, 2] = tray[at.MOMENT + spot]
        if tray[at.X + spot] == np.inf or _has_none(tray, how[0], spot):
            out[i, j, :] = np.nan
            status[i, j] = LOAD


_DIRECTIONS = np.array((at.KS, at.N0, at.C, at.PHI, at.K, at.C1, at.C3, at.Z))
_COLUMNS = (0, 1, 3, 4, 5, 6, 8, -1)  # of the derivatives by them
_ALSO = {2: 1, 7: 6}  # n1 and c2 act only through n0 + n1 s and c1 + c2 s


def directions_of(columns: Sequence[int] | None) -> Whole:
    """Complex steps (k,) that derivatives in some columns need, -1 being the sinkage; all of them for None.

    At least one, which finds the pairs without a normal force.
    """
    wanted = None if columns is None else {_ALSO.get(column, column) for column in columns}
    chosen = [i for i, column in enumerate(_COLUMNS) if wanted is None or column in wanted]
    return np.array(chosen or [0], dtype=np.int64)


@compiled
def jacobian(
    directions: Whole, theta: FloatArray, rows: FloatArray, sinkage: FloatArray, plan: Plan, out: FloatArray,
    status: Codes,
) -> None:  # fmt: skip
    """Fill `out` (n, m, 3, 10) with derivatives by nine parameters and the sinkage; NaN as in `forces`.

    Complex steps in `directions` (k,), eight side by side; columns of others are 0. The four further parameters of M2L
    stand before the sinkage, (n, m, 3, 14).
    """
    screen(theta, rows, plan, status)
    screen_sinkage(rows, sinkage, plan, status)
    trays, filled = np.zeros((RULES + 1, at.SIZE), np.complex128), np.zeros(RULES, np.int64)
    place = np.zeros((RULES, at.LANES, 3), np.int64)
    for i in range(status.shape[0]):
        for j in range(status.shape[1]):
            out[i, j, :, :] = 0.0 if status[i, j] == OK else np.nan
            if status[i, j] != OK:
                continue
            row = rows[j + i * plan[1]]
            which = _rule(plan[0], theta[i], row, sinkage[i, j])
            _by_effects(trays[RULES], plan[0], theta[i], row, sinkage[i, j], out[i, j])
            for direction in directions:
                lane = filled[which]
                load_lane(trays[which], lane, plan[0], theta[i], row, sinkage[i, j])
                trays[which, _DIRECTIONS[direction] + lane] += 1j * _STEP
                place[which, lane, 0], place[which, lane, 1], place[which, lane, 2] = i, j, direction
                filled[which] = lane + 1
                if filled[which] == at.LANES:
                    _differentiate(trays[which], (plan[0], which, at.LANES), place[which], out, status)
                    filled[which] = 0
    for which in range(RULES):
        if filled[which] > 0:
            pad(trays[which], filled[which])
            _differentiate(trays[which], (plan[0], which, filled[which]), place[which], out, status)


@called
def _differentiate(ws: Lanes, how: tuple[Kind, int, int], place: Whole, out: FloatArray, status: Codes) -> None:
    """Evaluate a tray of complex steps, `how` = (model, rule, lanes filled), and scatter the derivatives."""
    evaluate(ws, how[0], how[1])
    for lane in range(how[2]):
        i, j, column = place[lane, 0], place[lane, 1], _COLUMNS[place[lane, 2]]
        if _has_none(ws, how[0], lane):
            out[i, j, :, :] = np.nan
            status[i, j] = NORMAL_FORCE
            continue
        for f in range(3):
            out[i, j, f, column] = ws[at.RESULTS + f * at.LANES + lane].imag / _STEP
            if column == 1:
                out[i, j, f, 2] = out[i, j, f, 1] * ws[at.EXPONENT_SLIP + lane].real
            elif column == 6:
                out[i, j, f, 7] = out[i, j, f, 6] * ws[at.SLIP + lane].real


@called
def _by_effects(ws: Lanes, kind: Kind, theta: FloatArray, row: FloatArray, sinkage: float, out: FloatArray) -> None:
    """Fill the columns of `out` (3, 14) of the load effect, if any; c_P2 acts only through c_P1 + c_P2 s."""
    if len(kind) == M2L:
        load_lane(ws, 0, kind, theta, row, sinkage)
        pad(ws, 1)
        for lane, q in enumerate((at.CP1, at.CDP, at.CM)):
            ws[q + lane] += 1j * _STEP
        evaluate(ws, kind, 0)
        for lane, column in enumerate((9, 11, 12)):
            for f in range(3):
                out[f, column] = ws[at.RESULTS + f * at.LANES + lane].imag / _STEP
        for f in range(3):  # not by columns: numba compiles assignments of arrays for seconds
            out[f, 10] = out[f, 9] * row[0]
