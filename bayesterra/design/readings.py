"""What a candidate would read, for every draw, and how probable every reading is under every other draw."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import BoolArray, FloatArray, frozen
from bayesterra.data import Observations
from bayesterra.design.candidates import Candidate
from bayesterra.forward import Forward, offset_of
from bayesterra.likelihood import Likelihood, Outcomes
from bayesterra.models import Conditions
from bayesterra.noise import Noise
from bayesterra.parameters import OUTCOMES
from bayesterra.posteriors import Posterior
from bayesterra.study import Study

NORMAL_FORCE = "normal_force"
STEP = 1e-3
"""Relative step of the load in the slopes by which an error in the load reaches the other readings."""


@dataclass(frozen=True)
class Situation:
    """What is known before the next drive.

    Attributes
    ----------
    study : conditions, model and noise.
    posterior : its density, which knows which columns of the draws are noise.
    draws : parameter sets (n, d), of the posterior or of the cut prior.
    source : ``posterior`` or ``prior``.
    """

    study: Study
    posterior: Posterior
    draws: FloatArray
    source: str


@dataclass(frozen=True)
class Reading:
    """One row as every draw expects it: y = f + W⁻¹ ε with independent standard noise ε.

    Attributes
    ----------
    mean : f (n, k), NaN where the model has no answer.
    whitening : W (n, k, k), lower triangular.
    noise : laws of ε.
    """

    mean: FloatArray
    whitening: FloatArray
    noise: tuple[Noise, ...]

    @property
    def answered(self) -> BoolArray:
        """Draws (n,) for which the model has an answer."""
        return np.asarray(np.isfinite(self.mean).all(axis=1))

    def draw(self, standard: FloatArray) -> FloatArray:
        """Readings (n, k) from standard noise (n, k), one for every draw."""
        return self.mean + np.linalg.solve(self.whitening, standard[:, :, None])[:, :, 0]

    def log_density(self, readings: FloatArray, draws: slice | FloatArray = slice(None)) -> FloatArray:
        """Log density (m, n) of readings (m, k) under each of some draws."""
        mean, whitening = self.mean[draws], self.whitening[draws]
        total = np.log(np.diagonal(whitening, axis1=1, axis2=2)).sum(axis=1)[None, :]
        apart = [readings[:, b, None] - mean[None, :, b] for b in range(mean.shape[1])]
        for a, noise in enumerate(self.noise):
            used = [b for b in range(a + 1) if whitening[:, a, b].any()]
            standard = sum((apart[b] * whitening[None, :, a, b] for b in used[1:]), apart[used[0]]
                           * whitening[None, :, a, used[0]])  # fmt: skip
            total = total + noise.log_density(standard)
        return np.asarray(total)


def readings_of(situation: Situation, candidate: Candidate) -> tuple[Reading, ...]:
    """Every row of a candidate as every draw expects it.

    Drive ``sinkage``: readings at the median, over the draws, of the sinkage that the load makes, as that
    drive takes the sinkage as known. Drive ``both``: an error in the load is carried to the other readings to
    first order.
    """
    return tuple(_row(situation, row) for row in _rows(candidate))


def _rows(candidate: Candidate) -> Iterator[Candidate]:
    for i in range(len(candidate.slip)):
        one = slice(i, i + 1)
        yield replace(
            candidate, wheel=candidate.wheel[one], wheels=candidate.wheels[one], slip=candidate.slip[one],
            load=candidate.load[one],
        )  # fmt: skip


def _row(situation: Situation, row: Candidate) -> Reading:
    soil = situation.study.prior.soil_values(situation.draws)
    if situation.study.drive == "both":
        return _with_latent_load(situation, row, soil)
    values = _modelled(situation.study, row, soil, row.load)
    mean, scale = _read(situation, row, row.noise, values)
    return Reading(mean, _diagonal(1 / scale), row.noise)


def _modelled(study: Study, row: Candidate, soil: FloatArray, load: FloatArray) -> FloatArray:
    """Outcomes (n, 1, k) of the drive, as they are read but for noise."""
    conditions = Conditions.of(row.wheels, row.slip)
    drive, given = study.drive, load
    if drive == "sinkage":
        carried = Forward(study.model, "load", conditions, load)(soil).values[:, :, 0]
        given = np.nanmedian(carried + offset_of(soil), axis=0) if np.isfinite(carried).any() else load
    found = Forward(study.model, drive, conditions, frozen(given), as_read=True)(soil)
    return np.where(found.status[:, None, None] == 0, found.values, np.nan)


def _read(
    situation: Situation, row: Candidate, noise: tuple[Noise, ...], values: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Means and standard deviations (n, k) of some channels."""
    study, channels = situation.study, tuple(one.channel for one in noise)
    blank = Observations(row.wheel, row.slip, row.load, {}, {}, np.ones(1, dtype=np.bool_), (1,))
    conditions = Conditions.of(row.wheels, row.slip)
    likelihood = Likelihood(Forward(study.model, study.drive, conditions, row.load), blank, noise)
    estimated = situation.posterior.noise_values(situation.draws, channels)
    mean = likelihood.predicted(Outcomes(values, np.zeros(len(values), dtype=np.int64)))
    return mean[:, 0], likelihood.scales(mean, estimated)[:, 0]


def _diagonal(values: FloatArray) -> FloatArray:
    return np.asarray(values[:, :, None] * np.eye(values.shape[1]))


def _with_latent_load(situation: Situation, row: Candidate, soil: FloatArray) -> Reading:
    """Sinkage, pull and moment given the normal force, which says how far the load may be off."""
    others = tuple(noise for noise in row.noise if noise.channel != NORMAL_FORCE)
    at = _modelled(situation.study, row, soil, row.load)
    mean, scale = _read(situation, row, others, at)
    up, down = (_modelled(situation.study, row, soil, row.load * (1 + step)) for step in (STEP, -STEP))
    rise = (up - down) / (2 * STEP * row.load)
    slope = _read(situation, row, others, rise)[0]
    spread = _load_sd(situation, row, at)
    covariance = _diagonal(scale**2) + (slope * spread)[:, :, None] * (slope * spread)[:, None, :]
    known: BoolArray = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
    safe = np.where(known[:, None, None], covariance, np.eye(len(others)))
    whitening: FloatArray = np.asarray(np.linalg.inv(np.linalg.cholesky(safe)), dtype=np.float64)
    return Reading(np.where(known[:, None], mean, np.nan), whitening, others)


def _load_sd(situation: Situation, row: Candidate, at: FloatArray) -> FloatArray:
    """Standard deviation (n, 1) of the load, from its range and, where it is read, the normal force."""
    low, high = situation.study.load_range or (0.0, np.inf)
    weight = np.full((len(at), 1), 12 / (high - low) ** 2)
    force = tuple(noise for noise in row.noise if noise.channel == NORMAL_FORCE)
    if force:
        weight = weight + 1 / _read(situation, row, force, at)[1] ** 2
    return np.asarray(1 / np.sqrt(weight))


def standard_noise(reading: Reading, rng: Generator) -> FloatArray:
    """Standard noise (n, k) of one row; one stream gives one channel the same noise in every candidate."""
    normal = rng.standard_normal((len(reading.mean), len(OUTCOMES)))
    drawn = normal[:, [OUTCOMES.index(noise.channel) for noise in reading.noise]]
    for column, noise in enumerate(reading.noise):
        if np.isfinite(noise.dof):
            drawn[:, column] = noise.draw((len(drawn),), rng)
    return drawn
