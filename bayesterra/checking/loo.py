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
from scipy.special import ndtr
from threadpoolctl import threadpool_limits

from bayesterra.arrays import FloatArray, spaced
from bayesterra.likelihood.posterior import Posterior
from bayesterra.sampling.importance import Pair, PosteriorProposal, refined
from bayesterra.stats.mixture import ProposalLaw
from bayesterra.stats.weights import log_mean, pareto_limit, pareto_smoothed, systematic, weighted_log_mean

FEW_ROWS = 20
"""Below this number of rows each is left out by a sampling of its own."""
DRAWS = 4000
START_DRAWS = 1024
PIT_DRAWS = 1000
FINAL_DRAWS = (8192, 32768)
"""Weighted draws of a refit, and of a second attempt."""
CLOSE = 0.05
"""Monte Carlo error of a row's elpd, below which a refit is done."""
INDISTINCT = 4.0
"""Difference in elpd below which models are not told apart (Sivula et al. 2020)."""

Pits = dict[str, tuple[float, ...]]


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
    x = spaced(draws, DRAWS)
    near, density = PosteriorProposal.of(posterior, x), posterior.log_rows(x)[1]
    own, *streams = seed.spawn(1 + density.shape[1])
    whole = near.mixture(default_rng(own))
    cases = [_Case(near, whole, x, density, i) for i in range(density.shape[1])]
    limit = pareto_limit(len(x)) if len(cases) >= few_rows else -np.inf
    with threadpool_limits(limits=1), ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        results = list(pool.map(lambda case, stream: case.result(limit, stream), cases, streams))
    rows = posterior.likelihood.observations.rows
    return CrossValidation(
        tuple(case.left_out(row, result) for row, case, result in zip(rows, cases, results, strict=True)),
        tuple(log_mean(density, axis=0).tolist()),
        _pits(posterior, cases, results) if len(cases) >= few_rows else {},
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
        finite = np.isfinite(log_weights)
        return cls(x[finite], *pareto_smoothed(log_weights[finite]), log_row[finite])

    def estimate(self) -> tuple[float, float]:
        """Elpd of the row and its Monte Carlo error."""
        return weighted_log_mean(self.log_weights, self.log_row)

    @property
    def reliable(self) -> bool:
        return self.estimate()[1] < CLOSE and self.k < pareto_limit(len(self.x))


@dataclass(frozen=True)
class _Case:
    """One row to leave out.

    Attributes
    ----------
    near, whole : the full posterior, and a proposal fitted to its draws.
    x : these draws (n, d).
    density : log density of every row there, given all other rows (n, m).
    index : the row.
    """

    near: PosteriorProposal
    whole: ProposalLaw
    x: FloatArray
    density: FloatArray
    index: int

    @cached_property
    def weighted(self) -> _Weighted:
        """The full posterior's draws, weighted."""
        row = self.density[:, self.index]
        return _Weighted.of(self.x, -row, row)

    def left_out(self, row: int, result: _Weighted) -> LeftOut:
        """The entry of a row whose :meth:`result` is known."""
        elpd, error = result.estimate()
        return LeftOut(row, elpd, error, self.weighted.k, result is not self.weighted)

    def result(self, limit: float, seed: SeedSequence) -> _Weighted:
        """The posterior without the row; sampled afresh where k̂ is above the limit."""
        if self.weighted.k <= limit:
            return self.weighted
        rng = default_rng(seed)
        weights = np.exp(self.weighted.log_weights)
        start = self.near.u[systematic(weights, START_DRAWS, rng)]
        without = refined(start, self._densities, rng)
        for n in FINAL_DRAWS:
            refitted = self._drawn(without, n, rng)
            if refitted.reliable:
                return refitted
        # without this row the posterior is quite another one
        return self._drawn(self.near.from_prior(self._densities, rng), FINAL_DRAWS[-1], rng)

    def _terms(self, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Parameters, log prior with Jacobian, log density of the row and the others, −inf where any is."""
        x, log_jacobian = self.near.coordinates.to_physical(u)
        prior = self.near.posterior.log_prior(x)
        supported = (prior > -np.inf) & np.isfinite(log_jacobian)  # coordinates of 1e5 have no digits left
        prior = np.where(supported, prior + np.where(supported, log_jacobian, 0.0), -np.inf)
        row, others = np.full(len(u), -np.inf), np.full(len(u), -np.inf)
        inside = np.flatnonzero(supported)
        total, rows = self.near.posterior.log_rows(x[inside])
        answered = np.isfinite(rows).all(axis=1)
        inside, total, rows = inside[answered], total[answered], rows[answered]
        row[inside], others[inside] = rows[:, self.index], total - rows[:, self.index]
        return x, np.where(np.isfinite(row), prior, -np.inf), row, others

    def _densities(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log prior and log likelihood of all other rows."""
        _, prior, _, others = self._terms(u)
        return prior, others

    def _drawn(self, without: ProposalLaw, n: int, rng: Generator) -> _Weighted:
        """Weighted draws of a proposal without the row and of one with it, where its density is high."""
        proposal = Pair(without, self.whole)
        u = proposal.sample(n, rng)
        x, prior, row, others = self._terms(u)
        log_weights = np.where(np.isfinite(prior), prior + others, -np.inf) - proposal.log_density(u)
        return _Weighted.of(x, log_weights, row)


def _pits(posterior: Posterior, cases: Sequence[_Case], results: Sequence[_Weighted]) -> Pits:
    """Probability below each reading, per channel; empty where the load is latent."""
    likelihood = posterior.likelihood
    if likelihood.forward.drive.latent_load:
        return {}
    full = posterior.scores(cases[0].x)
    table = np.empty((len(cases), len(likelihood.channels)))
    for i, (case, result) in enumerate(zip(cases, results, strict=True)):
        if result is case.weighted:
            table[i] = np.exp(result.log_weights) @ ndtr(full[:, i])
        else:
            chosen = systematic(np.exp(result.log_weights), PIT_DRAWS, default_rng(0))
            table[i] = ndtr(posterior.scores(result.x[chosen])[:, i]).mean(axis=0)
    return {name: tuple(table[:, c].tolist()) for c, name in enumerate(likelihood.channels)}


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
        """True where it is at least ``INDISTINCT`` and at least two standard errors."""
        return bool(abs(self.elpd) >= INDISTINCT and abs(self.elpd) >= 2 * self.se)


def difference(first: CrossValidation, second: CrossValidation) -> Difference:
    """Compare two models by the rows that both leave out.

    Raises
    ------
    ValueError : they were fitted to different rows.
    """
    rows = [[left_out.row for left_out in model.rows] for model in (first, second)]
    if rows[0] != rows[1]:
        raise ValueError(f"models are compared on the same rows only (got rows {rows[0]} and {rows[1]})")
    by_row = first.by_row - second.by_row
    return Difference(float(by_row.sum()), _spread_error(by_row))
