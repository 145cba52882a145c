"""Checks of soil tests: every test predicted from all other readings, and bands of new tests.

The readings of a test are predicted from the posterior of all other tests, by importance weights of the draws
(Vehtari et al. 2017), or by sampling anew where the weights cannot be relied on. What is judged is what a
person would ask of a new test: its level (the mean of its log residuals), and its slope (the difference of
the means of its further and its nearer half), each one number per test, and what shares of its readings the
bands hold.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator, SeedSequence
from scipy.special import ndtr, ndtri
from scipy.stats import chi2, kstest

from bayesterra.arrays import FloatArray, spaced
from bayesterra.likelihood.experiments import Experiment, covariance, marginal_sd
from bayesterra.likelihood.posterior import Posterior
from bayesterra.report.numbers import probability
from bayesterra.report.verdicts import Verdict, unknown_verdict
from bayesterra.sampling.adaptation import OF_SOIL_TESTS
from bayesterra.sampling.sampler import sample
from bayesterra.stats.mixture import pareto_limit, pareto_smoothed, weighted_log_mean
from bayesterra.study.result import CURVE_QUANTILES as QUANTILES
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.soil_tests import LEVELS, Readings

DRAWS, LEAVING_DRAWS, BAND_DRAWS, GRID = 500, 4000, 1000, 60
ANEW = SamplingOptions(target_ess=500, walkers=32)
BANDS = (0.5, 0.9)

NEW_TESTS = ("series", "test", "level", "unit", "readings", "elpd", "level_pit", "slope_pit",
           *(f"covered_{100 * band:.0f}" for band in BANDS), "k_hat", "anew")  # fmt: skip

ALARM = 0.05
"""Probability of a false alarm over all checks together."""


@dataclass(frozen=True)
class NewTests:
    """Every soil test beside its prediction from all other readings, and bands of new tests.

    Attributes
    ----------
    table : one row per test: series, test, level and its unit (plate radius or normal stress), readings, elpd
        (log density of its readings), level_pit, slope_pit (share of the prediction below what was read; NaN for
        a slope of less than four readings), covered_50, covered_90 (shares of its readings inside the bands),
        k_hat, anew (sampled without it).
    bands : quantiles of the mean curve and of a new test by series, level and path; kPa and mm.
    checks : p values by name: whether levels and slopes are uniform, and whether their means by plate or
        stress are zero.
    """

    table: pd.DataFrame
    bands: pd.DataFrame
    checks: Mapping[str, float]

    @property
    def alarm(self) -> bool:
        """True where one of the checks says that the readings do not look like those of the model."""
        p_values = [p for p in self.checks.values() if np.isfinite(p)]
        return bool(p_values) and min(p_values) * len(p_values) < ALARM

    def record(self) -> dict[str, Any]:
        """Content for ``run.json``."""
        return {"soil_tests": {"checks": dict(self.checks), "alarm": self.alarm}}


def new_tests(posterior: Posterior, draws: FloatArray, seed: SeedSequence) -> NewTests:
    """Predict every test from all other readings; ``draws`` (n, d) of the posterior are nearly independent."""
    tables, bands, checks = list[pd.DataFrame](), list[pd.DataFrame](), dict[str, float]()
    for number, experiment in enumerate(posterior.experiments):
        leaving, banding = seed.spawn(2)
        own = pd.DataFrame(_left_out(posterior, number, draws, leaving), columns=list(NEW_TESTS))
        beginning = f"{experiment.test.name}: " if len(posterior.experiments) > 1 else ""
        checks |= {f"{beginning}{name}": p for name, p in _checks(own, experiment.readings).items()}
        tables.append(own)
        bands.append(_bands(experiment, spaced(draws, BAND_DRAWS), np.random.default_rng(banding)))
    return NewTests(pd.concat(tables, ignore_index=True), pd.concat(bands, ignore_index=True), checks)


def _left_out(posterior: Posterior, place: int, draws: FloatArray, seed: SeedSequence) -> Iterator[dict[str, Any]]:
    """Rows of the tests of one series."""
    experiment = posterior.experiments[place]
    draws, readings, of = spaced(draws, LEAVING_DRAWS), experiment.readings, LEVELS[experiment.readings.kind]
    densities, several = experiment.log_likelihoods(draws), len(readings.tests) > 1
    for number, (name, stream) in enumerate(zip(readings.tests, seed.spawn(len(readings.tests)), strict=True)):
        weights, k_hat = pareto_smoothed(-densities[:, number])
        anew = several and not k_hat <= pareto_limit(len(draws))
        x, others = draws, np.arange(len(readings.tests)) != number
        if anew:
            kept = (each.only(others) if i == place else each for i, each in enumerate(posterior.experiments))
            size = None if posterior.driven else OF_SOIL_TESTS
            samples = sample(replace(posterior, experiments=tuple(kept)), ANEW, stream, adaptation=size)
            x = spaced(samples.chains.reshape(-1, samples.chains.shape[-1]), DRAWS)
            weights = np.full(len(x), -np.log(len(x)))
        level = {"level": readings.levels[number] / of.scale, "unit": of.unit}
        row = _predicted(experiment, number, x, weights)
        yield {"series": experiment.test.name, "test": name, **level, **row, "k_hat": k_hat, "anew": anew}


def _bands(experiment: Experiment, x: FloatArray, rng: Generator) -> pd.DataFrame:
    readings, tables = experiment.readings, []
    scores = ndtri((np.arange(20) + rng.random()) / 20)  # a mixture of normal laws, by fixed scores in every draw
    for level in np.unique(readings.level):
        path = readings.path[readings.level == level]
        grid, spread = np.geomspace(path.min(), path.max(), GRID), experiment.spread(x)
        curve = readings.model.log_stress(experiment.soil(x), spread.true_path(grid), np.full(GRID, level))
        new = (curve[:, None] + marginal_sd(grid, spread)[:, None] * scores[:, None]).reshape(-1, GRID)
        columns = {
            "series": experiment.test.name,
            "level": level / LEVELS[readings.kind].scale,
            "path [mm]": 1e3 * grid,
        }
        for name, values in (("curve", curve), ("test", new)):
            ends = np.exp(np.quantile(values, QUANTILES, axis=0)) / 1e3
            columns |= {f"{name}_q{100 * q:02.0f}": row for q, row in zip(QUANTILES, ends, strict=True)}
        tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)


def _predicted(experiment: Experiment, number: int, x: FloatArray, log_weights: FloatArray) -> dict[str, float]:
    """One test beside its prediction, from draws (n, d) with log weights (n,) that sum to one."""
    readings = experiment.readings
    chosen = readings.test == number
    alone = experiment.only(np.arange(len(readings.tests)) == number)
    with np.errstate(all="ignore"):  # without this plate its modulus may be negative: no density, no weight
        densities = alone.log_likelihoods(x)[:, 0]
    possible = np.isfinite(densities)
    elpd = weighted_log_mean(log_weights[possible], densities[possible])[0]
    rng = np.random.default_rng(number)
    shares = np.exp(log_weights) * possible
    picked = rng.choice(len(x), size=DRAWS, p=shares / shares.sum())
    soil, path = experiment.soil(x[picked]), readings.path[chosen]
    spread = experiment.spread(x[picked])
    mean = readings.model.log_stress(soil, spread.true_path(path), readings.level[chosen])
    residual = np.log(readings.stress[chosen]) - mean
    law = covariance(path, spread)
    inside = ndtr(residual / marginal_sd(path, spread)).mean(axis=0)
    covered = {f"covered_{100 * band:.0f}": float((np.abs(inside - 0.5) <= band / 2).mean()) for band in BANDS}
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


def _checks(table: pd.DataFrame, readings: Readings) -> dict[str, float]:
    p_values, levels = dict[str, float](), readings.levels
    for name in ("level", "slope"):
        values = table[f"{name}_pit"].to_numpy()
        finite = np.isfinite(values)
        if finite.sum() < 4:
            continue
        p_values[f"{name}s of tests uniform"] = float(kstest(values[finite], "uniform").pvalue)
        groups = np.unique(levels[finite])
        if 1 < len(groups) < finite.sum():
            scores = ndtri(np.clip(values, 1e-9, 1 - 1e-9))
            by_group = [scores[finite & (levels == group)] for group in groups]
            total = sum(len(part) * part.mean() ** 2 for part in by_group)
            p_values[f"{name}s alike under every {'plate' if readings.kind == 'plate' else 'stress'}"] = float(
                chi2.sf(total, len(groups))
            )
    return p_values


def verdict_on_tests(table: pd.DataFrame, record: Mapping[str, Any] | None, failed: str) -> Verdict:
    """Verdict on new tests: predicted as well as the intervals say, or not; ``failed`` says why there are none."""
    if record is None:
        return unknown_verdict("Soil tests", failed)
    inside, checks = int(table["level_pit"].between(0.05, 0.95).sum()), record["checks"]
    text = f"Soil tests predicted from all other readings: the level of {inside} of {len(table)} lies in its 90 %."
    figures, thresholds = {name: p for name, p in checks.items() if p is not None}, {"bad": ALARM / max(len(checks), 1)}
    if not checks:
        return Verdict("Soil tests", "too few to tell", "note", text)
    worst = min(figures, key=figures.__getitem__, default="")
    if record["alarm"]:
        said = f"soil tests are not as the others predict them ({worst}: p {probability(figures[worst])})"
        return Verdict(
            "Soil tests", "not as predicted", "bad", f"{text} Against the model: {worst}.", said, figures, thresholds
        )
    return Verdict("Soil tests", "as predicted", "good", text, "", figures, thresholds)
