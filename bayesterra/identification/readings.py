"""The rows that least squares can use, in the form that each method needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.data import Observations
from bayesterra.errors import StudyError
from bayesterra.forward import Forward
from bayesterra.likelihood import Likelihood
from bayesterra.models import Conditions
from bayesterra.parameters import OFFSET
from bayesterra.posteriors import Posterior, posterior
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

    The normal force is the measured one, or the load where none was measured. Readings of the sinkage are
    freed of their zero error, as far as it is known.
    """
    used = without_offset(study.observations.used(), study)
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


def known_offset(study: Study) -> float:
    """Zero error (m) of the sinkage readings: fixed, or the median of its prior."""
    law = study.prior.laws.get(OFFSET)
    return study.prior.fixed.get(OFFSET, 0.0) if law is None else law.median


def without_offset(rows: Observations, study: Study) -> Observations:
    """The rows with the known zero error taken off the sinkage."""
    offset = known_offset(study)
    if not offset or "sinkage" not in rows.values:
        return rows
    return replace(rows, values={**rows.values, "sinkage": rows.values["sinkage"] - offset})


def weighted_target(study: Study) -> Posterior:
    """The posterior whose weighted residuals joint minimises: that of the study without latent quantities.

    With the drive ``both`` the measured normal force stands for the load, so rows without one are left out.

    Raises
    ------
    StudyError : no row has a measured normal force.
    """
    density = posterior(study)
    whole = density.likelihood
    rows, noise, drive = without_offset(whole.observations, study), whole.noise, study.drive
    if drive == "both":
        drive, noise = "load", [one for one in noise if one.channel != "normal_force"]
        force = rows.values.get("normal_force", np.full(len(rows), np.nan))
        rows = replace(rows, load=force).take(force > 0)
    if not len(rows) or not noise:
        raise StudyError("joint: no row has both a measured normal force and an outcome")
    forward = Forward.of(study.model, drive, rows, dict(study.wheels))
    return replace(density, likelihood=Likelihood(forward, rows, tuple(noise)))
