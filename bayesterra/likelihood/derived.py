"""Quantities that follow from the soil parameters and mean something to the one who drives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.forward import Forward, soil_at
from bayesterra.models import Conditions, Wheel, WheelSoilModel
from bayesterra.parameters import SoilColumns
from bayesterra.study.drive import Drive
from bayesterra.study.study import Study

REFERENCE_SINKAGE = 0.010
REFERENCE_STRESS = 5e3
SLIP_GRID = np.linspace(0.02, 0.8, 40)


@dataclass(frozen=True)
class Response:
    """Response of one wheel under one load over ``SLIP_GRID``, for n soils.

    Attributes
    ----------
    load : N, NaN where neither load nor normal force was measured (and so are the responses).
    sinkage, drawbar_pull, resistance_moment, efficiency : (n, slips), NaN where the model has no answer.
    """

    load: float
    sinkage: FloatArray
    drawbar_pull: FloatArray
    resistance_moment: FloatArray
    efficiency: FloatArray


def reference_load(study: Study) -> float:
    """Median load (N) of the rows in the fit, of the normal force where no load was given.

    Else the middle of the latent loads' range; NaN where there is none.
    """
    loads = study.observations.used().carried
    return float(np.median(loads[~np.isnan(loads)])) if not np.isnan(loads).all() else study.middle_load


def drive(study: Study, soil: FloatArray) -> Response:
    """Drive the study's first wheel under its median load on soils (n, 16)."""
    return drive_wheel(study.model, next(iter(study.wheels.values())), reference_load(study), soil)


def drive_wheel(model: WheelSoilModel, wheel: Wheel, load: float, soil: FloatArray) -> Response:
    """Drive ``wheel`` under ``load`` (N) over ``SLIP_GRID`` on soils (n, 16)."""
    conditions = Conditions.of(wheel, SLIP_GRID)
    forward = Forward(model, Drive.LOAD, conditions, np.full(len(SLIP_GRID), load))
    outcomes = forward(soil, every_row=True)
    pull, moment = outcomes["drawbar_pull"], outcomes["resistance_moment"]
    return Response(load, outcomes["sinkage"], pull, moment, tractive_efficiency(pull, moment, conditions))


def tractive_efficiency(pull: FloatArray, moment: FloatArray, conditions: Conditions) -> FloatArray:
    """Power at the drawbar over power at the axle, η = F_DP v / (M_DR ω) = F_DP r_s (1 − s) / M_DR.

    By v = r_s ω (1 − s), eq. (3); pull (N) and moment (N m) of shape (n, rows). Negative where the wheel has
    to be pushed, NaN where the axle takes no power.
    """
    speed = conditions.shearing_radius * (1.0 - conditions.slip)
    return pull * speed / np.where(moment > 0, moment, np.nan)


def bearing_pressure(soil: FloatArray) -> FloatArray:
    """Bekker pressure K_s z^n0 at ``REFERENCE_SINKAGE`` and zero slip, Pa, eq. (5); soils (n, 16)."""
    return soil[:, SoilColumns.Ks] * REFERENCE_SINKAGE ** soil[:, SoilColumns.n0]


def shear_strength(soil: FloatArray) -> FloatArray:
    """Strength c + σ tan φ at σ = ``REFERENCE_STRESS``, Pa; soils (n, 16). Eq. (9) at large displacement."""
    return np.asarray(soil[:, SoilColumns.c] + REFERENCE_STRESS * np.tan(soil[:, SoilColumns.phi]))


def derive(study: Study, soil: FloatArray) -> dict[str, FloatArray]:
    """All quantities of ``DERIVED``, for the study's first wheel under its median load; see below."""
    return derive_for(study.model, next(iter(study.wheels.values())), reference_load(study), soil)


def derive_for(model: WheelSoilModel, wheel: Wheel, load: float, soil: FloatArray) -> dict[str, FloatArray]:
    """All quantities of ``DERIVED`` for ``wheel`` under ``load`` (N), each (n,), SI.

    ``soil`` (n, 16) as every forward model takes it; NaN where the model has no answer.
    """
    driven, soil = drive_wheel(model, wheel, load, soil), soil_at(soil, wheel.width)
    pull, pull_slip = greatest(driven.drawbar_pull)
    efficiency, efficiency_slip = greatest(driven.efficiency)
    return {
        "bearing_pressure": bearing_pressure(soil),
        "shear_strength": shear_strength(soil),
        "peak_pull": pull,
        "peak_pull_slip": pull_slip,
        "peak_efficiency": efficiency,
        "peak_efficiency_slip": efficiency_slip,
    }


def greatest(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Greatest of ``values`` (n, slips) over ``SLIP_GRID`` and its slip, each (n,); NaN where all are.

    Between the slips of the grid: the vertex of the parabola through the greatest value and its neighbours.
    """
    filled = np.where(np.isfinite(values), values, -np.inf)
    best, every = filled.argmax(axis=1), np.arange(len(filled))
    centre = np.clip(best, 1, len(SLIP_GRID) - 2)
    around = filled[every[:, None], centre[:, None] + np.array([-1, 0, 1])]
    inner = (centre == best) & np.isfinite(around).all(axis=1)
    before, middle, after = np.where(inner[:, None], around, [0.0, 1.0, 0.0]).T
    shift = np.where(inner, 0.5 * (before - after) / np.minimum(before - 2 * middle + after, -1e-300), 0.0)
    height = filled[every, best] - np.where(inner, 0.25 * (before - after) * shift, 0.0)
    answered = np.isfinite(values).any(axis=1)
    slip = SLIP_GRID[best] + shift * (SLIP_GRID[1] - SLIP_GRID[0])
    return np.where(answered, height, np.nan), np.where(answered, slip, np.nan)
