"""Traction of a wheel over slip: drawbar pull and efficiency, and the greatest of both."""

from __future__ import annotations

import numpy as np

from bayesterra.models.checks import FloatArray
from bayesterra.models.conditions import Conditions
from bayesterra.models.forces import DRAWBAR_PULL, RESISTANCE_MOMENT
from bayesterra.models.forward import ForwardModel
from bayesterra.models.wheel import Wheel

SLIP_GRID = np.linspace(0.02, 0.8, 40)


def traction(model: ForwardModel, wheel: Wheel, load: float, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Drawbar pull and efficiency (n, slips) of a wheel under ``load`` (N) over ``SLIP_GRID``.

    ``parameters`` (n, k) are those of the model. NaN where it has no answer, and where the load is not known.
    """
    conditions = Conditions.of(wheel, SLIP_GRID)
    loads = np.full(len(SLIP_GRID), load)
    values, _ = model.response_at(parameters, conditions, loads, every_row=True)
    pull = values[:, :, DRAWBAR_PULL]
    return pull, tractive_efficiency(pull, values[:, :, RESISTANCE_MOMENT], conditions)


def tractive_efficiency(pull: FloatArray, moment: FloatArray, conditions: Conditions) -> FloatArray:
    """Power at the drawbar over power at the axle, η = F_DP v / (M_DR ω) = F_DP r_s (1 − s) / M_DR.

    By v = r_s ω (1 − s), eq. (3); pull (N) and moment (N m) of shape (n, rows). Negative where the wheel has
    to be pushed, NaN where the axle takes no power.
    """
    speed = conditions.shearing_radius * (1.0 - conditions.slip)
    return pull * speed / np.where(moment > 0, moment, np.nan)


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
