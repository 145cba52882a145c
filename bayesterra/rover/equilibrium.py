r"""Loads of the axles of a rover that moves steadily straight up a slope, by statics.

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
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Protocol

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.forward import soil_at
from bayesterra.models import Conditions, Status, Wheel, WheelSoilModel
from bayesterra.rover.geometry import Rover

SETTLED = 1e-11
"""Change of the loads, relative to the weight, and of the slope, at which the balance is met."""
REPETITIONS = 80
_LEAST = 1e-6  # share of the weight at which an axle's load is held while others settle


class Outcome(IntEnum):
    """How the question for a slip ends."""

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


class Ground(Protocol):
    """What the wheels drive on: n soils, known by their numbers."""

    def respond(
        self, soils: IntArray, slip: FloatArray, load: FloatArray, mean_load: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """Sinkage, F_DP and M_DR of a front and a rear wheel (p, 2, 3), and outcomes (p,).

        For ``soils`` (p,), ``slip`` and ``load`` (p, 2), and the mean load per wheel (p,).
        """


@dataclass(frozen=True)
class SoftGround:
    """Soils, as every forward model takes them or as the model's own parameters, through a model."""

    model: WheelSoilModel
    rover: Rover
    soil: FloatArray

    @cached_property
    def _parameters(self) -> tuple[FloatArray, ...]:
        """The model's parameters (n, 9 or 13) under the wheels of each axle."""
        if self.soil.shape[1] == len(self.model.parameters):
            return (self.soil, self.soil)
        return tuple(soil_at(self.soil, wheel.width) for wheel in self.rover.wheels)

    def respond(
        self, soils: IntArray, slip: FloatArray, load: FloatArray, mean_load: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """See :class:`Ground`."""
        values, outcomes = np.empty((*slip.shape, 3)), np.zeros(len(slip), dtype=np.int64)
        for axle, theta in enumerate(self._parameters):
            conditions = _conditions(self.rover.wheels[axle], slip[:, axle])
            values[:, axle], status = self.model.response_of_pairs(
                theta[soils], conditions, load[:, axle], mean_load=mean_load
            )
            outcomes = np.maximum(outcomes, _OF_STATUS[status])
        return values, outcomes


def _conditions(wheel: Wheel, slip: FloatArray) -> Conditions:
    """As ``Conditions.of``, without its checks, which would take longer than the forces."""
    radii = (wheel.radius, wheel.width, wheel.lug_height, float(wheel.shearing_radius()))
    return Conditions(slip, *(np.full(len(slip), value) for value in radii))


@dataclass(frozen=True)
class State:
    """Balanced states of a rover, p of them, or (n, k); axles front and rear along a last axis.

    Attributes
    ----------
    slope, tow : α, rad, and T, N; (p,).
    slip, load, sinkage, pull, moment : of one wheel of each axle, (p, 2); SI. NaN where there is no state.
    outcome : (p,) an :class:`Outcome`.
    """

    slope: FloatArray
    tow: FloatArray
    slip: FloatArray
    load: FloatArray
    sinkage: FloatArray
    pull: FloatArray
    moment: FloatArray
    outcome: IntArray


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
        found, codes = ground.respond(soils[active], slip[active], load[active], 0.25 * across)
        values[active] = found
        pull = 2 * found[:, :, 1].sum(axis=1)
        if slope is None:
            alpha[active] = np.arcsin(np.clip((pull - pulled[active]) / weight, -1, 1))
        elif tow is None:
            pulled[active] = pull - weight * np.sin(a)
        front[active] = front_load(rover, found, alpha[active], pulled[active])
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
    """Whether an axle that already carries next to nothing would carry less than nothing."""
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
    places = (
        (rover.wheelbase, rise),
        (rover.centre_ahead, rover.centre_height - r_r),
        (0.0, rover.tow_height - r_r),
    )
    return tuple((x * cos - y * sin, x * sin + y * cos) for x, y in places)
