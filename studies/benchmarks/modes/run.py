"""How often the sampler finds a narrow second mode beside a broad one, and what it says when it does not.

Usage: python run.py. Rows that modes.csv holds already are kept.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.random import Generator, SeedSequence
from scipy.special import ndtr

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.likelihood.posterior import INSIDE, OUTSIDE_PRIOR
from bayesterra.sampling.coordinates import Coordinates, NormalScore
from bayesterra.sampling.sampler import Target, sample
from bayesterra.stats.laws import Law
from bayesterra.study.schema import SamplingOptions

HERE = Path(__file__).parent
sys.path.append(str(HERE.parents[1] / "support"))

from readme import markdown  # noqa: E402
from stored import append, done  # noqa: E402

BROAD, SHARE = 0.05, 0.7
"""Standard deviation of the broad mode in every coordinate of the unit cube, and its share."""
PLACES = (0.3, 0.7)
"""Centres of the broad and of the narrow mode in every coordinate."""
CASES = {2: (0.005, 0.002), 4: (0.02, 0.01, 0.005), 6: (0.03, 0.02, 0.01), 8: (0.03, 0.02)}
"""Standard deviations of the narrow mode, by the number of coordinates."""
RUNS = 10
MOST = 2000
"""Steps after which a run that has not converged is left; ten times what the others take."""
HEADER = ("coordinates", "sd of the narrow mode", "found", "missed, says so", "missed, unsaid", "CPU s", "evaluations")
FLAT = Law("uniform", lower=0.0, upper=1.0)


@dataclass(frozen=True)
class Uniform:
    """The flat prior on the unit cube."""

    d: int

    def sample(self, n: int, rng: Generator) -> FloatArray:
        """Draws (n, d)."""
        return rng.random((n, self.d))


@dataclass(frozen=True)
class TwoModes:
    """Two normal laws in a unit cube of d coordinates, cut to it."""

    d: int
    width: float

    @property
    def names(self) -> tuple[str, ...]:
        """Coordinates."""
        return tuple(f"x{i + 1}" for i in range(self.d))

    @property
    def prior(self) -> Uniform:
        """The flat prior."""
        return Uniform(self.d)

    def reasons(self, x: FloatArray) -> IntArray:
        """Codes (n,) of why sets (n, d) have no density."""
        return np.where(self._inside(x), INSIDE, OUTSIDE_PRIOR)

    def _inside(self, x: FloatArray) -> FloatArray:
        return np.asarray(((x > 0) & (x < 1)).all(axis=1))

    def log_prior_and_likelihood(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log prior and log likelihood (n,); the evidence is one."""
        inside, logs = self._inside(x), []
        for share, place, sd in zip((SHARE, 1 - SHARE), PLACES, (BROAD, self.width), strict=True):
            z = (x - place) / sd
            mass = ndtr((1 - place) / sd) - ndtr(-place / sd)
            constant = np.log(share) - self.d * np.log(np.sqrt(2 * np.pi) * sd * mass)
            logs.append(constant - 0.5 * (z**2).sum(axis=1))
        return np.where(inside, 0.0, -np.inf), np.where(inside, np.logaddexp(*logs), -np.inf)


def one(d: int, width: float, seed: int) -> dict[str, object]:
    """One default run: the narrow mode's share of its draws, the verdict, evidence and cost."""
    target = Target(TwoModes(d, width), Coordinates(tuple(((i,), NormalScore(FLAT)) for i in range(d))))
    started = time.process_time()
    samples = sample(target, SamplingOptions(max_steps=MOST), SeedSequence(seed))
    seconds = time.process_time() - started
    near = np.linalg.norm(samples.chains - PLACES[1], axis=-1) < np.linalg.norm(samples.chains - PLACES[0], axis=-1)
    by_ensemble, diagnosis = near.mean(axis=(1, 2)), samples.diagnosis
    return {
        "d": d,
        "width": width,
        "run": seed,
        "share": round(float(near.mean()), 3),
        "ensembles": int((by_ensemble > 0.01).sum()),
        "found": bool((by_ensemble > 0.5 * (1 - SHARE)).all()),
        "converged": diagnosis.converged,
        "log_evidence": round(float(np.mean([each.log_evidence for each in samples.adaptations])), 3),
        "steps": diagnosis.steps,
        "evaluations": sum(each.evaluations for each in samples.adaptations),
        "cpu_seconds": round(seconds, 2),
    }


def table(name: str = "modes.csv") -> str:
    """A table of the README, a row for every width of the narrow mode."""
    rows = []
    for (d, width), runs in pd.read_csv(HERE / name).groupby(["d", "width"], sort=True):
        found, said = runs["found"], ~runs["converged"]
        numbers = (int(found.sum()), int((~found & said).sum()), int((~found & ~said).sum()))
        rows.append(
            (d, f"{width:g}", *numbers, f"{runs['cpu_seconds'].median():.1f}", f"{runs['evaluations'].median():.0f}")
        )
    return markdown(HEADER, rows, "|rrrrrr")


def main() -> None:
    """Make all runs that the table does not hold yet."""
    path = HERE / "modes.csv"
    known = done(path, "d", "width", "run")
    for d, widths in CASES.items():
        for width in widths:
            for run in (run for run in range(1, RUNS + 1) if (d, width, run) not in known):
                append(path, pd.DataFrame([one(d, width, run)]))
                print(pd.read_csv(path).tail(1).to_string(header=False), flush=True)
    print(table())


if __name__ == "__main__":
    main()
