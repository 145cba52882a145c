"""Tractive efficiency and the greatest of a curve."""

import numpy as np

from bayesterra.models import M1, Conditions, Soil, Wheel
from bayesterra.models.traction import SLIP_GRID, greatest, tractive_efficiency

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
