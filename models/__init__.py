"""Wheel-soil models M1, M2, M3, M2L of Ding et al. 2015, with exact derivatives; they know no statistics."""

if __name__ != "bayesterra.models":  # the folder is importable under a second name from the repository's root
    raise ImportError(f"import this package as 'bayesterra.models', not {__name__!r}")

from bayesterra.models.base import WheelSoilModel
from bayesterra.models.conditions import Conditions, Status
from bayesterra.models.forces import Components, Forces
from bayesterra.models.forward import ForwardModel
from bayesterra.models.integral import M1
from bayesterra.models.linear import M2, M3
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
    from bayesterra.models.batch import KINDS  # numba is heavy: only where it is needed
    from bayesterra.models.batch import warm_up as warm_up_kernels

    warm_up_kernels(names or KINDS)
