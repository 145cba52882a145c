"""Tasks that take little, and some that kill whoever computes them; importable by worker processes."""

import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.random import SeedSequence, default_rng

from bayesterra.runtime.engines import Engine, completed, usable_processors


@dataclass(frozen=True)
class Sums:
    """Numbers that depend on the last digit of linear algebra; a file per run says who was at it."""

    folder: Path
    seconds: float = 0.0

    def __call__(self, number: int) -> float:
        """Sum of a product of random matrices."""
        (self.folder / f"{number}-{os.getpid()}").touch()
        time.sleep(self.seconds)
        a = default_rng(SeedSequence(1, spawn_key=(number,))).normal(size=(60, 60))
        return float(np.linalg.solve(a, a @ a.T).sum())

    @property
    def runs(self) -> list[str]:
        """Names of the files: number and process of every run that was begun."""
        return sorted(path.name for path in self.folder.iterdir())


def processors(number: int) -> float:
    """Processors that a task may use where it is computed."""
    return usable_processors()


@dataclass(frozen=True)
class Deadly(Sums):
    """Number 3 kills the process that computes it, every time or as often as ``times`` says."""

    times: int = 1000

    def __call__(self, number: int) -> float:
        """See above."""
        found = super().__call__(number)
        if number == 3 and len([name for name in self.runs if name.startswith("3-")]) <= self.times:
            os.kill(os.getpid(), signal.SIGKILL)
        return found


@dataclass(frozen=True)
class Failing(Sums):
    """Number 3 raises an error."""

    def __call__(self, number: int) -> float:
        """See above."""
        if number == 3:
            raise ArithmeticError("no sums today")
        return super().__call__(number)


def run(task: Sums, engine: Engine, note: Callable[[int], None], numbers: range) -> None:
    """Compute, and note every number as its outcome comes."""
    for number, _ in completed(task, numbers, engine):
        note(number)
