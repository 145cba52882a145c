"""IM2 and IM3: the decoupled closed forms M2 and M3, one pass of three fits (Ding et al. 2015, Section 7).

The right-hand sides of (29)-(41) hold the measured F_N and M_DR; every formula takes complex parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayesterra.arrays import FloatArray
from bayesterra.identification.readings import Readings
from bayesterra.identification.solver import Formula
from bayesterra.identification.steps import Step
from bayesterra.identification.support import MARGIN
from bayesterra.models import WheelSoilModel
from bayesterra.models.geometry import entrance_angle, shear_start_radius

Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Contact:
    """What is measured or known in every row, (m,) each, SI.

    Attributes
    ----------
    entrance : θ1 (6).
    shear_start : θ1' (12).
    normal, moment : measured F_N and M_DR, NaN where not measured.
    """

    slip: FloatArray
    radius: FloatArray
    width: FloatArray
    shearing_radius: FloatArray
    entrance: FloatArray
    shear_start: FloatArray
    normal: FloatArray
    moment: FloatArray


def contact(readings: Readings, model: WheelSoilModel) -> Contact:
    """Contact of every row, with the transition slips and the shear start of ``model``."""
    rows = readings.conditions
    start_radius = shear_start_radius(
        rows.radius,
        rows.lug_height,
        rows.slip,
        transition_slips=model.transition_slips,
        shear_start=model.shear_start,
    )
    return Contact(
        rows.slip,
        rows.radius,
        rows.width,
        rows.shearing_radius,
        np.asarray(entrance_angle(readings.sinkage, rows.radius)),
        np.arccos((rows.radius - readings.sinkage) / start_radius),
        readings.forces["normal_force"],
        readings.forces["resistance_moment"],
    )


class Shape(NamedTuple):
    """Angles and their combinations A, B, C below (24), (m,) each."""

    leaving: Complex
    middle: Complex
    A: Complex
    B: Complex
    C: Complex


def shape(theta: Complex, at: Contact) -> Shape:
    """Shape of the contact for parameters (9,), with θm/θ1 clipped into (c3, 1)."""
    _, _, _, _, _, _, c1, c2, c3 = theta
    t1, t2 = at.entrance, c3 * at.entrance
    tm = _inside(c1 + c2 * at.slip, c3) * t1
    front, rear = t1 - tm, tm - t2
    A = (np.cos(tm) - np.cos(t2)) / rear + (np.cos(tm) - np.cos(t1)) / front
    B = (np.sin(tm) - np.sin(t2)) / rear + (np.sin(tm) - np.sin(t1)) / front
    return Shape(t2, tm, A, B, (t1 - t2) / 2)


def _inside(ratio: Complex, c3: np.complex128) -> Complex:
    low, high = c3 + MARGIN, 1 - MARGIN
    return np.where(ratio.real < low.real, low, np.where(ratio.real > high, high, ratio))


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


BOTH = ("normal_force", "resistance_moment")
EQUATIONS: dict[str, tuple[tuple[str, str, Callable[[Complex, Contact], Complex], tuple[str, ...]], ...]] = {
    "IM2": (
        ("P_III", "drawbar_pull", drawbar_pull_2, ("drawbar_pull", *BOTH)),
        ("P_I", "normal_force", normal_force_2, BOTH),
        ("P_II", "resistance_moment", resistance_moment_2, BOTH),
    ),
    "IM3": (
        ("P_III", "drawbar_pull", drawbar_pull_3, ("drawbar_pull", *BOTH)),
        ("P_I", "normal_force", normal_force_3, ("normal_force",)),
        ("P_II", "resistance_moment", resistance_moment_3, BOTH),
    ),
}
"""Group, channel, equation and the channels it needs, in the order of the fits."""


def decoupled_steps(method: str, readings: Readings, model: WheelSoilModel) -> list[Step]:
    """The three fits of IM2 or IM3."""
    at = contact(readings, model)

    def step(
        group: str, channel: str, equation: Callable[[Complex, Contact], Complex], needs: tuple[str, ...]
    ) -> Step:
        known = np.all([~np.isnan(readings.forces[name]) for name in needs], axis=0)
        return Step(
            group, channel, Formula(lambda theta: equation(theta, at)), readings.forces[channel], known, needs
        )

    return [step(*row) for row in EQUATIONS[method]]
