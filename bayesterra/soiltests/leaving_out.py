"""Whether predictions for a new test can be relied on: every test predicted from the others.

The readings of a test are predicted from the posterior of all other tests, by importance weights of the draws
(Vehtari et al. 2017), or by sampling anew where the weights cannot be relied on. What is judged is what a
person would ask of a new test: its level (the mean of its log residuals), and its slope (the difference of
the means of its further and its nearer half), each one number per test, and what shares of its readings the
bands hold.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import SeedSequence
from scipy.special import logsumexp, ndtr, ndtri
from scipy.stats import chi2, kstest

from bayesterra.arrays import FloatArray
from bayesterra.diagnostics import pareto_limit, pareto_smoothed
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.sampling.sampler import Target, sample_target
from bayesterra.schema import SamplingOptions
from bayesterra.soiltests.curves import log_curve
from bayesterra.soiltests.posterior import TestPosterior, coordinates
from bayesterra.soiltests.scatter import covariance

PLAN = AdaptationOptions(particles=512, components=8, refinements=(4, 8), more=(), shores=12)
"""Posteriors of soil tests are simple in their coordinates: a smaller adaptation than that of wheels is
enough."""
DRAWS = 500
ANEW = SamplingOptions(target_ess=500, walkers=32)
BANDS = (0.5, 0.9)
COLUMNS = ("test", "level", "readings", "elpd", "level_pit", "slope_pit",
           *(f"covered_{100 * band:.0f}" for band in BANDS), "k_hat", "anew")  # fmt: skip
ALARM = 0.05
"""Probability of a false alarm over all checks together."""


@dataclass(frozen=True)
class LeftOut:
    """Every test beside its prediction from the others.

    Attributes
    ----------
    table : one row per test: test, plate_radius or normal_stress (SI), readings, elpd (log density of its
        readings), k_hat, anew (sampled without it), level_pit, slope_pit (share of the prediction below
        what was read; NaN for a slope of less than four readings), covered_50, covered_90 (shares of its
        readings inside the bands).
    checks : p values by name: whether levels and slopes are uniform, and whether their means by plate or
        stress are zero.
    """

    table: pd.DataFrame
    checks: dict[str, float]

    @property
    def alarm(self) -> bool:
        """Whether one of the checks says that the readings do not look like those of the model."""
        known = [p for p in self.checks.values() if np.isfinite(p)]
        return bool(known) and min(known) * len(known) < ALARM


def leave_out(posterior: TestPosterior, draws: FloatArray, seed: SeedSequence) -> LeftOut:
    """Predict every test from the others; ``draws`` (n, d) of the posterior are nearly independent."""
    readings = posterior.readings
    densities = posterior.log_likelihoods(draws)
    streams = seed.spawn(len(readings.tests))
    rows = []
    for number, name in enumerate(readings.tests):
        weights, k_hat = pareto_smoothed(-densities[:, number])
        anew = len(readings.tests) > 1 and not k_hat <= pareto_limit(len(draws))
        x = draws
        if anew:
            x = _anew(posterior, number, streams[number])
            weights = np.full(len(x), -np.log(len(x)))
        row = _predicted(posterior, number, x, weights)
        rows.append({"test": name, "level": readings.levels[number], **row, "k_hat": k_hat, "anew": anew})
    table = _table(rows, readings.kind)
    return LeftOut(table, _checks(table, readings.levels))


def none_left_out(kind: str) -> LeftOut:
    """Without any test, where leaving them out failed."""
    return LeftOut(_table([], kind), {})


def _table(rows: list[dict[str, Any]], kind: str) -> pd.DataFrame:
    columns = {"level": "plate_radius" if kind == "plate" else "normal_stress"}
    return pd.DataFrame(rows, columns=list(COLUMNS)).rename(columns=columns)


def _anew(posterior: TestPosterior, number: int, stream: SeedSequence) -> FloatArray:
    """Draws (n, d) of the posterior of all other tests."""
    others = np.arange(len(posterior.readings.tests)) != number
    reduced = TestPosterior(posterior.prior, posterior.readings.only(others))
    samples = sample_target(Target(reduced, coordinates(reduced)), ANEW, stream, adaptation=PLAN)
    flat = samples.chains.reshape(-1, samples.chains.shape[-1])
    return flat[:: max(1, len(flat) // DRAWS)]


def _predicted(
    posterior: TestPosterior, number: int, x: FloatArray, log_weights: FloatArray
) -> dict[str, float]:
    """How one test looks beside its prediction, from draws (n, d) with log weights (n,) that sum to one."""
    readings = posterior.readings
    chosen = readings.test == number
    alone = TestPosterior(posterior.prior, readings.only(np.arange(len(readings.tests)) == number))
    with np.errstate(all="ignore"):  # without this plate its modulus may be negative: no density, no weight
        densities = alone.log_likelihoods(x)[:, 0]
    possible = np.isfinite(densities)
    elpd = float(logsumexp(log_weights[possible] + densities[possible]))
    rng = np.random.default_rng(number)
    shares = np.exp(log_weights) * possible
    picked = rng.choice(len(x), size=DRAWS, p=shares / shares.sum())
    soil, path = posterior.soil(x[picked]), readings.path[chosen]
    spread = posterior.spread(x[picked])
    mean = log_curve(readings.kind, soil, spread.true_path(path), readings.level[chosen])
    residual = np.log(readings.stress[chosen]) - mean
    law = covariance(path, spread)
    sd = np.sqrt(np.einsum("nii->ni", law))
    inside = ndtr(residual / sd).mean(axis=0)
    covered = {
        f"covered_{100 * band:.0f}": float((np.abs(inside - 0.5) <= band / 2).mean()) for band in BANDS
    }
    count = int(chosen.sum())
    mean = np.full(count, 1.0 / count)
    half = count // 2
    slope = np.where(np.arange(count) < half, -1.0 / max(half, 1), 1.0 / (count - half))
    slope_pit = _pit(residual, law, slope) if count >= 4 else np.nan
    level_pit = _pit(residual, law, mean)
    return {"readings": count, "elpd": elpd, "level_pit": level_pit, "slope_pit": slope_pit, **covered}


def _pit(residual: FloatArray, law: FloatArray, weights: FloatArray) -> float:
    """Share of the predictive law of a weighted sum of residuals (n, m) below what it is."""
    value, variance = residual @ weights, np.einsum("i,nij,j->n", weights, law, weights)
    return float(ndtr(value / np.sqrt(variance)).mean())


def _checks(table: pd.DataFrame, levels: FloatArray) -> dict[str, float]:
    found: dict[str, float] = {}
    for name in ("level", "slope"):
        values = table[f"{name}_pit"].to_numpy()
        known = np.isfinite(values)
        if known.sum() < 4:
            continue
        found[f"{name}s of tests uniform"] = float(kstest(values[known], "uniform").pvalue)
        groups = np.unique(levels[known])
        if 1 < len(groups) < known.sum():
            scores = ndtri(np.clip(values, 1e-9, 1 - 1e-9))
            parts = [scores[known & (levels == group)] for group in groups]
            total = sum(len(part) * part.mean() ** 2 for part in parts)
            found[f"{name}s alike under every {'plate' if 'plate_radius' in table else 'stress'}"] = float(
                chi2.sf(total, len(groups))
            )
    return found
