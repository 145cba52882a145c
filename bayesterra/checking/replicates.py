"""Replicated tables of readings, and the posterior of each by importance weights from one common pool.

The pool is modelled once; a replicate costs arithmetic only. With a latent load (drive ``both``) the outcomes
are taken as linear in the load around the value that explains the row as measured.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng
from threadpoolctl import threadpool_limits

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.likelihood.correlated import DOUBLES, CorrelatedLikelihood
from bayesterra.likelihood.covariance import TableLaw
from bayesterra.likelihood.forward import Outcomes
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import Posterior
from bayesterra.sampling.importance import PosteriorProposal, Proposed
from bayesterra.stats.mixture import ProposalLaw
from bayesterra.stats.weights import effective_number, normalised, systematic

T = TypeVar("T")

LOAD_STEP = -1e-3
"""Relative step of the load for the slopes of outcomes; a lower load is carried wherever a higher one is."""


@dataclass(frozen=True)
class Modelled:
    """Readings that parameter sets predict at every row in the fit.

    Attributes
    ----------
    mean, scale : modelled readings and their noise (n, m, channels).
    slope : growth of ``mean`` with a latent load (n, m, channels), per N; None where the load is known.
    joint : law of the whole table where rows hang together; ``mean`` then holds discrepancy, ripple and
        slip errors as they were drawn.
    """

    mean: FloatArray
    scale: FloatArray
    slope: FloatArray | None
    joint: TableLaw | None = None

    @classmethod
    def of(cls, posterior: Posterior, x: FloatArray, outcomes: Outcomes) -> Modelled:
        """Readings behind ``outcomes`` of parameter sets (n, d)."""
        likelihood = posterior.likelihood
        mean = likelihood.predicted(outcomes)
        scale = likelihood.scales(mean, posterior.noise_values(x))
        return cls(mean, scale, _slope(posterior, x, outcomes), _joint(posterior, x))

    def take(self, chosen: IntArray) -> Modelled:
        """Those of the sets, also repeatedly."""
        slope = None if self.slope is None else self.slope[chosen]
        joint = None if self.joint is None else self.joint.take(chosen)
        return Modelled(self.mean[chosen], self.scale[chosen], slope, joint)

    def log_likelihood(self, likelihood: Likelihood, readings: FloatArray) -> FloatArray:
        """Log likelihood (n,) of readings (m, channels), NaN where there is none, but for a constant."""
        if self.joint is not None:
            return self.joint.log_density(readings)
        z = (readings - self.mean) / self.scale
        present = ~np.isnan(readings)
        total = -np.log(self.scale).sum(axis=(1, 2), where=present)
        for i, noise in enumerate(likelihood.noise):
            total += noise.log_density(z[:, :, i]).sum(axis=1, where=present[:, i])
        if self.slope is not None:
            curvature, pull = self._along(z, present)
            total += (0.5 * pull**2 / curvature - 0.5 * np.log(curvature)).sum(axis=1)
        return np.asarray(total)

    def _along(self, z: FloatArray, present: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Precision of every row's load (n, m) as its readings tell it, and that times the load's shift."""
        b = np.where(present, (self.slope if self.slope is not None else 0.0) / self.scale, 0.0)
        return (b**2).sum(axis=2), (b * np.where(present, z, 0.0)).sum(axis=2)

    def explaining(self, readings: FloatArray, rng: Generator) -> Modelled:
        """The same with every latent quantity drawn as these readings (m, channels) tell it."""
        if self.joint is not None:
            return replace(self, mean=self.joint.mean + self.joint.draw(readings, rng).at_rows)
        if self.slope is None:
            return self
        curvature, pull = self._along((readings - self.mean) / self.scale, ~np.isnan(readings))
        shift = pull / curvature + rng.standard_normal(pull.shape) / np.sqrt(curvature)
        return replace(self, mean=self.mean + self.slope * shift[:, :, None])


def _slope(posterior: Posterior, x: FloatArray, outcomes: Outcomes) -> FloatArray | None:
    forward = posterior.likelihood.forward
    if not forward.drive.latent_load:
        return None
    loads = outcomes["normal_force"]
    moved = replace(forward, given=loads * (1 + LOAD_STEP))(posterior.prior.soil_values(x))
    difference = posterior.likelihood.predicted(moved) - posterior.likelihood.predicted(outcomes)
    return np.asarray(np.nan_to_num(difference) / (LOAD_STEP * loads[:, :, None]))


def _joint(posterior: Posterior, x: FloatArray) -> TableLaw | None:
    likelihood, soil = posterior.likelihood, posterior.prior.soil_values(x)
    if not isinstance(likelihood, CorrelatedLikelihood):
        return None
    return likelihood.law(soil, likelihood.forward(soil), posterior.noise_values(x))


def normal_scores(posterior: Posterior, x: FloatArray) -> FloatArray:
    """Readings (n, m, channels) as normal scores under their law given all other rows, NaN without one."""
    likelihood = posterior.likelihood
    if isinstance(likelihood, CorrelatedLikelihood):
        return likelihood.scores(posterior.prior.soil_values(x), posterior.noise_values(x))
    predicted = likelihood.predicted(posterior.outcomes(x))
    z = (likelihood.measured - predicted) / likelihood.scales(predicted, posterior.noise_values(x))
    return np.stack([noise.normal_score(z[:, :, c]) for c, noise in enumerate(likelihood.noise)], axis=2)


@dataclass(frozen=True)
class ReplicateOptions:
    """Settings by which replicates and their posteriors are made.

    Attributes
    ----------
    number : replicated tables.
    pool : parameter sets that all posteriors are weighed from.
    widening : how much wider than the posterior they are spread.
    draws : draws of each posterior.
    fewest : effective draws below which a posterior is looked for around its own centre.
    local : parameter sets drawn there.
    searches : such searches at most.
    """

    number: int = 200
    pool: int = 8192
    widening: float = 1.5
    draws: int = 200
    fewest: float = 50.0
    local: int = 1024
    searches: int = 2


@dataclass(frozen=True)
class _Pool:
    """Proposed sets with all that they say."""

    sets: Proposed
    modelled: Modelled
    outcomes: Outcomes

    @classmethod
    def of(cls, near: PosteriorProposal, mixture: ProposalLaw, n: int, rng: Generator) -> _Pool:
        if isinstance(near.posterior.likelihood, CorrelatedLikelihood):  # its matrices must find room
            n = min(n, int(DOUBLES / max(1, near.posterior.likelihood.layout.doubles)))
        sets = near.propose(mixture, n, rng)
        outcomes = near.posterior.explained(sets.x, rng)
        kept = np.flatnonzero(outcomes.status == 0)
        sets, outcomes = sets.take(kept), outcomes.take(kept)
        return cls(sets, Modelled.of(near.posterior, sets.x, outcomes), outcomes)

    def weights(self, likelihood: Likelihood, readings: FloatArray) -> FloatArray:
        return normalised(self.sets.log_base + self.modelled.log_likelihood(likelihood, readings))


@dataclass(frozen=True)
class Replicate:
    """A replicated table.

    Attributes
    ----------
    readings : (m, channels), NaN where the measured table has none.
    modelled : draws of its posterior.
    effective : effective number of draws behind them.
    """

    readings: FloatArray
    modelled: Modelled
    effective: float


def replicates(
    posterior: Posterior,
    draws: FloatArray,
    seed: SeedSequence,
    options: ReplicateOptions,
    judge: Callable[[Replicate], T],
) -> list[T]:
    """Draw tables from the posterior predictive law of draws (n, d), and judge each by its own posterior."""
    own, *streams = seed.spawn(1 + options.number)
    rng, near, likelihood = default_rng(own), PosteriorProposal.of(posterior, draws), posterior.likelihood
    pool = _Pool.of(near, near.mixture(rng, options.widening), options.pool, rng)
    chosen = systematic(pool.weights(likelihood, likelihood.measured), options.number, rng)
    tables = likelihood.draw(pool.outcomes.take(chosen), posterior.noise_values(pool.sets.x[chosen]), rng)
    tables[:, np.isnan(likelihood.measured)] = np.nan

    def judged(table: FloatArray, stream: SeedSequence) -> T:
        return judge(_settled(near, pool, table, default_rng(stream), options))

    with threadpool_limits(limits=1), ThreadPoolExecutor(os.cpu_count() or 1) as workers:
        return list(workers.map(judged, tables, streams))


def _settled(
    near: PosteriorProposal, pool: _Pool, readings: FloatArray, rng: Generator, options: ReplicateOptions
) -> Replicate:
    """The posterior of a table, from the pool or, where too few draws fit it, from around its centre."""
    likelihood = near.posterior.likelihood
    weights = pool.weights(likelihood, readings)
    for _ in range(options.searches):
        if effective_number(weights) >= options.fewest:
            break
        local = _Pool.of(near, near.shifted(weights @ pool.sets.u), options.local, rng)
        local_weights = local.weights(likelihood, readings)
        if effective_number(local_weights) > effective_number(weights):
            pool, weights = local, local_weights
    draws = pool.modelled.take(systematic(weights, options.draws, rng)).explaining(readings, rng)
    return Replicate(readings, draws, effective_number(weights))
