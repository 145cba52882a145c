"""The tasks of a design: one candidate in one place of the plan, judged by one method, the same anywhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.random import default_rng

from bayesterra.design.candidates import Candidate
from bayesterra.design.gain import Estimate, estimate, normal_estimate
from bayesterra.design.pairs import Interest, Pairs, pairs
from bayesterra.design.readings import Reading, Situation, readings_of
from bayesterra.engines import Engine, ended, in_process

METHODS = {"mixture": estimate, "regression": normal_estimate}


@dataclass(frozen=True)
class Grid:
    """Candidates and the draws that they are judged by; for one place of a plan all have the same noise.

    Attributes
    ----------
    situation, candidates : what is known before, and what may be driven.
    interest : the draws and which parameters are asked about.
    seed : of the readings that are drawn.
    """

    situation: Situation
    candidates: tuple[Candidate, ...]
    interest: Interest
    seed: int

    @cached_property
    def _readings(self) -> dict[int, tuple[Reading, ...]]:
        return {}

    def __getstate__(self) -> dict[str, Any]:
        """Without what can be computed again."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def pairs(self, index: int, place: int) -> Pairs:
        """Readings of a candidate in some place of the plan."""
        if index not in self._readings:
            self._readings[index] = readings_of(self.situation, self.candidates[index])
        return pairs(self._readings[index], self.interest, default_rng((self.seed, place)))

    def together(self, picks: Sequence[int | None]) -> Pairs | None:
        """Readings of some rows, each in its place."""
        found = [self.pairs(index, place) for place, index in enumerate(picks) if index is not None]
        return sum(found[1:], found[0]) if found else None


class Question(NamedTuple):
    """What a candidate is judged for.

    Attributes
    ----------
    candidate : its number, from 0.
    place : its place in the plan, from 0.
    picks : rows that stand already, each in its place; None where there is none.
    method : one of ``METHODS``.
    """

    candidate: int
    place: int
    picks: tuple[int | None, ...]
    method: str

    def __str__(self) -> str:
        return f"candidate {self.candidate + 1} for drive {self.place + 1}"


@dataclass(frozen=True)
class Judging:
    """The task: a question in, an estimate out. One serves a whole design and keeps what it needs again."""

    grid: Grid

    @cached_property
    def _beside(self) -> dict[tuple[int | None, ...], Pairs | None]:
        return {}

    def __getstate__(self) -> dict[str, Any]:
        """Without what can be computed again."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __call__(self, question: Question) -> Estimate:
        """Judge a candidate beside the rows that stand already."""
        one, beside = self.grid.pairs(question.candidate, question.place), self._together(question.picks)
        return METHODS[question.method](one if beside is None else beside + one, self.grid.interest)

    def _together(self, picks: tuple[int | None, ...]) -> Pairs | None:
        if picks not in self._beside:
            self._beside.clear()  # they are large, and asked for in turn
            self._beside[picks] = self.grid.together(picks)
        return self._beside[picks]


@dataclass(frozen=True)
class Progress:
    """How far a design is.

    Attributes
    ----------
    drive : of the plan, from 1, that candidates are judged for.
    done, of : candidates judged for it, this time, and all.
    judged : estimates in all.
    seconds_left : of this time, at the pace so far; None at its start.
    """

    drive: int
    done: int
    of: int
    judged: int
    seconds_left: float | None


Report = Callable[[Mapping[int, Estimate], Progress], None]


@dataclass
class Judge:
    """Has candidates judged, time after time, and counts the tasks: each has a number that tells it for good.

    Attributes
    ----------
    finished : estimates by number of the task that are known already.
    report : called with new ones, and the progress.
    """

    grid: Grid
    engine: Engine = field(default_factory=in_process)
    finished: Mapping[int, Estimate] = field(default_factory=dict)
    report: Report = lambda found, progress: None
    count: int = 0

    def __post_init__(self) -> None:
        self._task = Judging(self.grid)

    def estimates(self, method: str, picks: Sequence[int | None], place: int) -> tuple[Estimate, ...]:
        """Every candidate in one place, beside the rows in the others."""
        beside = tuple(None if i == place else index for i, index in enumerate(picks))
        n, first = len(self.grid.candidates), self.count
        self.count += n
        known = {i: self.finished[first + i] for i in range(n) if first + i in self.finished}
        started, before = time.perf_counter(), len(known)
        self.report({}, Progress(place + 1, before, n, first + before, None))
        todo = [Question(i, place, beside, method) for i in range(n) if i not in known]
        for batch in ended(self._task, todo, self.engine, short=True):
            known |= {question.candidate: one for question, one in batch}
            left = (time.perf_counter() - started) / (len(known) - before) * (n - len(known))
            new = {first + question.candidate: one for question, one in batch}
            self.report(new, Progress(place + 1, len(known), n, first + len(known), left))
        return tuple(known[i] for i in range(n))


def as_content(one: Estimate) -> dict[str, Any]:
    """An estimate as a store of tasks keeps it, to the last digit."""
    return {**asdict(one), "replicates": one.replicates.tolist()}


def from_content(content: Mapping[str, Any]) -> Estimate:
    """The estimate that a store has kept."""
    return Estimate(**{**content, "replicates": np.array(content["replicates"])})
