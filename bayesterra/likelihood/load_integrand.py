"""Compiled integrand of a row over log sinkage, and the search for where its mass lies.

A row's likelihood is the integral of dW = (dF_N/dx) dx over x = log z of the densities of its readings. Here
t = −1..1 is the place on a curve of :mod:`bayesterra.models.kernels`.

Panels are laid over log sinkage until nothing of weight can lie outside. Where the integrand turns out to be
narrow between the places of a scan, its height is judged by a parabola, and doubts keep the place in.
"""

import numpy as np

from bayesterra.models import kernels as at
from bayesterra.models.kernels import Kind, Lanes, called, exp, inlined, log

SINKAGE, NORMAL, PULL, MOMENT = range(4)
CHANNELS = 4
PLACES = 1024
"""Places at which the integrand can be held at once."""

# A desk is one flat array, so that LLVM can prove that nothing overlaps. Behind the model's lanes and curve
# stand: the row's specification, channel by channel: reading, scale = max(fraction |value|, floor), degrees
# of freedom, highest log density there is, zero error, and −1 or 1 where the reading is a limit
READING, FLOOR, FRACTION, DOF, PEAK, SHIFT, SIDE = range(7)
COLUMNS = 7
SPEC = at.FREE

# what the search knows; the curve that the drawn load lies on; places on the curve at hand, and
# the log integrand and what a channel should read there; intervals that are still to do
FOUND = SPEC + CHANNELS * COLUMNS
CHOSEN = FOUND + 16
T = CHOSEN + at.CURVE_SIZE
LEVEL = T + PLACES + 1
MODELLED = LEVEL + PLACES + 1
STACK = MODELLED + PLACES + 1
PANELS, PARTS = 128, 64
PART = STACK + 2 * PANELS
FINE, FAR, STEPS = 16.0, 40.0, 1281
"""Law of what lies beyond a limit, as a table: steps in a standard deviation, where it begins, how many."""
PLACES_BEYOND = np.arange(STEPS) / FINE - FAR
BEYOND = PART + 4 * PARTS
DESK_SIZE = BEYOND + CHANNELS * STEPS

NOTHING = -1e300


@inlined
def spec(workspace: Lanes, channel: int, column: int) -> float:
    """One entry of the specification of a row."""
    return float(workspace[SPEC + channel * COLUMNS + column])


@inlined
def is_read(workspace: Lanes, channel: int) -> bool:
    """True where a channel was measured."""
    reading = spec(workspace, channel, READING)
    return reading == reading


@inlined
def curve_of(channel: int) -> int:
    """Place where the polynomial of a force begins."""
    return at.LOG_NORMAL if channel == NORMAL else at.PULL if channel == PULL else at.MOMENT


@called
def value(workspace: Lanes, channel: int, t: float) -> float:
    """Reading that a channel should give, without zero error."""
    if channel == SINKAGE:
        return float(exp(workspace[at.MIDDLE] + workspace[at.HALF] * t))
    curve = at.polynomial(workspace, curve_of(channel), t)
    return float(exp(curve) if channel == NORMAL else curve)


@called
def log_law(workspace: Lanes, channel: int, modelled: float) -> float:
    """Log density of a channel's reading; 0 where there is none."""
    if not is_read(workspace, channel):
        return 0.0
    centre = modelled + spec(workspace, channel, SHIFT)
    scale = max(spec(workspace, channel, FRACTION) * abs(centre), spec(workspace, channel, FLOOR))
    r, side = (spec(workspace, channel, READING) - centre) / scale, spec(workspace, channel, SIDE)
    if side != 0.0:
        return beyond(workspace, channel, -side * r)
    dof = spec(workspace, channel, DOF)
    shape = -0.5 * r * r if np.isinf(dof) else -0.5 * (dof + 1.0) * np.log1p(r * r / dof)
    return float(spec(workspace, channel, PEAK) - np.log(scale / spec(workspace, channel, FLOOR)) + shape)


@called
def beyond(workspace: Lanes, channel: int, r: float) -> float:
    """Log probability of a channel's standardised residuals below ``r``, by cubics through its table.

    Farther out it falls as a Gaussian law does, or as a power of ``r``.
    """
    place, first = (r + FAR) * FINE, BEYOND + channel * STEPS
    if place >= STEPS - 2.0:
        return float(workspace[first + STEPS - 1])
    if place < 1.0 and np.isinf(spec(workspace, channel, DOF)):
        return float(np.log1p(-1.0 / (r * r)) - 0.5 * r * r - np.log(-r) - 0.5 * np.log(2.0 * np.pi))
    if place < 1.0:
        growth = (workspace[first + 1] - workspace[first]) * FINE * FAR
        return float(workspace[first] - growth * np.log(-r / FAR))
    k, t = first + int(place), place - int(place)
    a, b, c, d = workspace[k - 1], workspace[k], workspace[k + 1], workspace[k + 2]
    bend = t * (t - 1.0) / 6.0 * ((2.0 - t) * a + (t + 1.0) * d)
    return float(bend + 0.5 * (t + 1.0) * (t - 2.0) * ((t - 1.0) * b - t * c))


@called
def log_law_peak(workspace: Lanes, channel: int) -> float:
    """Highest log density that a channel's reading can have, or log probability of a limit."""
    number = is_read(workspace, channel) and spec(workspace, channel, SIDE) == 0.0
    return float(spec(workspace, channel, PEAK)) if number else 0.0


@called
def fill_levels(workspace: Lanes, count: int) -> None:
    """Fill the log integrand at the first ``count`` places."""
    growth, half = at.powers(workspace, at.LOG_NORMAL), 1.0 / workspace[at.HALF]
    for k in range(count):
        rise = at.derive_powers(growth, workspace[T + k]) * half
        rise = rise if rise > at.FLAT else at.FLAT
        workspace[LEVEL + k] = at.sum_powers(growth, workspace[T + k]) + log(rise)
    for channel in range(CHANNELS):
        if is_read(workspace, channel):
            _fill_modelled(workspace, channel, count)
            _add_law(workspace, channel, count)


@inlined
def _fill_modelled(workspace: Lanes, channel: int, count: int) -> None:
    """Fill what a channel should read at the first ``count`` places."""
    shift = spec(workspace, channel, SHIFT)
    if channel == SINKAGE:
        middle, half = workspace[at.MIDDLE], workspace[at.HALF]
        for k in range(count):
            workspace[MODELLED + k] = exp(middle + half * workspace[T + k]) + shift
        return
    a = at.powers(workspace, curve_of(channel))
    for k in range(count):
        workspace[MODELLED + k] = at.sum_powers(a, workspace[T + k])
    if channel == NORMAL:
        for k in range(count):
            workspace[MODELLED + k] = exp(workspace[MODELLED + k])


@inlined
def _add_law(workspace: Lanes, channel: int, count: int) -> None:
    """Add the log density of a reading, given what it should read."""
    per, fraction = 1.0 / spec(workspace, channel, FLOOR), spec(workspace, channel, FRACTION)
    reading, peak = spec(workspace, channel, READING), spec(workspace, channel, PEAK)
    dof, side = spec(workspace, channel, DOF), spec(workspace, channel, SIDE)
    if side != 0.0:
        for k in range(count):
            workspace[LEVEL + k] += log_law(
                workspace, channel, workspace[MODELLED + k] - spec(workspace, channel, SHIFT)
            )
        return
    if fraction == 0.0:
        for k in range(count):
            workspace[MODELLED + k] = (reading - workspace[MODELLED + k]) * per
    else:
        for k in range(count):
            growth = fraction * per * abs(workspace[MODELLED + k])
            growth = growth if growth > 1.0 else 1.0
            workspace[MODELLED + k] = (reading - workspace[MODELLED + k]) * per / growth
            workspace[LEVEL + k] -= log(growth)
    if np.isinf(dof):
        for k in range(count):
            workspace[LEVEL + k] += peak - 0.5 * workspace[MODELLED + k] * workspace[MODELLED + k]
    else:
        for k in range(count):
            far = 1.0 + workspace[MODELLED + k] * workspace[MODELLED + k] / dof
            workspace[LEVEL + k] += peak - 0.5 * (dof + 1.0) * log(far)


@called
def finest(workspace: Lanes, low: float, high: float) -> float:
    """Distance of places that shows every reading by itself; the whole part where the noise is Gaussian.

    A product of Gaussians is no wider than any of them, and so shows at once how narrow it is; heavy tails
    hide a narrow law inside a wide one.
    """
    step = high - low
    for channel in range(CHANNELS):
        if not is_read(workspace, channel) or np.isinf(spec(workspace, channel, DOF)):
            continue
        for k in range(5):
            t = low + 0.25 * k * (high - low)
            modelled, near = value(workspace, channel, t), value(workspace, channel, t + 1e-4 * (high - low))
            steep = abs(near - modelled) / (1e-4 * (high - low))
            scale = max(spec(workspace, channel, FRACTION) * abs(modelled), spec(workspace, channel, FLOOR))
            step = min(step, 0.7 * scale / max(steep, 1e-300))
    return float(step)


@called
def add_up(workspace: Lanes, count: int, top: float) -> float:
    """Sum of the first ``count`` integrands, scaled by the level ``top``; takes the levels' place."""
    for k in range(count):
        workspace[LEVEL + k] = exp(workspace[LEVEL + k] - top)
    total = 0.0
    for k in range(count):
        total += workspace[LEVEL + k]
    return total


@called
def doubt(workspace: Lanes, t: float) -> float:
    """Estimate the error of the log integrand at ``t`` that the polynomials leave."""
    growth, rise = at.tail(workspace, at.LOG_NORMAL), max(at.slope(workspace, t), at.FLAT)
    total = 16.0 * growth / (workspace[at.HALF] * rise)
    for channel in range(CHANNELS):
        if not is_read(workspace, channel):
            continue
        modelled = value(workspace, channel, t)
        centre = modelled + spec(workspace, channel, SHIFT)
        scale = max(spec(workspace, channel, FRACTION) * abs(centre), spec(workspace, channel, FLOOR))
        error = modelled * growth if channel == NORMAL else modelled * growth / rise  # of an end of the range
        error = error if channel < PULL else at.tail(workspace, curve_of(channel))
        total += (1.0 + abs(spec(workspace, channel, READING) - centre) / scale) * error / scale
    return float(total)


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


@called
def locate(workspace: Lanes, kind: Kind, falls: bool, start: float) -> None:
    """Find the interval of log z outside which the integrand has no weight, beginning at ``start``."""
    forget(workspace)
    right = min(start + REACH, workspace[TOP])
    left = right - 2.0 * REACH
    going_left, going_right = search(workspace, kind, (True, falls), left, right)
    for _ in range(MOST):
        if not going_right or right >= workspace[TOP]:
            break
        step = min(right + 2.0 * REACH, workspace[TOP])
        _, going_right = search(workspace, kind, (True, falls), right, step)
        right = step
    for _ in range(MOST):
        if not going_left:
            break
        going_left, _ = search(workspace, kind, (True, falls), left - 2.0 * REACH, left)
        left -= 2.0 * REACH


@inlined
def forget(workspace: Lanes) -> None:
    """Begin a search."""
    workspace[BEST], workspace[SLACK] = NOTHING, 0.0
    workspace[LOW] = workspace[HIGH] = workspace[TOP]


@called
def search(workspace: Lanes, kind: Kind, how: tuple[bool, bool], left: float, right: float) -> tuple[bool, bool]:
    """Scan a panel; tell whether there may be weight to its left and to its right.

    ``how`` says whether few nodes suffice, and whether F_N may fall.
    """
    low, high, cells = solve(workspace, kind, how, left, right)
    workspace[SCANNED] = cells
    if high > low:
        _note_weight(workspace, cells)
    bottom, top = at.polynomial(workspace, at.LOG_NORMAL, -1.0), at.polynomial(workspace, at.LOG_NORMAL, 1.0)
    bar = workspace[BEST] - DEPTH
    to_left = bottom > workspace[LOAD_LOW] and _bound(workspace, -1.0) > bar
    return to_left, top < workspace[LOAD_HIGH] and _bound(workspace, 1.0) > bar


@called
def _note_weight(workspace: Lanes, cells: int) -> None:
    """Join the weighty part of a scan to the interval found before."""
    best, before = highest_level(workspace, cells + 1), workspace[BEST]
    first, last, slack = weighty(workspace, max(best, before) - DEPTH, cells)
    if last < first:
        return
    low = workspace[at.MIDDLE] + workspace[at.HALF] * workspace[T + max(first - 1, 0)]
    high = workspace[at.MIDDLE] + workspace[at.HALF] * workspace[T + min(last + 1, cells)]
    alone = best > before + workspace[SLACK] + DEPTH
    workspace[LOW] = low if alone else min(workspace[LOW], low)
    workspace[HIGH] = min(high if alone else max(workspace[HIGH], high), workspace[TOP])
    workspace[SLACK] = slack if alone else max(workspace[SLACK], slack)
    workspace[BEST] = max(best, before)


@inlined
def weighty(workspace: Lanes, bar: float, cells: int) -> tuple[int, int, float]:
    """First and last place of a scan that reaches above a level, and how much higher than seen it may be."""
    first, last, slack = cells + 1, -1, 0.0
    for k in range(cells + 1):
        rise = excess(workspace, k, cells + 1)
        if workspace[LEVEL + k] + rise > bar:
            first, last, slack = min(first, k), k, max(slack, rise)
    return first, last, slack


@inlined
def highest_level(workspace: Lanes, count: int) -> float:
    """Highest of the first ``count`` levels."""
    best = NOTHING
    for k in range(count):
        best = max(best, workspace[LEVEL + k])
    return float(best)


@inlined
def excess(workspace: Lanes, k: int, count: int) -> float:
    """Rise of the integrand that is possible near a local maximum, by a parabola and some."""
    if workspace[LEVEL + k] < max(workspace[LEVEL + max(k - 1, 0)], workspace[LEVEL + min(k + 1, count - 1)]):
        return 0.0
    centre = min(max(k, 1), count - 2)
    before, after = workspace[LEVEL + centre - 1], workspace[LEVEL + centre + 1]
    here = workspace[LEVEL + centre]
    bend = 2.0 * here - before - after
    climb = 0.5 * (after - before) + bend * (centre - k)  # slope of the parabola at k
    if bend <= 0.0:
        return 0.0
    outward = climb * (k - centre)  # at an end the peak may lie outside
    if outward > 0.5 * bend:
        return 0.0
    return float((climb * climb / (2.0 * bend) if outward <= 0.0 else 0.0) + 0.25 * bend)


@called
def solve(workspace: Lanes, kind: Kind, how: tuple[bool, bool], left: float, right: float) -> tuple[float, float, int]:
    """Lay and scan a panel; return places between which the integrand may have weight, and cells between.

    The highest log z is brought down to where F_N stops rising. Equal places: nothing of the loads' range,
    and in place of the cells whether the panel lies ``BELOW`` or ``ABOVE`` it. Ends of that range are only
    looked for where there is weight near them.
    """
    _aim(workspace, left, right)
    idle = at.trace(workspace, kind, how[0])
    if idle > at.DEGREE:
        return 0.0, 0.0, BELOW
    if idle > 0:
        ends = 0.5 * (left + right) + 0.5 * (right - left) * at.POINTS[idle - 1 : idle + 1]
        left = at.carrying_from(workspace, kind, ends[0], ends[1], np.exp(workspace[LOAD_LOW]))
        _aim(workspace, left, right)
        at.trace(workspace, kind, how[0])
    high = 1.0
    if how[1]:
        high = at.crest_of(workspace)
        if high < 1.0:
            workspace[TOP] = min(workspace[TOP], workspace[at.MIDDLE] + workspace[at.HALF] * high)
    lowest, highest = workspace[LOAD_LOW], workspace[LOAD_HIGH]
    if at.polynomial(workspace, at.LOG_NORMAL, -1.0) >= highest:
        return 0.0, 0.0, ABOVE
    if at.polynomial(workspace, at.LOG_NORMAL, high) <= lowest:
        return 0.0, 0.0, BELOW
    cells = scan(workspace, -1.0, high)
    first, last, slack = weighty(workspace, highest_level(workspace, cells + 1) - DEPTH, cells)
    margin = 1 if slack > 1.0 else 0
    begin, end = workspace[T + max(first - margin, 0)], workspace[T + min(last + margin, cells)]
    cut_low = at.polynomial(workspace, at.LOG_NORMAL, begin) < lowest
    cut_high = at.polynomial(workspace, at.LOG_NORMAL, end) > highest
    if not (cut_low or cut_high):
        return -1.0, high, cells
    low = -1.0
    if at.polynomial(workspace, at.LOG_NORMAL, low) < lowest:
        low = at.place_of(workspace, lowest, low, high)
    if at.polynomial(workspace, at.LOG_NORMAL, high) > highest:
        high = at.place_of(workspace, highest, low, high)
    return low, high, scan(workspace, low, high)


@inlined
def _aim(workspace: Lanes, left: float, right: float) -> None:
    workspace[at.MIDDLE], workspace[at.HALF] = 0.5 * (left + right), 0.5 * (right - left)


@called
def spread(workspace: Lanes, count: int, low: float, high: float) -> None:
    """Fill ``count`` evenly spaced places, both ends included, and the levels there."""
    step = (high - low) / (count - 1)
    for k in range(count):
        workspace[T + k] = low + step * k
    fill_levels(workspace, count)


@called
def scan(workspace: Lanes, low: float, high: float) -> int:
    """Spread places until none of the peaks between them is hidden; return the number of cells."""
    cells = CELLS
    while True:
        spread(workspace, cells + 1, low, high)
        if cells >= MOST_CELLS or _shows_all(workspace, cells):
            return cells
        cells *= 4


@inlined
def _shows_all(workspace: Lanes, cells: int) -> bool:
    """True where no peak that may count rises much between places, as narrow ones do."""
    bar, hidden = highest_level(workspace, cells + 1) - DEPTH, False
    for k in range(1, cells):
        rise = excess(workspace, k, cells + 1)
        hidden = hidden or (rise > SEEN and workspace[LEVEL + k] + 4.0 * rise > bar)
    return not hidden


@called
def _bound(workspace: Lanes, end: float) -> float:
    """Upper bound of the log integrand beyond an end of the panel, −1 or 1, whatever pull and moment do."""
    total = 2.0 + (workspace[LOAD_HIGH] if end > 0 else at.polynomial(workspace, at.LOG_NORMAL, end))
    for channel in range(CHANNELS):
        if channel in (SINKAGE, NORMAL):
            modelled = value(workspace, channel, end)
            ahead = spec(workspace, channel, SIDE)
            if ahead == 0.0:
                ahead = spec(workspace, channel, READING) - spec(workspace, channel, SHIFT) - modelled
            if ahead * end < 0.0:
                total += log_law(workspace, channel, modelled)
                continue
        total += log_law_peak(workspace, channel)
    return float(total)
