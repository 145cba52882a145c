"""Equations of M2 and M3 decoupled by parameter groups, Ding et al. 2015, Section 5.

The right-hand sides of (29)-(41) hold the measured F_N and M_DR; every formula takes complex parameters, for
derivatives by complex steps.
"""

from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from bayesterra.models.base import WheelSoilModel
from bayesterra.models.checks import FloatArray
from bayesterra.models.conditions import Conditions
from bayesterra.models.geometry import entrance_angle, shear_start_radius
from bayesterra.models.soil import SOIL_FIELDS

Complex = NDArray[np.complex128]
MARGIN = 1e-6
"""Distance of θm/θ1 from c3 and 1, and of N from 0, at which rows are clipped."""

_C1, _C2, _C3 = (SOIL_FIELDS.index(name) for name in ("c1", "c2", "c3"))


Angles = TypeVar("Angles", FloatArray, NDArray[np.complex128])


def ratio(theta: Angles, slip: FloatArray) -> Angles:
    """Ratios θm/θ1 (m,), (8), of soil parameters (p,)."""
    ratios: Angles = theta[_C1] + theta[_C2] * slip
    return ratios


def leaving(theta: Angles, slip: FloatArray) -> Angles:
    """Ratios θ2/θ1 (m,), (7), of soil parameters (p,): one at all slips."""
    return np.repeat(theta[_C3], len(slip))


@dataclass(frozen=True)
class Contact:
    """Measured and known values of every row, (m,) each, SI."""

    slip: FloatArray
    radius: FloatArray
    width: FloatArray
    shearing_radius: FloatArray
    entrance: FloatArray  # θ1 (6)
    shear_start: FloatArray  # θ1' (12)
    normal: FloatArray  # measured F_N, NaN where not measured
    moment: FloatArray  # measured M_DR likewise

    @classmethod
    def of(
        cls, model: WheelSoilModel, rows: Conditions, sinkage: FloatArray, normal: FloatArray, moment: FloatArray
    ) -> "Contact":
        """Contact of every row, with the transition slips and the shear start of `model`."""
        start_radius = shear_start_radius(
            rows.radius,
            rows.lug_height,
            rows.slip,
            transition_slips=model.transition_slips,
            shear_start=model.shear_start,
        )
        return cls(
            rows.slip,
            rows.radius,
            rows.width,
            rows.shearing_radius,
            np.asarray(entrance_angle(sinkage, rows.radius)),
            np.arccos((rows.radius - sinkage) / start_radius),
            normal,
            moment,
        )


class Shape(NamedTuple):
    """Angles and their combinations A, B, C below (24), (m,) each."""

    leaving: Complex
    middle: Complex
    A: Complex
    B: Complex
    C: Complex


def shape(theta: Complex, at: Contact) -> Shape:
    """Shape of the contact for parameters (p,), with θm/θ1 clipped into (θ2/θ1, 1)."""
    back = leaving(theta, at.slip)
    t1, t2 = at.entrance, back * at.entrance
    tm = _inside(ratio(theta, at.slip), back) * t1
    front, rear = t1 - tm, tm - t2
    A = (np.cos(tm) - np.cos(t2)) / rear + (np.cos(tm) - np.cos(t1)) / front
    B = (np.sin(tm) - np.sin(t2)) / rear + (np.sin(tm) - np.sin(t1)) / front
    return Shape(t2, tm, A, B, (t1 - t2) / 2)


def _inside(middle: Complex, back: Complex) -> Complex:
    low, high = back + MARGIN, 1 - MARGIN
    return np.where(middle.real < low.real, low, np.where(middle.real > high, high, middle))


def largest_stress(theta: Complex, middle: Complex, at: Contact) -> Complex:
    """σ_m (18), Pa."""
    Ks, n0, n1, *_ = theta
    half_sum, half_difference = (at.entrance + middle) / 2, (at.entrance - middle) / 2
    depth = 2 * at.radius * np.sin(half_sum) * np.sin(half_difference)
    stress: Complex = Ks * np.exp((n0 + n1 * at.slip) * np.log(depth))
    return stress


def mobilised(theta: Complex, middle: Complex, at: Contact) -> Complex:
    """E of (19): the share of the shear strength that is mobilised at θm."""
    K = theta[5]
    path = (at.shear_start - middle) - (1 - at.slip) * (np.sin(at.shear_start) - np.sin(middle))
    share: Complex = -np.expm1(-at.shearing_radius * path / K)
    return share


def drawbar_pull_2(theta: Complex, at: Contact) -> Complex:
    """F_DP of M2, (29), N."""
    _, _, A, B, C = shape(theta, at)
    return (A**2 + B**2) / (A * C) * at.moment / at.shearing_radius - B / A * at.normal


def normal_force_2(theta: Complex, at: Contact) -> Complex:
    """F_N of M2, (38), N."""
    _, middle, A, B, C = shape(theta, at)
    stress = largest_stress(theta, middle, at)
    return at.radius * at.width * A * stress + B * at.moment / (at.shearing_radius * C)


def resistance_moment_2(theta: Complex, at: Contact) -> Complex:
    """M_DR of M2, (40), N m."""
    _, middle, A, B, C = shape(theta, at)
    E, friction, r_s = mobilised(theta, middle, at), np.tan(theta[4]) / (at.radius * A), at.shearing_radius
    strength = at.width * theta[3] + at.normal * friction
    moment: Complex = r_s**2 * C * E * strength / (1 + r_s * B * E * friction)
    return moment


def drawbar_pull_3(theta: Complex, at: Contact) -> Complex:
    """F_DP of M3, (36), N."""
    leaving, middle, _, B, _ = shape(theta, at)
    cos = np.cos(middle)
    return at.moment * cos / at.shearing_radius - 2 * B * at.normal / ((at.entrance - leaving) * cos)


def normal_force_3(theta: Complex, at: Contact) -> Complex:
    """F_N of M3, (39), N."""
    leaving, middle, *_ = shape(theta, at)
    stress = largest_stress(theta, middle, at)
    return at.radius * at.width * (at.entrance - leaving) * stress * np.cos(middle) / 2


def resistance_moment_3(theta: Complex, at: Contact) -> Complex:
    """M_DR of M3, (41), N m."""
    leaving, middle, *_ = shape(theta, at)
    cohesion = at.width * theta[3] * (at.entrance - leaving) / 2
    friction = at.normal * np.tan(theta[4]) / (at.radius * np.cos(middle))
    moment: Complex = mobilised(theta, middle, at) * at.shearing_radius**2 * (cohesion + friction)
    return moment
