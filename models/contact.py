"""The contact arc and the stresses along it, written straight from the paper."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from bayesterra.models.checks import FloatArray, require
from bayesterra.models.geometry import Floats, entrance_angle, leaving_angle, maximum_stress_angle
from bayesterra.models.soil import Soil
from bayesterra.models.wheel import Wheel


@dataclass(frozen=True)
class Contact:
    """A wheel in the soil: exponent and angles, Ding et al. 2015, eqs. (5)-(8), (12); fields broadcast."""

    soil: Soil
    wheel: Wheel
    slip: Floats
    exponent: Floats
    entrance: Floats
    leaving: Floats
    maximum: Floats
    start: Floats

    @classmethod
    def of(
        cls, soil: Soil, wheel: Wheel, slip: Floats, sinkage: Floats, start_radius: Floats, exponent: Floats
    ) -> Self:
        """Contact at a sinkage in m; ValueError where eq. (4) is not defined."""
        entrance = entrance_angle(sinkage, wheel.radius)
        require(np.asarray(exponent) > 0, "n0 + n1 s", "must be positive", exponent)
        ratio = np.asarray(maximum_stress_angle(1.0, soil.c1, soil.c2, slip))
        inside = (ratio > soil.c3) & (ratio < 1) & (np.asarray(soil.c3) >= -1)
        require(inside, "c1 + c2 s", "must lie between c3 and 1, and c3 in [-1, 1)", ratio)
        start = entrance_angle(np.asarray(start_radius) - wheel.radius + sinkage, start_radius)
        leaving = leaving_angle(entrance, soil.c3)
        return cls(soil, wheel, slip, exponent, entrance, leaving, ratio * entrance, start)

    def normal_stress(self, angle: FloatArray) -> FloatArray:
        """Normal stress sigma, eq. (4); rear angles are mirrored to the front angle of equal stress."""
        share = (angle - self.leaving) / (self.maximum - self.leaving)
        front = np.where(angle >= self.maximum, angle, self.entrance - share * (self.entrance - self.maximum))
        rise = np.cos(front) - np.cos(self.entrance)
        radius = self.wheel.radius
        return np.asarray(self.soil.Ks * (radius * np.maximum(rise, 0.0)) ** np.asarray(self.exponent))

    def shear_stress(self, angle: FloatArray, normal_stress: FloatArray) -> FloatArray:
        """Shear stress tau, eq. (9)."""
        limit = self.soil.c + normal_stress * np.tan(self.soil.phi)
        return np.asarray(-limit * np.expm1(-self.shear_displacement(angle) / self.soil.K))

    def shear_displacement(self, angle: FloatArray) -> FloatArray:
        """Shear displacement j in m, eq. (11)."""
        drag = (1 - np.asarray(self.slip)) * (np.sin(self.start) - np.sin(angle))
        return np.asarray(self.wheel.shearing_radius(self.soil.phi) * ((self.start - angle) - drag))

    def peak_stresses(self) -> tuple[FloatArray, FloatArray]:
        """sigma_m and tau_m, eqs. (18), (19)."""
        normal = self.normal_stress(np.asarray(self.maximum))
        return normal, self.shear_stress(np.asarray(self.maximum), normal)

    def lever_arms(self) -> tuple[FloatArray, FloatArray]:
        """A and B of (24)."""
        parts = [(self.leaving, self.maximum), (self.maximum, self.entrance)]
        cosines = [(np.cos(low) - np.cos(high)) / (high - low) for low, high in parts]
        sines = [(np.sin(high) - np.sin(low)) / (high - low) for low, high in parts]
        return np.asarray(cosines[1] - cosines[0]), np.asarray(sines[0] - sines[1])

    def triangle(self, angle: FloatArray) -> FloatArray:
        """The share of the peak on two straight lines from 0 at both ends, eqs. (20), (21)."""
        front = (self.entrance - angle) / (self.entrance - self.maximum)
        return np.asarray(np.minimum(front, (angle - self.leaving) / (self.maximum - self.leaving)))
