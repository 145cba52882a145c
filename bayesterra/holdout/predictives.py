"""What the posterior of the training rows says about the readings of rows that were left out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import BoolArray, FloatArray, frozen
from bayesterra.data import Observations
from bayesterra.forward import known_loads
from bayesterra.holdout.mixtures import Mixture
from bayesterra.joint_rows import JointRows
from bayesterra.posteriors import Posterior, likelihood_of
from bayesterra.study import Study

KNOWN = {"load": (), "both": ("normal_force",), "sinkage": ("sinkage",)}
"""Channels of a left-out row that stay known, by drive, beside its slip: with ``both`` the normal force as it
was read, with ``sinkage`` the sinkage. With ``load`` the load is known, which is no channel."""
FEWEST = 20
"""Fewer draws with an answer than this are no law that could be scored."""


def scored_channels(study: Study) -> tuple[str, ...]:
    """Channels that are predicted and scored."""
    return tuple(name for name in study.noise if name not in KNOWN[study.drive])


def conditions(study: Study) -> FloatArray:
    """What is known of every row (m, k): slip, load (or sinkage), and the wheel (0 or 1)."""
    rows = study.observations
    driven = rows.values["sinkage"] if study.drive == "sinkage" else known_loads(rows)
    driven = np.nan_to_num(driven)  # never read: says nothing
    wheels = [np.array([name == own for own in rows.wheel], dtype=np.float64) for name in study.wheels]
    return np.column_stack([rows.slip, driven, *wheels[1:]])


@dataclass(frozen=True)
class Predictives:
    """Predictive laws of left-out readings.

    Attributes
    ----------
    channels : scored ones, the last axis.
    centre, scale : (n, rows, channels) of the law of a reading, NaN where the model has no answer.
    dof : (channels,) of the noise.
    """

    channels: tuple[str, ...]
    centre: FloatArray
    scale: FloatArray
    dof: tuple[float, ...]

    def answered(self, row: int) -> BoolArray:
        """Which draws (n,) have an answer at a row."""
        return np.asarray(np.isfinite(self.centre[:, row]).all(axis=1))

    def law(self, row: int, channel: int) -> Mixture | None:
        """The law of a reading, from the draws that have an answer; None where there are too few."""
        kept = self.answered(row)
        if kept.sum() < FEWEST:
            return None
        return Mixture(self.centre[kept, row, channel], self.scale[kept, row, channel], self.dof[channel])


def predictives(
    study: Study, posterior: Posterior, draws: FloatArray, left: BoolArray, rng: Generator
) -> Predictives:
    """Predict the rows in ``left`` (m,) by draws (n, d) of a posterior that does not know their readings.

    The slip of a left-out row is known, and its load; with the drive ``both`` its normal force as it was
    read: each draw's load then comes from the flat prior of loads and the law of that one reading. Where rows
    hang together, the readings of the rows in use that are not left out count as well.
    """
    if study.errors:
        return _beside_others(study, posterior, draws, left)
    likelihood = likelihood_of(study, blinded(study, left))
    noise = posterior.noise_values(draws)
    outcomes = likelihood.explained(posterior.prior.soil_values(draws), noise, rng)
    centre = likelihood.predicted(outcomes)
    scale = likelihood.scales(centre, noise)
    names = scored_channels(study)
    columns = [likelihood.channels.index(name) for name in names]
    dof = tuple(study.noise[name].dof for name in names)
    return Predictives(names, centre[:, :, columns], scale[:, :, columns], dof)


def _beside_others(study: Study, posterior: Posterior, draws: FloatArray, left: BoolArray) -> Predictives:
    """The laws where what is left out hangs together with what is not."""
    rows = study.observations
    rows = replace(rows, use=frozen(rows.use & ~left, np.bool_))
    likelihood = likelihood_of(study, rows)
    assert isinstance(likelihood, JointRows)  # noqa: S101
    noise, soil = posterior.noise_values(draws), posterior.prior.soil_values(draws)
    centre, scale = likelihood.ahead(soil, noise, left)
    names = scored_channels(study)
    columns = [likelihood.channels.index(name) for name in names]
    return Predictives(names, centre[:, :, columns], scale[:, :, columns], (np.inf,) * len(names))


def blinded(study: Study, left: BoolArray) -> Observations:
    """The rows in ``left`` (m,) without the readings that are to be predicted."""
    rows = study.observations.take(left)
    nothing = frozen(np.full(len(rows), np.nan))
    known = KNOWN[study.drive]
    return replace(rows, values={n: v if n in known else nothing for n, v in rows.values.items()})
