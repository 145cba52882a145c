"""One level left out: a posterior of the other rows, predictions of the level's readings, scores."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.random import SeedSequence, default_rng

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.calibration.fitting import Fit, ShortRuns
from bayesterra.calibration.tasks import CONVERGED, FAILED, UNCONVERGED
from bayesterra.errors import BayesterraError
from bayesterra.holdout.baselines import BASELINES, Answer, Known
from bayesterra.holdout.levels import TOLERANCE, Level, clusters
from bayesterra.holdout.mixtures import Mixture
from bayesterra.holdout.predictives import conditions, predictives, scored_channels
from bayesterra.parameters import CHANNELS
from bayesterra.posteriors import posterior
from bayesterra.predictive import predict_curves
from bayesterra.study import SamplingOptions, Study

DRAWS = 1000
"""Posterior draws, at most, that a predictive law is made of."""
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
REFITS = ShortRuns(
    short=SamplingOptions(target_ess=1000, walkers=64, max_steps=300),
    long=SamplingOptions(target_ess=1000, walkers=64, max_steps=8000),
)
"""The sampler of every run, until there are 1000 effective draws."""


@dataclass(frozen=True)
class Band:
    """Predictive median and 90 % of the readings of one channel over slip, field units.

    Attributes
    ----------
    wheel, channel : of which.
    slip, low, middle, high : (k,); NaN where the model has no answer.
    """

    wheel: str
    channel: str
    slip: FloatArray
    low: FloatArray
    middle: FloatArray
    high: FloatArray


@dataclass(frozen=True)
class Outcome:
    """What leaving one level out found.

    Attributes
    ----------
    level : its name.
    status : of the refit: ``converged``, ``not converged`` or ``failed``; a failed one has no model rows.
    ess, r_hat, seconds : of its sampling; processor time.
    note : why it failed.
    rows : scores, one entry per predictor, row and channel; see :attr:`Holdout.table`.
    bands : of the model without the level.
    """

    level: str
    status: str
    ess: float
    r_hat: float
    seconds: float
    note: str = ""
    rows: tuple[Mapping[str, Any], ...] = ()
    bands: tuple[Band, ...] = ()


@dataclass(frozen=True)
class LeaveOneOut:
    """The task: the number of a level in, an outcome out, the same wherever and whenever it is run."""

    study: Study
    levels: tuple[Level, ...]
    seed: int
    fit: Fit = field(default_factory=lambda: REFITS)

    def __call__(self, task: int) -> Outcome:
        """Leave level number ``task`` out, counted from 0."""
        started = time.process_time()
        level = self.levels[task]
        scorer = _Scorer(self.study, level)
        rows = [row for name in BASELINES for row in scorer.baseline(name, self.levels)]
        fitting, predicting = SeedSequence(self.seed, spawn_key=(task,)).spawn(2)
        training = self.study.with_use(self.study.observations.use & ~level.left)
        try:
            fitted = self.fit(training, fitting)
            target, rng = posterior(training), default_rng(predicting)
            draws = fitted.draws[:: max(1, -(-len(fitted.draws) // DRAWS))]
            rows = scorer.model(predictives(self.study, target, draws, level.left, rng)) + rows
            bands = tuple(_bands(self.study, predict_curves(self.study, target, draws, rng)))
        except (BayesterraError, ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
            note = f"{type(error).__name__}: {error}"
            seconds = time.process_time() - started
            return Outcome(level.name, FAILED, 0.0, np.nan, seconds, note, tuple(rows))
        status = CONVERGED if fitted.converged else UNCONVERGED
        seconds = time.process_time() - started
        return Outcome(
            level.name, status, fitted.ess, fitted.r_hat, seconds, rows=tuple(rows), bands=bands
        )  # fmt: skip


@dataclass(frozen=True)
class _Scorer:
    """Scores of predictive laws for the readings of one level."""

    study: Study
    level: Level

    @property
    def places(self) -> IntArray:
        """Where the level's rows stand in the table."""
        return np.flatnonzero(self.level.left)

    @property
    def kept(self) -> BoolArray:
        """The training rows (m,)."""
        return self.study.observations.use & ~self.level.left

    def model(self, found: Any) -> list[dict[str, Any]]:
        """Rows of the study's own model."""
        name, rows = self.study.model.name, []
        for row, place in enumerate(self.places):
            unanswered = 1 - float(found.answered(row).mean())
            for column, channel in enumerate(found.channels):
                law = found.law(row, column)
                rows += self._scored(name, int(place), channel, law, unanswered, "")
        return rows

    def baseline(self, name: str, levels: tuple[Level, ...]) -> list[dict[str, Any]]:
        """Rows of a baseline."""
        number = np.full(len(self.study.observations), -1)
        for i, level in enumerate(levels):
            number[level.left] = i
        known, rows = conditions(self.study), []
        for channel in scored_channels(self.study):
            values = self.study.observations.values[channel]
            kept = self.kept & ~np.isnan(values)
            answer = Answer(())
            if kept.sum() >= 2:
                slip_level = clusters(known[kept, 0], TOLERANCE)
                training = Known(known[kept], values[kept], number[kept], slip_level)
                answer = BASELINES[name](training, known[self.level.left])
            laws = answer.laws or (None,) * len(self.places)
            for place, law in zip(self.places, laws, strict=True):
                rows += self._scored(name, int(place), channel, law, 0.0, answer.detail)
        return rows

    def _scored(
        self, predictor: str, place: int, channel: str, law: Mixture | None, unanswered: float, detail: str
    ) -> list[dict[str, Any]]:
        """One row of the table; none where nothing was measured."""
        rows, scale = self.study.observations, CHANNELS[channel].scale
        observed = float(rows.values[channel][place])
        if np.isnan(observed):
            return []
        driven = rows.slip[self.kept]
        slip = float(rows.slip[place])
        head = {
            "predictor": predictor,
            "level": self.level.name,
            "row": rows.rows[place],
            "wheel": rows.wheel[place],
            "slip": slip,
            "channel": channel,
            "unit": CHANNELS[channel].unit,
            "extrapolated": bool(slip < driven.min() or slip > driven.max()),
            "observed": observed / scale,
        }
        return [{**head, **_scores(law, observed, scale), "no_answer": unanswered, "detail": detail}]


def _scores(law: Mixture | None, observed: float, scale: float) -> dict[str, Any]:
    """Quantiles and scores in field units; without a law they are missing, and the reading is not covered."""
    names = tuple(f"q{100 * level:02.0f}" for level in QUANTILES)
    if law is None:
        missing = dict.fromkeys((*names, "pit", "crps", "log_score"), np.nan)
        return {**missing, "covered50": False, "covered90": False}
    q = dict(zip(names, law.quantiles(np.array(QUANTILES)) / scale, strict=True))
    pit = float(law.cdf(np.array([observed]))[0])
    return {
        **{name: float(value) for name, value in q.items()},
        "pit": pit,
        "crps": law.crps(observed) / scale,
        "log_score": law.log_density(observed) + float(np.log(scale)),
        "covered50": bool(0.25 <= pit <= 0.75),
        "covered90": bool(0.05 <= pit <= 0.95),
    }


def _bands(study: Study, curves: Any) -> list[Band]:
    """Bands of the scored channels."""
    found = []
    for curve in curves:
        for channel in scored_channels(study):
            column, scale = curve.outcomes.index(channel), CHANNELS[channel].scale
            readings = curve.readings[:, :, column] / scale
            q = np.full((3, len(curve.slip)), np.nan)
            for i in range(len(curve.slip)):
                known = readings[np.isfinite(readings[:, i]), i]
                if known.size:
                    q[:, i] = np.quantile(known, [0.05, 0.5, 0.95])
            found.append(Band(curve.wheel, channel, curve.slip, *q))
    return found
