"""A wheel's dimensions and the radius on which slip and shear stress are defined."""

from dataclasses import dataclass

import numpy as np

from bayesterra.models.checks import FloatArray, as_floats, plain, require
from bayesterra.models.geometry import shearing_radius_coefficient


@dataclass(frozen=True)
class Wheel:
    """A rigid wheel, with or without lugs; lengths in m. ValueError for dimensions that no wheel has."""

    radius: float
    """Radius r without lugs."""
    width: float
    """Width b."""
    lug_height: float = 0.0
    """Lug height h."""
    lug_count: int = 0
    """Number of lugs n_L."""
    shearing_radius_coefficient: float | None = None
    """lambda_s of Ding et al. 2015, (1), between 0 and 1; None: from (2) there at the soil's friction angle."""

    def __post_init__(self) -> None:
        for name in ("radius", "width"):
            value = as_floats(name, getattr(self, name))
            require(value > 0, name, "must be positive", value)
            require((value >= 1e-6) & (value <= 1e3), name, "must lie between 1e-6 and 1000 m", value)
        for name in ("lug_height", "lug_count"):
            value = as_floats(name, getattr(self, name))
            require(value >= 0, name, "must not be negative", value)
        require(self.lug_count == int(self.lug_count), "lug_count", "must be a whole number", self.lug_count)
        if self.shearing_radius_coefficient is not None:
            value = as_floats("shearing_radius_coefficient", self.shearing_radius_coefficient)
            require((value >= 0) & (value <= 1), "shearing_radius_coefficient", "must lie in [0, 1]", value)

    def shearing_radius(self, phi: float | FloatArray = 0.0) -> float | FloatArray:
        """r_s in m for friction angle `phi` in rad, Ding et al. 2015, eqs. (1) and (2).

        Raises ValueError where lambda_s leaves [0, 1], as it does for short lugs.
        """
        shape = np.shape(phi)
        if self.lug_height == 0:
            return plain(np.full(shape, float(self.radius)))
        given = self.shearing_radius_coefficient
        coefficient = self._coefficient_from_friction(phi) if given is None else given
        return plain(np.broadcast_to(self.radius + np.asarray(coefficient) * self.lug_height, shape).copy())

    def _coefficient_from_friction(self, phi: float | FloatArray) -> float | FloatArray:
        value = shearing_radius_coefficient(self.radius, self.lug_height, self.lug_count, phi)
        inside = (np.asarray(value) >= 0) & (np.asarray(value) <= 1)
        rule = "from equation (2) must lie in [0, 1]; give the wheel's own value instead"
        require(inside, "shearing_radius_coefficient", rule, value)
        return value
