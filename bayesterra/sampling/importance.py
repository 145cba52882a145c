"""Importance sampling around a posterior: proposals fitted to its draws, weights, resampling."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from scipy.special import logsumexp

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.coordinates import Coordinates, coordinates
from bayesterra.posteriors import Posterior, draw_cut_prior
from bayesterra.sampling.adaptation import AdaptationOptions, Densities, adapt, refine
from bayesterra.sampling.mixture import ProposalLaw, RandomSource, StudentMixture, fit_mixture
from bayesterra.sampling.unbending import fit_proposal

COMPONENTS = 12
FITTED = 4096
"""Draws, at most, that a proposal is fitted to."""
REFINEMENT = AdaptationOptions(particles=1024, components=COMPONENTS, refinements=(4, 4), more=())


@dataclass(frozen=True)
class Proposed:
    """Parameter sets inside the range of the prior, drawn from a proposal.

    Attributes
    ----------
    u : sampling coordinates (n, d).
    x : the same in physical units (n, d), SI and radians.
    log_base : log prior over proposal (n,); with a log likelihood added, log importance weights.
    drawn : number of sets drawn, those outside the prior's range included.
    """

    u: FloatArray
    x: FloatArray
    log_base: FloatArray
    drawn: int

    def take(self, chosen: IntArray) -> Proposed:
        """Those of the sets, also repeatedly."""
        return Proposed(self.u[chosen], self.x[chosen], self.log_base[chosen], self.drawn)


@dataclass(frozen=True)
class Surroundings:
    """A posterior, its sampling coordinates, and draws of it in these (n, d)."""

    posterior: Posterior
    coordinates: Coordinates
    u: FloatArray

    @classmethod
    def of(cls, posterior: Posterior, draws: FloatArray) -> Surroundings:
        """Around posterior draws (n, d), of which ``FITTED`` at most are used."""
        chosen = coordinates(posterior)
        return cls(posterior, chosen, chosen.from_physical(draws[:: max(1, -(-len(draws) // FITTED))]))

    def mixture(self, rng: Generator, widening: float = 1.0) -> StudentMixture:
        """A law fitted to the draws, every component stretched by ``widening``."""
        fitted = around(self.u, rng)
        return replace(fitted, factors=widening * fitted.factors)

    def shifted(self, centre: FloatArray) -> StudentMixture:
        """A law as wide as the draws around another centre (d,)."""
        covariance = np.atleast_2d(np.cov(self.u.T))
        steadied = covariance + 1e-9 * np.diag(np.diagonal(covariance))
        factor: FloatArray = np.asarray(np.linalg.cholesky(steadied), dtype=np.float64)
        return StudentMixture(np.ones(1), centre[None], factor[None], 4.0)

    def afresh(self, densities: Densities, rng: Generator) -> ProposalLaw:
        """A proposal for another target over the same parameters, found all the way from the prior."""
        plan = AdaptationOptions()
        start = self.coordinates.from_physical(draw_cut_prior(self.posterior, plan.particles, rng).x)
        return adapt(densities, start, plan, rng).proposal

    def propose(self, mixture: ProposalLaw, n: int, rng: Generator) -> Proposed:
        """Draw ``n`` sets from a proposal and keep those inside the prior's range."""
        u = mixture.sample(n, rng)
        x, log_jacobian = self.coordinates.to_physical(u)
        log_prior = self.posterior.log_prior(x)
        inside = np.flatnonzero(np.isfinite(log_prior) & np.isfinite(log_jacobian))
        base = log_prior[inside] + log_jacobian[inside] - mixture.log_density(u[inside])
        return Proposed(u[inside], x[inside], base, n)


def around(u: FloatArray, rng: Generator) -> StudentMixture:
    """A law fitted to points (n, d)."""
    return fit_mixture(u, np.ones(len(u)), COMPONENTS, rng)


def refined(start: FloatArray, densities: Densities, rng: Generator) -> ProposalLaw:
    """A proposal for the target of ``densities`` that starts from points (n, d) near it."""
    widths, plan = start.std(axis=0), REFINEMENT
    first = fit_proposal(start, np.ones(len(start)), widths, plan.components, plan.defence, rng)
    return refine(first, start, widths, densities, plan, rng).proposal


@dataclass(frozen=True)
class Pair:
    """Two proposals in equal shares: where the one is thin, the other may not be."""

    first: ProposalLaw
    second: ProposalLaw

    def sample(self, n: int, random: RandomSource) -> FloatArray:
        """Draw n points (n, d)."""
        return np.concatenate([self.first.sample(n // 2, random), self.second.sample(n - n // 2, random)])

    def log_density(self, u: FloatArray) -> FloatArray:
        """Log density (n,) at points (n, d)."""
        return np.asarray(np.logaddexp(self.first.log_density(u), self.second.log_density(u)) - np.log(2.0))


def normalised(log_weights: FloatArray) -> FloatArray:
    """Weights (n,) that sum to one."""
    return np.asarray(np.exp(log_weights - logsumexp(log_weights)))


def effective_draws(weights: FloatArray) -> float:
    """Effective number of draws of weights (n,) that sum to one (Kong 1992)."""
    return float(1.0 / (weights**2).sum())


def systematic(weights: FloatArray, n: int, rng: Generator) -> IntArray:
    """Indices (n,) drawn in proportion to weights (k,) by systematic resampling."""
    steps = np.cumsum(weights) / weights.sum()
    return np.minimum(np.searchsorted(steps, (np.arange(n) + rng.random()) / n), len(weights) - 1)
