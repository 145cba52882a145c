"""Folds of a leave-out check: which rows are left out together, and the task that predicts them."""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Integral
from typing import Any, TypeAlias

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng

from bayesterra.arrays import BoolArray, FloatArray, IntArray, answered_quantiles, frozen, spaced
from bayesterra.checking.holdout_scores import BASELINES, Answer, Mixture, TrainingRows
from bayesterra.checking.predictive import Curves, predict_curves
from bayesterra.checking.ranks import FAILED
from bayesterra.checking.short_runs import FAILURES, Fit, ShortGroupRuns, ShortRuns
from bayesterra.errors import StudyError, did_you_mean
from bayesterra.likelihood.joint import JointPosterior, whole_posterior
from bayesterra.likelihood.posterior import Posterior, likelihood_of
from bayesterra.parameters import CHANNELS
from bayesterra.stats.tails import Tails
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study

TOLERANCE = 0.03
"""Slips nearer than this count as one level."""
WIDEST = 4
"""Tolerances that a level is wide, at most."""
SAME_LOAD = 0.1
"""Loads nearer than this share count as one level."""
WAYS = ("slip", "wheel", "load", "row")

By: TypeAlias = str | Sequence[object]
"""Grouping of rows: see :func:`levels`."""


@dataclass(frozen=True)
class Fold:
    """Rows that are left out together."""

    name: str  # for tables and figures
    left: BoolArray  # (m,) which rows of the study's table these are; rows in use only


def clusters(values: FloatArray, tolerance: float) -> IntArray:
    """Number of the cluster of each value (m,), ascending; a gap wider than ``tolerance`` parts two.

    Values without a gap, as of a log, are no level: wider than ``WIDEST`` tolerances they are cut into equal ranges.

    >>> clusters(np.array([0.5, 0.02, 0.51, 0.0]), 0.03).tolist()
    [1, 0, 1, 0]
    >>> clusters(np.array([0.0, 0.01, 0.02, 0.03, 0.04, 0.05]), 0.011).tolist()
    [0, 0, 0, 1, 1, 1]
    """
    order = np.argsort(values, kind="stable")
    numbers = np.zeros(len(values), dtype=np.int64)
    first = 0
    for run in np.split(order, np.flatnonzero(np.diff(values[order]) > tolerance) + 1) if len(order) else ():
        span = values[run[-1]] - values[run[0]]
        parts = int(np.ceil(span / (WIDEST * tolerance) - 1e-9)) if span else 1
        edges = values[run[0]] + span * np.arange(1, parts) / parts
        _, place = np.unique(np.searchsorted(edges, values[run], side="right"), return_inverse=True)
        numbers[run] = first + place
        first = int(numbers[run[-1]]) + 1
    return numbers


def levels(study: Study, by: By = "slip", tolerance: float = TOLERANCE) -> tuple[Fold, ...]:
    """Group the rows in use.

    Parameters
    ----------
    by : ``slip`` (slips nearer than ``tolerance``, each to the next, are one level), ``load`` (loads within
        a tenth), ``wheel`` or ``row``; or groups of row numbers, ``[[1, 2], [3]]``, of which only these are
        left out; or one label for every row of the study's table.
    tolerance : for ``slip``; a level is four times as wide at most.

    Raises
    ------
    StudyError : an unknown grouping, row numbers that are not in use or named twice, or nothing to fit to
        once a level is left out.
    """
    if not tolerance >= 0:
        raise StudyError(f"'tolerance' must not be negative (got {tolerance:g})")
    use, folds = study.observations.use, folds_of(study, by, tolerance)
    if len(folds) < 2 and (not folds or folds[0].left.sum() == use.sum()):
        what = f"levels of '{by}'" if isinstance(by, str) else "groups of rows"
        wide = f" at tolerance {tolerance:g}" if by == "slip" else ""
        raise StudyError(f"to leave one out there must be two or more {what} (got {len(folds)}{wide})")
    return tuple(folds)


def folds_of(study: Study, by: By, tolerance: float = TOLERANCE) -> list[Fold]:
    """The groups of :func:`levels`, however many there are."""
    folds = _named(study, by, tolerance) if isinstance(by, str) else _listed(study, by)
    return [fold for fold in folds if fold.left.any()]


def _named(study: Study, by: str, tolerance: float) -> list[Fold]:
    rows = study.observations
    if by == "wheel":
        return _labelled(study, rows.wheel)
    if by == "row":
        return _labelled(study, [f"row {row}" for row in rows.rows])
    if by == "load":
        loads = rows.known_loads
        known = rows.use & (loads > 0)
        return _clustered("load {:.{}g} N", 4, loads, np.log(np.where(known, loads, 1)), known, SAME_LOAD)
    if by != "slip":
        raise StudyError(f"'by' must be {', '.join(WAYS)} or groups of rows (got '{by}'){did_you_mean(by, WAYS)}")
    return _clustered("slip {:.{}f}", 3, rows.slip, rows.slip, rows.use, tolerance)


def _clustered(
    name: str, digits: int, values: FloatArray, along: FloatArray, chosen: BoolArray, tolerance: float
) -> list[Fold]:
    """Levels of the chosen rows: clusters ``along`` a scale (m,), named by their mean of ``values`` (m,)."""
    number = np.full(len(values), -1)
    number[chosen] = clusters(along[chosen], tolerance)
    masks = [number == k for k in range(number.max() + 1)]
    tried = ([name.format(values[mask].mean(), digits + more) for mask in masks] for more in range(12))
    names = next((names for names in tried if len({*names}) == len(names)), [f"level {k}" for k in range(len(masks))])
    return [Fold(*each) for each in zip(names, masks, strict=True)]


def _labelled(study: Study, labels: Sequence[object]) -> list[Fold]:
    use = study.observations.use
    texts = np.array([str(label) for label in labels], dtype=object)
    return [Fold(text, np.asarray((texts == text) & use)) for text in dict.fromkeys(texts)]


def _listed(study: Study, by: Sequence[object]) -> list[Fold]:
    """Groups of row numbers, or labels."""
    rows = study.observations
    if not any(isinstance(entry, list | tuple | np.ndarray) for entry in by):
        if len(by) != len(rows):
            raise StudyError(f"'by' must have one label for each of {len(rows)} rows (got {len(by)})")
        return _labelled(study, list(by))
    places = {row: i for i, row in enumerate(rows.rows) if rows.use[i]}
    folds, seen = [], set[int]()
    for group in by:
        numbers = list(group) if isinstance(group, list | tuple | np.ndarray) else [group]
        left = np.zeros(len(rows), dtype=np.bool_)
        for number in numbers:
            if not isinstance(number, Integral) or int(number) not in places:
                raise StudyError(f"'by' must hold numbers of rows in use (got {number!r})")
            if int(number) in seen:
                raise StudyError(f"'by' must name a row once (row {number} is named twice)")
            seen.add(int(number))
            left[places[int(number)]] = True
        folds.append(Fold("row " + ", ".join(str(number) for number in numbers), left))
    return folds


DRAWS = 1000
"""Posterior draws, at most, that a predictive law is made of."""
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
REFITS = ShortRuns(
    short=SamplingOptions(target_ess=1000, walkers=64, max_steps=300),
    long=SamplingOptions(target_ess=1000, walkers=64, max_steps=8000),
    ensembles=4,
)
"""The sampler of every run, until there are 1000 effective draws."""
GROUP_REFITS = ShortGroupRuns(short=SamplingOptions(target_ess=1000, walkers=32, max_steps=120), long=REFITS.long)
"""The same for a joint posterior."""


def refits(study: Study) -> ShortRuns:
    """The default sampler of refits of a study, with or without groups."""
    return REFITS if study.pooling is None else GROUP_REFITS


@dataclass(frozen=True)
class Band:
    """Predictive median and 90 % of the readings of one channel over slip, field units."""

    group: str  # empty without groups
    wheel: str
    channel: str
    rows: BoolArray  # (m,) which rows of the study's table are this wheel's in this group
    slip: FloatArray  # (k,)
    low: FloatArray  # (k,), as the other two: NaN where the model has no answer
    middle: FloatArray
    high: FloatArray


@dataclass(frozen=True)
class Outcome:
    """Result of leaving one level out."""

    level: str  # its name
    status: str  # of the refit: ``converged``, ``not converged`` or ``failed``; a failed one has no model rows
    ess: float  # of its sampling
    r_hat: float  # likewise
    seconds: float  # processor time
    note: str = ""  # why it failed; or which groups the refit did not have
    rows: tuple[Mapping[str, Any], ...] = ()  # scores of every predictor, row and channel; see ``Holdout``
    bands: tuple[Band, ...] = ()  # of the model without the level, for every group and wheel that has rows of it


@dataclass(frozen=True)
class LeaveOneOut:
    """The task: the number of a level in, an outcome out, the same wherever and whenever it is run.

    With groups the rows of each are predicted by its own parameters among draws of the joint posterior; those
    of a group that is left out whole by parameters from the populations and priors.
    """

    study: Study
    folds: tuple[Fold, ...]
    seed: int
    fit: Fit

    def __call__(self, task: int) -> Outcome:
        """Leave level number ``task`` out, counted from 0."""
        started, fold = time.process_time(), self.folds[task]
        scorer = Scorer(self.study, fold)
        baselines = [row for name in BASELINES for row in scorer.baseline(name, self.folds)]
        fitting, predicting = SeedSequence(self.seed, spawn_key=(task,)).spawn(2)
        training = self.study.with_use(scorer.kept)
        try:
            fitted = self.fit(training, fitting)
            target, rng = whole_posterior(training, fewest=1), default_rng(predicting)
            rows, bands = scorer.predicted(target, spaced(fitted.draws, DRAWS), rng)
        except FAILURES as error:
            note, seconds = f"{type(error).__name__}: {error}", time.process_time() - started
            return Outcome(fold.name, FAILED, 0.0, np.nan, seconds, note, tuple(baselines))
        seconds = time.process_time() - started
        absent = [group for group in self.study.by_group() if group not in target.groups]
        note = f"not in the fit: {', '.join(absent)}" if absent else ""
        rows += baselines
        return Outcome(fold.name, fitted.status, fitted.ess, fitted.r_hat, seconds, note, tuple(rows), tuple(bands))


@dataclass(frozen=True)
class Scorer:
    """Scores of predictive laws for the readings of one level; of the rows ``only`` (m,), where given."""

    study: Study
    fold: Fold
    only: BoolArray | None = None

    @property
    def kept(self) -> BoolArray:
        """The training rows (m,)."""
        return self.study.observations.use & ~self.fold.left

    def predicted(
        self, target: Posterior | JointPosterior, draws: FloatArray, rng: Generator, *, banded: bool = True
    ) -> tuple[list[dict[str, Any]], list[Band]]:
        """Rows of the study's own model, and its bands, by draws of a posterior without the level."""
        numbers, rows, bands = self.study.observations.rows, list[dict[str, Any]](), list[Band]()
        for group, study in self.study.by_group().items():
            mine = np.isin(numbers, study.observations.rows)
            if not (self.fold.left & mine).any():
                continue
            alone, x = target.one_group(group, draws, rng)
            rows += self._rows(predictives(study, alone, x, self.fold.left[mine], rng), mine)
            if banded:
                bands += self._bands(group, predict_curves(study, alone, x, rng), mine)
        return rows, bands

    def _rows(self, laws: "Predictives", mine: BoolArray) -> list[dict[str, Any]]:
        name, rows = self.study.model.name, []
        for row, place in enumerate(np.flatnonzero(self.fold.left & mine)):
            unanswered = 1 - float(laws.answered(row).mean())
            for column, channel in enumerate(laws.channels):
                law = laws.law(row, column)
                rows += self._scored(name, int(place), channel, law, unanswered, "")
        return rows

    def _bands(self, group: str, curves: Sequence[Curves], mine: BoolArray) -> Iterator[Band]:
        """Bands of the scored channels, of every wheel with rows that are left out."""
        for curve in curves:
            rows = mine & (np.array(self.study.observations.wheel) == curve.wheel)
            for channel in scored_channels(self.study) if (rows & self.fold.left).any() else ():
                column, scale = curve.outcomes.index(channel), CHANNELS[channel].scale
                q = answered_quantiles(curve.readings[:, :, column] / scale, (0.05, 0.5, 0.95))
                yield Band(group, curve.wheel, channel, rows, curve.slip, *q)

    def baseline(self, name: str, folds: tuple[Fold, ...]) -> list[dict[str, Any]]:
        """Rows of a baseline."""
        number = np.full(len(self.study.observations), -1)
        for i, fold in enumerate(folds):
            number[fold.left] = i
        inputs, rows = conditions(self.study), []
        for channel in scored_channels(self.study):
            values = self.study.observations.numbers().values[channel]
            kept = self.kept & ~np.isnan(values)
            answer = Answer(())
            if kept.sum() >= 2:
                slip_level = clusters(inputs[kept, 0], TOLERANCE)
                training = TrainingRows(inputs[kept], values[kept], number[kept], slip_level)
                answer = BASELINES[name](training, inputs[self.fold.left])
            places = np.flatnonzero(self.fold.left)
            for place, law in zip(places, answer.laws or (None,) * len(places), strict=True):
                rows += self._scored(name, int(place), channel, law, 0.0, answer.detail)
        return rows

    def _scored(
        self, predictor: str, place: int, channel: str, law: Mixture | None, unanswered: float, detail: str
    ) -> list[dict[str, Any]]:
        """One row of the table; none where nothing was measured, or a limit only."""
        rows, scale = self.study.observations.numbers(), CHANNELS[channel].scale
        observed = float(rows.values[channel][place])
        if np.isnan(observed) or (self.only is not None and not self.only[place]):
            return []
        driven, slip = rows.slip[self.kept], float(rows.slip[place])
        head = {
            "predictor": predictor,
            "level": self.fold.name,
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


FEWEST = 20
"""Fewer draws with an answer than this are no law that could be scored."""


def scored_channels(study: Study) -> tuple[str, ...]:
    """Channels that are predicted and scored."""
    return tuple(name for name in study.noise if name not in study.drive.kept)


def conditions(study: Study) -> FloatArray:
    """Conditions of every row (m, k), known beforehand: slip, load (or sinkage), and the wheel (0 or 1)."""
    rows = study.observations
    driven = np.nan_to_num(study.drive.given(rows))  # never read: says nothing
    wheels = [np.array([name == own for own in rows.wheel], dtype=np.float64) for name in study.wheels]
    return np.column_stack([rows.slip, driven, *wheels[1:]])


@dataclass(frozen=True)
class Predictives:
    """Predictive laws of left-out readings."""

    channels: tuple[str, ...]  # scored ones, the last axis
    centre: FloatArray  # of the law of a reading (n, rows, channels), NaN where the model has no answer
    scale: FloatArray  # of that law, likewise
    tails: tuple[Tails, ...]  # (channels,) of the noise

    def answered(self, row: int) -> BoolArray:
        """True for draws (n,) that have an answer at a row."""
        return np.asarray(np.isfinite(self.centre[:, row]).all(axis=1))

    def law(self, row: int, channel: int) -> Mixture | None:
        """The law of a reading, from the draws that have an answer; None where there are too few."""
        kept = self.answered(row)
        if kept.sum() < FEWEST:
            return None
        return Mixture(self.centre[kept, row, channel], self.scale[kept, row, channel], self.tails[channel])


def predictives(study: Study, posterior: Posterior, draws: FloatArray, left: BoolArray, rng: Generator) -> Predictives:
    """Predict the rows in ``left`` (m,) by draws (n, d) of a posterior that does not know their readings.

    The slip of a left-out row is known, and its load; with the drive ``both`` its normal force as it was
    read: each draw's load then comes from the flat prior of loads and the law of that one reading. Where rows
    hang together, the readings of the rows in use that are not left out count as well.
    """
    noise, soil = posterior.noise_values(draws), posterior.prior.soil_values(draws)
    rows = study.observations
    likelihood = likelihood_of(study, replace(rows, use=frozen(rows.use & ~left, np.bool_)))
    centre, scale = likelihood.ahead(soil, noise, left, rng)
    names = scored_channels(study)
    columns = [likelihood.channels.index(name) for name in names]
    tails = tuple(study.noise[name].tails for name in names)
    return Predictives(names, centre[:, :, columns], scale[:, :, columns], tails)
