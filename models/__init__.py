"""Wheel-soil models M1, M2, M3, M2L of Ding et al. 2015, with exact derivatives; they know no statistics."""

if __name__ != "bayesterra.models":  # the folder is importable under a second name from the repository's root
    raise ImportError(f"import this package as 'bayesterra.models', not {__name__!r}")

from dataclasses import MISSING, fields
from typing import Any

from bayesterra.models.base import WheelSoilModel
from bayesterra.models.conditions import Conditions, Status
from bayesterra.models.ding import M1, M2, M3
from bayesterra.models.forces import Components, Forces
from bayesterra.models.forward import ForwardModel
from bayesterra.models.load_effect import M2L
from bayesterra.models.own import ModelParameter, OwnModel
from bayesterra.models.soil import LOAD_EFFECT_FIELDS, RANGES, SOIL_FIELDS, LoadEffectSoil, Soil
from bayesterra.models.wheel import Wheel

MODELS: dict[str, type[WheelSoilModel]] = {"M1": M1, "M2": M2, "M3": M3, "M2L": M2L}

__all__ = [
    "LOAD_EFFECT_FIELDS",
    "M1",
    "M2",
    "M2L",
    "M3",
    "MODELS",
    "RANGES",
    "SOIL_FIELDS",
    "Components",
    "Conditions",
    "Forces",
    "ForwardModel",
    "LoadEffectSoil",
    "ModelParameter",
    "OwnModel",
    "Soil",
    "Status",
    "Wheel",
    "WheelSoilModel",
    "warm_up",
]


def warm_up(*names: str) -> None:
    """Compile every kernel of models, of all without names, or load it from numba's cache, before workers start."""
    soil = Soil(Ks=2.5e6, n0=0.76, n1=1.3, c=250.0, phi=0.5568, K=0.012, c1=0.5, c2=-0.3)
    wheel = Wheel(0.157, 0.165, 0.01, 30, shearing_radius_coefficient=0.65)
    for kind in (MODELS[name] for name in names or MODELS):
        needed: dict[str, Any] = {field.name: 80.0 for field in fields(kind) if field.default is MISSING}
        model = kind(**needed)  # M2L needs a mean load
        theta = [*soil.as_array(), *[0.0] * (len(model.parameters) - len(SOIL_FIELDS))]
        model.response_jacobian_at([theta], Conditions.of(wheel, 0.2), 80.0)
        model.components(soil, wheel, 0.2, 0.01)
