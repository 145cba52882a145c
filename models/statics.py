"""Statics of a rover: loads of its axles on a slope, and the slip at which it holds.

::

            y  (off the slope)                        forward, up the slope  x →
            ↑
              T ←──•                  ● centre of gravity: G sin α ←, G cos α ↓
                   │ tow              │
            rear   │                  │                       front
             ( + )─┴──────────────────┴───────────────────────( + )     axles, wheelbase L
              ↑ F_N,r   → F_DP,r   ↺ M_DR,r                    ↑ F_N,f   → F_DP,f   ↺ M_DR,f

What is external. The soil acts on every wheel with stresses on its arc. They are, exactly, a force at the
axle, F_N off and F_DP along the slope, and a moment about it, M_DR, against the turning of the wheel: that is
how (14) defines the three. Nothing is assumed about a point of contact; where the force would cut the ground
follows from M_DR. The driving torque T_D acts between wheel and body and is internal to the rover: it turns
the wheel forward and the body back with the same moment, and drops out. In steady motion T_D = M_DR, so it
comes to the same whether one says that the soil's M_DR lifts the front of the whole rover, or that the
reaction of the drives lifts the front of its body. Neither air nor acceleration acts.

Balance of the whole rover, sums over the four wheels, T the tow force, which pulls back along the slope:

    along    Σ F_DP = G sin α + T
    across   Σ F_N  = G cos α
    moments about the rear axle (positive lifts the front), with positions relative to that axle:
        x_f F_N,f − y_f F_DP,f + M_DR,f + M_DR,r − x_g G cos α + y_g G sin α + y_t T = 0

On level hard ground x_f = L, y_f = r_f − r_r, and x_g, y_g are those of the file. As wheels sink by different
depths the body tilts, and these positions turn with it. The tow force is taken to pull at the rear axle's
place, at its height. Left and right are alike, so the two wheels of an axle share its load.

Loads depend on the moments and sinkages, which depend on the loads: the balance is met by repetition, which
converges at once since redistributing a load hardly changes the sum of the moments.

In (42) the mean load per wheel is that on the slope, G cos α / 4.

For every soil the slope (or tow force) that is held is taken over a grid of slips. It rises with slip, and
may fall again where wheels dig themselves in. The slip for a given slope is the first at which that slope is
held: from there more slip pulls more, so that the state is stable. It is then refined between its neighbours
on the grid until the forces balance.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import IntEnum
from typing import Literal, Protocol

import numpy as np

from bayesterra.models.checks import BoolArray, FloatArray, IntArray
from bayesterra.models.conditions import Conditions, Status
from bayesterra.models.forces import DRAWBAR_PULL
from bayesterra.models.forward import ForwardModel
from bayesterra.models.wheel import Wheel

SETTLED = 1e-11
"""Change of the loads, relative to the weight, and of the slope, at which the balance is met."""
REPETITIONS = 80
_LEAST = 1e-6  # share of the weight at which an axle's load is held while others settle


class Outcome(IntEnum):
    """Outcome of the question for a slip."""

    HELD = 0
    CANNOT = 1
    """No slip pulls enough."""
    SINKS = 2
    """A wheel would sink beyond its radius."""
    LIFTS = 3
    """An axle would carry no load."""
    BRAKES = 4
    """At slip 0 the wheels already pull more than is asked: slip 0 or below, where no model here reaches."""
    NO_ANSWER = 5
    """The model has no answer for these parameters at the slips that matter."""
    UNSETTLED = 6
    """The loads do not settle."""


OUTCOMES = {
    Outcome.HELD: "held",
    Outcome.CANNOT: "no slip pulls enough",
    Outcome.SINKS: "sinks beyond the wheel radius",
    Outcome.LIFTS: "an axle lifts off",
    Outcome.BRAKES: "rolls without slip",
    Outcome.NO_ANSWER: "the model has no answer: N ≤ 0, or θm outside (θ2, θ1)",
    Outcome.UNSETTLED: "the loads do not settle",
}
_OF_STATUS = np.full(max(Status) + 1, Outcome.NO_ANSWER, dtype=np.int64)

_OF_STATUS[Status.OK] = Outcome.HELD

_OF_STATUS[[Status.LOAD, Status.SINKAGE]] = Outcome.SINKS


@dataclass(frozen=True, kw_only=True)
class Rover:
    """A rover with two axles of two wheels each; left and right are alike. SI units.

    Attributes
    ----------
    weight : G, N, of body and wheels.
    gravity : under which it weighs that, m/s²; None where it is not known.
    wheelbase : distance L of the axles, m.
    centre_height : of the centre of gravity above the ground on which the rims stand, m.
    centre_ahead : the same, ahead of the rear axle, m.
    tow_height : where the tow force pulls, above that ground, m.
    wheels : front and rear, shearing radius known.
    front_to_rear_speed : r_s ω of the front wheels over that of the rear wheels, as commanded; with 1, the
        default, all wheels slip alike.

    Raises
    ------
    ValueError : a value that no rover has.
    """

    weight: float
    wheelbase: float
    centre_height: float
    centre_ahead: float
    tow_height: float
    wheels: tuple[Wheel, Wheel]
    gravity: float | None = None
    front_to_rear_speed: float = 1.0

    def __post_init__(self) -> None:
        base, ahead, speed = self.wheelbase, self.centre_ahead, self.front_to_rear_speed
        least = sum(wheel.radius for wheel in self.wheels)
        between = f"must lie between the axles, 0 to {base:g} m"
        for key, value, good, rule in (
            ("weight", self.weight, self.weight > 0, "must be above 0 N"),
            ("gravity", self.gravity, self.gravity is None or self.gravity > 0, "must be above 0 m/s²"),
            ("wheelbase", base, base > least, f"must exceed the radii of both wheels, {least:g} m"),
            ("centre_of_gravity.height", self.centre_height, self.centre_height > 0, "must be above 0 m"),
            ("centre_of_gravity.ahead_of_rear_axle", ahead, 0 < ahead < base, between),
            ("tow_height", self.tow_height, self.tow_height >= 0, "must not be below 0 m"),
            ("front_to_rear_speed", speed, 0.5 <= speed <= 2, "must lie between 0.5 and 2"),
        ):
            if not good:
                raise ValueError(f"'{key}' {rule} (got {value:g})")

    @property
    def mean_load(self) -> float:
        """A quarter of the weight, N."""
        return self.weight / 4

    @property
    def equal_slip(self) -> bool:
        """True where all wheels are commanded the same speed on their shearing radius."""
        return self.front_to_rear_speed == 1

    def slips(self, slowest: FloatArray) -> FloatArray:
        """Slip of front and rear wheels (n, 2) where the slower axle slips by `slowest` (n,).

        All move at one speed v, and 1 − s = v/(r_s ω) by eq. (3), so that (1 − s_f) q = 1 − s_r for the ratio
        q of their commanded speeds r_s ω.
        """
        speeds = np.array([self.front_to_rear_speed, 1.0])
        return np.asarray(1 - (1 - slowest[:, None]) * speeds.min() / speeds)


class Ground(Protocol):
    """Ground under the wheels: n soils, known by their numbers."""

    def respond(
        self, soils: IntArray, slip: FloatArray, load: FloatArray, mean_load: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """Sinkage, F_DP and M_DR of a front and a rear wheel (p, 2, 3), and outcomes (p,).

        For ``soils`` (p,), ``slip`` and ``load`` (p, 2), and the mean load per wheel (p,).
        """


@dataclass(frozen=True)
class SoftGround:
    """Soils through a model: its parameters (n, k) under the wheels of each axle."""

    model: ForwardModel
    wheels: tuple[Wheel, Wheel]
    parameters: tuple[FloatArray, FloatArray]

    def respond(
        self, soils: IntArray, slip: FloatArray, load: FloatArray, mean_load: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """See :class:`Ground`."""
        values, outcomes = np.empty((*slip.shape, 3)), np.zeros(len(slip), dtype=np.int64)
        for axle, theta in enumerate(self.parameters):
            conditions = _conditions(self.wheels[axle], slip[:, axle])
            values[:, axle], status = self.model.response_of_pairs(
                theta[soils], conditions, load[:, axle], mean_load=mean_load
            )
            outcomes = np.maximum(outcomes, _OF_STATUS[status])
        return values, outcomes


@dataclass(frozen=True)
class CurvedGround:
    """A ground whose answers are off by curves (n, slips, 3) over ``SLIPS``, one set for each axle."""

    ground: Ground
    curves: tuple[FloatArray, FloatArray]

    def respond(
        self, soils: IntArray, slip: FloatArray, load: FloatArray, mean_load: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """See :class:`Ground`; between slips curves are straight, beyond the last level."""
        values, outcomes = self.ground.respond(soils, slip, load, mean_load)
        place = np.clip(slip / _GAP, 0.0, len(SLIPS) - 1.0)
        left = np.minimum(place.astype(np.int64), len(SLIPS) - 2)
        for axle, curve in enumerate(self.curves):
            at, share = left[:, axle], (place - left)[:, axle, None]
            values[:, axle] += (1.0 - share) * curve[soils, at] + share * curve[soils, at + 1]
        return values, outcomes


def _conditions(wheel: Wheel, slip: FloatArray) -> Conditions:
    """As ``Conditions.of``, without its checks, which would take longer than the forces."""
    radii = (wheel.radius, wheel.width, wheel.lug_height, float(wheel.shearing_radius()))
    return Conditions(slip, *(np.full(len(slip), value) for value in radii))


@dataclass(frozen=True)
class State:
    """Balanced states of a rover, p of them, or (n, k); axles front and rear along a last axis."""

    slope: FloatArray  # α, rad, (p,)
    tow: FloatArray  # T, N, (p,)
    slip: FloatArray  # of one wheel of each axle, (p, 2); NaN where there is no state
    load: FloatArray  # N, of one wheel of each axle, as what follows
    sinkage: FloatArray  # m
    pull: FloatArray  # N
    moment: FloatArray  # N m
    outcome: IntArray  # (p,) an :class:`Outcome`


def settle(
    rover: Rover,
    ground: Ground,
    soils: IntArray,
    slowest: FloatArray,
    *,
    slope: FloatArray | None = None,
    tow: FloatArray | None = None,
) -> State:
    """Balance a rover whose slower axle slips by ``slowest`` (p,) on ``soils`` (p,).

    With ``slope`` left out it is the one that is held against ``tow``; with ``tow`` left out, the tow force
    that is held on ``slope``. With both given the loads are balanced, the forces along the slope are not.
    """
    count, weight = len(slowest), rover.weight
    slip = rover.slips(slowest)
    alpha = np.zeros(count) if slope is None else np.array(slope, dtype=np.float64)
    pulled = np.zeros(count) if tow is None else np.array(tow, dtype=np.float64)
    front = weight * np.cos(alpha) * rover.centre_ahead / rover.wheelbase
    load, values = np.full((count, 2), np.nan), np.full((count, 2, 3), np.nan)
    outcome = np.full(count, Outcome.UNSETTLED, dtype=np.int64)
    active = np.arange(count)
    for _ in range(REPETITIONS):
        if not active.size:
            break
        a, across = alpha[active], weight * np.cos(alpha[active])
        held = np.clip(front[active], _LEAST * weight, across - _LEAST * weight)
        load[active] = 0.5 * np.column_stack([held, across - held])
        responses, codes = ground.respond(soils[active], slip[active], load[active], 0.25 * across)
        values[active] = responses
        pull = 2 * responses[:, :, DRAWBAR_PULL].sum(axis=1)
        if slope is None:
            alpha[active] = np.arcsin(np.clip((pull - pulled[active]) / weight, -1, 1))
        elif tow is None:
            pulled[active] = pull - weight * np.sin(a)
        front[active] = front_load(rover, responses, alpha[active], pulled[active])
        change = np.maximum(np.abs(front[active] - held) / weight, np.abs(alpha[active] - a))
        lifts = np.minimum(held, across - held) <= _LEAST * weight * (1 + 1e-9)
        done = (change < SETTLED) | (codes != Outcome.HELD) | (lifts & _stays_off(front[active], across))
        codes = np.where((codes == Outcome.HELD) & (change >= SETTLED), Outcome.LIFTS, codes)
        outcome[active[done]] = codes[done]
        active = active[~done]
    bad = outcome != Outcome.HELD
    load[bad], values[bad] = np.nan, np.nan
    sinkage, pulls, moment = np.moveaxis(values, 2, 0)
    return State(alpha, pulled, slip, load, sinkage, pulls, moment, outcome)


def _stays_off(front: FloatArray, across: FloatArray) -> BoolArray:
    """True where an axle that already carries next to nothing would carry less than nothing."""
    return np.asarray((front <= 0) | (front >= across))


def front_load(rover: Rover, values: FloatArray, slope: FloatArray, tow: FloatArray) -> FloatArray:
    """F_N of both front wheels (p,), N, from the moments about the rear axle.

    ``values`` (p, 2, 3) are sinkage, F_DP and M_DR of a front and a rear wheel.
    """
    sinkage, pull, moment = np.moveaxis(values, 2, 0)
    (x_f, y_f), (x_g, y_g), (_, y_t) = positions(rover, sinkage)
    weight = rover.weight
    turning = 2 * moment.sum(axis=1) - 2 * y_f * pull[:, 0] + y_t * tow
    return np.asarray((weight * (x_g * np.cos(slope) - y_g * np.sin(slope)) - turning) / x_f)


def positions(rover: Rover, sinkage: FloatArray) -> tuple[tuple[FloatArray, FloatArray], ...]:
    """Front axle, centre of gravity and tow point relative to the rear axle, each x and y (p,), m."""
    r_f, r_r = (wheel.radius for wheel in rover.wheels)
    rise = r_f - r_r
    distance = np.hypot(rover.wheelbase, rise)
    tilt = np.arcsin((rise + sinkage[:, 1] - sinkage[:, 0]) / distance) - np.arcsin(rise / distance)
    cos, sin = np.cos(tilt), np.sin(tilt)
    places = ((rover.wheelbase, rise), (rover.centre_ahead, rover.centre_height - r_r), (0.0, rover.tow_height - r_r))
    return tuple((x * cos - y * sin, x * sin + y * cos) for x, y in places)


Sought = Literal["slope", "tow"]
SLIPS = np.linspace(0.0, 0.95, 51)
"""Slips of the slower axle; what happens between neighbours and is over at once goes unseen."""
_BALANCED = 1e-11  # misfit of the forces along the slope, relative to the weight
_STEPS = 100
_GAP = float(SLIPS[1])
_ZOOMS = 5


@dataclass(frozen=True)
class Sweep:
    """Slopes or tow forces that n soils hold over ``SLIPS``."""

    sought: Sought  # whether slopes (rad) or tow forces (N) are asked for
    fixed: float  # the tow force, or the slope, against which they are held
    held: FloatArray  # (n, slips) slope or tow force; NaN where there is no balanced state
    outcome: IntArray  # (n, slips)

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
        """Outcomes (n,) that end the run, of the slips beyond its last; ``CANNOT`` where there are none."""
        runs = self.runs
        after = np.where(runs.any(axis=1), runs.shape[1] - runs[:, ::-1].argmax(axis=1), 0)
        inside = np.minimum(after, runs.shape[1] - 1)
        codes = self.outcome[np.arange(len(runs)), inside]
        return np.asarray(np.where(after < runs.shape[1], codes, Outcome.CANNOT))


def sweep(rover: Rover, ground: Ground, count: int, sought: Sought, fixed: float = 0.0) -> Sweep:
    """Slopes that ``count`` soils hold at every slip against the tow force ``fixed``, or the other way."""
    soils, shape = np.repeat(np.arange(count), len(SLIPS)), (count, len(SLIPS))
    held, outcome = _held(rover, ground, soils, np.tile(SLIPS, count), sought, fixed)
    return Sweep(sought, fixed, held.reshape(shape), outcome.reshape(shape))


def _held(
    rover: Rover, ground: Ground, soils: IntArray, slips: FloatArray, sought: Sought, fixed: float
) -> tuple[FloatArray, IntArray]:
    """Values that ``soils`` (p,) hold at slips (p,), NaN where there is no balanced state; outcomes (p,)."""
    constant = np.full(len(slips), fixed)
    if sought == "slope":
        state = settle(rover, ground, soils, slips, tow=constant)
    else:
        state = settle(rover, ground, soils, slips, slope=constant)
    value = state.slope if sought == "slope" else state.tow
    return np.where(state.outcome == Outcome.HELD, value, np.nan), state.outcome


def states_at(rover: Rover, ground: Ground, traction: Sweep, values: FloatArray) -> State:
    """The states (n, k) in which n soils hold slopes or tow forces ``values`` (k,), as ``traction`` sought.

    Where the outcome is ``BRAKES``, the state is that at slip 0, in which the wheels pull more than is asked.
    """
    shape = (len(traction.held), len(values))
    low, outcome = _brackets(traction, values)
    wanted = np.broadcast_to(values, shape)
    fixed = np.full(shape, traction.fixed)
    slope, tow = (wanted, fixed) if traction.sought == "slope" else (fixed, wanted)
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


def _brackets(traction: Sweep, values: FloatArray) -> tuple[IntArray, IntArray]:
    """Index (n, k) of the last slip before a value is first held, and outcomes (n, k)."""
    runs, first = traction.runs, traction.first
    reached = runs[:, None, :] & (np.nan_to_num(traction.held, nan=-np.inf)[:, None, :] >= values[:, None])
    at = reached.argmax(axis=2)
    outcome = np.where(reached.any(axis=2), Outcome.HELD, traction.ending[:, None])
    # Held at the first slip with an answer: at slip 0 it rolls by itself; else what keeps lower slips out.
    before = traction.outcome[np.arange(len(first)), np.maximum(first - 1, 0)]
    early = np.where(first == 0, Outcome.BRAKES, before)
    outcome = np.where((outcome == Outcome.HELD) & (at == first[:, None]), early[:, None], outcome)
    return np.maximum(at - 1, 0), outcome.astype(np.int64)


def _refined(rover: Rover, ground: Ground, soils: IntArray, low: IntArray, slope: FloatArray, tow: FloatArray) -> State:
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
    """The greatest slope or tow force that each of n soils holds."""

    value: FloatArray  # (n,) rad or N; NaN where no slip has an answer
    slip: FloatArray  # (n,) of the slower axle there
    rising: BoolArray  # (n,) whether it still rises where the slips, or the answers, end


def greatest(rover: Rover, ground: Ground, traction: Sweep, most: float = 1.0) -> Greatest:
    """The greatest of what ``traction`` sought, at slips up to ``most``."""
    runs = traction.runs
    usable = runs & (most + 1e-12 >= SLIPS)
    held = np.where(usable, traction.held, -np.inf)
    every, best = np.arange(len(held)), held.argmax(axis=1)
    value, slip = held[every, best], SLIPS[best]
    ends = np.minimum(SLIPS[len(SLIPS) - 1 - runs[:, ::-1].argmax(axis=1)], most)
    low = np.maximum(slip - _GAP, SLIPS[traction.first])
    high = np.minimum(slip + _GAP, ends)
    soils = np.flatnonzero(np.isfinite(value))
    for _ in range(_ZOOMS):
        width = (high - low)[soils]
        inner = low[soils, None] + width[:, None] * np.array([0.25, 0.5, 0.75, 1.0])
        rows, fixed = np.repeat(soils, inner.shape[1]), traction.fixed
        held = _held(rover, ground, rows, inner.ravel(), traction.sought, fixed)[0].reshape(inner.shape)
        reached = np.where(np.isnan(held), -np.inf, held)
        top = reached.argmax(axis=1)
        higher = reached[np.arange(len(soils)), top]
        better = higher > value[soils]
        slip[soils] = np.where(better, inner[np.arange(len(soils)), top], slip[soils])
        value[soils] = np.where(better, higher, value[soils])
        low[soils] = np.maximum(low[soils], slip[soils] - 0.25 * width)
        high[soils] = np.minimum(high[soils], slip[soils] + 0.25 * width)
    answered = np.isfinite(value)
    rising = answered & (slip >= ends - 1e-9)
    return Greatest(np.where(answered, value, np.nan), np.where(answered, slip, np.nan), rising)
