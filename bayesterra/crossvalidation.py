"""Leave-one-out cross-validation by row: how well a row is predicted by the others.

A row stands for all its readings. Its readings are left out, its slip and load stay known, and so does the
support of the prior. Importance weights from the full posterior do where their Pareto k̂ says that they may;
elsewhere, and always with few rows, the posterior without the row is sampled afresh.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng
from scipy.special import logsumexp, ndtr
from scipy.stats import binom
from threadpoolctl import threadpool_limits

from bayesterra.arrays import FloatArray
from bayesterra.diagnostics import pareto_limit, pareto_smoothed
from bayesterra.likelihood import Likelihood
from bayesterra.posteriors import Posterior, draw_cut_prior
from bayesterra.sampling.adaptation import AdaptationOptions, adapt, refine
from bayesterra.sampling.importance import Surroundings, around, systematic
from bayesterra.sampling.mixture import StudentMixture

FEW_ROWS = 20
"""Below this number of rows each is left out by a sampling of its own."""
DRAWS = 4000
REFIT = AdaptationOptions(particles=1024, components=12, refinements=(4, 4))
FINAL_DRAWS = (8192, 32768)
"""Weighted draws of a refit, and of a second attempt."""
CLOSE = 0.05
"""Monte Carlo error of a row's elpd, below which a refit is done."""
INDISTINCT = 4.0
"""Difference in elpd below which models are not told apart (Sivula et al. 2020)."""


@dataclass(frozen=True)
class LeftOut:
    """One row left out.

    Attributes
    ----------
    row : its number in the table of measurements.
    elpd : log density of its readings, predicted by all others.
    error : Monte Carlo standard error of that.
    k : Pareto k̂ of the weights that lead there from the full posterior.
    refitted : whether the posterior without the row was sampled afresh.
    """

    row: int
    elpd: float
    error: float
    k: float
    refitted: bool


@dataclass(frozen=True)
class CrossValidation:
    """All rows left out, one at a time.

    Attributes
    ----------
    rows : one entry per row in the fit.
    full : log density of every row's readings under the posterior of all rows (m,).
    pit : per channel, probability of a reading below the measured one, predicted by the other rows, (m,) with
        NaN where nothing was measured; empty with fewer than ``FEW_ROWS`` rows and with latent loads.
    """

    rows: tuple[LeftOut, ...]
    full: tuple[float, ...]
    pit: Mapping[str, tuple[float, ...]]

    @property
    def by_row(self) -> FloatArray:
        """Elpd of every row (m,)."""
        return np.array([row.elpd for row in self.rows])

    @property
    def elpd(self) -> float:
        """Sum over rows: expected log predictive density of a new table at these slips and loads."""
        return float(self.by_row.sum())

    @property
    def se(self) -> float:
        """Standard error of :attr:`elpd` from the spread between rows."""
        return _spread_error(self.by_row)

    @property
    def effective_parameters(self) -> float:
        """By how much the full posterior predicts its own readings better (p_loo)."""
        return float(np.sum(self.full) - self.elpd)

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> CrossValidation:
        """Read back what ``dataclasses.asdict`` wrote into a record."""
        rows = tuple(LeftOut(**{**row, "k": _number(row["k"])}) for row in record["rows"])
        pit = {name: tuple(map(_number, values)) for name, values in record["pit"].items()}
        return cls(rows, tuple(record["full"]), pit)


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)


def _spread_error(values: FloatArray) -> float:
    return float(np.sqrt(len(values)) * values.std(ddof=1)) if len(values) > 1 else float("nan")


def leave_one_out(
    posterior: Posterior, draws: FloatArray, seed: SeedSequence, few_rows: int = FEW_ROWS
) -> CrossValidation:
    """Leave every row out once.

    Parameters
    ----------
    posterior : of all rows.
    draws : near-independent draws of it (n, d).
    seed : root of the random streams of the refits.
    few_rows : below this number of rows all are refitted, and no ``pit`` is computed.
    """
    x = draws[:: max(1, -(-len(draws) // DRAWS))]
    near, density = Surroundings.of(posterior, x), posterior.log_terms(x).sum(axis=2)
    cases = [_Case(near, x, density, i) for i in range(density.shape[1])]
    limit = pareto_limit(len(x)) if len(cases) >= few_rows else -np.inf
    with threadpool_limits(limits=1), ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        found = list(pool.map(lambda case, stream: case.result(limit, stream), cases, seed.spawn(len(cases))))
    rows = posterior.likelihood.observations.rows
    return CrossValidation(
        tuple(case.left_out(row, one) for row, case, one in zip(rows, cases, found, strict=True)),
        tuple((logsumexp(density, axis=0) - np.log(len(x))).tolist()),
        _pits(posterior, found) if len(cases) >= few_rows else {},
    )


@dataclass(frozen=True)
class _Weighted:
    """Draws of a posterior without one row.

    Attributes
    ----------
    x : parameter sets (n, d).
    log_weights : smoothed, their sum one (n,).
    k : Pareto k̂ of the weights.
    log_row : log density of the row's readings at each (n,).
    """

    x: FloatArray
    log_weights: FloatArray
    k: float
    log_row: FloatArray

    @classmethod
    def of(cls, x: FloatArray, log_weights: FloatArray, log_row: FloatArray) -> _Weighted:
        known = np.isfinite(log_weights)
        return cls(x[known], *pareto_smoothed(log_weights[known]), log_row[known])

    def estimate(self) -> tuple[float, float]:
        """Elpd of the row and its Monte Carlo error."""
        elpd = float(logsumexp(self.log_weights + self.log_row))
        excess = np.exp(self.log_weights) * np.expm1(self.log_row - elpd)
        return elpd, float(np.sqrt((excess**2).sum()))

    @property
    def reliable(self) -> bool:
        return self.estimate()[1] < CLOSE and self.k < pareto_limit(len(self.x))


@dataclass(frozen=True)
class _Case:
    """One row to leave out: draws of the full posterior (n, d), log density of every row there (n, m)."""

    near: Surroundings
    x: FloatArray
    density: FloatArray
    index: int

    @cached_property
    def weighted(self) -> _Weighted:
        """The full posterior's draws, weighted."""
        row = self.density[:, self.index]
        return _Weighted.of(self.x, -row, row)

    def left_out(self, row: int, found: _Weighted) -> LeftOut:
        """The entry of a row whose :meth:`result` is known."""
        elpd, error = found.estimate()
        return LeftOut(row, elpd, error, self.weighted.k, found is not self.weighted)

    def result(self, limit: float, seed: SeedSequence) -> _Weighted:
        """The posterior without the row; sampled afresh where k̂ is above the limit."""
        if self.weighted.k <= limit:
            return self.weighted
        rng = default_rng(seed)
        weights = np.exp(self.weighted.log_weights)
        start = self.near.u[systematic(weights, REFIT.particles, rng)]
        mixture = refine(around(start, rng), start, self._densities, REFIT, rng)[0]
        for n in FINAL_DRAWS:
            refitted = self._drawn(mixture, n, rng)
            if refitted.reliable:
                return refitted
        return self._drawn(self._from_the_prior(rng), FINAL_DRAWS[-1], rng)

    def _from_the_prior(self, rng: Generator) -> StudentMixture:
        """A proposal found the long way, for rows without which the posterior is quite another one."""
        posterior, plan = self.near.posterior, AdaptationOptions()
        start = self.near.coordinates.from_physical(draw_cut_prior(posterior, plan.particles, rng).x)
        return adapt(self._densities, start, plan, rng).mixture

    def _terms(self, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Parameters, log prior with Jacobian, and log density of every row (n, m), all −inf where any is."""
        x, log_jacobian = self.near.coordinates.to_physical(u)
        prior = self.near.posterior.log_prior(x) + log_jacobian
        terms = np.full((len(u), self.density.shape[1]), -np.inf)
        inside = np.flatnonzero(np.isfinite(prior))
        terms[inside] = self.near.posterior.log_terms(x[inside]).sum(axis=2)
        answered = np.isfinite(terms).all(axis=1)
        return x, np.where(answered, prior, -np.inf), np.where(answered[:, None], terms, -np.inf)

    def _densities(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log prior and log likelihood of all other rows."""
        _, prior, terms = self._terms(u)
        return prior, np.delete(terms, self.index, axis=1).sum(axis=1)

    def _drawn(self, mixture: StudentMixture, n: int, rng: Generator) -> _Weighted:
        u = mixture.sample(n, rng)
        x, prior, terms = self._terms(u)
        others = np.delete(terms, self.index, axis=1).sum(axis=1)
        log_weights = np.where(np.isfinite(prior), prior + others, -np.inf) - mixture.log_density(u)
        return _Weighted.of(x, log_weights, terms[:, self.index])


def _pits(posterior: Posterior, cases: Sequence[_Weighted]) -> dict[str, tuple[float, ...]]:
    """Probability below each reading, per channel; empty where the load is latent."""
    likelihood = posterior.likelihood
    if likelihood.forward.drive == "both":
        return {}
    table = np.array([_pit(posterior, case, i) for i, case in enumerate(cases)])
    return {name: tuple(table[:, c].tolist()) for c, name in enumerate(likelihood.channels)}


def _pit(posterior: Posterior, case: _Weighted, index: int) -> FloatArray:
    """Probability below each reading of a row, (channels,)."""
    whole, here = posterior.likelihood, np.arange(len(posterior.likelihood.observations)) == index
    row = Likelihood(whole.forward.row(index), whole.observations.take(here), whole.noise)
    predicted = row.predicted(row.forward(posterior.prior.soil_values(case.x)))
    z = ((row.measured - predicted) / row.scales(predicted, posterior.noise_values(case.x)))[:, 0]
    scores = np.column_stack([noise.normal_score(z[:, c]) for c, noise in enumerate(row.noise)])
    return np.asarray(np.exp(case.log_weights) @ ndtr(scores))


def ecdf_band(n: int, probability: float = 0.95, simulations: int = 4000) -> tuple[FloatArray, FloatArray]:
    """Simultaneous band of the empirical distribution of n uniform values (Säilynoja et al. 2022).

    Returns lower and upper ends at 1/n, 2/n, ..., 1, such that the whole curve lies inside with the
    probability given; found by simulation with a fixed stream.
    """
    points = np.arange(1, n + 1) / n
    values = np.sort(default_rng(0).random((simulations, n)), axis=1)
    counts = np.array([np.searchsorted(one, points, side="right") for one in values])
    tails = np.minimum(binom.cdf(counts, n, points), binom.sf(counts - 1, n, points))[:, :-1].min(axis=1)
    level = np.quantile(tails, 1.0 - probability)
    return binom.ppf(level, n, points) / n, binom.isf(level, n, points) / n


def calibrated(pit: Sequence[float]) -> bool:
    """Whether PIT values, NaN left out, keep inside the 95 % band of uniform ones."""
    values = np.sort([p for p in pit if np.isfinite(p)])
    low, high = ecdf_band(len(values))
    share = np.searchsorted(values, np.arange(1, len(values) + 1) / len(values), side="right") / len(values)
    return bool(((share >= low) & (share <= high)).all())


@dataclass(frozen=True)
class Difference:
    """Elpd of one model less that of another, on the same rows.

    Attributes
    ----------
    elpd : the difference; positive where the first predicts better.
    se : its standard error, from the spread of the rows' differences.
    """

    elpd: float
    se: float

    @property
    def distinguishable(self) -> bool:
        """Whether it is at least ``INDISTINCT`` and at least two standard errors."""
        return bool(abs(self.elpd) >= INDISTINCT and abs(self.elpd) >= 2 * self.se)

    @property
    def word(self) -> str:
        """The answer in words."""
        if not self.distinguishable:
            return "not distinguishable"
        return f"the {'first' if self.elpd > 0 else 'second'} predicts better"


def difference(first: CrossValidation, second: CrossValidation) -> Difference:
    """Compare two models by the rows that both leave out.

    Raises
    ------
    ValueError : they were fitted to different rows.
    """
    rows = [[left_out.row for left_out in one.rows] for one in (first, second)]
    if rows[0] != rows[1]:
        raise ValueError(f"models are compared on the same rows only (got rows {rows[0]} and {rows[1]})")
    by_row = first.by_row - second.by_row
    return Difference(float(by_row.sum()), _spread_error(by_row))
