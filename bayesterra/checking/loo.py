"""Cross-validation: how well a row, or a level of rows, is predicted by the others.

A row stands for all its readings. Its readings are left out, its slip and load stay known, and so does the
support of the prior. Importance weights from the full posterior do where their Pareto k̂ says that they may;
elsewhere, and always with few rows, the posterior without the rows is sampled afresh.
"""

from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng
from scipy.special import ndtr
from threadpoolctl import threadpool_limits

from bayesterra.arrays import BoolArray, FloatArray, IntArray, in_parts, spaced
from bayesterra.likelihood.joint import JointPosterior
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import Posterior
from bayesterra.runtime.engines import usable_processors
from bayesterra.sampling.evidence import ENOUGH, Pair, PosteriorProposal, refined
from bayesterra.stats import mixture as mixtures

FEW_ROWS = 20
"""Below this number of rows weights must be as even as a new sampling makes them."""
DRAWS, FEWEST_DRAWS, NUMBERS = 4000, 500, 1e7
"""Draws that are weighed, so many numbers of all readings at most."""
START_DRAWS, START_EFFECTIVE = 1024, 300
"""Draws that a refit starts from, and how many of them differ at least: its weights are flattened to that."""
PIT_DRAWS, ROWS = 1000, 100
"""Draws of a refit that tell a probability below a reading; rows whose mean densities are made at once."""
FINAL_DRAWS = (8192, 8192, 16384, 16384)
"""Weighted draws of a refit, and of further attempts."""
EFFECTIVE = 1000
"""Effective draws below which there is another attempt: the ends of predictive laws scatter with fewer."""
EVEN = 0.5
"""Pareto k̂ of the weights of a level above which, as with fewer effective draws than ``ENOUGH`` or a quarter of those
weighed, it is left out by a sampling of its own: predictive laws are made of these draws, and need more than a mean."""
CLOSE = 0.05
"""Monte Carlo error of a row's elpd, below which a refit is done."""
INDISTINCT = 4.0
"""Difference in elpd below which models are not told apart (Sivula et al. 2020)."""

Pits = dict[str, tuple[float, ...]]


@dataclass(frozen=True)
class LeftOut:
    """One row left out."""

    row: int  # its number in the table of measurements
    elpd: float  # log density of its readings, predicted by all others
    error: float  # Monte Carlo standard error of that
    k: float  # Pareto k̂ of the weights that lead there from the full posterior
    refitted: bool  # whether the posterior without the row was sampled afresh


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
    def from_record(cls, record: Mapping[str, Any]) -> "CrossValidation":
        """Read back what ``dataclasses.asdict`` wrote into a record."""
        rows = tuple(LeftOut(**{**row, "k": _number(row["k"])}) for row in record["rows"])
        pit = {name: tuple(map(_number, values)) for name, values in record["pit"].items()}
        return cls(rows, tuple(record["full"]), pit)


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)


def _spread_error(values: FloatArray) -> float:
    return float(np.sqrt(len(values)) * values.std(ddof=1)) if len(values) > 1 else float("nan")


@dataclass(frozen=True)
class Without:
    """The posterior without some rows."""

    x: FloatArray  # near-independent draws of it (n, d)
    reliable: bool  # False where they come from weights that are too uneven


Level = tuple[int, ...]
"""Places of rows among those in the fit."""


def cross_validate(
    posterior: Posterior,
    draws: FloatArray,
    seed: SeedSequence,
    rests: Mapping[Level, Likelihood],
    few_rows: int = FEW_ROWS,
) -> tuple[CrossValidation, dict[Level, Without]]:
    """Leave every row out once, and levels of rows.

    Parameters
    ----------
    posterior : of all rows.
    draws : near-independent draws of it (n, d).
    seed : root of the random streams of the refits.
    rests : by level, the likelihood of all other rows.
    few_rows : below this number of rows each is refitted whose weights are not ``EVEN`` with ``EFFECTIVE`` draws, and
        no ``pit`` is computed.
    """
    x = spaced(draws, min(DRAWS, max(FEWEST_DRAWS, int(NUMBERS / posterior.likelihood.measured.size))))
    near, log_rows = PosteriorProposal.of(posterior, x), posterior.log_rows(x)
    density, more = log_rows[1], [level for level in rests if len(level) > 1]
    m, few = density.shape[1], posterior.likelihood.rows_apart and posterior.likelihood.forward.nodes is None

    own, *streams = seed.spawn(1 + m + len(more))
    whole = near.mixture(default_rng(own))
    cases = [_Case(near, whole, x, log_rows, (i,), None) for i in range(m)]
    cases += [_Case(near, whole, x, log_rows, level, None if few else rests[level]) for level in more]
    limits, least = np.full(len(cases), EVEN), np.full(len(cases), ENOUGH)
    limits[:m], least[:m] = (mixtures.pareto_limit(len(x)), 0.0) if m >= few_rows else (EVEN, EFFECTIVE)
    results = _results(cases, limits, least, streams)
    rows, found = posterior.likelihood.observations.rows, dict(zip(cases, results, strict=True))
    of_rows = CrossValidation(
        tuple(case.left_out(row, found[case]) for row, case in zip(rows, cases[:m], strict=True)),
        tuple(in_parts(partial(mixtures.log_mean, axis=1), ROWS, density.T).tolist()),
        _pits(posterior, cases[:m], results[:m]) if m >= few_rows else {},
    )
    return of_rows, {case.rows: found[case].drawn() for case in cases if case.rows in rests}


MANY = 12
"""Free parameters above which no proposal without a level can be fitted to draws of those with it."""


def without_levels(
    posterior: JointPosterior, draws: FloatArray, seed: SeedSequence, levels: Collection[Level]
) -> dict[Level, Without]:
    """The posterior without each level of rows; the rows are independent given the parameters.

    Parameters as for :func:`cross_validate`. With more than ``MANY`` parameters weights alone lead there; a posterior
    far from these draws is not looked for.
    """
    x = spaced(draws, DRAWS)
    near, log_rows = PosteriorProposal.of(posterior, x), posterior.log_rows(x)
    own, *streams = seed.spawn(1 + len(levels))
    whole = near.mixture(default_rng(own))
    limit, least = (EVEN, ENOUGH) if x.shape[1] <= MANY else (np.inf, 0.0)
    cases = [_Case(near, whole, x, log_rows, level, None) for level in levels]
    results = _results(cases, np.full(len(cases), limit), np.full(len(cases), least), streams, far=False)
    return dict(zip(levels, (case.drawn() for case in results), strict=True))


@dataclass(frozen=True)
class _Weighted:
    """Draws x (n, d) without some rows: smoothed log weights, their k̂, and the log density of the rows' readings."""

    x: FloatArray
    log_weights: FloatArray
    k: float
    log_row: FloatArray

    @classmethod
    def of(cls, x: FloatArray, log_weights: FloatArray, log_row: FloatArray) -> "_Weighted":
        finite = np.isfinite(log_weights)
        if not finite.all():  # else all cases share x
            x, log_weights, log_row = x[finite], log_weights[finite], log_row[finite]
        return cls(x, *mixtures.pareto_smoothed(log_weights), log_row)

    def estimate(self) -> tuple[float, float]:
        """Elpd of the rows and its Monte Carlo error."""
        return mixtures.weighted_log_mean(self.log_weights, self.log_row)

    def drawn(self) -> Without:
        """As many draws of equal weight as a predictive law needs."""
        chosen = mixtures.systematic(np.exp(self.log_weights), PIT_DRAWS, default_rng(0))
        return Without(self.x[chosen], self.reliable)

    @property
    def effective(self) -> float:
        return mixtures.effective_number(np.exp(self.log_weights))

    @property
    def reliable(self) -> bool:
        told = self.effective >= EFFECTIVE or self.estimate()[1] < CLOSE  # draws may do where an elpd does not
        return told and self.k < mixtures.pareto_limit(len(self.x))


@dataclass(frozen=True, eq=False)
class _Case:
    """Rows to leave out, with draws x (n, d) of the full posterior; ``rest``: likelihood of all others, if need be."""

    near: PosteriorProposal[Any]
    whole: mixtures.ProposalLaw
    x: FloatArray
    log_rows: tuple[FloatArray, FloatArray]
    rows: Level
    rest: Likelihood | None

    @cached_property
    def density(self) -> FloatArray:
        """Log density of the rows at the draws, given all others (n,)."""
        total, rows = self.log_rows
        if self.rest is None:
            return np.asarray(rows[:, self.rows[0]] if len(self.rows) == 1 else rows[:, self.rows].sum(axis=1))
        return total - self._said(self.rest, self.x)

    def _said(self, likelihood: Likelihood, x: FloatArray) -> FloatArray:
        """Log likelihood (n,) of sets (n, d)."""
        posterior = self.near.posterior
        return likelihood.log_likelihood(posterior.prior.soil_values(x), posterior.noise_values(x))

    @cached_property
    def weighted(self) -> _Weighted:
        """The full posterior's draws, weighted."""
        return _Weighted.of(self.x, -self.density, self.density)

    def left_out(self, row: int, result: _Weighted) -> LeftOut:
        """The entry of a row whose :meth:`result` is known."""
        elpd, error = result.estimate()
        return LeftOut(row, elpd, error, self.weighted.k, result is not self.weighted)

    def result(self, limit: float, least: float, seed: SeedSequence, *, far: bool = True) -> _Weighted:
        """The posterior without the rows; sampled afresh where weights do not do, ``far`` from these draws too."""
        if self.weighted.k <= limit and self.weighted.effective >= min(least, len(self.weighted.x) / 4):
            return self.weighted
        rng, refitted, attempts = default_rng(seed), self.weighted, list[_Weighted]()
        for n in FINAL_DRAWS:  # again from where the weights of the last attempt lead
            logs = refitted.log_weights
            power = mixtures.largest_power(logs, 1.0, min(START_EFFECTIVE, 0.5 * len(logs)))
            chosen = mixtures.systematic(mixtures.relative(power * logs), START_DRAWS, rng)
            start = self.near.coordinates.from_physical(refitted.x[chosen])
            attempts.append(refitted := self._drawn(refined(start, self._densities, rng), n, rng))
            best = max(attempts, key=lambda each: (each.reliable, each.effective if each.reliable else -each.k))
            if best.reliable and best.effective >= EFFECTIVE:
                break
        if best.reliable or not far:
            return best
        # without these rows the posterior is quite another one
        return self._drawn(self.near.from_prior(self._densities, rng), FINAL_DRAWS[-1], rng)

    def _before(self, u: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
        """Parameters, log prior with Jacobian, and which of the sets have one."""
        x, log_jacobian = self.near.coordinates.to_physical(u)
        prior = self.near.posterior.log_before(x)
        supported = (prior > -np.inf) & np.isfinite(log_jacobian)  # coordinates of 1e5 have no digits left
        prior = np.where(supported, prior + np.where(supported, log_jacobian, 0.0), -np.inf)
        return x, prior, np.flatnonzero(supported)

    def _densities(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log prior and log likelihood of all other rows, to make proposals with."""
        x, prior, inside = self._before(u)
        others = np.full(len(u), -np.inf)
        if self.rest is not None:
            others[inside] = self._said(self.rest, x[inside])
        else:
            answered, _, rest = self._apart(x[inside])
            others[inside[answered]] = rest
        return np.where(np.isfinite(others), prior, -np.inf), others

    def _apart(self, x: FloatArray) -> tuple[BoolArray, FloatArray, FloatArray]:
        """Which sets (n, d) have a likelihood, and for these its log for the rows and for all others."""
        total, rows = self.near.posterior.log_rows(x)
        answered = np.isfinite(rows).all(axis=1)
        own = rows[answered][:, self.rows].sum(axis=1)
        return answered, own, total[answered] - own

    def _drawn(self, without: mixtures.ProposalLaw, n: int, rng: Generator) -> _Weighted:
        """Weighted draws of a proposal without the rows and of one with them, where its density is high."""
        proposal = Pair(without, self.whole)
        u = proposal.sample(n, rng)
        x, prior, inside = self._before(u)
        if self.rest is None:
            answered, own, others = self._apart(x[inside])
        else:
            total, rest = (self._said(of, x[inside]) for of in (self.near.posterior.likelihood, self.rest))
            answered = np.isfinite(total) & np.isfinite(rest)
            own, others = (total[answered] - rest[answered]), rest[answered]
        inside = inside[answered]
        return _Weighted.of(x[inside], prior[inside] + others - proposal.log_density(u[inside]), own)


def _results(
    cases: Sequence[_Case], limits: FloatArray, least: FloatArray, streams: Sequence[SeedSequence], *, far: bool = True
) -> list[_Weighted]:
    with threadpool_limits(limits=1), ThreadPoolExecutor(usable_processors()) as pool:
        return list(pool.map(partial(_Case.result, far=far), cases, limits, least, streams))


def _pits(posterior: Posterior, cases: Sequence[_Case], results: Sequence[_Weighted]) -> Pits:
    """Probability below each reading, per channel; empty where the load is latent."""
    likelihood = posterior.likelihood
    if likelihood.forward.drive.latent_load:
        return {}
    table, x = np.zeros((len(cases), len(likelihood.channels))), cases[0].x
    weighted = [i for i, (case, result) in enumerate(zip(cases, results, strict=True)) if result is case.weighted]
    for first in range(0, len(x), likelihood.at_once):
        part = slice(first, first + likelihood.at_once)
        below = ndtr(posterior.scores(x[part]))
        for i in weighted:
            table[i] += np.exp(results[i].log_weights[part]) @ below[:, i]
    for i in set(range(len(cases))) - set(weighted):
        chosen = mixtures.systematic(np.exp(results[i].log_weights), PIT_DRAWS, default_rng(0))
        table[i] = ndtr(posterior.scores(results[i].x[chosen])[:, i]).mean(axis=0)
    return {name: tuple(table[:, c].tolist()) for c, name in enumerate(likelihood.channels)}


@dataclass(frozen=True)
class Difference:
    """Elpd of one model less that of another, on the same rows."""

    elpd: float  # the difference; positive where the first predicts better
    se: float  # its standard error, from the spread of the rows' differences

    @property
    def distinguishable(self) -> bool:
        """True where it is at least ``INDISTINCT`` and at least two standard errors."""
        return bool(abs(self.elpd) >= INDISTINCT and abs(self.elpd) >= 2 * self.se)


def difference(first: CrossValidation, second: CrossValidation) -> Difference:
    """Compare two models by the rows that both leave out; ValueError where they were fitted to different rows."""
    rows = [[left_out.row for left_out in model.rows] for model in (first, second)]
    if rows[0] != rows[1]:
        raise ValueError(f"models are compared on the same rows only (got rows {rows[0]} and {rows[1]})")
    by_row = first.by_row - second.by_row
    return Difference(float(by_row.sum()), _spread_error(by_row))
