"""Integral of a row's likelihood over its latent load, compiled, and by NumPy for models that are not.

Compiled: panels of full accuracy are laid over the interval that the search found; one mostly serves. On a panel the
forces are polynomials, so the integrand is cheap, and is summed until twice the places say the same.

By NumPy, over log sinkage between the ends of the loads' range: the integrand is looked at on a grid, which is laid
anew where the weight is until it is well resolved; there it is summed over dW by Gauss's rule in panels. A peak much
narrower than a cell of the first grid counts where its neighbours show it.
"""

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import FloatArray
from bayesterra.likelihood import load_integrand as lv
from bayesterra.likelihood.forward import Forward
from bayesterra.models import kernels as at
from bayesterra.models.forces import NORMAL_FORCE, SINKAGE
from bayesterra.models.kernels import Kind, Lanes, called, inlined
from bayesterra.study.drive import Drive

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


PLACES, ZOOMS = 65, 6
"""Places of a grid, and grids at most."""
DEPTH = 16.0
"""Depth below the highest level, in logs, beyond which there is no weight."""
PANELS, GAUSS = 16, 6
"""Panels of the sum, and nodes of each."""
_X, _W = np.polynomial.legendre.leggauss(GAUSS)
_PANEL_NODES = 0.5 * (1 + _X)
_PANEL_WEIGHTS = np.tile(0.5 * _W, PANELS)
_POWERS = np.vander(_X, increasing=True)
_SLOPES = 2 * np.linalg.solve(_POWERS.T, np.column_stack([np.zeros(GAUSS), _POWERS[:, :-1] * np.arange(1, GAUSS)]).T).T
"""Matrix that takes values at the nodes of a panel to derivatives by its share."""
_DEEPEST = 1.0 - 1e-9  # share of the radius

Levels = Callable[[FloatArray], FloatArray]
"""Log density (n, m) of every row's readings at what the model says there, (n, m, 4)."""


def log_rows(
    forward: Forward, soil: FloatArray, ends: tuple[float, float], levels: Levels, rng: Generator | None
) -> FloatArray:
    """Log likelihood of every row, and a load drawn if there is a source of chance, (n, m, 2).

    Parameters
    ----------
    forward : the model at the rows, loads unknown.
    soil : soil arrays (n, p).
    ends : range (N) of the flat law of the load.
    levels : log density of the readings, given true outcomes.
    """
    held = Forward(forward.model, Drive.LOAD, forward.conditions, forward.given)
    shape = (len(soil), len(forward.given))
    depths = []
    for end in ends:
        depth = held.at_load(end)(soil, every_row=True)["sinkage"]
        depths.append(np.where(np.isnan(depth), _DEEPEST * forward.conditions.radius, depth))
    low, high = np.log(depths[0]), np.log(depths[1])
    answered = held.at_load(ends[0])(soil, every_row=True)["sinkage"] > 0
    for _ in range(ZOOMS):
        log_depth = low + np.linspace(0.0, 1.0, PLACES)[:, None, None] * (high - low)
        values, level = _at(forward, soil, log_depth, levels)
        bar = level.max(axis=0) - DEPTH
        weighty = level >= bar
        first, last = weighty.argmax(axis=0), PLACES - 1 - weighty[::-1].argmax(axis=0)
        if (last - first > PLACES // 2).all():
            break
        low = np.take_along_axis(log_depth, np.maximum(first - 1, 0)[None], 0)[0]
        high = np.take_along_axis(log_depth, np.minimum(last + 1, PLACES - 1)[None], 0)[0]
    panels = _panels(log_depth, values[..., NORMAL_FORCE], level)
    nodes = (panels[:-1, None] + _PANEL_NODES[:, None, None] * np.diff(panels, axis=0)[:, None]).reshape(-1, *shape)
    values, level = _at(forward, soil, nodes, levels)
    growth = np.einsum("ij,kj...->ki...", _SLOPES, values[..., NORMAL_FORCE].reshape(PANELS, GAUSS, *shape))
    level = level + np.log(np.maximum(growth.reshape(level.shape), 1e-300) * _PANEL_WEIGHTS[:, None, None])
    top = level.max(axis=0)
    with np.errstate(invalid="ignore"):
        pieces = np.nan_to_num(np.exp(level - np.where(np.isfinite(top), top, 0.0)))
    total = pieces.sum(axis=0)
    out = np.full((*shape, 2), np.nan)
    with np.errstate(divide="ignore"):
        out[..., 0] = np.where(answered & (total > 0), top + np.log(total) - np.log(ends[1] - ends[0]), -np.inf)
    if rng is not None:
        load = values[..., NORMAL_FORCE]
        edges = np.concatenate([load[:1], 0.5 * (load[1:] + load[:-1]), load[-1:]])
        drawn = _quantile(edges, pieces, rng.random(shape))
        out[..., 1] = np.where(np.isfinite(out[..., 0]), np.clip(drawn, *ends), np.nan)
    return out


def _at(forward: Forward, soil: FloatArray, log_depth: FloatArray, levels: Levels) -> tuple[FloatArray, FloatArray]:
    """Forces (places, n, m, 3) and levels (places, n, m) at log sinkages (places, n, m)."""
    values, level = np.empty((*log_depth.shape, 3)), np.empty(log_depth.shape)
    for k, depth in enumerate(np.exp(log_depth)):
        values[k] = Forward(forward.model, Drive.SINKAGE, forward.conditions, depth)(soil, every_row=True).values
        found = levels(np.insert(values[k], SINKAGE, depth, axis=2))
        level[k] = np.where(np.isnan(found), -np.inf, found)
    return values, level


def _panels(log_depth: FloatArray, load: FloatArray, level: FloatArray) -> FloatArray:
    """Ends (panels + 1, n, m) of panels that halve between even ones and ones of even weight."""
    top = level.max(axis=0)
    with np.errstate(invalid="ignore"):
        density = np.exp(level - np.where(np.isfinite(top), top, 0.0))
        masses = np.nan_to_num(0.5 * (density[1:] + density[:-1]) * np.maximum(np.diff(load, axis=0), 0.0))
        total = masses.sum(axis=0)
    masses = 1.0 / len(masses) + np.where(total > 0, masses / np.where(total > 0, total, 1.0), 0.0)
    shares = np.linspace(0.0, 1.0, PANELS + 1)
    ends = [_quantile(log_depth, masses, np.full(total.shape, share)) for share in shares[1:-1]]
    return np.stack([log_depth[0], *ends, log_depth[-1]])


def _quantile(edges: FloatArray, masses: FloatArray, shares: FloatArray) -> FloatArray:
    """Places (n, m) below which ``shares`` of the masses (k, n, m) lie, each spread evenly between its edges."""
    below = np.cumsum(masses, axis=0)
    below /= np.where(below[-1] > 0, below[-1], 1.0)
    k = np.minimum((below < shares).sum(axis=0), len(masses) - 1)[None]
    before = np.where(k > 0, np.take_along_axis(below, np.maximum(k - 1, 0), 0), 0.0)[0]
    share = (shares - before) / np.maximum(np.take_along_axis(below, k, 0)[0] - before, 1e-300)
    left, right = np.take_along_axis(edges, k, 0)[0], np.take_along_axis(edges, k + 1, 0)[0]
    return np.asarray(left + np.clip(share, 0.0, 1.0) * (right - left))
