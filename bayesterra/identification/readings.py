"""The rows that IM1, IM2 and IM3 can use: those with a measured sinkage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.models import Conditions
from bayesterra.study import Study


@dataclass(frozen=True)
class Readings:
    """Sinkage-driven readings, SI.

    Attributes
    ----------
    conditions : slip and wheel of each row.
    sinkage : (m,) above 0 and below the radius.
    forces : ``normal_force``, ``drawbar_pull`` and ``resistance_moment``, each (m,), NaN where not measured.
    left_out : number of used rows without such a sinkage.
    """

    conditions: Conditions
    sinkage: FloatArray
    forces: Mapping[str, FloatArray]
    left_out: int = 0


def readings(study: Study) -> Readings:
    """Rows in the fit that have a sinkage inside (0, r).

    The normal force is the measured one, or the load where none was measured.
    """
    used = study.observations.used()
    none = np.full(len(used), np.nan)
    sinkage = used.values.get("sinkage", none)
    radius = np.array([study.wheels[name].radius for name in used.wheel])
    keep = np.flatnonzero((sinkage > 0) & (sinkage < radius))
    normal = used.values.get("normal_force", none)
    forces = {
        "normal_force": np.where(np.isnan(normal), used.load, normal)[keep],
        "drawbar_pull": used.values.get("drawbar_pull", none)[keep],
        "resistance_moment": used.values.get("resistance_moment", none)[keep],
    }
    wheels = [study.wheels[used.wheel[i]] for i in keep]
    conditions = Conditions.of(wheels, used.slip[keep])
    return Readings(conditions, sinkage[keep], forces, len(used) - len(keep))
