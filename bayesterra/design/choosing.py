"""Candidates in order of what they are expected to tell, and several rows chosen one after the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray
from bayesterra.design.candidates import Candidate
from bayesterra.design.gain import Estimate, jackknife
from bayesterra.design.judging import METHODS, Grid, Judge, Report
from bayesterra.design.pairs import Interest
from bayesterra.design.readings import Situation
from bayesterra.engines import Engine, in_process
from bayesterra.errors import StudyError
from bayesterra.parameters import PARAMETERS

BIT = float(np.log(2.0))
"""Nats in a bit."""
EFFECTIVE = 8.0
"""Effective draws after a reading, below which gains come from regression."""
UNANSWERED = 0.05
"""Share of draws without an answer above which a candidate is marked."""


CRITERIA = ("information", "sd")
"""What is maximised: the gain about the parameters of interest together, or the mean log shrinking of sds."""
PASSES = 3
"""Times, at most, that every chosen row is asked whether another one would do better in its place."""


@dataclass(frozen=True)
class Ranking:
    """Every candidate beside some rows that stand already, judged by one method.

    Attributes
    ----------
    estimates : of every candidate together with these rows; NaN where too few draws have an answer.
    method : ``mixture``, or ``regression``, whose gains are lower bounds.
    scores : (candidates, 1 + groups) what is maximised, nats.
    """

    estimates: tuple[Estimate, ...]
    method: str
    scores: FloatArray

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
class Design:
    """Which measurement next.

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
        candidate, one = self.candidates[index], self.ranking.estimates[index]
        lag, lag_error = self.ranking.behind(index)
        return {
            "rank": rank,
            **described(candidate),
            "gain [bit]": one.values[0] / BIT,
            "gain_error": one.errors[0] / BIT,
            "behind_best [bit]": lag / BIT,
            "behind_error": lag_error / BIT,
            "gain_all [bit]": one.values[1] / BIT,
            "gain_all_error": one.errors[1] / BIT,
            **self.deviations(one),
            "no_answer": 1 - one.answered,
            "effective_draws": one.effective,
            "method": self.ranking.method,
            "chosen": self.picks.count(index),
        }

    @property
    def plan(self) -> pd.DataFrame:
        """One row per chosen drive: gain and standard deviations with all drives down to it."""
        rows = [
            {
                "drive": number,
                **described(self.candidates[index]),
                "joint_gain [bit]": one.values[0] / BIT,
                "joint_gain_error": one.errors[0] / BIT,
                **self.deviations(one),
                "no_answer": 1 - one.answered,
                "method": self.method,
            }
            for number, (index, one) in enumerate(zip(self.picks, self.together, strict=True), start=1)
        ]
        return pd.DataFrame(rows)

    def deviations(self, one: Estimate) -> dict[str, float]:
        """Standard deviation before and after, and its error, of every parameter of interest."""
        found: dict[str, float] = {}
        for i, name in enumerate(self.about):
            known = PARAMETERS[name]
            column = f"sd_{name}" + ("" if known.unit == "-" else f" [{known.unit}]")
            found[column] = float(self.before[i] / known.scale)
            found[f"{column} after"] = float(one.values[2 + i] / known.scale)
            found[f"{column} error"] = float(one.errors[2 + i] / known.scale)
        return found


def described(candidate: Candidate) -> dict[str, object]:
    """Where and with what a candidate drives, as columns."""
    several = len(candidate.slip) > 1
    return {
        "wheel": ", ".join(dict.fromkeys(candidate.wheel)),
        "load [N]": np.nan if several else float(candidate.load[0]),
        "slip": np.nan if several else float(candidate.slip[0]),
        "rows": len(candidate.slip),
        "channels": " ".join(candidate.channels),
    }


@dataclass(frozen=True)
class _Choice:
    """Ranks candidates, and exchanges them."""

    judge: Judge
    by: str

    def rank(self, picks: Sequence[int | None], place: int) -> Ranking:
        """Every candidate in one place, beside the rows in the others."""
        found = self.judge.estimates("mixture", picks, place)
        known = [one.effective for one in found if np.isfinite(one.values[0])]
        if not known:
            raise StudyError(
                "no drive that was asked for has an answer for enough draws: try other loads or slips"
            )
        if min(known) >= EFFECTIVE:
            return self._ranking(found, "mixture")
        return self._ranking(self.judge.estimates("regression", picks, place), "regression")

    def _ranking(self, found: tuple[Estimate, ...], method: str) -> Ranking:
        before = self.judge.grid.interest.values.std(axis=0, ddof=1)
        scores = [score(one, self.by, before) for one in found]
        return Ranking(found, method, np.array(scores))

    def exchanged(self, picks: list[int]) -> list[int]:
        """The plan with rows exchanged as long as that makes it better (Fedorov 1972, one row at a time)."""
        for _ in range(PASSES if len(picks) > 1 else 0):
            before = list(picks)
            for place in range(len(picks)):
                picks[place] = self.rank(picks, place).best
            if picks == before:
                break
        return picks


def score(one: Estimate, by: str, before: FloatArray) -> FloatArray:
    """What is maximised (1 + groups,), nats."""
    if by == "information":
        return np.asarray(one.replicates[:, 0])
    return np.asarray(-np.log(one.replicates[:, 2:] / before).mean(axis=1))


def choose(
    situation: Situation,
    candidates: Sequence[Candidate],
    about: Sequence[str],
    *,
    number: int = 1,
    by: str = "information",
    seed: int = 1,
    engine: Engine | None = None,
    finished: Mapping[int, Estimate] = MappingProxyType({}),
    report: Report = lambda found, progress: None,
) -> Design:
    """Rank candidates by what they tell about some parameters, and choose several rows to drive together.

    Rows are chosen one after the other by their joint gain and then exchanged one at a time.

    Parameters
    ----------
    number : rows to choose; the same drive may be chosen again.
    by : ``information`` or ``sd``, see ``CRITERIA``.
    seed : of the readings that are drawn.
    engine : judges the candidates; by default this process.
    finished : what was judged before, by the numbers that ``report`` was told.
    report : called with new estimates by number, and the progress.

    Raises
    ------
    StudyError : no candidate has an answer for enough draws.
    """
    names = situation.posterior.names
    interest = Interest(situation.draws, tuple(names.index(name) for name in about))
    grid = Grid(situation, tuple(candidates), interest, seed)
    choice = _Choice(Judge(grid, engine or in_process(), finished, report), by)
    ranking = last = choice.rank((), 0)
    picks = [ranking.best]
    for place in range(1, number):
        last = choice.rank(picks, place)
        picks.append(last.best)
    picks = choice.exchanged(picks)
    joint = [grid.together(picks[: i + 1]) for i in range(number)]
    return Design(
        situation, tuple(about), tuple(candidates), by, ranking, tuple(picks),
        tuple(METHODS[last.method](one, interest) for one in joint if one is not None),
        last.method, interest.values.std(axis=0, ddof=1), seed,
    )  # fmt: skip
