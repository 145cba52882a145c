"""The posterior once more by nested sampling, at two settings: agreement or not, without saying who is wrong.

The only module that imports dynesty, an optional extra. Nested samplers err on ridges without a warning, so
that two settings are run: where they differ from each other they are no judge.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import SeedSequence, default_rng

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError
from bayesterra.likelihood.joint import Whole
from bayesterra.sampling.importance import Evidence
from bayesterra.stats.diagnostics import effective_size
from bayesterra.stats.weights import effective_number

LIVE = (500, 1500)
"""Live points of the two settings."""
QUANTILES = (0.05, 0.5, 0.95)
APART = 4.0
"""Standard errors from which two samplers disagree."""

MANY = 6
"""Parameters from which nested sampling walks at random in place of drawing uniformly in ellipsoids."""


@dataclass(frozen=True)
class Weighted:
    """Weighted draws and log evidence of one sampler.

    Attributes
    ----------
    name : what a reader calls it.
    x : parameter sets (n, d).
    weights : (n,), summing to one.
    sizes : effective draws behind the mean and the share below every one of ``QUANTILES``, per parameter
        (d, statistics).
    log_z, error : log evidence under the stated prior; NaN where it is not known.
    """

    name: str
    x: FloatArray
    weights: FloatArray
    sizes: FloatArray
    log_z: float
    error: float

    @classmethod
    def independent(cls, name: str, x: FloatArray, weights: FloatArray, log_z: float, error: float) -> Weighted:
        """Independent draws with weights; their effective number is Kish's."""
        size = effective_number(weights)
        return cls(name, x, weights, np.full((x.shape[1], 1 + len(QUANTILES)), size), log_z, error)

    @classmethod
    def of_ensembles(cls, name: str, chains: FloatArray, evidence: Evidence | None) -> Weighted:
        """Draws of ensembles (ensembles, steps, walkers, d), which depend on each other.

        Every statistic has the effective size that the diagnosis of the sampling would give it.
        """
        flat = chains.reshape(-1, chains.shape[-1])
        sizes = np.array([_sizes(chains[..., i]) for i in range(chains.shape[-1])])
        log_z, error = (evidence.log_z, evidence.error) if evidence else (np.nan, np.nan)
        return cls(name, flat, np.full(len(flat), 1 / len(flat)), sizes, log_z, error)

    def share_below(self, i: int, value: float) -> float:
        """Probability that parameter ``i`` lies at or below a value."""
        return float(self.weights[self.x[:, i] <= value].sum())


def _sizes(chains: FloatArray) -> list[float]:
    """Effective draws behind the mean and the shares below quantiles of a parameter's chains."""
    shares = [(chains <= value).astype(float) for value in np.quantile(chains, QUANTILES)]
    return [max(1.0, min(effective_size(part), chains.size)) for part in (chains, *shares)]


@dataclass(frozen=True)
class CrossCheck:
    """Statistics of several samplers side by side.

    Attributes
    ----------
    table : one row per pair of samplers and statistic: ``one, other, parameter, statistic, z``; z is their
        difference in standard errors.
    samplers : names, ours first.
    """

    table: pd.DataFrame
    samplers: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """``agree``, ``disagree``, or ``nested sampling disagrees with itself``."""
        apart = self.table["z"].abs() > APART
        ours = (self.table["one"] == self.samplers[0]) | (self.table["other"] == self.samplers[0])
        if (apart & ~ours).any():
            return "nested sampling disagrees with itself"
        return "disagree" if apart.any() else "agree"

    @property
    def worst(self) -> str:
        """The statistic that differs most, in words."""
        row = self.table.iloc[int(self.table["z"].abs().argmax())]
        where = f"{row['statistic']} of {row['parameter']}" if row["parameter"] else row["statistic"]
        return f"{where}: {abs(row['z']):.1f} errors between {row['one']} and {row['other']}"

    def record(self) -> dict[str, Any]:
        """Everything, for ``run.json``."""
        return {
            "verdict": self.verdict,
            "worst": self.worst,
            "threshold": APART,
            "samplers": list(self.samplers),
            "table": self.table.to_dict("records"),
        }


def compare(samplers: tuple[Weighted, ...], names: tuple[str, ...]) -> CrossCheck:
    """Set every pair of samplers side by side."""
    rows = []
    for k, this in enumerate(samplers):
        for other in samplers[k + 1 :]:
            z = {("", "log evidence"): float((other.log_z - this.log_z) / np.hypot(this.error, other.error))}
            z = {what: value for what, value in z.items() if not np.isnan(value)}
            for i, name in enumerate(names):
                z |= {(name, what): value for what, value in _differences(this, other, i).items()}
            pair = {"one": this.name, "other": other.name}
            rows += [{**pair, "parameter": p, "statistic": what, "z": v} for (p, what), v in z.items()]
    return CrossCheck(pd.DataFrame(rows), tuple(sampler.name for sampler in samplers))


def _differences(this: Weighted, other: Weighted, i: int) -> dict[str, float]:
    """Differences of a parameter's mean and of the probability below quantiles, in standard errors."""
    (m, sd), (n, other_sd) = _moments(this, i), _moments(other, i)
    errors = 1 / this.sizes[i], 1 / other.sizes[i]
    differences = {"mean": (n - m) / np.hypot(sd * np.sqrt(errors[0][0]), other_sd * np.sqrt(errors[1][0]))}
    order = np.argsort(this.x[:, i])
    steps = np.cumsum(this.weights[order])
    for q, variance in zip(QUANTILES, (errors[0] + errors[1])[1:], strict=True):
        at = min(int(np.searchsorted(steps, q)), len(order) - 1)
        value = float(this.x[order[at], i])
        error = np.sqrt(q * (1 - q) * variance)
        differences[f"{100 * q:.0f} % quantile"] = (other.share_below(i, value) - q) / error
    return {name: float(value) for name, value in differences.items()}


def _moments(sampler: Weighted, i: int) -> tuple[float, float]:
    mean = float(sampler.weights @ sampler.x[:, i])
    return mean, float(np.sqrt(sampler.weights @ (sampler.x[:, i] - mean) ** 2))


def check_installed() -> None:
    """Raise a StudyError where nested sampling is not installed."""
    if find_spec("dynesty") is None:
        raise StudyError("'--crosscheck' needs dynesty: pip install 'bayesterra[crosscheck]'")


def against_nested(
    posterior: Whole,
    ours: Weighted,
    seed: SeedSequence,
    live: tuple[int, ...] = LIVE,
    report: Callable[[str], None] = lambda stage: None,
) -> CrossCheck:
    """Sample a posterior by nested sampling at every number of live points and compare with our draws.

    StudyError where dynesty is not installed.
    """
    samplers = [ours]
    for points, stream in zip(live, seed.spawn(len(live)), strict=True):
        report(f"nested sampling, {points} live points")
        samplers.append(nested(posterior, points, stream))
    return compare(tuple(samplers), posterior.names)


def nested(posterior: Whole, live: int, seed: SeedSequence) -> Weighted:
    """Static nested sampling from the unit cube of the stated prior, by dynesty."""
    check_installed()
    from dynesty import NestedSampler

    d = len(posterior.names)
    moves = "auto" if d < MANY else "rwalk"  # uniform draws do not come to an end in eight dimensions

    def physical(cube: FloatArray) -> FloatArray:
        return np.asarray(posterior.prior.quantile(cube[None])[0])

    def log_likelihood(x: FloatArray) -> float:
        return float(posterior.log_prior_and_likelihood(x[None])[1][0])

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its remarks on progress and plateaus
        sampler = NestedSampler(log_likelihood, physical, d, nlive=live, rstate=default_rng(seed), sample=moves)
        sampler.run_nested(print_progress=False, dlogz=0.1)
        results = sampler.results
    weights = np.asarray(results.importance_weights())
    weights /= weights.sum()
    return Weighted.independent(
        f"nested ({live})", results.samples, weights, float(results.logz[-1]), float(results.logzerr[-1])
    )
