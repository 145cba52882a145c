"""Statics of the rover and the slip it needs, against closed forms and against sums of forces."""

from dataclasses import dataclass, fields

import numpy as np
import pytest

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.models import M1, M2, M2L, Conditions, Wheel, WheelSoilModel
from bayesterra.models.statics import SLIPS, Outcome, SoftGround, State, greatest, settle, states_at, sweep
from bayesterra.prediction.rover import Rover

WHEEL = Wheel(0.15, 0.15, 0.01, 24, 0.65)
SMALL = Wheel(0.12, 0.12, 0.01, 24, 0.65)
WEIGHT, BASE, HEIGHT, TOW_HEIGHT = 300.0, 0.8, 0.35, 0.25
RISE, FALL = 1.2, 1.1
"""Of the made-up traction: F_DP / F_N = RISE s − FALL s²."""


def rover(ahead: float = 0.4, *, height: float = HEIGHT, speed: float = 1.0, front: Wheel = WHEEL) -> Rover:
    """A rover of 300 N, its centre of gravity midway unless told."""
    return Rover(
        name="test",
        weight=WEIGHT,
        wheelbase=BASE,
        centre_height=height,
        centre_ahead=ahead,
        tow_height=TOW_HEIGHT,
        wheels=(front, WHEEL),
        front_to_rear_speed=speed,
    )


def soft(model: WheelSoilModel, machine: Rover, theta: FloatArray) -> SoftGround:
    """Soils (n, k) of the model's own parameters under a rover."""
    return SoftGround(model, machine.wheels, (theta, theta))


@dataclass(frozen=True)
class MadeUp:
    """Pull in proportion to load, F_DP = (RISE s − FALL s²) F_N, moment ``arm`` F_N, one sinkage for all."""

    arm: float = 0.0
    deepest: float = 1.0
    """Slip above which the wheels sink beyond their radius."""

    def respond(
        self, soils: IntArray, slip: FloatArray, load: FloatArray, mean_load: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """See :class:`bayesterra.models.statics.Ground`."""
        pull = (RISE * slip - FALL * slip**2) * load
        sunk = (slip > self.deepest).any(axis=1)
        return np.stack([np.full_like(slip, 0.01), pull, self.arm * load], axis=2), np.where(
            sunk, Outcome.SINKS, Outcome.HELD
        )


def soils(count: int = 40) -> FloatArray:
    """Soils about Table 10's for Wh32."""
    rng = np.random.default_rng(1)
    theta = np.tile([2.5e6, 0.849, 1.063, 268.0, np.radians(29.3), 0.0101, 0.339, -0.017, 0.0], (count, 1))
    theta[:, 3] *= np.exp(0.5 * rng.standard_normal(count))
    theta[:, 4] *= 1 + 0.1 * rng.standard_normal(count)
    return theta


def at(found: State, i: int, k: int) -> tuple[float, float]:
    """Loads of a front and a rear wheel."""
    return float(found.load[i, k, 0]), float(found.load[i, k, 1])


def test_slip_is_the_smaller_root_of_the_made_up_traction() -> None:
    """Σ F_DP = μ(s) G cos α must be G sin α + T: the first of the two slips, and none above the peak of μ."""
    slopes, tow = np.radians([2.0, 8.0, 14.0, 19.0]), 5.0
    found = states_at(rover(), MadeUp(), sweep(rover(), MadeUp(), 1, "slope", tow), slopes)
    needed = np.tan(slopes) + tow / (WEIGHT * np.cos(slopes))
    root = RISE**2 - 4 * FALL * needed
    climbs = root >= 0
    assert climbs.tolist() == [True, True, True, False]
    expected = (RISE - np.sqrt(root[climbs])) / (2 * FALL)
    np.testing.assert_allclose(found.slip[0, climbs, 0], expected, rtol=1e-9)
    assert found.outcome[0].tolist() == [Outcome.HELD] * 3 + [Outcome.CANNOT]
    assert np.isnan(found.load[0, 3]).all()


def test_greatest_slope_and_tow_are_those_of_the_peak() -> None:
    """Arctan of the greatest F_DP / F_N, and that share of the weight on the flat."""
    peak, where = RISE**2 / (4 * FALL), RISE / (2 * FALL)
    steepest = greatest(rover(), MadeUp(), sweep(rover(), MadeUp(), 3, "slope"))
    np.testing.assert_allclose(steepest.value, np.arctan(peak), rtol=1e-6)
    np.testing.assert_allclose(steepest.slip, where, atol=1e-3)
    pulled = greatest(rover(), MadeUp(), sweep(rover(), MadeUp(), 3, "tow"))
    np.testing.assert_allclose(pulled.value, peak * WEIGHT, rtol=1e-6)
    assert not steepest.rising.any()


def test_greatest_slope_up_to_a_slip() -> None:
    """Held to slips below the peak, the greatest slope is that at the last slip, and still rises there."""
    found = greatest(rover(), MadeUp(), sweep(rover(), MadeUp(), 1, "slope"), 0.3)
    assert found.value[0] == pytest.approx(np.arctan(RISE * 0.3 - FALL * 0.09), rel=1e-9)
    assert found.slip[0] == pytest.approx(0.3, abs=1e-9)
    assert found.rising.all()


@pytest.mark.parametrize(("slope", "tow"), [(0.0, 0.0), (np.radians(12), 0.0), (np.radians(5), 20.0)])
def test_loads_are_those_of_a_hand_calculation(slope: float, tow: float) -> None:
    """Moments about the rear axle: 2 N_f L = G (x cos α − y sin α) − a G cos α − y_t T, y from the axle."""
    arm, ahead = 0.05, 0.3
    found = states_at(rover(ahead), MadeUp(arm), sweep(rover(ahead), MadeUp(arm), 1, "slope", tow), np.array([slope]))
    lever = WEIGHT * (ahead * np.cos(slope) - (HEIGHT - 0.15) * np.sin(slope)) - (TOW_HEIGHT - 0.15) * tow
    front = (lever - arm * WEIGHT * np.cos(slope)) / BASE / 2
    expected = (front, WEIGHT * np.cos(slope) / 2 - front)
    assert at(found, 0, 0) == pytest.approx(expected, rel=1e-9)


def test_a_centred_rover_on_the_flat_loads_its_axles_alike() -> None:
    """Without resistance moments; these carry over 2 Σ M_DR / L from front to rear."""
    flat = np.zeros(1)
    still = settle(rover(), MadeUp(), np.zeros(1, int), np.array([0.2]), slope=flat, tow=flat)
    assert still.load[0] == pytest.approx([WEIGHT / 4, WEIGHT / 4], rel=1e-12)
    turned = settle(rover(), MadeUp(0.05), np.zeros(1, int), np.array([0.2]), slope=flat, tow=flat)
    front, rear = turned.load[0]
    assert 2 * (rear - front) == pytest.approx(2 * 2 * turned.moment[0].sum() / BASE, rel=1e-9)


def residuals(machine: Rover, state: State) -> FloatArray:
    """Forces along and across over the weight, and moments about the centre of gravity over G L.

    Places come from the sinkages alone: the axles stand r − z above the ground, the body joins them.
    """
    radii = np.array([wheel.radius for wheel in machine.wheels])
    axles = radii - state.sinkage
    span = np.hypot(machine.wheelbase, radii[0] - radii[1])
    across = axles[..., 0] - axles[..., 1]
    forward = np.stack([np.sqrt(span**2 - across**2), across], axis=-1) / span
    level = np.array([machine.wheelbase, radii[0] - radii[1]]) / span

    def place(x: float, y: float) -> FloatArray:
        """Of a point of the body, from the rear axle: its share along the line of the axles and off it."""
        along, off = level[0] * x + level[1] * y, level[0] * y - level[1] * x
        normal = np.stack([-forward[..., 1], forward[..., 0]], axis=-1)
        return np.asarray(along * forward + off * normal)

    centre = place(machine.centre_ahead, machine.centre_height - radii[1])
    tow = place(0.0, machine.tow_height - radii[1])
    front = span * forward
    turning = 2 * state.moment.sum(axis=-1) + (tow - centre)[..., 1] * state.tow
    for axle, where in enumerate((front - centre, -centre)):
        turning += 2 * (where[..., 0] * state.load[..., axle] - where[..., 1] * state.pull[..., axle])
    along = 2 * state.pull.sum(axis=-1) - state.tow - machine.weight * np.sin(state.slope)
    off = 2 * state.load.sum(axis=-1) - machine.weight * np.cos(state.slope)
    return np.stack([along, off, turning / machine.wheelbase]) / machine.weight


@pytest.mark.parametrize("model", [M1(), M2()])
@pytest.mark.parametrize("machine", [rover(), rover(0.3, speed=1.05, front=SMALL)])
def test_forces_and_moments_balance(model: M1 | M2, machine: Rover) -> None:
    """Sums over all forces on the rover vanish to 1e-8 of its weight, wherever a state is reported."""
    theta = soils()
    ground = soft(model, machine, theta)
    found = states_at(machine, ground, sweep(machine, ground, len(theta), "slope", 10.0), np.radians([0, 4, 8, 12]))
    held = found.outcome == Outcome.HELD
    assert held.mean() > 0.5
    assert np.abs(residuals(machine, found)[:, held]).max() < 1e-8


def test_the_states_are_those_of_the_model() -> None:
    """Sinkage, pull and moment are the model's at each wheel's own slip and load; slips at one speed v."""
    machine, theta = rover(0.3, speed=1.1), soils(5)
    ground = soft(M2(), machine, theta)
    found = states_at(machine, ground, sweep(machine, ground, 5, "slope"), np.radians([10.0]))
    front, rear = found.slip[:, 0].T
    np.testing.assert_allclose((1 - front) * 1.1, 1 - rear, rtol=1e-12)
    for axle in (0, 1):
        conditions = Conditions.of(WHEEL, found.slip[:, 0, axle])
        values, _ = M2().response_at(theta, conditions, found.load[:, 0, axle])
        states = np.stack([one[:, 0, axle] for one in (found.sinkage, found.pull, found.moment)], axis=1)
        np.testing.assert_allclose(states, values[np.arange(5), np.arange(5)], rtol=1e-8)


def test_the_load_effect_takes_the_mean_load_on_the_slope() -> None:
    """M2L answers with W̄ = G cos α / 4, whatever mean load its study had."""
    effects = np.column_stack([soils(3), np.tile([-0.3, 0.6, -0.4, 0.3], (3, 1))])
    ground = soft(M2L(mean_load=1.0), rover(), effects)
    slope = np.radians(10.0)
    found = states_at(rover(), ground, sweep(rover(), ground, 3, "slope"), np.array([slope]))
    assert (found.outcome == Outcome.HELD).all()
    model = M2L(mean_load=WEIGHT * np.cos(slope) / 4)
    values, _ = model.response_at(effects, Conditions.of(WHEEL, found.slip[:, 0, 1]), found.load[:, 0, 1])
    np.testing.assert_allclose(found.pull[:, 0, 1], values[np.arange(3), np.arange(3), 1], rtol=1e-8)


def test_more_tow_needs_more_slip_until_none_holds() -> None:
    """Slip and rear load rise with the tow force; what fails once fails against more."""
    theta = soils()
    ground = soft(M1(), rover(), theta)
    found = states_at(rover(), ground, sweep(rover(), ground, len(theta), "tow"), np.linspace(5, 140, 28))
    held = np.isin(found.outcome, (Outcome.HELD, Outcome.BRAKES))
    steps = np.diff(found.slip[:, :, 0], axis=1)[held[:, 1:]]
    assert (steps >= 0).all()
    assert (steps > 0).mean() > 0.95
    assert (np.diff(found.load[:, :, 1], axis=1)[held[:, 1:]] > 0).all()
    assert not (held[:, 1:] & ~held[:, :-1]).any()
    assert held[:, 0].all()
    assert not held[:, -1].any()


def test_draws_do_not_know_of_each_other() -> None:
    """The same soils in another order give the same states, to the last bit."""
    theta, order = soils(12), np.random.default_rng(2).permutation(12)
    slopes = np.radians([3, 11, 16])
    one, other = (soft(M1(), rover(), values) for values in (theta, theta[order]))
    first = states_at(rover(), one, sweep(rover(), one, 12, "slope"), slopes)
    second = states_at(rover(), other, sweep(rover(), other, 12, "slope"), slopes)
    for field in fields(State):
        np.testing.assert_array_equal(getattr(first, field.name)[order], getattr(second, field.name))


def test_what_ends_the_climb_is_named() -> None:
    """Sinking, an axle that lifts off, and a rover that would roll by itself are told apart."""
    slopes = np.radians([10.0])

    def outcome(machine: Rover, ground: MadeUp, slope: FloatArray = slopes) -> Outcome:
        found = states_at(machine, ground, sweep(machine, ground, 1, "slope"), slope)
        return Outcome(int(found.outcome[0, 0]))

    assert outcome(rover(), MadeUp(deepest=0.1)) == Outcome.SINKS
    assert outcome(rover(), MadeUp(deepest=0.3)) == Outcome.HELD
    assert outcome(rover(0.1, height=0.8), MadeUp()) == Outcome.LIFTS
    assert outcome(rover(), MadeUp(), np.zeros(1)) == Outcome.BRAKES
    assert outcome(rover(), MadeUp(), np.radians([20.0])) == Outcome.CANNOT


def test_a_soil_without_an_answer_at_high_slip_still_climbs_at_low_slip() -> None:
    """θm leaves the arc at some slip: below it slopes are held, above it the model is silent."""
    theta = soils(1)
    theta[0, 6:8] = 0.5, -2.0
    ground = soft(M1(), rover(), theta)
    found = sweep(rover(), ground, 1, "slope")
    assert 0.2 < SLIPS[found.runs[0]].max() < 0.25
    states = states_at(rover(), ground, found, np.radians([5.0, 30.0]))
    assert states.outcome[0].tolist() == [Outcome.HELD, Outcome.NO_ANSWER]
