"""Derived quantities: tractive efficiency, the greatest of a curve, and widths of wheels."""

import numpy as np
import pytest

from bayesterra.likelihood.forward import SLIP_GRID, derive_for, greatest, traction, tractive_efficiency
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.models import M1, Conditions, Soil, Wheel
from bayesterra.parameters import DERIVED, soil_array
from bayesterra.study.result import Result

WHEEL = Wheel(0.15735, 0.165, 0.010, 30, 0.65)
SOIL = Soil(Ks=2.5e6, n0=0.76, n1=1.30, c=250.0, phi=0.5568, K=0.012, c1=0.5, c2=-0.3)


def test_efficiency_is_drawbar_power_over_axle_power() -> None:
    """At ω = 1 rad/s the wheel travels r_s (1 − s) a second: η is pull times that over moment."""
    slip = np.array([0.1, 0.3, 0.5])
    z = M1().sinkage(SOIL, WHEEL, slip, 80.0)
    forces = M1().forces(SOIL, WHEEL, slip, z)
    travelled = (0.15735 + 0.65 * 0.010) * (1 - slip)
    pull, moment = np.atleast_2d(forces.drawbar_pull), np.atleast_2d(forces.resistance_moment)
    efficiency = tractive_efficiency(pull, moment, Conditions.of(WHEEL, slip))
    np.testing.assert_allclose(efficiency[0], forces.drawbar_pull * travelled / forces.resistance_moment)


def test_no_soil_gives_power_back(wide: Result) -> None:
    """Slip alone loses the share s of the power, so η stays below 1 − s for every soil of the prior."""
    target = posterior(wide.study)
    soil = target.prior.soil_values(draw_cut_prior(target, 500, np.random.default_rng(1)).x)
    efficiency = traction(M1(), WHEEL, 80.0, soil)[1]
    assert np.nanmax(efficiency + SLIP_GRID) < 1.0


def test_efficiency_needs_power_at_the_axle() -> None:
    """Where the soil drives the wheel there is no tractive efficiency."""
    conditions = Conditions.of(WHEEL, [0.02, 0.02])
    efficiency = tractive_efficiency(np.array([[-1.0, 1.0]]), np.array([[-0.1, 0.0]]), conditions)
    assert np.isnan(efficiency).all()


def test_greatest_finds_the_vertex_between_grid_points() -> None:
    """A parabola's greatest value and its slip are found exactly, off the grid."""
    values = 3.0 - 7.0 * (SLIP_GRID - 0.333) ** 2
    height, slip = greatest(values[None])
    np.testing.assert_allclose([height[0], slip[0]], [3.0, 0.333], rtol=1e-12)


def test_greatest_at_the_ends_and_without_answers() -> None:
    """A rising curve has its greatest value at the last slip; rows without an answer have none."""
    rising = SLIP_GRID.copy()
    broken = np.where(SLIP_GRID < 0.5, SLIP_GRID, np.nan)
    height, slip = greatest(np.stack([rising, broken, np.full(len(SLIP_GRID), np.nan)]))
    np.testing.assert_allclose(height[:2], [0.8, 0.48], rtol=1e-12)
    np.testing.assert_allclose(slip[:2], [0.8, 0.48], rtol=1e-12)
    assert np.isnan([height[2], slip[2]]).all()


def test_bearing_pressure_knows_the_width() -> None:
    """With k_c and k_φ in place of K_s, the narrower wheel meets the stiffer soil."""
    extended = soil_array({**vars(SOIL), "Ks": np.nan, "kc": 15.6e3, "kphi": 1.2e6})
    for width in (0.165, 0.05):
        wheel = Wheel(0.15735, width, 0.010, 30, 0.65)
        found = derive_for(M1(), wheel, 80.0, extended)["bearing_pressure"][0]
        assert found == pytest.approx((15.6e3 / width + 1.2e6) * 0.01**0.76)


def test_summary_holds_every_derived_quantity(wide: Result) -> None:
    """Posterior, errors and prior of all derived quantities stand in the summary."""
    rows = wide.summary.set_index("parameter").loc[list(DERIVED)]
    assert np.isfinite(rows.drop(columns="unit").to_numpy(dtype=float)).all()
    assert (rows["prior_sd"] > rows["sd"]).all()
