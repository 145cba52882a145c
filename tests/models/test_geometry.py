"""Kinematics and geometry against numbers of the paper."""

import math

import numpy as np
import pytest

from bayesterra.models import Wheel
from bayesterra.models.geometry import (
    convert_slip,
    entrance_angle,
    exponent,
    leaving_angle,
    maximum_stress_angle,
    minimum_lug_height,
    shear_start_radius,
    shearing_radius_coefficient,
    slip_from_speeds,
)  # fmt: skip

PHI = math.radians(31.9)


@pytest.mark.parametrize(("radius", "lugs", "height"), [(0.135, 24, 14.81e-3), (0.15735, 30, 14.73e-3)])
def test_minimum_lug_height(radius: float, lugs: int, height: float) -> None:
    """Equation (10) gives the text's 14.81 and 14.73 mm without lug-soil friction."""
    assert minimum_lug_height(radius, lugs, PHI, 0.0) == pytest.approx(height, abs=5e-6)


def test_full_lug_friction_lowers_the_minimum() -> None:
    """Equation (10) mixes its two limits linearly, r tan(pi/n_L) tan(X_c) at full friction."""
    rough = 0.135 * math.tan(math.pi / 24) * math.tan(math.pi / 4 - PHI / 2)
    smooth = float(minimum_lug_height(0.135, 24, PHI, 0.0))
    assert minimum_lug_height(0.135, 24, PHI, 1.0) == pytest.approx(rough)
    assert minimum_lug_height(0.135, 24, PHI, 0.25) == pytest.approx(0.75 * smooth + 0.25 * rough)


@pytest.mark.parametrize(("height", "coefficient"), [(0.015, 0.744), (0.010, 0.629)])
def test_shearing_radius_coefficient(height: float, coefficient: float) -> None:
    """Equation (2) gives 0.744 and 0.629 for lugs of 15 and 10 mm."""
    assert shearing_radius_coefficient(0.135, height, 24, PHI) == pytest.approx(coefficient, abs=5e-4)
    radius = Wheel(0.135, 0.165, height, 24).shearing_radius(PHI)
    assert radius == pytest.approx(0.135 + coefficient * height, abs=1e-5)


def test_slip_conversion_round_trip() -> None:
    """Slip converted to another radius and back is the slip, and equals slip from the speeds themselves."""
    on_rim = np.linspace(0, 0.9, 10)
    on_shear = convert_slip(on_rim, 0.15735, 0.1642)
    np.testing.assert_allclose(convert_slip(on_shear, 0.1642, 0.15735), on_rim, atol=1e-15)
    np.testing.assert_allclose(slip_from_speeds(0.2, 0.15735 * 0.2 * (1 - on_rim), 0.1642), on_shear, atol=1e-15)


def test_braking_slip() -> None:
    """When the wheel is slower than the ground, (3) divides by the travel speed."""
    assert slip_from_speeds(1.0, 0.3, 0.15) == pytest.approx(-0.5)
    assert slip_from_speeds(0.0, 0.3, 0.15) == -1.0
    assert slip_from_speeds(1.0, 0.0, 0.15) == 1.0


def test_contact_angles() -> None:
    """Equations (5)-(8) in plain numbers."""
    assert exponent(0.76, 1.3, 0.2) == pytest.approx(1.02)
    assert entrance_angle(0.02, 0.135) == pytest.approx(math.acos(0.115 / 0.135))
    assert leaving_angle(0.5, -0.2) == pytest.approx(-0.1)
    assert maximum_stress_angle(0.5, 0.5, -0.3, 0.2) == pytest.approx(0.22)


def test_small_entrance_angles_keep_their_digits() -> None:
    """theta_1 of a tiny sinkage is sqrt(2 z / r) to full precision."""
    assert entrance_angle(1e-14, 0.1) == pytest.approx(math.sqrt(2e-13), rel=1e-13)


def test_shear_start_radius() -> None:
    """R_j falls from R to r between the transition slips, eq. (13), and its variants hold it."""
    slips = np.array([0.0, 0.15, 0.325, 0.5, 0.9])
    radii = shear_start_radius(0.135, 0.015, slips)
    np.testing.assert_allclose(radii, [0.15, 0.15, 0.1425, 0.135, 0.135])
    np.testing.assert_array_equal(shear_start_radius(0.135, 0.015, slips, shear_start="rim"), np.full(5, 0.135))
    np.testing.assert_array_equal(shear_start_radius(0.135, 0.015, slips, shear_start="tip"), np.full(5, 0.135 + 0.015))


def test_speeds_that_give_no_slip() -> None:
    """Standing still or running backwards has no slip."""
    with pytest.raises(ValueError, match=r"'travel_speed' and 'angular_speed' must not both be zero \(got 0\)"):
        slip_from_speeds(0.0, 0.0, 0.15)
    with pytest.raises(ValueError, match=r"'travel_speed' must not be negative \(got -1\)"):
        slip_from_speeds(1.0, -1.0, 0.15)
    with pytest.raises(ValueError, match=r"'angular_speed' must not be negative \(got -0.15\)"):
        slip_from_speeds(-1.0, 1.0, 0.15)


def test_lug_equations_need_lugs() -> None:
    """Equations (2) and (10) refuse wheels without lugs."""
    with pytest.raises(ValueError, match=r"'lug_count' must be at least 3 for equations \(2\) and \(10\) \(got 0\)"):
        minimum_lug_height(0.135, 0, PHI, 0.0)
    with pytest.raises(ValueError, match=r"'lug_height' must be positive for equations \(2\) and \(10\) \(got 0\)"):
        shearing_radius_coefficient(0.135, 0.0, 24, PHI)
