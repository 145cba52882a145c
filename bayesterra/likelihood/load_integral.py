"""Compiled integral of a row's likelihood over its latent load."""

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
def log_integral(desk: Lanes, model: int, falls: bool, left: float, right: float) -> float:
    """Log of the integral of a row's likelihood over the load; −inf where no load of the range is carried.

    ``desk`` holds pair, readings, range of the load and highest log z; ``left`` and ``right`` are a guess of
    where in log z the weight lies.
    """
    if _at_once(desk, model, falls, left, right):
        return float(desk[SUM_TOP] + np.log(desk[SUM]))
    pn.locate(desk, model, falls, 0.5 * (left + right))
    _sum_panels(desk, model, falls)
    if desk[SUM] <= 0.0:
        _look_closely(desk, model, falls)
        _sum_panels(desk, model, falls)
    return float(desk[SUM_TOP] + np.log(desk[SUM])) if desk[SUM] > 0.0 else -np.inf


@compiled
def _sum_panels(desk: Lanes, model: int, falls: bool) -> None:
    """Sum over the interval that was found, and over more of it as its ends turn out to be weighty."""
    _clear(desk)
    if desk[BEST] <= lv.NOTHING:
        return
    desk[BEST] = lv.NOTHING  # the rough one may be far too high where noise is small
    todo = _push(desk, 0, desk[LOW], desk[HIGH])
    for _ in range(MOST):
        if todo == 0:
            todo = _widen(desk)
        if todo == 0:
            break
        todo = _do_panel(desk, model, falls, todo - 1)


@compiled
def _look_closely(desk: Lanes, model: int, falls: bool) -> None:
    """Look once more, with full accuracy, for soils that hardly carry more than the lowest load."""
    desk[TOP] = at.highest(desk)
    pn.forget(desk)
    right = desk[TOP]
    for _ in range(CLOSE_PANELS if falls else 1):
        pn.look(desk, model, (False, falls), right - CLOSE, right)
        right -= CLOSE


@compiled
def _at_once(desk: Lanes, model: int, falls: bool, left: float, right: float) -> bool:
    """Try one panel of full accuracy; tell whether all weight lies in it and it is well described."""
    pn.forget(desk)
    _clear(desk)
    going_left, going_right = pn.look(desk, model, (False, falls), left, right)
    if going_left or (going_right and right < desk[TOP]) or desk[BEST] <= lv.NOTHING:
        return False
    low = (desk[LOW] - desk[at.MIDDLE]) / desk[at.HALF]
    high = (desk[HIGH] - desk[at.MIDDLE]) / desk[at.HALF]
    filled = high - low >= FILLED * (desk[T + 1] - desk[T])
    if filled and desk[SCANNED] == CELLS and desk[SLACK] < pn.SEEN:
        _set_part(desk, 0, low, high)
        desk[PART + 2], ready = _best_place(desk, 0, CELLS), 1
    else:
        ready = _find_parts(desk, low, high)
    if _most_doubt(desk, ready) > ERROR:
        return False
    _add_parts(desk, ready)
    return bool(desk[SUM] > 0.0)


@inlined
def _clear(desk: Lanes) -> None:
    desk[SUM], desk[SUM_TOP], desk[LEFT], desk[RIGHT] = 0.0, lv.NOTHING, lv.NOTHING, lv.NOTHING


@inlined
def _push(desk: Lanes, todo: int, low: float, high: float) -> int:
    if todo < PANELS and high > low:
        desk[STACK + 2 * todo], desk[STACK + 2 * todo + 1] = low, high
        todo += 1
    return todo


@compiled
def _widen(desk: Lanes) -> int:
    """Push panels beyond ends that turned out to be weighty."""
    todo, width, bar = 0, desk[HIGH] - desk[LOW], desk[BEST] - EMPTY
    if desk[RIGHT] > bar:
        end = min(desk[HIGH] + width, desk[TOP])
        todo = _push(desk, todo, desk[HIGH], end)
        desk[HIGH], desk[RIGHT] = end, lv.NOTHING
    if desk[LEFT] > bar:
        todo = _push(desk, todo, desk[LOW] - width, desk[LOW])
        desk[LOW], desk[LEFT] = desk[LOW] - width, lv.NOTHING
    return todo


@compiled
def _do_panel(desk: Lanes, model: int, falls: bool, todo: int) -> int:
    """Sum a panel from the stack, or split it if eight points do not describe it; return what is to do."""
    left, right = desk[STACK + 2 * todo], desk[STACK + 2 * todo + 1]
    low, high, cells = pn.settle(desk, model, (False, falls), left, right)
    if high <= low:
        _note_miss(desk, left, right, cells)
        return todo
    ready = _find_parts(desk, low, high)
    wide = right - left > WIDEST or _most_doubt(desk, ready) > ERROR
    if wide and right - left > NARROW and todo + 2 <= PANELS:
        todo = _push(desk, todo, left, 0.5 * (left + right))
        return _push(desk, todo, 0.5 * (left + right), right)
    _add_parts(desk, ready)
    _note_ends(desk, left, right, low, high)
    return todo


@inlined
def _note_miss(desk: Lanes, left: float, right: float, where: int) -> None:
    """Ask for panels beyond an end where the rough forces put a panel short of the loads' range."""
    if where == pn.BELOW and right >= desk[HIGH] and right < desk[TOP]:
        desk[RIGHT] = np.inf
    if where == pn.ABOVE and left <= desk[LOW]:
        desk[LEFT] = np.inf


@compiled
def _note_ends(desk: Lanes, left: float, right: float, low: float, high: float) -> None:
    """Keep the levels at the ends of the interval of weight, if the range of the load goes on beyond."""
    desk[T], desk[T + 1] = low, high
    lv.fill_levels(desk, 2)
    if left <= desk[LOW]:
        open_end = lv.polynomial(desk, at.LOG_NORMAL, -1.0) > desk[LOAD_LOW]
        desk[LEFT] = desk[LEVEL] if low == -1.0 and open_end else lv.NOTHING
    if right >= desk[HIGH]:
        open_end = right < desk[TOP] and lv.polynomial(desk, at.LOG_NORMAL, 1.0) < desk[LOAD_HIGH]
        desk[RIGHT] = desk[LEVEL + 1] if high == 1.0 and open_end else lv.NOTHING


@compiled
def _find_parts(desk: Lanes, low: float, high: float) -> int:
    """Divide a panel into parts narrow about their weight, which then stand first; return how many."""
    ready, end = 0, 1
    _set_part(desk, 0, low, high)
    while end > ready:
        end -= 1
        low, high = desk[PART + 4 * end], desk[PART + 4 * end + 1]
        cells = pn.scan(desk, low, high)
        desk[BEST] = max(desk[BEST], pn.highest_level(desk, cells + 1))
        first = 0
        while first <= cells and end + 1 < PARTS:
            last = _run(desk, first, cells)
            if last < first:
                first += 1
                continue
            begin, stop = max(first - 1, 0), min(last + 1, cells)
            place = end
            if stop - begin >= FILLED or high - low < NARROW:
                _set_part(desk, end, desk[PART + 4 * ready], desk[PART + 4 * ready + 1])
                place, ready = ready, ready + 1
            _set_part(desk, place, desk[T + begin], desk[T + stop])
            desk[PART + 4 * place + 2] = _best_place(desk, first, last)
            end += 1
            first = last + 3
    return ready


@inlined
def _set_part(desk: Lanes, i: int, low: float, high: float) -> None:
    desk[PART + 4 * i], desk[PART + 4 * i + 1] = low, high


@inlined
def _best_place(desk: Lanes, first: int, last: int) -> float:
    best = first
    for k in range(first, last + 1):
        best = k if desk[LEVEL + k] > desk[LEVEL + best] else best
    return float(desk[T + best])


@compiled
def _run(desk: Lanes, first: int, cells: int) -> int:
    """Last of a run of weighty places that begins at ``first``, over gaps of two; less where none begins."""
    bar, last = desk[BEST] - DEPTH, first - 1
    for k in range(first, cells + 1):
        if k > last + 3 or (k > first and last < first):
            break
        if desk[LEVEL + k] + pn.excess(desk, k, cells + 1) > bar:
            last = k
    return last


@compiled
def _most_doubt(desk: Lanes, ready: int) -> float:
    """Greatest doubt at the highest places of the parts."""
    most = 0.0
    for i in range(ready):
        most = max(most, lv.doubt(desk, desk[PART + 4 * i + 2]))
    return most


@compiled
def _add_parts(desk: Lanes, ready: int) -> None:
    """Add the integrals over parts, and choose one for the drawn load with its share of the sum."""
    for i in range(ready):
        low, high = desk[PART + 4 * i], desk[PART + 4 * i + 1]
        pn.spread(desk, CELLS + 1, low, high)
        top = pn.highest_level(desk, CELLS + 1)
        empty = max(desk[LEVEL], desk[LEVEL + CELLS]) < top - EMPTY
        part = _trapezoid(desk, top, low, high) if empty else _gauss(desk, top, low, high)
        part *= desk[at.HALF]
        if part <= 0.0:
            continue
        if top > desk[SUM_TOP]:
            desk[SUM], desk[SUM_TOP] = desk[SUM] * np.exp(desk[SUM_TOP] - top), top
        part *= np.exp(top - desk[SUM_TOP])
        desk[SUM] += part
        share = part / desk[SUM]
        if desk[UNIFORM] < share:
            desk[UNIFORM], desk[FROM], desk[TO] = desk[UNIFORM] / share, low, high
            desk[CHOSEN : CHOSEN + at.CURVE_SIZE] = desk[at.CURVE : at.CURVE + at.CURVE_SIZE]
        else:
            desk[UNIFORM] = (desk[UNIFORM] - share) / (1.0 - share)


@compiled
def _trapezoid(desk: Lanes, top: float, low: float, high: float) -> float:
    """Sum an integrand that vanishes at both ends; the levels of a scan are in place."""
    total = lv.add_up(desk, CELLS + 1, top)
    count, step, finest, agreed = CELLS, (high - low) / CELLS, lv.finest(desk, low, high), _agreed(desk)
    while True:
        for k in range(count):
            desk[T + k] = low + (k + 0.5) * step
        lv.fill_levels(desk, count)
        between = lv.add_up(desk, count, top)
        change = abs(between - total)
        total, count, step = total + between, 2 * count, 0.5 * step
        if (change < agreed * total and step < finest) or count > lv.PLACES:
            return total * step


@compiled
def _agreed(desk: Lanes) -> float:
    """Relative change at which a sum is taken: a smooth integrand's finer sum is far better than that."""
    smooth = True
    for channel in range(lv.CHANNELS):
        plain = lv.spec(desk, channel, lv.FRACTION) == 0.0 and np.isinf(lv.spec(desk, channel, lv.DOF))
        smooth = smooth and plain
    return 3e-3 if smooth else 1e-4


@compiled
def _gauss(desk: Lanes, top: float, low: float, high: float) -> float:
    """Sum an integrand that is cut off at an end."""
    before, pieces, finest, agreed = 0.0, 1, 4.0 * lv.finest(desk, low, high), _agreed(desk)
    while True:
        size = 0.5 * (high - low) / pieces
        for p in range(pieces):
            for k in range(_GAUSS):
                desk[T + p * _GAUSS + k] = low + size * (2 * p + 1 + _NODES[k])
        lv.fill_levels(desk, pieces * _GAUSS)
        lv.add_up(desk, pieces * _GAUSS, top)
        total = 0.0
        for p in range(pieces):
            for k in range(_GAUSS):
                total += size * _WEIGHTS[k] * desk[LEVEL + p * _GAUSS + k]
        pieces *= 2
        if (abs(total - before) < agreed * total and size < finest) or pieces * _GAUSS > lv.PLACES:
            return total
        before = total


@compiled
def drawn_load(desk: Lanes) -> float:
    """The load drawn from its law given readings and soil, after :func:`log_integral`."""
    count = 257
    desk[at.CURVE : at.CURVE + at.CURVE_SIZE] = desk[CHOSEN : CHOSEN + at.CURVE_SIZE]
    pn.spread(desk, count, desk[FROM], desk[TO])
    lv.add_up(desk, count, pn.highest_level(desk, count))
    for k in range(1, count):
        desk[LEVEL + k - 1] = 0.5 * (desk[LEVEL + k - 1] + desk[LEVEL + k])
    total = 0.0
    for k in range(count - 1):
        total += desk[LEVEL + k]
    aim, k = desk[UNIFORM] * total, 0
    while k < count - 2 and aim > desk[LEVEL + k]:
        aim -= desk[LEVEL + k]
        k += 1
    share = min(aim / max(desk[LEVEL + k], 1e-300), 1.0)
    t = desk[T + k] + share * (desk[T + k + 1] - desk[T + k])
    return float(np.exp(lv.polynomial(desk, at.LOG_NORMAL, t)))
