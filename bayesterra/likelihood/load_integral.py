"""Compiled integral of a row's likelihood over its latent load.

Panels of full accuracy are laid over the interval that the search found; one mostly serves. On a panel the
forces are polynomials, so the integrand is cheap, and is summed until twice the places say the same.
"""

from __future__ import annotations

import numpy as np

from bayesterra.likelihood import load_integrand as lv
from bayesterra.likelihood import load_integrand as pn
from bayesterra.likelihood.load_integrand import (
    BEST,
    CELLS,
    CHOSEN,
    DEPTH,
    FROM,
    HIGH,
    LEFT,
    LEVEL,
    LOAD_HIGH,
    LOAD_LOW,
    LOW,
    PANELS,
    PART,
    PARTS,
    RIGHT,
    SCANNED,
    SLACK,
    STACK,
    SUM,
    SUM_TOP,
    TO,
    TOP,
    UNIFORM,
    T,
)
from bayesterra.models import kernels as at
from bayesterra.models.kernels import Lanes, compiled, inlined

EMPTY = 12.0  # depth below which the end of an interval counts as empty
ERROR = 5e-4  # of the log integrand, left by the polynomials: a guess on the high side
FILLED = 6  # cells that a part must fill to be summed as it is
MOST = 2000  # panels before a row is taken as it stands
NARROW, WIDEST = 1e-9, 2.0
CLOSE, CLOSE_PANELS = 0.25, 8  # width in log z of panels that look for a crest, and their number

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_GAUSS = 16


@compiled
def log_integral(workspace: Lanes, model: int, falls: bool, left: float, right: float) -> float:
    """Log of the integral of a row's likelihood over the load; −inf where no load of the range is carried.

    ``workspace`` holds pair, readings, range of the load and highest log z; ``left`` and ``right`` are a
    guess of where in log z the weight lies.
    """
    if _at_once(workspace, model, falls, left, right):
        return float(workspace[SUM_TOP] + np.log(workspace[SUM]))
    pn.locate(workspace, model, falls, 0.5 * (left + right))
    _sum_panels(workspace, model, falls)
    if workspace[SUM] <= 0.0:
        _look_closely(workspace, model, falls)
        _sum_panels(workspace, model, falls)
    return float(workspace[SUM_TOP] + np.log(workspace[SUM])) if workspace[SUM] > 0.0 else -np.inf


@compiled
def _sum_panels(workspace: Lanes, model: int, falls: bool) -> None:
    """Sum over the interval that was found, and over more of it as its ends turn out to be weighty."""
    _clear(workspace)
    if workspace[BEST] <= lv.NOTHING:
        return
    workspace[BEST] = lv.NOTHING  # the rough one may be far too high where noise is small
    todo = _push(workspace, 0, workspace[LOW], workspace[HIGH])
    for _ in range(MOST):
        if todo == 0:
            todo = _widen(workspace)
        if todo == 0:
            break
        todo = _do_panel(workspace, model, falls, todo - 1)


@compiled
def _look_closely(workspace: Lanes, model: int, falls: bool) -> None:
    """Look once more, with full accuracy, for soils that hardly carry more than the lowest load."""
    workspace[TOP] = at.highest(workspace)
    pn.forget(workspace)
    right = workspace[TOP]
    for _ in range(CLOSE_PANELS if falls else 1):
        pn.search(workspace, model, (False, falls), right - CLOSE, right)
        right -= CLOSE


@compiled
def _at_once(workspace: Lanes, model: int, falls: bool, left: float, right: float) -> bool:
    """Try one panel of full accuracy; tell whether all weight lies in it and it is well described."""
    pn.forget(workspace)
    _clear(workspace)
    going_left, going_right = pn.search(workspace, model, (False, falls), left, right)
    if going_left or (going_right and right < workspace[TOP]) or workspace[BEST] <= lv.NOTHING:
        return False
    low = (workspace[LOW] - workspace[at.MIDDLE]) / workspace[at.HALF]
    high = (workspace[HIGH] - workspace[at.MIDDLE]) / workspace[at.HALF]
    filled = high - low >= FILLED * (workspace[T + 1] - workspace[T])
    if filled and workspace[SCANNED] == CELLS and workspace[SLACK] < pn.SEEN:
        _set_part(workspace, 0, low, high)
        workspace[PART + 2], ready = _best_place(workspace, 0, CELLS), 1
    else:
        ready = _find_parts(workspace, low, high)
    if _most_doubt(workspace, ready) > ERROR:
        return False
    _add_parts(workspace, ready)
    return bool(workspace[SUM] > 0.0)


@inlined
def _clear(workspace: Lanes) -> None:
    workspace[SUM], workspace[SUM_TOP], workspace[LEFT], workspace[RIGHT] = (
        0.0,
        lv.NOTHING,
        lv.NOTHING,
        lv.NOTHING,
    )


@inlined
def _push(workspace: Lanes, todo: int, low: float, high: float) -> int:
    if todo < PANELS and high > low:
        workspace[STACK + 2 * todo], workspace[STACK + 2 * todo + 1] = low, high
        todo += 1
    return todo


@compiled
def _widen(workspace: Lanes) -> int:
    """Push panels beyond ends that turned out to be weighty."""
    todo, width, bar = 0, workspace[HIGH] - workspace[LOW], workspace[BEST] - EMPTY
    if workspace[RIGHT] > bar:
        end = min(workspace[HIGH] + width, workspace[TOP])
        todo = _push(workspace, todo, workspace[HIGH], end)
        workspace[HIGH], workspace[RIGHT] = end, lv.NOTHING
    if workspace[LEFT] > bar:
        todo = _push(workspace, todo, workspace[LOW] - width, workspace[LOW])
        workspace[LOW], workspace[LEFT] = workspace[LOW] - width, lv.NOTHING
    return todo


@compiled
def _do_panel(workspace: Lanes, model: int, falls: bool, todo: int) -> int:
    """Sum a panel from the stack, or split it if eight points do not describe it; return what is to do."""
    left, right = workspace[STACK + 2 * todo], workspace[STACK + 2 * todo + 1]
    low, high, cells = pn.solve(workspace, model, (False, falls), left, right)
    if high <= low:
        _note_miss(workspace, left, right, cells)
        return todo
    ready = _find_parts(workspace, low, high)
    wide = right - left > WIDEST or _most_doubt(workspace, ready) > ERROR
    if wide and right - left > NARROW and todo + 2 <= PANELS:
        todo = _push(workspace, todo, left, 0.5 * (left + right))
        return _push(workspace, todo, 0.5 * (left + right), right)
    _add_parts(workspace, ready)
    _note_ends(workspace, left, right, low, high)
    return todo


@inlined
def _note_miss(workspace: Lanes, left: float, right: float, where: int) -> None:
    """Ask for panels beyond an end where the rough forces put a panel short of the loads' range."""
    if where == pn.BELOW and right >= workspace[HIGH] and right < workspace[TOP]:
        workspace[RIGHT] = np.inf
    if where == pn.ABOVE and left <= workspace[LOW]:
        workspace[LEFT] = np.inf


@compiled
def _note_ends(workspace: Lanes, left: float, right: float, low: float, high: float) -> None:
    """Keep the levels at the ends of the interval of weight, if the range of the load goes on beyond."""
    workspace[T], workspace[T + 1] = low, high
    lv.fill_levels(workspace, 2)
    if left <= workspace[LOW]:
        open_end = lv.polynomial(workspace, at.LOG_NORMAL, -1.0) > workspace[LOAD_LOW]
        workspace[LEFT] = workspace[LEVEL] if low == -1.0 and open_end else lv.NOTHING
    if right >= workspace[HIGH]:
        open_end = (
            right < workspace[TOP] and lv.polynomial(workspace, at.LOG_NORMAL, 1.0) < workspace[LOAD_HIGH]
        )
        workspace[RIGHT] = workspace[LEVEL + 1] if high == 1.0 and open_end else lv.NOTHING


@compiled
def _find_parts(workspace: Lanes, low: float, high: float) -> int:
    """Divide a panel into parts narrow about their weight, which then stand first; return how many."""
    ready, end = 0, 1
    _set_part(workspace, 0, low, high)
    while end > ready:
        end -= 1
        low, high = workspace[PART + 4 * end], workspace[PART + 4 * end + 1]
        cells = pn.scan(workspace, low, high)
        workspace[BEST] = max(workspace[BEST], pn.highest_level(workspace, cells + 1))
        first = 0
        while first <= cells and end + 1 < PARTS:
            last = _run(workspace, first, cells)
            if last < first:
                first += 1
                continue
            begin, stop = max(first - 1, 0), min(last + 1, cells)
            place = end
            if stop - begin >= FILLED or high - low < NARROW:
                _set_part(workspace, end, workspace[PART + 4 * ready], workspace[PART + 4 * ready + 1])
                place, ready = ready, ready + 1
            _set_part(workspace, place, workspace[T + begin], workspace[T + stop])
            workspace[PART + 4 * place + 2] = _best_place(workspace, first, last)
            end += 1
            first = last + 3
    return ready


@inlined
def _set_part(workspace: Lanes, i: int, low: float, high: float) -> None:
    workspace[PART + 4 * i], workspace[PART + 4 * i + 1] = low, high


@inlined
def _best_place(workspace: Lanes, first: int, last: int) -> float:
    best = first
    for k in range(first, last + 1):
        best = k if workspace[LEVEL + k] > workspace[LEVEL + best] else best
    return float(workspace[T + best])


@compiled
def _run(workspace: Lanes, first: int, cells: int) -> int:
    """Last of a run of weighty places that begins at ``first``, over gaps of two; less where none begins."""
    bar, last = workspace[BEST] - DEPTH, first - 1
    for k in range(first, cells + 1):
        if k > last + 3 or (k > first and last < first):
            break
        if workspace[LEVEL + k] + pn.excess(workspace, k, cells + 1) > bar:
            last = k
    return last


@compiled
def _most_doubt(workspace: Lanes, ready: int) -> float:
    """Greatest doubt at the highest places of the parts."""
    most = 0.0
    for i in range(ready):
        most = max(most, lv.doubt(workspace, workspace[PART + 4 * i + 2]))
    return most


@compiled
def _add_parts(workspace: Lanes, ready: int) -> None:
    """Add the integrals over parts, and choose one for the drawn load with its share of the sum."""
    for i in range(ready):
        low, high = workspace[PART + 4 * i], workspace[PART + 4 * i + 1]
        pn.spread(workspace, CELLS + 1, low, high)
        top = pn.highest_level(workspace, CELLS + 1)
        empty = max(workspace[LEVEL], workspace[LEVEL + CELLS]) < top - EMPTY
        part = _trapezoid(workspace, top, low, high) if empty else _gauss(workspace, top, low, high)
        part *= workspace[at.HALF]
        if part <= 0.0:
            continue
        if top > workspace[SUM_TOP]:
            workspace[SUM], workspace[SUM_TOP] = workspace[SUM] * np.exp(workspace[SUM_TOP] - top), top
        part *= np.exp(top - workspace[SUM_TOP])
        workspace[SUM] += part
        share = part / workspace[SUM]
        if workspace[UNIFORM] < share:
            workspace[UNIFORM], workspace[FROM], workspace[TO] = workspace[UNIFORM] / share, low, high
            workspace[CHOSEN : CHOSEN + at.CURVE_SIZE] = workspace[at.CURVE : at.CURVE + at.CURVE_SIZE]
        else:
            workspace[UNIFORM] = (workspace[UNIFORM] - share) / (1.0 - share)


@compiled
def _trapezoid(workspace: Lanes, top: float, low: float, high: float) -> float:
    """Sum an integrand that vanishes at both ends; the levels of a scan are in place."""
    total = lv.add_up(workspace, CELLS + 1, top)
    count, step, finest, agreed = (
        CELLS,
        (high - low) / CELLS,
        lv.finest(workspace, low, high),
        _agreed(workspace),
    )
    while True:
        for k in range(count):
            workspace[T + k] = low + (k + 0.5) * step
        lv.fill_levels(workspace, count)
        between = lv.add_up(workspace, count, top)
        change = abs(between - total)
        total, count, step = total + between, 2 * count, 0.5 * step
        if (change < agreed * total and step < finest) or count > lv.PLACES:
            return total * step


@compiled
def _agreed(workspace: Lanes) -> float:
    """Relative change at which a sum is taken: a smooth integrand's finer sum is far better than that."""
    smooth = True
    for channel in range(lv.CHANNELS):
        plain = lv.spec(workspace, channel, lv.FRACTION) == 0.0 and np.isinf(
            lv.spec(workspace, channel, lv.DOF)
        )
        smooth = smooth and plain
    return 3e-3 if smooth else 1e-4


@compiled
def _gauss(workspace: Lanes, top: float, low: float, high: float) -> float:
    """Sum an integrand that is cut off at an end."""
    before, pieces, finest, agreed = 0.0, 1, 4.0 * lv.finest(workspace, low, high), _agreed(workspace)
    while True:
        size = 0.5 * (high - low) / pieces
        for p in range(pieces):
            for k in range(_GAUSS):
                workspace[T + p * _GAUSS + k] = low + size * (2 * p + 1 + _NODES[k])
        lv.fill_levels(workspace, pieces * _GAUSS)
        lv.add_up(workspace, pieces * _GAUSS, top)
        total = 0.0
        for p in range(pieces):
            for k in range(_GAUSS):
                total += size * _WEIGHTS[k] * workspace[LEVEL + p * _GAUSS + k]
        pieces *= 2
        if (abs(total - before) < agreed * total and size < finest) or pieces * _GAUSS > lv.PLACES:
            return total
        before = total


@compiled
def drawn_load(workspace: Lanes) -> float:
    """The load drawn from its law given readings and soil, after :func:`log_integral`."""
    count = 257
    workspace[at.CURVE : at.CURVE + at.CURVE_SIZE] = workspace[CHOSEN : CHOSEN + at.CURVE_SIZE]
    pn.spread(workspace, count, workspace[FROM], workspace[TO])
    lv.add_up(workspace, count, pn.highest_level(workspace, count))
    for k in range(1, count):
        workspace[LEVEL + k - 1] = 0.5 * (workspace[LEVEL + k - 1] + workspace[LEVEL + k])
    total = 0.0
    for k in range(count - 1):
        total += workspace[LEVEL + k]
    aim, k = workspace[UNIFORM] * total, 0
    while k < count - 2 and aim > workspace[LEVEL + k]:
        aim -= workspace[LEVEL + k]
        k += 1
    share = min(aim / max(workspace[LEVEL + k], 1e-300), 1.0)
    t = workspace[T + k] + share * (workspace[T + k + 1] - workspace[T + k])
    return float(np.exp(lv.polynomial(workspace, at.LOG_NORMAL, t)))
