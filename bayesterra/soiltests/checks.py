"""Checks of a soil test: usual least-squares practice beside it, and every test predicted from the others.

``regression``: plates as by Bekker, a straight line through log p against log z for each radius, the mean
of their exponents, and k_c, k_φ from a line through the moduli against 1/b; shear as by Janosi and
Hanamoto, τ_max and K of each curve, then Mohr–Coulomb's line through τ_max and the mean K. ``nonlinear``:
one fit to all readings; plates with Wong's (1980) weights, which make residuals of the log count like those
of the pressure.

The readings of a test are predicted from the posterior of all other tests, by importance weights of the draws
(Vehtari et al. 2017), or by sampling anew where the weights cannot be relied on. What is judged is what a
person would ask of a new test: its level (the mean of its log residuals), and its slope (the difference of
the means of its further and its nearer half), each one number per test, and what shares of its readings the
bands hold.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import SeedSequence
from scipy.optimize import least_squares
from scipy.special import ndtr, ndtri
from scipy.stats import chi2, kstest

from bayesterra.arrays import FloatArray
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.sampling.sampler import Target, sample
from bayesterra.soiltests.posterior import TestPosterior, coordinates, covariance, marginal_sd
from bayesterra.soiltests.schema import COLUMNS, KINDS, LEVELS, QUANTITIES
from bayesterra.soiltests.study import Readings
from bayesterra.stats.mixture import pareto_limit, pareto_smoothed, weighted_log_mean
from bayesterra.study.schema import SamplingOptions

METHODS = {"regression": "lines through each plate or curve", "nonlinear": "one fit to all readings"}


@dataclass(frozen=True)
class Fitted:
    """Least-squares estimates by method; what the tests cannot separate is missing, and ``notes`` say why."""

    values: Mapping[str, Mapping[str, float]]
    notes: tuple[str, ...]


def fit(readings: Readings) -> Fitted:
    """Estimate the soil parameters by both methods."""
    return _plate(readings) if readings.kind == "plate" else _shear(readings)


def _plate(readings: Readings) -> Fitted:
    z, p, b = np.log(readings.path), np.log(readings.stress), readings.level
    radii = np.unique(b)
    lines = [np.polyfit(z[b == radius], p[b == radius], 1) if _line(z[b == radius]) else None for radius in radii]
    slopes = [line[0] for line in lines if line is not None]
    if not slopes:
        return Fitted({}, ("least squares need two readings of a plate at least",))
    n = float(np.mean(slopes))
    moduli = np.array([np.exp(np.mean(p[b == radius] - n * z[b == radius])) for radius in radii])
    if len(radii) == 1:
        note = (
            f"plates of one radius: k_c and k_φ cannot be separated, k_c/b + k_φ ="
            f" {moduli[0] / QUANTITIES['kphi'].scale:.4g} kPa/m^n at b = {1e3 * radii[0]:g} mm"
        )
        direct = _weighted(z, p, b, np.array([0.0, moduli[0], n]))[2]
        return Fitted({"regression": {"n": n}, "nonlinear": {"n": direct}}, (note,))
    kc, kphi = np.polyfit(1.0 / radii, moduli, 1)
    start = np.array([kc, kphi, n])
    fits = (start, _weighted(z, p, b, start))
    named = (dict(zip(KINDS["plate"], map(float, values), strict=True)) for values in fits)
    return Fitted(dict(zip(METHODS, named, strict=True)), ())


def _line(z: FloatArray) -> bool:
    return z.size > 1 and float(np.ptp(z)) > 0


def _weighted(z: FloatArray, p: FloatArray, b: FloatArray, start: FloatArray) -> FloatArray:
    """k_c, k_φ and n with residuals p (log p − log model)."""
    ends = 1.0 / np.array([b.min(), b.max()])
    weight, middle = np.exp(p - p.max()), float(z.mean())
    span = max(float(ends[0] - ends[1]), 1e-300)
    share = (ends[0] - 1.0 / b) / span if ends[0] > ends[1] else np.zeros(len(b))

    def modulus(u: FloatArray) -> FloatArray:
        first, last = np.exp(u[0]), np.exp(u[1])
        return np.asarray((1.0 - share) * first + share * last)

    def residual(u: FloatArray) -> FloatArray:
        return np.asarray(weight * (p - np.log(modulus(u)) - u[2] * (z - middle)))

    begin = np.log(np.maximum(start[0] * ends + start[1], 1e-3 * np.exp(p.min()))) + start[2] * middle
    optimum = least_squares(residual, [*begin, start[2]], x_scale="jac").x
    first, last = np.exp(optimum[:2] - optimum[2] * middle)
    kc = (first - last) / span if ends[0] > ends[1] else 0.0
    return np.array([kc, last - kc * ends[1] if ends[0] > ends[1] else first, optimum[2]])


def _shear(readings: Readings) -> Fitted:
    curves = []
    for number in range(len(readings.tests)):
        chosen = readings.test == number
        if chosen.sum() > 1:
            curves.append((readings.levels[number], *_curve(readings.path[chosen], readings.stress[chosen])))
    if not curves:
        return Fitted({}, ("least squares need two readings of a curve at least",))
    stress, strength, K = np.array(curves).T
    middle = float(K.mean())
    if len(np.unique(stress)) == 1:
        unit = COLUMNS["shear_stress"]
        note = (
            f"one normal stress: c and φ cannot be separated, c + σ tan φ ="
            f" {strength.mean() / unit.scale:.4g} kPa at σ = {stress[0] / unit.scale:g} kPa"
        )
        direct = _curve(readings.path, readings.stress)[1]
        return Fitted({"regression": {"K": middle}, "nonlinear": {"K": direct}}, (note,))
    slope, c = np.polyfit(stress, strength, 1)
    start = {"c": float(c), "phi": float(np.arctan(slope)), "K": middle}
    return Fitted({"regression": start, "nonlinear": _all_curves(readings, start)}, ())


def _curve(j: FloatArray, tau: FloatArray) -> tuple[float, float]:
    """τ_max and K of one curve."""
    top = float(tau.max())

    def residual(u: FloatArray) -> FloatArray:
        return np.asarray(np.exp(u[0]) * -np.expm1(-j / np.exp(u[1])) - tau / top)

    optimum = least_squares(residual, [0.0, np.log(np.median(j) / 3)]).x
    return top * float(np.exp(optimum[0])), float(np.exp(optimum[1]))


def _all_curves(readings: Readings, start: Mapping[str, float]) -> dict[str, float]:
    top = float(readings.stress.max())

    def residual(u: FloatArray) -> FloatArray:
        strength = u[0] * top + readings.level * np.tan(u[1])
        return np.asarray((strength * -np.expm1(-readings.path / np.exp(u[2])) - readings.stress) / top)

    begin = [max(start["c"], 1.0) / top, float(np.clip(start["phi"], 0.01, 1.4)), np.log(start["K"])]
    optimum = least_squares(residual, begin, bounds=([0.0, 0.0, -np.inf], [np.inf, 1.5, np.inf])).x
    return {"c": float(optimum[0] * top), "phi": float(optimum[1]), "K": float(np.exp(optimum[2]))}


PLAN = AdaptationOptions(particles=512, components=8, refinements=(4, 8), more=(), shores=12)
"""Posteriors of soil tests are simple in their coordinates: a smaller adaptation than that of wheels is
enough."""
DRAWS = 500
ANEW = SamplingOptions(target_ess=500, walkers=32)
BANDS = (0.5, 0.9)

LEFT_OUT_COLUMNS = ("test", "level", "readings", "elpd", "level_pit", "slope_pit",
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
        """True where one of the checks says that the readings do not look like those of the model."""
        p_values = [p for p in self.checks.values() if np.isfinite(p)]
        return bool(p_values) and min(p_values) * len(p_values) < ALARM


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
    return pd.DataFrame(rows, columns=list(LEFT_OUT_COLUMNS)).rename(columns={"level": LEVELS[kind].name})


def _anew(posterior: TestPosterior, number: int, stream: SeedSequence) -> FloatArray:
    """Draws (n, d) of the posterior of all other tests."""
    others = np.arange(len(posterior.readings.tests)) != number
    reduced = TestPosterior(posterior.prior, posterior.readings.only(others))
    samples = sample(Target(reduced, coordinates(reduced)), ANEW, stream, adaptation=PLAN)
    flat = samples.chains.reshape(-1, samples.chains.shape[-1])
    return flat[:: max(1, len(flat) // DRAWS)]


def _predicted(posterior: TestPosterior, number: int, x: FloatArray, log_weights: FloatArray) -> dict[str, float]:
    """One test beside its prediction, from draws (n, d) with log weights (n,) that sum to one."""
    readings = posterior.readings
    chosen = readings.test == number
    alone = TestPosterior(posterior.prior, readings.only(np.arange(len(readings.tests)) == number))
    with np.errstate(all="ignore"):  # without this plate its modulus may be negative: no density, no weight
        densities = alone.log_likelihoods(x)[:, 0]
    possible = np.isfinite(densities)
    elpd = weighted_log_mean(log_weights[possible], densities[possible])[0]
    rng = np.random.default_rng(number)
    shares = np.exp(log_weights) * possible
    picked = rng.choice(len(x), size=DRAWS, p=shares / shares.sum())
    soil, path = posterior.soil(x[picked]), readings.path[chosen]
    spread = posterior.spread(x[picked])
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


def _checks(table: pd.DataFrame, levels: FloatArray) -> dict[str, float]:
    p_values: dict[str, float] = {}
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
            p_values[f"{name}s alike under every {'plate' if 'plate_radius' in table else 'stress'}"] = float(
                chi2.sf(total, len(groups))
            )
    return p_values
