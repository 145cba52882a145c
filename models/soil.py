"""The soil's mechanical parameters."""

from dataclasses import astuple, dataclass, fields

import numpy as np

from bayesterra.models.checks import FloatArray, as_floats, require


@dataclass(frozen=True)
class Soil:
    """Soil parameters in SI units and radians; every field is a number or an array, and fields broadcast.

    Raises ValueError for values that no soil can have.
    """

    Ks: float | FloatArray
    """Sinkage modulus K_s = k_c/b + k_phi, Pa/m^N."""
    n0: float | FloatArray
    """Sinkage exponent at zero slip, N = n0 + n1 s."""
    n1: float | FloatArray
    """Growth of the sinkage exponent with slip."""
    c: float | FloatArray
    """Cohesion, Pa."""
    phi: float | FloatArray
    """Internal friction angle, rad."""
    K: float | FloatArray
    """Shearing deformation modulus, m."""
    c1: float | FloatArray
    """Maximum-stress angle over entrance angle at zero slip, theta_m = (c1 + c2 s) theta_1."""
    c2: float | FloatArray
    """Growth of that ratio with slip."""
    c3: float | FloatArray = 0.0
    """Leaving angle over entrance angle."""

    def __post_init__(self) -> None:
        for name, value in zip((field.name for field in fields(self)), astuple(self), strict=True):
            values = as_floats(name, value)
            if name in _RULES:
                lowest, strict, rule = _RULES[name]
                require(values > lowest if strict else values >= lowest, name, rule, values)
        require(np.asarray(self.phi) < np.pi / 2, "phi", "must be below pi/2 rad", self.phi)

    def as_array(self) -> FloatArray:
        """The parameters along a last axis: SOIL_FIELDS, and LOAD_EFFECT_FIELDS of a :class:`LoadEffectSoil`."""
        values = (np.asarray(value, dtype=np.float64) for value in astuple(self))
        return np.stack(np.broadcast_arrays(*values), axis=-1)


@dataclass(frozen=True)
class LoadEffectSoil(Soil):
    """Soil parameters and the coefficients of the load effect, Ding et al. 2015, eq. (42), for M2L.

    They describe a soil under the wheels of one vehicle, with the mean load per wheel for a reference.
    """

    cP1: float | FloatArray = 0.0
    """Correction of F_DP at zero slip, factor 1 + c_P1 + c_P2 s."""
    cP2: float | FloatArray = 0.0
    """Growth of that factor with slip."""
    cDP: float | FloatArray = 0.0
    """Load effect on F_DP, factor 1 + c_DP (W_mean - F_N)/W_mean."""
    cM: float | FloatArray = 0.0
    """Load effect on M_DR, factor 1 + c_M (W_mean - F_N)/W_mean of the friction under F_N."""


SOIL_FIELDS = tuple(field.name for field in fields(Soil))
LOAD_EFFECT_FIELDS = tuple(field.name for field in fields(LoadEffectSoil))[len(SOIL_FIELDS) :]
RANGES = {"Ks": (0.0, np.inf), "c": (0.0, np.inf), "phi": (0.0, np.pi / 2), "K": (0.0, np.inf)}
"""Physical ranges by name, SI; other parameters may take any value."""
_RULES = {  # lowest value, whether it is excluded, the rule in words
    "Ks": (0.0, True, "must be positive"),
    "K": (0.0, True, "must be positive"),
    "c": (0.0, False, "must not be negative"),
    "phi": (0.0, False, "must not be negative"),
}
