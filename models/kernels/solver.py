"""Compiled sinkage solve F_N(z) = W for eight pairs at a time: secant steps in (log z, log F_N), bracketed.

F_N is close to a power of z, so in logarithms the secant converges fast. A few nodes bring the pair near, all
nodes finish; the last step is so small that F_DP and M_DR are carried along it linearly, not evaluated again.

Where F_N does not rise all the way to z = r, a grid is searched for the smallest sinkage that carries the load. Over
the prior box F_N of M1 rises with z wherever c3 >= 0; with c3 < 0 it can start out negative. F_N of M2 and M3 can have
one maximum, beyond z = 0.36 r, when theta_m is close to theta_1.
"""

import numpy as np

from bayesterra.models.kernels import lanes as at
from bayesterra.models.kernels.compiler import Lanes, called, inlined
from bayesterra.models.kernels.elementary import exp, log, root
from bayesterra.models.kernels.evaluation import M1, Kind, evaluate
from bayesterra.models.kernels.quadrature import ROUGH

_MARGIN = 1e-9  # the search ends this far below the radius, relative
_DEPTH = 80.0  # and begins this far below its end in log z
_SMALLEST = 1e-300
_SAME = 1e-11  # points closer than this in log z give no slope
_FLAT = 1e-6  # smallest slope that a secant step uses
_NEAR = 1e-5  # misfit at which few nodes have done their part
_LAST = 3e-8  # largest misfit that one more step, not evaluated again, may remove
_ACCURACY = 1e-11  # of F_N after that step
_ROUGH_STEPS, _STEPS = 10, 100


@called
def start(ws: Lanes) -> None:
    """Guess log z from bearing on a short arc: F_N ~ b K_s z^N sqrt(2 r z) times a mean of (1 - x^2)^N."""
    for i in range(at.LANES):
        n = ws[at.N0 + i] + ws[at.N1 + i] * ws[at.EXPONENT_SLIP + i]
        ratio = ws[at.C1 + i] + ws[at.C2 + i] * ws[at.SLIP + i]
        typical = 0.6 * ratio + 0.4
        shape = (1.0 - ws[at.C3 + i]) * exp(n * log(1.0 - typical * typical))
        scale = ws[at.WIDTH + i] * ws[at.KS + i] * root(2.0 * ws[at.RADIUS + i]) * shape
        top = log(ws[at.RADIUS + i] * (1.0 - _MARGIN))
        guess = log(ws[at.LOAD + i] / scale) / (n + 0.5)
        guess = min(max(guess, top - 0.5 * _DEPTH), top - 0.05)
        ws[at.TOP + i] = top
        ws[at.X + i] = guess
        ws[at.SLOPE + i] = n + 0.5
        ws[at.DOUBT + i] = 1.0
        _forget(ws, i)


@called
def rough_search(ws: Lanes, kind: Kind) -> None:
    """Come near the root with few nodes."""
    for _ in range(_ROUGH_STEPS):
        misfit(ws, kind, ROUGH)
        waiting = 0
        for i in range(at.LANES):
            if ws[at.DONE + i] == 0.0:
                _update_slope(ws, i)
                ws[at.DONE + i] = 1.0 if abs(ws[at.F + i]) < _NEAR or _is_at_top(ws, i) else 0.0
                waiting += int(ws[at.DONE + i] == 0.0)
                _advance(ws, i)
        if waiting == 0:
            return


@called
def hand_over(source: Lanes, lane: int, target: Lanes, slot: int) -> None:
    """Copy a lane's solve into another tray, without its bracket, which few nodes may have got wrong."""
    for q in (at.LOAD, at.X, at.SLOPE, at.DOUBT, at.TOP, at.PULL_SLOPE, at.MOMENT_SLOPE):
        target[q + slot] = source[q + lane]
    _forget(target, slot)


@called
def refine(ws: Lanes, kind: Kind, which: int) -> None:
    """Finish the solve: fill Z, PULL and MOMENT; X = inf where no sinkage carries the load."""
    for _ in range(_STEPS):
        misfit(ws, kind, which)
        waiting = 0
        for i in range(at.LANES):
            if ws[at.DONE + i] == 0.0:
                _update_slope(ws, i)
                if _is_settled(ws, i):
                    ws[at.DONE + i] = 1.0
                else:
                    _advance(ws, i)
                    waiting += 1
        if waiting == 0:
            break
    for i in range(at.LANES):
        _finish(ws, i)


@called
def _forget(ws: Lanes, i: int) -> None:
    """Open the bracket of a lane and drop its previous point."""
    ws[at.LOW + i] = ws[at.TOP + i] - _DEPTH
    ws[at.HIGH + i] = np.inf
    ws[at.X_BEFORE + i] = ws[at.X + i]
    ws[at.STEP + i] = 0.0
    ws[at.DONE + i] = 0.0


@called
def misfit(ws: Lanes, kind: Kind, which: int) -> None:
    """Fill F = log(F_N / W) and the other forces at the current point."""
    for i in range(at.LANES):
        ws[at.Z + i] = exp(ws[at.X + i])
    evaluate(ws, kind, which)
    for i in range(at.LANES):
        normal = ws[at.NORMAL + i]
        ws[at.F + i] = log((normal if normal > _SMALLEST else _SMALLEST) / ws[at.LOAD + i])


@inlined
def _update_slope(ws: Lanes, i: int) -> None:
    """Take the slopes between the last two points of a lane, where these differ.

    On a parabola two secants in a row differ in proportion to the steps they span together, and the second
    differs from the slope at its end in proportion to its own: that is the doubt.
    """
    dx = ws[at.X + i] - ws[at.X_BEFORE + i]
    if abs(dx) > _SAME:
        slope = (ws[at.F + i] - ws[at.F_BEFORE + i]) / dx
        usable = slope > _FLAT
        share = abs(dx) / (abs(dx) + ws[at.STEP + i])
        doubt = max(abs(1.0 - ws[at.SLOPE + i] / slope) * share, 0.01 * abs(dx)) if usable else 1.0
        ws[at.DOUBT + i] = min(1.0, doubt)
        ws[at.STEP + i] = abs(dx)
        ws[at.SLOPE + i] = slope if usable else _FLAT
        ws[at.PULL_SLOPE + i] = (ws[at.PULL + i] - ws[at.PULL_BEFORE + i]) / dx
        ws[at.MOMENT_SLOPE + i] = (ws[at.MOMENT + i] - ws[at.MOMENT_BEFORE + i]) / dx


@inlined
def _is_at_top(ws: Lanes, i: int) -> bool:
    """True where a lane has shown that no sinkage below the radius carries its load."""
    return bool(ws[at.X + i] >= ws[at.TOP + i] and ws[at.F + i] < -_ACCURACY)


@inlined
def _is_settled(ws: Lanes, i: int) -> bool:
    """True where one more step, not evaluated, meets the load: misfit times error of the slope is small."""
    misfit, slope = abs(ws[at.F + i]), ws[at.SLOPE + i]
    is_near = misfit < _LAST * min(1.0, slope) and misfit * ws[at.DOUBT + i] < _ACCURACY
    return is_near or _is_at_top(ws, i)


@inlined
def _advance(ws: Lanes, i: int) -> None:
    """Move a lane by a secant step; outside the bracket, to its middle or to the highest sinkage."""
    x, f, top = ws[at.X + i], ws[at.F + i], ws[at.TOP + i]
    if f < 0.0:
        ws[at.LOW + i] = x
    else:
        ws[at.HIGH + i] = x
    low, high = ws[at.LOW + i], ws[at.HIGH + i]
    step = x - f / ws[at.SLOPE + i]
    if not low < step < high:
        step = top if step >= high > top else 0.5 * (low + min(high, top))
    ws[at.X_BEFORE + i], ws[at.F_BEFORE + i] = x, f
    ws[at.PULL_BEFORE + i], ws[at.MOMENT_BEFORE + i] = ws[at.PULL + i], ws[at.MOMENT + i]
    ws[at.X + i] = min(step, top)


@inlined
def _finish(ws: Lanes, i: int) -> None:
    """Take the last step of a lane and carry the forces along; X = inf where the load is not carried."""
    move = -ws[at.F + i] / ws[at.SLOPE + i]
    ws[at.Z + i] *= 1.0 + move
    ws[at.PULL + i] += ws[at.PULL_SLOPE + i] * move
    ws[at.MOMENT + i] += ws[at.MOMENT_SLOPE + i] * move
    if ws[at.DONE + i] == 0.0 or _is_at_top(ws, i):
        ws[at.X + i] = np.inf


_GRID_DEPTH = 12.0  # the grid begins this far below the radius in log z
_ROUNDS = 40
_NARROW = 1e-10


@called
def can_fall(ws: Lanes, lane: int, kind: Kind) -> bool:
    """True where F_N of a lane may be larger below z = r than at it."""
    return len(kind) != M1 or ws[at.C3 + lane] < 0.0


@called
def search_by_grid(ws: Lanes, lane: int, kind: Kind, which: int, tray: Lanes) -> None:
    """Fill `tray` with the solution of one lane, the same in all lanes; X = inf where F_N stays below the load."""
    for start in range(0, at.SIZE, at.LANES):
        for i in range(at.LANES):
            tray[start + i] = ws[start + lane]
    low, high = tray[at.TOP] - _GRID_DEPTH, tray[at.TOP]
    for _ in range(_ROUNDS):
        _lay_grid(tray, low, high)
        misfit(tray, kind, which)
        carrying = _first_carrying(tray)
        if carrying < at.LANES:
            _bracket(tray, carrying)
            refine(tray, kind, which)
            return
        peak = 0
        for i in range(1, at.LANES):
            peak = i if tray[at.F + i] > tray[at.F + peak] else peak
        low, high = tray[at.X + max(peak - 1, 0)], tray[at.X + min(peak + 1, at.LANES - 1)]
        if high - low < _NARROW:
            break
    tray[at.X] = np.inf


@called
def _lay_grid(tray: Lanes, low: float, high: float) -> None:
    for i in range(at.LANES):
        tray[at.X + i] = low + (high - low) * i / (at.LANES - 1)


@called
def _first_carrying(tray: Lanes) -> int:
    for i in range(at.LANES):
        if tray[at.F + i] >= 0.0:
            return i
    return at.LANES


@called
def _bracket(tray: Lanes, carrying: int) -> None:
    """Start all lanes between the first grid point that carries the load and the one before it."""
    high = tray[at.X + carrying]
    low = tray[at.X + carrying - 1] if carrying > 0 else high - _GRID_DEPTH
    for i in range(at.LANES):
        tray[at.LOW + i], tray[at.HIGH + i] = low, high
        tray[at.X + i] = tray[at.X_BEFORE + i] = 0.5 * (low + high)
        tray[at.SLOPE + i], tray[at.DOUBT + i], tray[at.DONE + i] = 1.0, 1.0, 0.0
