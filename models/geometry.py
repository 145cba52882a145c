"""Kinematics and contact geometry, Ding et al. 2015, eqs. (2)-(13); lengths in m, angles in rad."""

import numpy as np

from bayesterra.models.checks import FloatArray, plain, require

Floats = float | FloatArray

SHEAR_STARTS = ("transition", "rim", "tip")


def exponent(n0: Floats, n1: Floats, slip: Floats) -> Floats:
    """The sinkage exponent N, eq. (5)."""
    return n0 + n1 * slip


def entrance_angle(sinkage: Floats, radius: Floats) -> Floats:
    """theta_1, eq. (6), written so that small sinkages keep their digits."""
    return plain(2.0 * np.arcsin(np.sqrt(np.asarray(sinkage) / radius / 2.0)))


def leaving_angle(entrance: Floats, c3: Floats) -> Floats:
    """theta_2, eq. (7)."""
    return c3 * entrance


def maximum_stress_angle(entrance: Floats, c1: Floats, c2: Floats, slip: Floats) -> Floats:
    """theta_m, eq. (8)."""
    return (c1 + c2 * slip) * entrance


def shearing_radius_coefficient(radius: Floats, lug_height: Floats, lug_count: int, phi: Floats) -> Floats:
    """lambda_s, eq. (2); it leaves [0, 1] for short lugs, where it is not valid."""
    _check_lugs(lug_height, lug_count)
    half_pitch = np.pi / lug_count
    ratio = 1.0 / np.tan(half_pitch) / np.tan(np.pi / 4 - np.asarray(phi) / 2)
    return plain(np.asarray(1.0 - 3.0 * (radius + lug_height) / (8.0 * (1.0 + ratio) * lug_height)))


def minimum_lug_height(radius: Floats, lug_count: int, phi: Floats, lug_friction: Floats) -> Floats:
    """The least lug height for which (9) holds, eq. (10); `lug_friction` from 0 to 1 (full)."""
    _check_lugs(1.0, lug_count)
    slope = np.tan(np.pi / 4 - np.asarray(phi) / 2)
    pitch = 2.0 * np.pi / lug_count
    smooth = radius * (np.cos(pitch) + np.sin(pitch) * slope - 1.0)
    rough = radius * np.tan(pitch / 2.0) * slope
    return plain(np.asarray((1.0 - lug_friction) * smooth + lug_friction * rough))


def shear_start_radius(
    radius: Floats,
    lug_height: Floats,
    slip: Floats,
    *,
    transition_slips: tuple[float, float] = (0.15, 0.5),
    shear_start: str = "transition",
) -> Floats:
    """R_j, eq. (13), or its variants R_j = r ("rim") and R_j = r + h ("tip")."""
    if shear_start == "rim":
        return plain(np.asarray(radius + 0.0 * np.asarray(slip)))
    if shear_start == "tip":
        return plain(np.asarray(radius + lug_height + 0.0 * np.asarray(slip)))
    first, second = transition_slips
    share = np.clip((second - np.asarray(slip)) / (second - first), 0.0, 1.0)
    return plain(np.asarray(radius + lug_height * share))


def slip_from_speeds(angular_speed: Floats, travel_speed: Floats, radius: Floats) -> Floats:
    """The slip on `radius`, eq. (3), positive when driving, negative when braking.

    Raises ValueError where both speeds are zero, or either is negative.
    """
    rim_speed, travel = np.broadcast_arrays(np.asarray(radius) * angular_speed, np.asarray(travel_speed))
    require(rim_speed >= 0, "angular_speed", "must not be negative", rim_speed)
    require(travel >= 0, "travel_speed", "must not be negative", travel)
    fastest = np.maximum(rim_speed, travel)
    require(fastest > 0, "travel_speed", "and 'angular_speed' must not both be zero", fastest)
    return plain(np.asarray((rim_speed - travel) / fastest))


def convert_slip(slip: Floats, from_radius: Floats, to_radius: Floats) -> Floats:
    """Driving slip on another radius, s = 1 - (r_from/r_to)(1 - s_from), from eq. (3)."""
    return plain(np.asarray(1.0 - np.asarray(from_radius) / to_radius * (1.0 - np.asarray(slip))))


def _check_lugs(lug_height: Floats, lug_count: int) -> None:
    height = np.asarray(lug_height)
    require(height > 0, "lug_height", "must be positive for equations (2) and (10)", height)
    require(lug_count >= 3, "lug_count", "must be at least 3 for equations (2) and (10)", lug_count)
