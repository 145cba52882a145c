"""The slip at which a rover holds a slope or a tow force, and the greatest that it holds, for many soils.

For every soil the slope (or tow force) that is held is taken over a grid of slips. It rises with slip, and
may fall again where wheels dig themselves in. The slip for a given slope is the first at which that slope is
held: from there more slip pulls more, so that the state is stable. It is then refined between its neighbours
on the grid until the forces balance.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.rover.equilibrium import Ground, Outcome, State, settle
from bayesterra.rover.geometry import Rover

Sought = Literal["slope", "tow"]
SLIPS = np.linspace(0.0, 0.95, 51)
"""Slips of the slower axle; what happens between neighbours and is over at once goes unseen."""
_BALANCED = 1e-11  # misfit of the forces along the slope, relative to the weight
_STEPS = 100
_GAP = float(SLIPS[1])
_ZOOMS = 5


@dataclass(frozen=True)
class Sweep:
    """What n soils hold over ``SLIPS``.

    Attributes
    ----------
    sought : whether slopes (rad) or tow forces (N) are asked for.
    fixed : the tow force, or the slope, against which they are held.
    held : (n, slips) slope or tow force; NaN where there is no balanced state.
    outcome : (n, slips).
    """

    sought: Sought
    fixed: float
    held: FloatArray
    outcome: IntArray

    @property
    def first(self) -> IntArray:
        """First slip (n,) with an answer."""
        return np.asarray((self.outcome == Outcome.HELD).argmax(axis=1))

    @property
    def runs(self) -> BoolArray:
        """Slips (n, slips) that can be reached from the first with an answer, without a gap."""
        good = self.outcome == Outcome.HELD
        columns = np.arange(good.shape[1])
        failed = ~good & (columns >= self.first[:, None])
        return np.asarray(good & (np.cumsum(failed, axis=1) == 0))

    @property
    def ending(self) -> IntArray:
        """Why (n,) slips beyond the last of the run have no answer; ``CANNOT`` where there are none."""
        runs = self.runs
        after = np.where(runs.any(axis=1), runs.shape[1] - runs[:, ::-1].argmax(axis=1), 0)
        inside = np.minimum(after, runs.shape[1] - 1)
        codes = self.outcome[np.arange(len(runs)), inside]
        return np.asarray(np.where(after < runs.shape[1], codes, Outcome.CANNOT))


def sweep(rover: Rover, ground: Ground, count: int, sought: Sought, fixed: float = 0.0) -> Sweep:
    """What ``count`` soils hold at every slip: slopes against the tow force ``fixed``, or the other way."""
    soils = np.repeat(np.arange(count), len(SLIPS))
    slowest, given = np.tile(SLIPS, count), np.full(len(soils), fixed)
    if sought == "slope":
        state = settle(rover, ground, soils, slowest, tow=given)
    else:
        state = settle(rover, ground, soils, slowest, slope=given)
    value = state.slope if sought == "slope" else state.tow
    held = np.where(state.outcome == Outcome.HELD, value, np.nan)
    shape = (count, len(SLIPS))
    return Sweep(sought, fixed, held.reshape(shape), state.outcome.reshape(shape))


def states_at(rover: Rover, ground: Ground, found: Sweep, values: FloatArray) -> State:
    """The states (n, k) in which n soils hold slopes or tow forces ``values`` (k,), as ``found`` sought.

    Where the outcome is ``BRAKES``, the state is that at slip 0, in which the wheels pull more than is asked.
    """
    shape = (len(found.held), len(values))
    low, outcome = _brackets(found, values)
    wanted = np.broadcast_to(values, shape)
    fixed = np.full(shape, found.fixed)
    slope, tow = (wanted, fixed) if found.sought == "slope" else (fixed, wanted)
    soils = np.broadcast_to(np.arange(shape[0])[:, None], shape)
    rows, alpha, pulled, start = soils.ravel(), slope.flatten(), tow.flatten(), low.ravel()
    slip, load, sinkage, pull, moment = (np.full((rows.size, 2), np.nan) for _ in range(5))
    whole = State(alpha, pulled, slip, load, sinkage, pull, moment, outcome.flatten())
    todo, idle = (np.flatnonzero(whole.outcome == code) for code in (Outcome.HELD, Outcome.BRAKES))
    _put(whole, todo, _refined(rover, ground, rows[todo], start[todo], alpha[todo], pulled[todo]))
    still = settle(rover, ground, rows[idle], np.zeros(len(idle)), slope=alpha[idle], tow=pulled[idle])
    settled = np.where(still.outcome == Outcome.HELD, Outcome.BRAKES, still.outcome)
    _put(whole, idle, replace(still, outcome=settled))
    return shaped(whole, shape)


def _brackets(found: Sweep, values: FloatArray) -> tuple[IntArray, IntArray]:
    """Index (n, k) of the last slip before a value is first held, and outcomes (n, k)."""
    runs, first = found.runs, found.first
    reached = runs[:, None, :] & (np.nan_to_num(found.held, nan=-np.inf)[:, None, :] >= values[:, None])
    at = reached.argmax(axis=2)
    outcome = np.where(reached.any(axis=2), Outcome.HELD, found.ending[:, None])
    # Held at the first slip with an answer: at slip 0 it rolls by itself; else what keeps lower slips out.
    before = found.outcome[np.arange(len(first)), np.maximum(first - 1, 0)]
    early = np.where(first == 0, Outcome.BRAKES, before)
    outcome = np.where((outcome == Outcome.HELD) & (at == first[:, None]), early[:, None], outcome)
    return np.maximum(at - 1, 0), outcome.astype(np.int64)


def _refined(
    rover: Rover, ground: Ground, soils: IntArray, low: IntArray, slope: FloatArray, tow: FloatArray
) -> State:
    """Find the slip between ``SLIPS[low]`` and the next at which forces balance: false position, guarded.

    Illinois' rule: an end that stays has its misfit halved; every third step cuts the bracket in the middle.
    """

    def misfit(rows: IntArray, slip: FloatArray) -> tuple[State, FloatArray]:
        state = settle(rover, ground, soils[rows], slip, slope=slope[rows], tow=tow[rows])
        wanted = rover.weight * np.sin(slope[rows]) + tow[rows]
        return state, (2 * state.pull.sum(axis=1) - wanted) / rover.weight

    every = np.arange(len(soils))
    a, b = SLIPS[low], SLIPS[low + 1]
    f_a, (result, f_b) = misfit(every, a)[1], misfit(every, b)
    active = every[(np.abs(f_b) > _BALANCED) & np.isfinite(f_a) & np.isfinite(f_b)]
    for step in range(_STEPS):
        if not active.size:
            break
        left, right = a[active], b[active]
        secant = right - f_b[active] * (right - left) / (f_b[active] - f_a[active])
        middle = 0.5 * (left + right)
        cut = (step % 3 == 2) | ~((secant > left) & (secant < right))
        slip = np.where(cut, middle, secant)
        state, f = misfit(active, slip)
        _put(result, active, state)
        below = f < 0
        stays = np.where(below, f_b[active], f_a[active])
        f_a[active] = np.where(below, f, np.where(cut, stays, 0.5 * stays))
        f_b[active] = np.where(below, np.where(cut, stays, 0.5 * stays), f)
        a[active], b[active] = np.where(below, slip, left), np.where(below, right, slip)
        going = (np.abs(f) > _BALANCED) & np.isfinite(f) & (b[active] - a[active] > 1e-15)
        active = active[going]
    return result


def shaped(state: State, shape: tuple[int, ...]) -> State:
    """The same states in an array of another shape."""
    arrays = {field.name: getattr(state, field.name) for field in fields(State)}
    return State(**{name: array.reshape(*shape, *array.shape[1:]) for name, array in arrays.items()})


def _put(target: State, rows: IntArray, state: State) -> None:
    for field in fields(State):
        getattr(target, field.name)[rows] = getattr(state, field.name)


@dataclass(frozen=True)
class Greatest:
    """The greatest slope or tow force that each of n soils holds.

    Attributes
    ----------
    value : (n,) rad or N; NaN where no slip has an answer.
    slip : (n,) of the slower axle there.
    rising : (n,) whether it still rises where the slips, or the answers, end.
    """

    value: FloatArray
    slip: FloatArray
    rising: BoolArray


def greatest(rover: Rover, ground: Ground, found: Sweep, most: float = 1.0) -> Greatest:
    """The greatest of what ``found`` sought, at slips up to ``most``."""
    runs = found.runs
    usable = runs & (most + 1e-12 >= SLIPS)
    held = np.where(usable, found.held, -np.inf)
    every, best = np.arange(len(held)), held.argmax(axis=1)
    value, slip = held[every, best], SLIPS[best]
    ends = np.minimum(SLIPS[len(SLIPS) - 1 - runs[:, ::-1].argmax(axis=1)], most)
    low = np.maximum(slip - _GAP, SLIPS[found.first])
    high = np.minimum(slip + _GAP, ends)
    known = np.flatnonzero(np.isfinite(value))
    for _ in range(_ZOOMS):
        width = (high - low)[known]
        inner = low[known, None] + width[:, None] * np.array([0.25, 0.5, 0.75, 1.0])
        reached = _reached(rover, ground, found, known, inner)
        top = reached.argmax(axis=1)
        higher = reached[np.arange(len(known)), top]
        better = higher > value[known]
        slip[known] = np.where(better, inner[np.arange(len(known)), top], slip[known])
        value[known] = np.where(better, higher, value[known])
        low[known] = np.maximum(low[known], slip[known] - 0.25 * width)
        high[known] = np.minimum(high[known], slip[known] + 0.25 * width)
    answered = np.isfinite(value)
    rising = answered & (slip >= ends - 1e-9)
    return Greatest(np.where(answered, value, np.nan), np.where(answered, slip, np.nan), rising)


def _reached(rover: Rover, ground: Ground, found: Sweep, soils: IntArray, slips: FloatArray) -> FloatArray:
    """What ``soils`` (p,) hold at slips (p, m) of their own; −inf where there is no balanced state."""
    count = slips.shape[1]
    given = np.full(slips.size, found.fixed)
    rows = np.repeat(soils, count)
    if found.sought == "slope":
        state = settle(rover, ground, rows, slips.ravel(), tow=given)
        value = state.slope
    else:
        state = settle(rover, ground, rows, slips.ravel(), slope=given)
        value = state.tow
    return np.where(state.outcome == Outcome.HELD, value, -np.inf).reshape(slips.shape)
