"""Compiled integral of a row's likelihood over its latent load.

Panels of full accuracy are laid over the interval that the search found; one mostly serves. On a panel the
forces are polynomials, so the integrand is cheap, and is summed until twice the places say the same.
"""

import numpy as np

from bayesterra.likelihood import load_integrand as lv
from bayesterra.models import kernels as at
from bayesterra.models.kernels import Kind, Lanes, called, inlined

EMPTY = 12.0  # depth below which the end of an interval counts as empty
ERROR = 5e-4  # of the log integrand, left by the polynomials: a guess on the high side
FILLED = 6  # cells that a part must fill to be summed as it is
MOST = 2000  # panels before a row is taken as it stands
NARROW, WIDEST = 1e-9, 2.0
CLOSE, CLOSE_PANELS = 0.25, 8  # width in log z of panels that look for a crest, and their number

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_GAUSS = 16


@called
def log_integral(workspace: Lanes, kind: Kind, falls: bool, left: float, right: float) -> float:
    """Log of the integral of a row's likelihood over the load; −inf where no load of the range is carried.

    ``workspace`` holds pair, readings, range of the load and highest log z; ``left`` and ``right`` are a
    guess of where in log z the weight lies.
    """
    if _at_once(workspace, kind, falls, left, right):
        return float(workspace[lv.SUM_TOP] + np.log(workspace[lv.SUM]))
    lv.locate(workspace, kind, falls, 0.5 * (left + right))
    _sum_panels(workspace, kind, falls)
    if workspace[lv.SUM] <= 0.0:
        _look_closely(workspace, kind, falls)
        _sum_panels(workspace, kind, falls)
    return float(workspace[lv.SUM_TOP] + np.log(workspace[lv.SUM])) if workspace[lv.SUM] > 0.0 else -np.inf


@called
def _sum_panels(workspace: Lanes, kind: Kind, falls: bool) -> None:
    """Sum over the interval that was found, and over more of it as its ends turn out to be weighty."""
    _clear(workspace)
    if workspace[lv.BEST] <= lv.NOTHING:
        return
    workspace[lv.BEST] = lv.NOTHING  # the rough one may be far too high where noise is small
    todo = _push(workspace, 0, workspace[lv.LOW], workspace[lv.HIGH])
    for _ in range(MOST):
        if todo == 0:
            todo = _widen(workspace)
        if todo == 0:
            break
        todo = _do_panel(workspace, kind, falls, todo - 1)


@called
def _look_closely(workspace: Lanes, kind: Kind, falls: bool) -> None:
    """Look once more, with full accuracy, for soils that hardly carry more than the lowest load."""
    workspace[lv.TOP] = at.highest(workspace)
    lv.forget(workspace)
    right = workspace[lv.TOP]
    for _ in range(CLOSE_PANELS if falls else 1):
        lv.search(workspace, kind, (False, falls), right - CLOSE, right)
        right -= CLOSE


@called
def _at_once(workspace: Lanes, kind: Kind, falls: bool, left: float, right: float) -> bool:
    """Try one panel of full accuracy; tell whether all weight lies in it and it is well described."""
    lv.forget(workspace)
    _clear(workspace)
    going_left, going_right = lv.search(workspace, kind, (False, falls), left, right)
    if going_left or (going_right and right < workspace[lv.TOP]) or workspace[lv.BEST] <= lv.NOTHING:
        return False
    low = (workspace[lv.LOW] - workspace[at.MIDDLE]) / workspace[at.HALF]
    high = (workspace[lv.HIGH] - workspace[at.MIDDLE]) / workspace[at.HALF]
    filled = high - low >= FILLED * (workspace[lv.T + 1] - workspace[lv.T])
    if filled and workspace[lv.SCANNED] == lv.CELLS and workspace[lv.SLACK] < lv.SEEN:
        _set_part(workspace, 0, low, high)
        workspace[lv.PART + 2], ready = _best_place(workspace, 0, lv.CELLS), 1
    else:
        ready = _find_parts(workspace, low, high)
    if _most_doubt(workspace, ready) > ERROR:
        return False
    _add_parts(workspace, ready)
    return bool(workspace[lv.SUM] > 0.0)


@inlined
def _clear(workspace: Lanes) -> None:
    workspace[lv.SUM] = 0.0
    workspace[lv.SUM_TOP] = workspace[lv.LEFT] = workspace[lv.RIGHT] = lv.NOTHING


@inlined
def _push(workspace: Lanes, todo: int, low: float, high: float) -> int:
    if todo < lv.PANELS and high > low:
        workspace[lv.STACK + 2 * todo], workspace[lv.STACK + 2 * todo + 1] = low, high
        todo += 1
    return todo


@called
def _widen(workspace: Lanes) -> int:
    """Push panels beyond ends that turned out to be weighty."""
    todo, width, bar = 0, workspace[lv.HIGH] - workspace[lv.LOW], workspace[lv.BEST] - EMPTY
    if workspace[lv.RIGHT] > bar:
        end = min(workspace[lv.HIGH] + width, workspace[lv.TOP])
        todo = _push(workspace, todo, workspace[lv.HIGH], end)
        workspace[lv.HIGH], workspace[lv.RIGHT] = end, lv.NOTHING
    if workspace[lv.LEFT] > bar:
        todo = _push(workspace, todo, workspace[lv.LOW] - width, workspace[lv.LOW])
        workspace[lv.LOW], workspace[lv.LEFT] = workspace[lv.LOW] - width, lv.NOTHING
    return todo


@called
def _do_panel(workspace: Lanes, kind: Kind, falls: bool, todo: int) -> int:
    """Sum a panel from the stack, or split it if eight points do not describe it; return what is to do."""
    left, right = workspace[lv.STACK + 2 * todo], workspace[lv.STACK + 2 * todo + 1]
    low, high, cells = lv.solve(workspace, kind, (False, falls), left, right)
    if high <= low:
        _note_miss(workspace, left, right, cells)
        return todo
    ready = _find_parts(workspace, low, high)
    wide = right - left > WIDEST or _most_doubt(workspace, ready) > ERROR
    if wide and right - left > NARROW and todo + 2 <= lv.PANELS:
        todo = _push(workspace, todo, left, 0.5 * (left + right))
        return _push(workspace, todo, 0.5 * (left + right), right)
    _add_parts(workspace, ready)
    _note_ends(workspace, left, right, low, high)
    return todo


@inlined
def _note_miss(workspace: Lanes, left: float, right: float, where: int) -> None:
    """Ask for panels beyond an end where the rough forces put a panel short of the loads' range."""
    if where == lv.BELOW and right >= workspace[lv.HIGH] and right < workspace[lv.TOP]:
        workspace[lv.RIGHT] = np.inf
    if where == lv.ABOVE and left <= workspace[lv.LOW]:
        workspace[lv.LEFT] = np.inf


@called
def _note_ends(workspace: Lanes, left: float, right: float, low: float, high: float) -> None:
    """Keep the levels at the ends of the interval of weight, if the range of the load goes on beyond."""
    workspace[lv.T], workspace[lv.T + 1] = low, high
    lv.fill_levels(workspace, 2)
    if left <= workspace[lv.LOW]:
        open_end = at.polynomial(workspace, at.LOG_NORMAL, -1.0) > workspace[lv.LOAD_LOW]
        workspace[lv.LEFT] = workspace[lv.LEVEL] if low == -1.0 and open_end else lv.NOTHING
    if right >= workspace[lv.HIGH]:
        open_end = at.polynomial(workspace, at.LOG_NORMAL, 1.0) < workspace[lv.LOAD_HIGH]
        open_end = right < workspace[lv.TOP] and open_end
        workspace[lv.RIGHT] = workspace[lv.LEVEL + 1] if high == 1.0 and open_end else lv.NOTHING


@called
def _find_parts(workspace: Lanes, low: float, high: float) -> int:
    """Divide a panel into parts narrow about their weight, which then stand first; return how many."""
    ready, end = 0, 1
    _set_part(workspace, 0, low, high)
    while end > ready:
        end -= 1
        low, high = workspace[lv.PART + 4 * end], workspace[lv.PART + 4 * end + 1]
        cells = lv.scan(workspace, low, high)
        workspace[lv.BEST] = max(workspace[lv.BEST], lv.highest_level(workspace, cells + 1))
        first = 0
        while first <= cells and end + 1 < lv.PARTS:
            last = _run(workspace, first, cells)
            if last < first:
                first += 1
                continue
            begin, stop = max(first - 1, 0), min(last + 1, cells)
            place = end
            if stop - begin >= FILLED or high - low < NARROW:
                _set_part(workspace, end, workspace[lv.PART + 4 * ready], workspace[lv.PART + 4 * ready + 1])
                place, ready = ready, ready + 1
            _set_part(workspace, place, workspace[lv.T + begin], workspace[lv.T + stop])
            workspace[lv.PART + 4 * place + 2] = _best_place(workspace, first, last)
            end += 1
            first = last + 3
    return ready


@inlined
def _set_part(workspace: Lanes, i: int, low: float, high: float) -> None:
    workspace[lv.PART + 4 * i], workspace[lv.PART + 4 * i + 1] = low, high


@inlined
def _best_place(workspace: Lanes, first: int, last: int) -> float:
    best = first
    for k in range(first, last + 1):
        best = k if workspace[lv.LEVEL + k] > workspace[lv.LEVEL + best] else best
    return float(workspace[lv.T + best])


@called
def _run(workspace: Lanes, first: int, cells: int) -> int:
    """Last of a run of weighty places that begins at ``first``, over gaps of two; less where none begins."""
    bar, last = workspace[lv.BEST] - lv.DEPTH, first - 1
    for k in range(first, cells + 1):
        if k > last + 3 or (k > first and last < first):
            break
        if workspace[lv.LEVEL + k] + lv.excess(workspace, k, cells + 1) > bar:
            last = k
    return last


@called
def _most_doubt(workspace: Lanes, ready: int) -> float:
    """Greatest doubt at the highest places of the parts."""
    most = 0.0
    for i in range(ready):
        most = max(most, lv.doubt(workspace, workspace[lv.PART + 4 * i + 2]))
    return most


@called
def _add_parts(workspace: Lanes, ready: int) -> None:
    """Add the integrals over parts, and choose one for the drawn load with its share of the sum."""
    for i in range(ready):
        low, high = workspace[lv.PART + 4 * i], workspace[lv.PART + 4 * i + 1]
        lv.spread(workspace, lv.CELLS + 1, low, high)
        top = lv.highest_level(workspace, lv.CELLS + 1)
        empty = max(workspace[lv.LEVEL], workspace[lv.LEVEL + lv.CELLS]) < top - EMPTY
        part = _trapezoid(workspace, top, low, high) if empty else _gauss(workspace, top, low, high)
        part *= workspace[at.HALF]
        if part <= 0.0:
            continue
        if top > workspace[lv.SUM_TOP]:
            workspace[lv.SUM] *= np.exp(workspace[lv.SUM_TOP] - top)
            workspace[lv.SUM_TOP] = top
        part *= np.exp(top - workspace[lv.SUM_TOP])
        workspace[lv.SUM] += part
        share = part / workspace[lv.SUM]
        if workspace[lv.UNIFORM] < share:
            workspace[lv.UNIFORM] /= share
            workspace[lv.FROM], workspace[lv.TO] = low, high
            for k in range(at.CURVE_SIZE):
                workspace[lv.CHOSEN + k] = workspace[at.CURVE + k]
        else:
            workspace[lv.UNIFORM] = (workspace[lv.UNIFORM] - share) / (1.0 - share)


@called
def _trapezoid(workspace: Lanes, top: float, low: float, high: float) -> float:
    """Sum an integrand that vanishes at both ends; the levels of a scan are in place."""
    total = lv.add_up(workspace, lv.CELLS + 1, top)
    count, step = lv.CELLS, (high - low) / lv.CELLS
    finest, agreed = lv.finest(workspace, low, high), _agreed(workspace)
    while True:
        for k in range(count):
            workspace[lv.T + k] = low + (k + 0.5) * step
        lv.fill_levels(workspace, count)
        between = lv.add_up(workspace, count, top)
        change = abs(between - total)
        total, count, step = total + between, 2 * count, 0.5 * step
        if (change < agreed * total and step < finest) or count > lv.PLACES:
            return total * step


@called
def _agreed(workspace: Lanes) -> float:
    """Relative change at which a sum is taken: a smooth integrand's finer sum is far better than that."""
    smooth = True
    for channel in range(lv.CHANNELS):
        smooth = smooth and lv.spec(workspace, channel, lv.FRACTION) == 0.0
        smooth = smooth and np.isinf(lv.spec(workspace, channel, lv.DOF))
    return 3e-3 if smooth else 1e-4


@called
def _gauss(workspace: Lanes, top: float, low: float, high: float) -> float:
    """Sum an integrand that is cut off at an end."""
    before, pieces, finest, agreed = 0.0, 1, 4.0 * lv.finest(workspace, low, high), _agreed(workspace)
    while True:
        size = 0.5 * (high - low) / pieces
        for p in range(pieces):
            for k in range(_GAUSS):
                workspace[lv.T + p * _GAUSS + k] = low + size * (2 * p + 1 + _NODES[k])
        lv.fill_levels(workspace, pieces * _GAUSS)
        lv.add_up(workspace, pieces * _GAUSS, top)
        total = 0.0
        for p in range(pieces):
            for k in range(_GAUSS):
                total += size * _WEIGHTS[k] * workspace[lv.LEVEL + p * _GAUSS + k]
        pieces *= 2
        if (abs(total - before) < agreed * total and size < finest) or pieces * _GAUSS > lv.PLACES:
            return total
        before = total


@called
def drawn_load(workspace: Lanes) -> float:
    """The load drawn from its law given readings and soil, after :func:`log_integral`."""
    count = 257
    for k in range(at.CURVE_SIZE):
        workspace[at.CURVE + k] = workspace[lv.CHOSEN + k]
    lv.spread(workspace, count, workspace[lv.FROM], workspace[lv.TO])
    lv.add_up(workspace, count, lv.highest_level(workspace, count))
    for k in range(1, count):
        workspace[lv.LEVEL + k - 1] = 0.5 * (workspace[lv.LEVEL + k - 1] + workspace[lv.LEVEL + k])
    total = 0.0
    for k in range(count - 1):
        total += workspace[lv.LEVEL + k]
    aim, k = workspace[lv.UNIFORM] * total, 0
    while k < count - 2 and aim > workspace[lv.LEVEL + k]:
        aim -= workspace[lv.LEVEL + k]
        k += 1
    share = min(aim / max(workspace[lv.LEVEL + k], 1e-300), 1.0)
    t = workspace[lv.T + k] + share * (workspace[lv.T + k + 1] - workspace[lv.T + k])
    return float(np.exp(at.polynomial(workspace, at.LOG_NORMAL, t)))
