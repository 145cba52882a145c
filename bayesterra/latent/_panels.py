"""Compiled search for the part of log sinkage where a row's likelihood has weight.

Panels are laid over log sinkage until nothing of weight can lie outside. Where the integrand turns out to be
narrow between the places of a scan, its height is judged by a parabola, and doubts keep the place in.
"""

import numpy as np

from bayesterra.latent import _levels as lv
from bayesterra.latent._levels import FOUND, LEVEL, T
from bayesterra.models import kernels as at
from bayesterra.models.kernels import Lanes, compiled, inlined

DEPTH = 16.0  # what lies deeper below the highest level, in logs, has no weight
REACH = 1.0  # half-width of the rough panels in log z
CELLS, MOST_CELLS = 16, 1024  # of a scan
SEEN = 4.0  # how far the integrand may rise between places of a scan that shows all there is
MOST = 400  # panels in one direction
BELOW, ABOVE = -1, -2  # the range of the loads

# what a search knows: highest level, and how much higher it may be; interval of weight; ends of the range of
# the load in log N; highest log z; sum of weights, scaled by a level
BEST, SLACK, LOW, HIGH, LOAD_LOW, LOAD_HIGH, TOP, SUM, SUM_TOP = range(FOUND, FOUND + 9)
# levels at the outermost ends of the interval; a uniform number, and the interval of the chosen curve in
# which the drawn load lies; cells of the last scan
LEFT, RIGHT, UNIFORM, FROM, TO, SCANNED = range(FOUND + 9, FOUND + 15)


@compiled
def locate(desk: Lanes, model: int, falls: bool, start: float) -> None:
    """Find the interval of log z outside which the integrand has no weight, beginning at ``start``."""
    forget(desk)
    right = min(start + REACH, desk[TOP])
    left = right - 2.0 * REACH
    going_left, going_right = look(desk, model, (True, falls), left, right)
    for _ in range(MOST):
        if not going_right or right >= desk[TOP]:
            break
        step = min(right + 2.0 * REACH, desk[TOP])
        _, going_right = look(desk, model, (True, falls), right, step)
        right = step
    for _ in range(MOST):
        if not going_left:
            break
        going_left, _ = look(desk, model, (True, falls), left - 2.0 * REACH, left)
        left -= 2.0 * REACH


@inlined
def forget(desk: Lanes) -> None:
    """Begin a search."""
    desk[BEST], desk[SLACK], desk[LOW], desk[HIGH] = lv.NOTHING, 0.0, desk[TOP], desk[TOP]


@compiled
def look(desk: Lanes, model: int, how: tuple[bool, bool], left: float, right: float) -> tuple[bool, bool]:
    """Scan a panel; tell whether there may be weight to its left and to its right.

    ``how`` says whether few nodes suffice, and whether F_N may fall.
    """
    low, high, cells = settle(desk, model, how, left, right)
    desk[SCANNED] = cells
    if high > low:
        _note_weight(desk, cells)
    bottom, top = lv.polynomial(desk, at.LOG_NORMAL, -1.0), lv.polynomial(desk, at.LOG_NORMAL, 1.0)
    bar = desk[BEST] - DEPTH
    to_left = bottom > desk[LOAD_LOW] and _bound(desk, -1.0) > bar
    return to_left, top < desk[LOAD_HIGH] and _bound(desk, 1.0) > bar


@compiled
def _note_weight(desk: Lanes, cells: int) -> None:
    """Join the weighty part of a scan to the interval found before."""
    best, before = highest_level(desk, cells + 1), desk[BEST]
    first, last, slack = weighty(desk, max(best, before) - DEPTH, cells)
    if last < first:
        return
    low = desk[at.MIDDLE] + desk[at.HALF] * desk[T + max(first - 1, 0)]
    high = desk[at.MIDDLE] + desk[at.HALF] * desk[T + min(last + 1, cells)]
    alone = best > before + desk[SLACK] + DEPTH
    desk[LOW] = low if alone else min(desk[LOW], low)
    desk[HIGH] = min(high if alone else max(desk[HIGH], high), desk[TOP])
    desk[SLACK] = slack if alone else max(desk[SLACK], slack)
    desk[BEST] = max(best, before)


@inlined
def weighty(desk: Lanes, bar: float, cells: int) -> tuple[int, int, float]:
    """First and last place of a scan that reaches above a level, and how much higher than seen it may be."""
    first, last, slack = cells + 1, -1, 0.0
    for k in range(cells + 1):
        rise = excess(desk, k, cells + 1)
        if desk[LEVEL + k] + rise > bar:
            first, last, slack = min(first, k), k, max(slack, rise)
    return first, last, slack


@inlined
def highest_level(desk: Lanes, count: int) -> float:
    """Highest of the first ``count`` levels."""
    best = lv.NOTHING
    for k in range(count):
        best = max(best, desk[LEVEL + k])
    return float(best)


@inlined
def excess(desk: Lanes, k: int, count: int) -> float:
    """How far the integrand may rise near a local maximum, by a parabola and some."""
    if desk[LEVEL + k] < max(desk[LEVEL + max(k - 1, 0)], desk[LEVEL + min(k + 1, count - 1)]):
        return 0.0
    centre = min(max(k, 1), count - 2)
    before, here, after = desk[LEVEL + centre - 1], desk[LEVEL + centre], desk[LEVEL + centre + 1]
    bend = 2.0 * here - before - after
    climb = 0.5 * (after - before) + bend * (centre - k)  # slope of the parabola at k
    if bend <= 0.0:
        return 0.0
    outward = climb * (k - centre)  # at an end the peak may lie outside
    if outward > 0.5 * bend:
        return 0.0
    return float((climb * climb / (2.0 * bend) if outward <= 0.0 else 0.0) + 0.25 * bend)


@compiled
def settle(
    desk: Lanes, model: int, how: tuple[bool, bool], left: float, right: float
) -> tuple[float, float, int]:
    """Lay and scan a panel; return places between which the integrand may have weight, and cells between.

    The highest log z is brought down to where F_N stops rising. Equal places: nothing of the loads' range,
    and in place of the cells whether the panel lies ``BELOW`` or ``ABOVE`` it. Ends of that range are only
    looked for where there is weight near them.
    """
    _aim(desk, left, right)
    idle = at.trace(desk, model, how[0])
    if idle > at.DEGREE:
        return 0.0, 0.0, BELOW
    if idle > 0:
        ends = 0.5 * (left + right) + 0.5 * (right - left) * at.POINTS[idle - 1 : idle + 1]
        left = at.carrying_from(desk, model, ends[0], ends[1], np.exp(desk[LOAD_LOW]))
        _aim(desk, left, right)
        at.trace(desk, model, how[0])
    high = 1.0
    if how[1]:
        high = lv.crest_of(desk)
        if high < 1.0:
            desk[TOP] = min(desk[TOP], desk[at.MIDDLE] + desk[at.HALF] * high)
    lowest, highest = desk[LOAD_LOW], desk[LOAD_HIGH]
    if lv.polynomial(desk, at.LOG_NORMAL, -1.0) >= highest:
        return 0.0, 0.0, ABOVE
    if lv.polynomial(desk, at.LOG_NORMAL, high) <= lowest:
        return 0.0, 0.0, BELOW
    cells = scan(desk, -1.0, high)
    first, last, slack = weighty(desk, highest_level(desk, cells + 1) - DEPTH, cells)
    margin = 1 if slack > 1.0 else 0
    begin, end = desk[T + max(first - margin, 0)], desk[T + min(last + margin, cells)]
    cut_low = lv.polynomial(desk, at.LOG_NORMAL, begin) < lowest
    cut_high = lv.polynomial(desk, at.LOG_NORMAL, end) > highest
    if not (cut_low or cut_high):
        return -1.0, high, cells
    low = lv.place_of(desk, lowest, -1.0, high) if lv.polynomial(desk, at.LOG_NORMAL, -1.0) < lowest else -1.0
    if lv.polynomial(desk, at.LOG_NORMAL, high) > highest:
        high = lv.place_of(desk, highest, low, high)
    return low, high, scan(desk, low, high)


@inlined
def _aim(desk: Lanes, left: float, right: float) -> None:
    desk[at.MIDDLE], desk[at.HALF] = 0.5 * (left + right), 0.5 * (right - left)


@compiled
def spread(desk: Lanes, count: int, low: float, high: float) -> None:
    """Fill ``count`` evenly spaced places, both ends included, and the levels there."""
    step = (high - low) / (count - 1)
    for k in range(count):
        desk[T + k] = low + step * k
    lv.fill_levels(desk, count)


@compiled
def scan(desk: Lanes, low: float, high: float) -> int:
    """Spread places until none of the peaks between them is hidden; return the number of cells."""
    cells = CELLS
    while True:
        spread(desk, cells + 1, low, high)
        if cells >= MOST_CELLS or _shows_all(desk, cells):
            return cells
        cells *= 4


@inlined
def _shows_all(desk: Lanes, cells: int) -> bool:
    """Whether no peak that may count rises much between places, as narrow ones do."""
    bar, hidden = highest_level(desk, cells + 1) - DEPTH, False
    for k in range(1, cells):
        rise = excess(desk, k, cells + 1)
        hidden = hidden or (rise > SEEN and desk[LEVEL + k] + 4.0 * rise > bar)
    return not hidden


@compiled
def _bound(desk: Lanes, end: float) -> float:
    """Upper bound of the log integrand beyond an end of the panel, −1 or 1, whatever pull and moment do."""
    total = 2.0 + (desk[LOAD_HIGH] if end > 0 else lv.polynomial(desk, at.LOG_NORMAL, end))
    for channel in range(lv.CHANNELS):
        if channel in (lv.SINKAGE, lv.NORMAL):
            modelled = lv.value(desk, channel, end)
            ahead = lv.spec(desk, channel, lv.READING) - lv.spec(desk, channel, lv.SHIFT) - modelled
            if ahead * end < 0.0:
                total += lv.log_law(desk, channel, modelled)
                continue
        total += lv.log_law_peak(desk, channel)
    return float(total)
