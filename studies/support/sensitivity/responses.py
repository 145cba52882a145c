"""Load-driven responses of many soils, and how far they lie apart by the paper's error figure (16)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray
from bayesterra.models import Soil, WheelSoilModel
from bayesterra.parameters import CHANNELS
from sensitivity.groups import REFERENCE, Group, Setting, soil_array

OUTCOMES = ("sinkage", "drawbar_pull", "resistance_moment")
"""What answers to slip and load: the last axis of every array here."""


@dataclass(frozen=True)
class Responses:
    """Response of each soil to slip at one load.

    Attributes
    ----------
    names : of the soils (n,).
    setting : wheel, load and slips (m,).
    values : (n, m, 3), SI, in the order of ``OUTCOMES``.
    """

    names: tuple[str, ...]
    setting: Setting
    values: FloatArray

    @property
    def sinkage(self) -> FloatArray:
        """Sinkage (n, m), m."""
        return self.values[:, :, 0]

    @property
    def table(self) -> pd.DataFrame:
        """One row per soil and slip, in field units."""
        count = len(self.setting.slips)
        columns = {"soil": np.repeat(self.names, count), "slip": np.tile(self.setting.slips, len(self.names))}
        for i, name in enumerate(OUTCOMES):
            channel = CHANNELS[name]
            columns[f"{name} [{channel.unit}]"] = self.values[:, :, i].ravel() / channel.scale
        return pd.DataFrame(columns)


def respond(
    model: WheelSoilModel, soils: FloatArray, setting: Setting, names: Sequence[str] | None = None
) -> Responses:
    """Sinkage, drawbar pull and resistance moment of ``soils`` (n, 9) against slip under the load.

    Raises
    ------
    ValueError : a soil has no answer at one of the slips; the message says why, at (soil, slip).
    """
    soil, wheel = broadcast_soil(soils, 1), setting.wheel
    sinkage = model.sinkage(soil, wheel, setting.slips, setting.load)
    forces = model.forces(soil, wheel, setting.slips, sinkage)
    values = np.stack([sinkage, forces.drawbar_pull, forces.resistance_moment], axis=-1)
    named = names if names is not None else [str(i + 1) for i in range(len(soils))]
    return Responses(tuple(named), setting, values)


def broadcast_soil(soils: FloatArray, axes: int) -> Soil:
    """Soils (n, 9) as a soil of arrays (n, 1, ...), with ``axes`` axes to broadcast over."""
    return Soil(*(column.reshape(-1, *[1] * axes) for column in soils.T))


def respond_groups(model: WheelSoilModel, groups: Sequence[Group], setting: Setting) -> Responses:
    """The responses of groups of the paper; see :func:`respond`."""
    return respond(model, soil_array(groups), setting, [group.name for group in groups])


def error_figures(predicted: FloatArray, reference: FloatArray) -> FloatArray:
    """Err = max|F_m − F_p| / max|F_m| over the slips, Ding et al. 2015, eq. (16).

    ``predicted`` (..., m, 3) against ``reference`` (m, 3), measured or modelled; rows of the reference that
    are NaN, not measured, are left out. Shape (..., 3), fractions.
    """
    worst = np.nanmax(np.abs(reference - predicted), axis=-2)
    return np.asarray(worst / np.nanmax(np.abs(reference), axis=-2))


def error_bounds(distance: FloatArray, fit: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and greatest error (16) against measurements that are not known.

    By the triangle inequality, from the error ``distance`` (..., 3) of a prediction against the reference
    prediction in place of the measurements, and the ``fit`` (3,) of the reference prediction to them:
    max|F_m| differs from the reference's by at most fit · max|F_m|, so the distance in units of max|F_m| lies
    within distance · (1 ± fit).
    """
    near, far = distance * (1.0 - fit), distance * (1.0 + fit)
    return np.maximum(np.maximum(near - fit, fit - far), 0.0), far + fit


def error_table(model: WheelSoilModel, groups: Sequence[Group], setting: Setting) -> pd.DataFrame:
    """Errors (16) of groups against G1's response, beside the printed ones and their bounds, in percent.

    One row per group and outcome: group, table, outcome, ours, printed, low, high (where the printed error
    must lie if the model is the paper's), inside.
    """
    values = respond_groups(model, [REFERENCE, *groups], setting).values
    ours = error_figures(values[1:], values[0])
    low, high = error_bounds(ours, np.array(REFERENCE.printed_errors))
    printed = np.array([group.printed_errors for group in groups])
    flat = {"ours": ours, "printed": printed, "low": low, "high": high}
    table = pd.DataFrame(
        {
            "group": np.repeat([group.name for group in groups], len(OUTCOMES)),
            "table": np.repeat([group.table for group in groups], len(OUTCOMES)),
            "outcome": OUTCOMES * len(groups),
            **{name: 100.0 * value.ravel() for name, value in flat.items()},
        }
    )
    return table.assign(inside=table["printed"].between(table["low"], table["high"]))
