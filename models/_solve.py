"""Compiled sinkage solve: F_N(z) = W for eight pairs at a time."""

import numpy as np

from bayesterra.models._compiled import compiled
from bayesterra.models._elementary import exp, log
from bayesterra.models._lanes import (
    C1, C2, C3, DONE, EXPONENT_SLIP, F, F_BEFORE, HIGH, KS, LANES, LOAD, LOW, MOMENT, MOMENT_BEFORE, N0, N1, NORMAL,
    PULL, PULL_BEFORE, RADIUS, SLIP, SLOPE, TOP, WIDTH, X, X_BEFORE, Z,
)  # fmt: skip
from bayesterra.models._stress import evaluate
from bayesterra.models.checks import FloatArray

_MARGIN = 1e-9  # the search ends this far below the radius, relative
_DEPTH = 80.0  # and starts this far below it in log z
_SMALLEST = 1e-300
_SAME = 1e-11  # points closer than this in log z give no slope
_ROUGH, _FINE, _FINAL = 1e-4, 1e-7, 1e-11
_ROUGH_STEPS, _FINE_STEPS = 12, 100


@compiled
def start(ws: FloatArray) -> None:
    """Guess log z from the bearing part alone on a short arc, F_N ~ b K_s z^N sqrt(2 r z) * shape."""
    for i in range(LANES):
        n = ws[N0 + i] + ws[N1 + i] * ws[EXPONENT_SLIP + i]
        ratio = ws[C1 + i] + ws[C2 + i] * ws[SLIP + i]
        middle = 1.0 - (0.6 * ratio + 0.4) * (0.6 * ratio + 0.4)
        shape = (1.0 - ws[C3 + i]) * exp(n * log(middle))
        scale = ws[WIDTH + i] * ws[KS + i] * np.sqrt(2.0 * ws[RADIUS + i]) * shape
        ws[TOP + i] = log(ws[RADIUS + i] * (1.0 - _MARGIN))
        guess = log(ws[LOAD + i] / scale) / (n + 0.5)
        top = ws[TOP + i] - 0.05
        bottom = ws[TOP + i] - 0.5 * _DEPTH
        guess = top if guess > top else guess
        ws[X + i] = bottom if guess < bottom else guess
        ws[SLOPE + i] = n + 0.5
        reset(ws, i)


@compiled
def reset(ws: FloatArray, i: int) -> None:
    """Forget the bracket and the previous point of a lane."""
    ws[LOW + i] = ws[TOP + i] - _DEPTH
    ws[HIGH + i] = ws[TOP + i] + 1.0
    ws[X_BEFORE + i] = ws[X + i]
    ws[F_BEFORE + i] = 0.0
    ws[DONE + i] = 0.0


@compiled
def misfit(ws: FloatArray, model: int, which: int) -> None:
    """Fill F = log(F_N / W) at the current point."""
    for i in range(LANES):
        ws[Z + i] = exp(ws[X + i])
    evaluate(ws, model, which)
    for i in range(LANES):
        normal = ws[NORMAL + i]
        ws[F + i] = log((normal if normal > _SMALLEST else _SMALLEST) / ws[LOAD + i])


@compiled
def update_slope(ws: FloatArray, i: int) -> None:
    """Update the secant slope of a lane where its last two points differ."""
    dx = ws[X + i] - ws[X_BEFORE + i]
    if abs(dx) > _SAME:
        slope = (ws[F + i] - ws[F_BEFORE + i]) / dx
        if 0.02 < slope < 100.0:
            ws[SLOPE + i] = slope


@compiled
def advance(ws: FloatArray, i: int) -> None:
    """Move a lane to its next point: the secant step, or a safeguarded one where that leaves the bracket."""
    x, f = ws[X + i], ws[F + i]
    if f < 0.0:
        ws[LOW + i] = x
    else:
        ws[HIGH + i] = x
    low, high = ws[LOW + i], ws[HIGH + i]
    step = x - f / ws[SLOPE + i]
    if not low < step < high:
        step = 0.5 * (low + (high if high <= ws[TOP + i] else ws[TOP + i]))
        if f < 0.0 and high > ws[TOP + i]:
            step = ws[TOP + i]
    elif step > ws[TOP + i]:
        step = ws[TOP + i]
    ws[X_BEFORE + i], ws[F_BEFORE + i] = x, f
    ws[PULL_BEFORE + i], ws[MOMENT_BEFORE + i] = ws[PULL + i], ws[MOMENT + i]
    ws[X + i] = step


@compiled
def search(ws: FloatArray, model: int, which: int, tolerance: float, steps: int) -> None:
    """Iterate until every lane's misfit is small, or shows that it cannot be carried."""
    for step in range(steps):
        misfit(ws, model, which)
        waiting = 0
        for i in range(LANES):
            if ws[DONE + i] == 0.0:
                update_slope(ws, i)
                close_enough = abs(ws[F + i]) < (tolerance if step > 0 else _FINAL)
                if close_enough or (ws[X + i] >= ws[TOP + i] and ws[F + i] < 0.0):
                    ws[DONE + i] = 1.0
                else:
                    advance(ws, i)
                    waiting += 1
        if waiting == 0:
            return


@compiled
def finish(ws: FloatArray, i: int) -> None:
    """Take the last, tiny step of a lane and carry the forces along; X = inf where the load is not carried."""
    if ws[X + i] >= ws[TOP + i] and ws[F + i] < -_FINAL or not abs(ws[F + i]) < _ROUGH:
        ws[X + i] = np.inf
        return
    move = -ws[F + i] / ws[SLOPE + i]
    dx = ws[X + i] - ws[X_BEFORE + i]
    share = move / dx if abs(dx) > _SAME else 0.0
    ws[PULL + i] += share * (ws[PULL + i] - ws[PULL_BEFORE + i])
    ws[MOMENT + i] += share * (ws[MOMENT + i] - ws[MOMENT_BEFORE + i])
    ws[Z + i] = exp(ws[X + i] + move)


@compiled
def solve(ws: FloatArray, model: int, rough: int, fine: int) -> None:
    """Fill Z and the results with the sinkage under LOAD: few nodes to come near, then all of them."""
    start(ws)
    search(ws, model, rough, _ROUGH, _ROUGH_STEPS)
    for i in range(LANES):
        reset(ws, i)
    search(ws, model, fine, _FINE, _FINE_STEPS)
    for i in range(LANES):
        finish(ws, i)
