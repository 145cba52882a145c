"""Quantities that follow from the soil parameters and mean something to the one who drives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.likelihood import Forward
from bayesterra.models import Conditions
from bayesterra.parameters import SOIL_PARAMETERS, Parameter
from bayesterra.study import Study

REFERENCE_SINKAGE = 0.010
REFERENCE_STRESS = 5e3
SLIP_GRID = np.linspace(0.02, 0.8, 40)


@dataclass(frozen=True)
class Drive:
    """Responses of the study's first wheel over slip, at its median load, for n soils.

    Attributes
    ----------
    load : N, NaN where neither load nor normal force was measured (and so are the responses).
    sinkage, drawbar_pull, resistance_moment : (n, slips), NaN where the model has no answer.
    """

    load: float
    sinkage: FloatArray
    drawbar_pull: FloatArray
    resistance_moment: FloatArray


def drive(study: Study, soil: FloatArray) -> Drive:
    """Drive the study's first wheel over ``SLIP_GRID`` on soils (n, 9)."""
    observations = study.observations.used()
    force = observations.values.get("normal_force", observations.load)
    loads = np.where(np.isnan(observations.load), force, observations.load)
    load = float(np.median(loads[~np.isnan(loads)])) if not np.isnan(loads).all() else np.nan
    conditions = Conditions.of(next(iter(study.wheels.values())), SLIP_GRID)
    forward = Forward(study.model, "load", conditions, np.full(len(SLIP_GRID), load))
    z, pull, moment = forward(soil, every_row=True).values.transpose(2, 0, 1)
    return Drive(load, z, pull, moment)


def _column(name: str) -> Callable[[FloatArray], FloatArray]:
    return lambda soil: soil[:, SOIL_PARAMETERS.index(name)]


def bearing_pressure(soil: FloatArray) -> FloatArray:
    """Bekker pressure K_s z^n0 at ``REFERENCE_SINKAGE`` and zero slip, Pa, eq. (5); soils (n, 9)."""
    return _column("Ks")(soil) * REFERENCE_SINKAGE ** _column("n0")(soil)


def shear_strength(soil: FloatArray) -> FloatArray:
    """Strength c + σ tan φ at σ = ``REFERENCE_STRESS``, Pa; soils (n, 9). Eq. (9) at large displacement."""
    return _column("c")(soil) + REFERENCE_STRESS * np.tan(_column("phi")(soil))


DERIVED: dict[str, Parameter] = {
    quantity.name: quantity
    for quantity in (
        Parameter(
            "bearing_pressure", "p(10 mm)", r"p_{10}", "kPa", 1e3, "Pa", "bearing pressure at 10 mm sinkage"
        ),
        Parameter(
            "shear_strength", "τ(5 kPa)", r"\tau_{5}", "kPa", 1e3, "Pa", "shear strength at 5 kPa stress"
        ),
        Parameter("peak_pull", "max F_DP", r"F_\mathrm{DP}^{max}", "N", 1.0, "N", "greatest drawbar pull"),
        Parameter("peak_pull_slip", "s at max F_DP", r"s^{max}", "-", 1.0, "", "slip of greatest pull"),
    )
}


def derive(study: Study, soil: FloatArray) -> dict[str, FloatArray]:
    """All quantities of ``DERIVED`` for soils (n, 9), each (n,), SI; NaN where the model has no answer."""
    pull = drive(study, soil).drawbar_pull
    answered = np.isfinite(pull).any(axis=1)
    filled = np.where(np.isnan(pull), -np.inf, pull)
    best = filled.argmax(axis=1)
    return {
        "bearing_pressure": bearing_pressure(soil),
        "shear_strength": shear_strength(soil),
        "peak_pull": np.where(answered, filled[np.arange(len(soil)), best], np.nan),
        "peak_pull_slip": np.where(answered, SLIP_GRID[best], np.nan),
    }
