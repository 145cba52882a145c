"""What a least-squares identification returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.models import LoadEffectSoil, Soil
from bayesterra.parameters import MODEL_PARAMETERS, SOIL_PARAMETERS

FORCES = ("normal_force", "drawbar_pull", "resistance_moment")
"""The channels that IM1, IM2 and IM3 fit."""

METHODS = ("IM1", "IM2", "IM3", "joint")


@dataclass(frozen=True)
class Fit:
    """Soil parameters found by one method, and how it went.

    Attributes
    ----------
    method : ``IM1``, ``IM2``, ``IM3`` or ``joint``.
    soil : the parameters, SI and radians. Those in ``missing`` stand at their start values.
    errors : fit error (16) in percent of each channel, NaN where it was not measured or not fitted. IM1 and
        joint are judged by their model, IM2 and IM3 by their equations with the measured F_N and M_DR put in.
    converged : the passes met the criterion and every inner fit ended at a minimum.
    passes : passes of IM1, rounds of noise weights of joint, else 1.
    path : the parameters after each pass.
    held : parameters that were not free.
    at_bound : free parameters within 1e-4 of their range from a bound.
    missing : parameters that could not be identified; ``notes`` say why.
    clipped : at some slip, θm/θ1 (or N) was clipped to the model's range; with joint, it is at its edge.
    notes : in words, one line each.
    seconds : time taken.
    noise : typical standard deviation of each channel behind the weights of joint, SI; else empty.
    """

    method: str
    soil: Soil
    errors: Mapping[str, float]
    converged: bool
    passes: int
    path: tuple[Soil, ...]
    held: tuple[str, ...]
    at_bound: tuple[str, ...]
    missing: tuple[str, ...]
    clipped: bool
    notes: tuple[str, ...]
    seconds: float
    noise: Mapping[str, float]

    def values(self) -> dict[str, float]:
        """Soil parameters by name, SI and radians."""
        return {
            name: float(getattr(self.soil, name)) for name in MODEL_PARAMETERS if hasattr(self.soil, name)
        }

    def identified(self) -> dict[str, float]:
        """Soil parameters by name without those that the data could not tell."""
        return {name: value for name, value in self.values().items() if name not in self.missing}


def error_figure(measured: FloatArray, predicted: FloatArray) -> float:
    """Largest misfit in percent of the largest reading, Ding et al. 2015, eq. (16).

    Readings that are NaN count for nothing; NaN where there is no reading or every reading is 0.
    """
    known = ~np.isnan(measured)
    if not np.any(measured[known]):
        return float("nan")
    return float(100 * np.max(np.abs(measured - predicted)[known]) / np.max(np.abs(measured[known])))


def soil_of(theta: FloatArray) -> Soil:
    """Soil from parameters (9,), or (13,) with the load effect."""
    kind = Soil if len(theta) == len(SOIL_PARAMETERS) else LoadEffectSoil
    return kind(*(float(value) for value in theta))
