"""M2L: the closed form for vehicles whose wheels carry different loads."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from bayesterra.models.base import WheelSoilModel
from bayesterra.models.checks import FloatArray
from bayesterra.models.conditions import Conditions
from bayesterra.models.contact import Contact
from bayesterra.models.soil import LOAD_EFFECT_FIELDS, SOIL_FIELDS, LoadEffectSoil, Soil

_CDP, _CM = (len(SOIL_FIELDS) + LOAD_EFFECT_FIELDS.index(name) for name in ("cDP", "cM"))


@dataclass(frozen=True, kw_only=True)
class M2L(WheelSoilModel):
    """M2 with the load effect, Ding et al. 2015, eq. (42): c_P1, c_P2, c_DP, c_M of a LoadEffectSoil.

    F_N in (42b) and (42c) of Ding et al. 2015 is the wheel's own; without coefficients (a plain Soil) it is M2. For
    c_M < 0 (42) may have two normal forces at a sinkage: the smaller one counts, the one that M2 has as c_M
    goes to 0. The paper holds c1 = 0.5, c2 = c3 = 0; the model takes any.
    """

    mean_load: float
    """Mean load per wheel of the vehicle, W-bar, N."""

    equations: ClassVar[str] = "closed form with linear stresses and the effect of the wheel's load, (42)"
    parameters: ClassVar[tuple[str, ...]] = (*SOIL_FIELDS, *LOAD_EFFECT_FIELDS)
    _kind: ClassVar[tuple[int, ...]] = (0, 0, 0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.mean_load < np.inf:
            raise ValueError(f"'mean_load' must be positive and finite (got {self.mean_load})")

    def response_jacobian_at(self, theta: ArrayLike, conditions: Conditions, load: ArrayLike) -> FloatArray:
        """Exact d(z, F_DP, M_DR)/d theta at constant load, (n, m, 3, p)."""
        return self.known_under(load, super().response_jacobian_at(theta, conditions, load))

    def known_under(self, load: ArrayLike, slopes: FloatArray) -> FloatArray:
        """Derivatives by c_DP and c_M as 0 where `load` is the mean load, met by F_N to 1e-11 only."""
        at_mean = np.broadcast_to(np.asarray(load) == self.mean_load, slopes.shape[:2])
        slopes[at_mean, :, _CDP : _CM + 1] = 0.0
        return slopes

    def _stresses(self, contact: Contact, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        normal, shear = contact.peak_stresses()
        shape = contact.triangle(angle)
        return normal * shape, (shear + self._further_shear(contact, normal, shear)) * shape

    def _further_shear(self, contact: Contact, normal: FloatArray, shear: FloatArray) -> FloatArray:
        """Stress that (42c) adds to tau_m."""
        soil, wheel = contact.soil, contact.wheel
        load_effect = soil.cM if isinstance(soil, LoadEffectSoil) else 0.0
        a, b = contact.lever_arms()
        built_up = -np.expm1(-contact.shear_displacement(np.asarray(contact.maximum)) / soil.K)
        friction = built_up * np.tan(soil.phi) / (wheel.radius * a)
        arm = wheel.shearing_radius(soil.phi)
        plain = wheel.width * (wheel.radius * normal * a + arm * shear * b)
        growth = load_effect * arm * b * friction
        line = 1.0 - growth
        force = 2.0 * plain / (line + np.sqrt(line**2 + 4.0 * growth * plain / self.mean_load))
        return np.asarray(load_effect * (1.0 - force / self.mean_load) * force * friction / wheel.width)

    def _theta(self, soil: Soil) -> FloatArray:
        values = soil.as_array()
        missing = len(self.parameters) - values.shape[-1]
        return np.concatenate([values, np.zeros((*values.shape[:-1], missing))], axis=-1)

    def _rows(self, conditions: Conditions) -> FloatArray:
        return self._rows_under(conditions, np.full(len(conditions.slip), self.mean_load))

    def _rows_under(self, conditions: Conditions, mean_load: FloatArray) -> FloatArray:
        return np.column_stack([super()._rows(conditions), mean_load])
