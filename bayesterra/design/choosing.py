"""Choice of drives: candidates judged as tasks, in order, and several together."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from importlib.metadata import version
from types import MappingProxyType
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
import pandas as pd
from numpy.random import default_rng

from bayesterra.arrays import FloatArray
from bayesterra.design.candidates import Candidate, Reading, Situation, readings_of
from bayesterra.design.gain import Estimate, Interest, Pairs, estimate, jackknife, normal_estimate, pairs
from bayesterra.errors import StudyError
from bayesterra.parameters import PARAMETERS
from bayesterra.runtime.engines import Engine, ended, in_process
from bayesterra.runtime.tables import Count, Record
from bayesterra.study.result import AnalysisResult

METHODS = {"mixture": estimate, "regression": normal_estimate}


@dataclass(frozen=True)
class Grid:
    """Candidates and the draws that they are judged by; for one place of a plan all have the same noise.

    It is the task as well: a question in, an estimate out. One serves a whole design and keeps what it needs
    again.
    """

    situation: Situation  # what is known before
    candidates: tuple[Candidate, ...]  # what may be driven
    interest: Interest  # the draws and which parameters are asked about
    seed: int  # of the readings that are drawn

    @cached_property
    def _readings(self) -> dict[int, tuple[Reading, ...]]:
        return {}

    @cached_property
    def _beside(self) -> dict[tuple[int | None, ...], Pairs | None]:
        return {}

    def __getstate__(self) -> dict[str, Any]:
        """Without what can be computed again."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __call__(self, question: "Question") -> Estimate:
        """Judge a candidate beside the rows that stand already."""
        readings, beside = self.pairs(question.candidate, question.place), self._together(question.picks)
        return METHODS[question.method](readings if beside is None else beside + readings, self.interest)

    def _together(self, picks: tuple[int | None, ...]) -> Pairs | None:
        if picks not in self._beside:
            self._beside.clear()  # they are large, and asked for in turn
            self._beside[picks] = self.together(picks)
        return self._beside[picks]

    def pairs(self, index: int, place: int) -> Pairs:
        """Readings of a candidate in some place of the plan."""
        if index not in self._readings:
            self._readings[index] = readings_of(self.situation, self.candidates[index])
        return pairs(self._readings[index], self.interest, default_rng((self.seed, place)))

    def together(self, picks: Sequence[int | None]) -> Pairs | None:
        """Readings of some rows, each in its place."""
        readings = [self.pairs(index, place) for place, index in enumerate(picks) if index is not None]
        return sum(readings[1:], readings[0]) if readings else None


class Question(NamedTuple):
    """Question to a judge: a candidate, and the place of a plan that it is judged for."""

    candidate: int  # its number, from 0
    place: int  # its place in the plan, from 0
    picks: tuple[int | None, ...]  # rows that stand already, each in its place; None where there is none
    method: str  # one of ``METHODS``

    def __str__(self) -> str:
        return f"candidate {self.candidate + 1} for drive {self.place + 1}"


@dataclass(frozen=True)
class Progress:
    """Progress of a design."""

    drive: int  # of the plan, from 1, that candidates are judged for
    done: int  # candidates judged for it, this time
    of: int  # as many in all
    judged: int  # estimates in all
    seconds_left: float | None  # of this time, at the pace so far; None at its start


Report = Callable[[Mapping[int, Estimate], Progress], None]


@dataclass
class Judge:
    """Has candidates judged, ranks them and exchanges them; each task has a number that tells it for good."""

    grid: Grid
    by: str  # one of ``CRITERIA``
    engine: Engine
    finished: Mapping[int, Estimate]  # estimates by number of the task that are known already
    report: Report  # called with new ones, and the progress
    count: int = 0

    def estimates(self, method: str, picks: Sequence[int | None], place: int) -> tuple[Estimate, ...]:
        """Every candidate in one place, beside the rows in the others."""
        beside = tuple(None if i == place else index for i, index in enumerate(picks))
        n, first = len(self.grid.candidates), self.count
        self.count += n
        judgements = {i: self.finished[first + i] for i in range(n) if first + i in self.finished}
        started, before = time.perf_counter(), len(judgements)
        self.report({}, Progress(place + 1, before, n, first + before, None))
        todo = [Question(i, place, beside, method) for i in range(n) if i not in judgements]
        for batch in ended(self.grid, todo, self.engine, short=True):
            judgements |= {question.candidate: judgement for question, judgement in batch}
            left = (time.perf_counter() - started) / (len(judgements) - before) * (n - len(judgements))
            new = {first + question.candidate: judgement for question, judgement in batch}
            self.report(new, Progress(place + 1, len(judgements), n, first + len(judgements), left))
        return tuple(judgements[i] for i in range(n))

    def rank(self, picks: Sequence[int | None], place: int) -> "Ranking":
        """Every candidate in one place, beside the rows in the others."""
        judgements = self.estimates("mixture", picks, place)
        effective = [judgement.effective for judgement in judgements if np.isfinite(judgement.values[0])]
        if not effective:
            raise StudyError("no drive that was asked for has an answer for enough draws: try other loads or slips")
        if min(effective) >= EFFECTIVE:
            return self._ranking(judgements, "mixture")
        return self._ranking(self.estimates("regression", picks, place), "regression")

    def _ranking(self, judgements: tuple[Estimate, ...], method: str) -> "Ranking":
        before = self.grid.interest.values.std(axis=0, ddof=1)
        scores = [score(judgement, self.by, before) for judgement in judgements]
        return Ranking(judgements, method, np.array(scores))

    def exchanged(self, picks: list[int]) -> list[int]:
        """The plan with rows exchanged as long as that makes it better (Fedorov 1972, one row at a time)."""
        for _ in range(PASSES if len(picks) > 1 else 0):
            before = list(picks)
            for place in range(len(picks)):
                picks[place] = self.rank(picks, place).best
            if picks == before:
                break
        return picks


BIT = float(np.log(2.0))
"""Nats in a bit."""
EFFECTIVE = 8.0
"""Effective draws after a reading, below which gains come from regression."""
UNANSWERED = 0.05
"""Share of draws without an answer above which a candidate is marked."""

CRITERIA = ("information", "sd")
"""Criteria: the gain about the parameters of interest together, or the mean log shrinking of sds."""
PASSES = 3
"""Times, at most, that every chosen row is asked whether another one would do better in its place."""


@dataclass(frozen=True)
class Ranking:
    """Every candidate beside some rows that stand already, judged by one method."""

    estimates: tuple[Estimate, ...]  # of every candidate together with these rows; NaN where too few draws answer
    method: str  # ``mixture``, or ``regression``, whose gains are lower bounds
    scores: FloatArray  # (candidates, 1 + groups) what is maximised, nats

    @property
    def order(self) -> list[int]:
        """Candidates, the best first; those without an estimate last."""
        scores = np.nan_to_num(self.scores[:, 0], nan=-np.inf)
        return [int(i) for i in np.argsort(-scores, kind="stable")]

    @property
    def best(self) -> int:
        """The best candidate."""
        return self.order[0]

    def behind(self, index: int) -> tuple[float, float]:
        """By how much a candidate is worse than the best, nats, and the error of that."""
        difference = self.scores[self.best] - self.scores[index]
        return float(difference[0]), float(jackknife(difference))


@dataclass(frozen=True)
class Design(AnalysisResult):
    """Choice of the next measurements.

    Attributes
    ----------
    situation : what is known before.
    about : parameters of interest.
    candidates : in the order of the grid.
    by : one of ``CRITERIA``.
    ranking : of the candidates as single additions.
    picks : the rows to drive, as indices of candidates.
    together : estimates with the first of these rows, the first two, and so on.
    before : standard deviations of the parameters of interest among the draws, SI.
    seed : of the readings that were drawn.
    """

    MARK = "design.json"
    RECORD = Record.having(
        kind=Literal["design"], title=str, bayesterra=str, source=str, fingerprints=dict[str, str],
        draws=Count, seed=Count, about=list[str], by=str, candidates=Count, method=str,
        recommended=list[str], channels=list[list[str]],
    )  # fmt: skip
    VIEW = "bayesterra.design.page:design"
    FIGURES: ClassVar[Mapping[str, str]] = {"design.png": "gain_over_slip"}
    CALLED = "Page"

    situation: Situation
    about: tuple[str, ...]
    candidates: tuple[Candidate, ...]
    by: str
    ranking: Ranking
    picks: tuple[int, ...]
    together: tuple[Estimate, ...]
    method: str
    before: FloatArray
    seed: int

    @property
    def chosen(self) -> tuple[Candidate, ...]:
        """The rows to drive."""
        return tuple(self.candidates[index] for index in self.picks)

    @property
    def table(self) -> pd.DataFrame:
        """One row per candidate, the best first; gains in bits, standard deviations in field units."""
        rows = [self._row(rank, index) for rank, index in enumerate(self.ranking.order, start=1)]
        return pd.DataFrame(rows)

    def _row(self, rank: int, index: int) -> dict[str, object]:
        candidate, judgement = self.candidates[index], self.ranking.estimates[index]
        lag, lag_error = self.ranking.behind(index)
        return {
            "rank": rank, **described(candidate), "gain [bit]": judgement.values[0] / BIT,
            "gain_error": judgement.errors[0] / BIT, "behind_best [bit]": lag / BIT, "behind_error": lag_error / BIT,
            "gain_all [bit]": judgement.values[1] / BIT, "gain_all_error": judgement.errors[1] / BIT,
            **self.deviations(judgement), "no_answer": 1 - judgement.answered, "effective_draws": judgement.effective,
            "method": self.ranking.method, "chosen": self.picks.count(index),
        }  # fmt: skip

    @property
    def plan(self) -> pd.DataFrame:
        """One row per chosen drive: gain and standard deviations with all drives down to it."""
        rows = [
            {
                "drive": number,
                **described(self.candidates[index]),
                "joint_gain [bit]": judgement.values[0] / BIT,
                "joint_gain_error": judgement.errors[0] / BIT,
                **self.deviations(judgement),
                "no_answer": 1 - judgement.answered,
                "method": self.method,
            }
            for number, (index, judgement) in enumerate(zip(self.picks, self.together, strict=True), start=1)
        ]
        return pd.DataFrame(rows)

    def deviations(self, judgement: Estimate) -> dict[str, float]:
        """Standard deviation before and after, and its error, of every parameter of interest."""
        columns: dict[str, float] = {}
        for i, name in enumerate(self.about):
            parameter = PARAMETERS[name]
            column = f"sd_{parameter.header}"
            columns[column] = float(self.before[i] / parameter.scale)
            columns[f"{column} after"] = float(judgement.values[2 + i] / parameter.scale)
            columns[f"{column} error"] = float(judgement.errors[2 + i] / parameter.scale)
        return columns

    def tables(self) -> dict[str, pd.DataFrame]:
        """All candidates, and the drives that were chosen."""
        return {"design": self.table, "plan": self.plan}

    def to_record(self) -> dict[str, Any]:
        """Content of the JSON file."""
        study = self.situation.study
        return {
            "kind": "design", "title": study.title, "bayesterra": version("bayesterra"),
            "source": self.situation.source, "basis": self.situation.basis, "fingerprints": study.fingerprint,
            "draws": len(self.situation.draws), "seed": self.seed, "about": list(self.about), "by": self.by,
            "candidates": len(self.candidates), "method": self.ranking.method,
            "recommended": [candidate.where for candidate in self.chosen],
            "channels": [list(candidate.channels) for candidate in self.chosen],
        }  # fmt: skip


def described(candidate: Candidate) -> dict[str, object]:
    """Place and sensors of a candidate, as columns."""
    several = len(candidate.slip) > 1
    return {
        "wheel": ", ".join(dict.fromkeys(candidate.wheel)),
        "load [N]": np.nan if several else float(candidate.load[0]),
        "slip": np.nan if several else float(candidate.slip[0]),
        "rows": len(candidate.slip),
        "channels": " ".join(candidate.channels),
    }


def score(judgement: Estimate, by: str, before: FloatArray) -> FloatArray:
    """Criterion to maximise (1 + groups,), nats."""
    if by == "information":
        return np.asarray(judgement.replicates[:, 0])
    return np.asarray(-np.log(judgement.replicates[:, 2:] / before).mean(axis=1))


def choose(
    situation: Situation, candidates: Sequence[Candidate], about: Sequence[str], *, number: int = 1,
    by: str = "information", seed: int = 1, engine: Engine | None = None,
    finished: Mapping[int, Estimate] = MappingProxyType({}), report: Report = lambda estimates, progress: None,
) -> Design:  # fmt: skip
    """Rank candidates by what they tell about some parameters, and choose several rows to drive together.

    Rows are chosen one after the other by their joint gain and then exchanged one at a time.

    Parameters
    ----------
    number, by, seed, engine : as of :func:`bayesterra.design.recommendation.recommend`.
    finished : what was judged before, by the numbers that ``report`` was told.
    report : called with new estimates by number, and the progress.

    Raises
    ------
    StudyError : no candidate has an answer for enough draws.
    """
    names = situation.posterior.names
    interest = Interest(situation.draws, tuple(names.index(name) for name in about))
    grid = Grid(situation, tuple(candidates), interest, seed)
    judge = Judge(grid, by, engine or in_process(), finished, report)
    ranking = last = judge.rank((), 0)
    picks = [ranking.best]
    for place in range(1, number):
        last = judge.rank(picks, place)
        picks.append(last.best)
    picks = judge.exchanged(picks)
    joint = [grid.together(picks[: i + 1]) for i in range(number)]
    return Design(
        situation, tuple(about), tuple(candidates), by, ranking, tuple(picks),
        tuple(METHODS[last.method](readings, interest) for readings in joint if readings is not None),
        last.method, interest.values.std(axis=0, ddof=1), seed,
    )  # fmt: skip
