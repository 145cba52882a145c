"""Evidence, and what each row or group adds to it, by importance sampling from frozen laws.

Of a joint posterior the outer draws are shared values D; given these every group's locals are integrated out
by a few inner draws from its law, Ẑ_g(D), which is unbiased. Groups being independent given D,

    Z = E[p(D) ∏_g Ẑ_g(D) / q(D)],

and the same draws, with one group or one row left out of the product, give what the others predict for it
(integrated importance sampling: Vehtari et al. 2016, J. Machine Learning Research 17, 103).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.likelihood.joint import JointPosterior
from bayesterra.likelihood.posterior import INSIDE, Posterior
from bayesterra.pooling.inner import FITTED, OuterLaws, outer_laws
from bayesterra.sampling.coordinates import Coordinates
from bayesterra.sampling.family import JointFamily
from bayesterra.sampling.importance import Evidence, summed
from bayesterra.sampling.joint import JointSamples, group_coordinates
from bayesterra.stats.mixture import ProposalLaw
from bayesterra.stats.weights import log_mean, pareto_limit, pareto_smoothed

OUTER, INNER = 4096, 16
"""Draws of shared values, and of every group's locals for each of them."""
PLAIN = 16384
"""Draws of a posterior without groups of its own."""


@dataclass(frozen=True)
class Weighed:
    """Log importance weights in parts; s strata of n draws each.

    Attributes
    ----------
    base : log prior over proposal of what all groups share (s, n).
    groups : log likelihood of every group, its locals integrated out (groups, s, n).
    rows : the same without one of the group's rows, for every group (rows of the group, s, n).
    apart : as ``base``, each stratum over its own proposal, not over that of all; None where not known.
    """

    base: FloatArray
    groups: FloatArray
    rows: tuple[FloatArray, ...]
    apart: FloatArray | None = None

    @property
    def evidence(self) -> Evidence:
        """Log evidence under the stated prior, not renormalised after the physical cut.

        Its error has in it how far the strata lie apart, each weighed against its own proposal.
        """
        likelihood = self.groups.sum(axis=0)
        pooled = summed(self.base + likelihood)
        if self.apart is None:
            return pooled
        own = log_mean(self.apart + likelihood, axis=1)
        return pooled.beside(own.tolist())

    def left_out(self, group: int, row: int | None = None) -> LeftOutShare:
        """Prediction of all else for a group, or for one of its rows."""
        whole = self.base + self.groups.sum(axis=0)
        others = self.base + np.delete(self.groups, group, axis=0).sum(axis=0)
        without = others if row is None else others + self.rows[group][row]
        flat, left = whole.ravel(), np.where(np.isnan(without), -np.inf, without).ravel()
        log_z, log_left = map(log_mean, (flat, left))
        deviation = np.exp(flat - log_z) - np.exp(left - log_left)
        finite = left[np.isfinite(left)]
        return LeftOutShare(
            float(log_z - log_left),
            float(deviation.std() / np.sqrt(flat.size)),
            pareto_smoothed(finite)[1],
            pareto_limit(flat.size),
        )


@dataclass(frozen=True)
class LeftOutShare:
    """Log predictive density of readings left out.

    Attributes
    ----------
    elpd, error : the log density and its Monte Carlo error.
    k, limit : Pareto shape of the weights without these readings; above ``limit`` neither can be relied on.
    """

    elpd: float
    error: float
    k: float
    limit: float

    @property
    def reliable(self) -> bool:
        """True where the error can be relied on."""
        return self.k <= self.limit


def weigh_joint(samples: JointSamples, rng: Generator, *, outer: int = OUTER, inner: int = INNER) -> Weighed:
    """Weigh fresh draws of the laws of all ensembles of a joint posterior."""
    family = JointFamily(samples.joint)
    laws = [_laws(family, samples, e, rng) for e in range(len(samples.laws))]
    each = -(-outer // len(laws))
    D = [law.drivers.sample(each, rng) for law in laws]
    everywhere = np.concatenate(D)
    levels = np.array([law.drivers.log_density(everywhere) for law in laws])
    shape = (len(laws), each)
    prior = family.log_prior(everywhere).reshape(shape)
    base = prior - log_mean(levels, axis=0).reshape(shape)
    apart = prior - np.array([level.reshape(shape)[e] for e, level in enumerate(levels)])
    groups = np.empty((family.groups, *shape))
    rows: list[list[FloatArray]] = [[] for _ in range(family.groups)]
    for e, law in enumerate(laws):
        for g in range(family.groups):
            groups[g, e], without = _integrated(family, law, g, D[e], inner, rng)
            rows[g].append(without)
    return Weighed(base, groups, tuple(np.stack(strata, axis=1) for strata in rows), apart)


def _laws(family: JointFamily, samples: JointSamples, ensemble: int, rng: Generator) -> OuterLaws:
    """Laws to weigh with, from one ensemble's draws of all groups together and of each alone."""
    flat = samples.chains[ensemble].reshape(-1, samples.chains.shape[-1])
    shared, own = family.joint.split(flat[:: max(1, len(flat) // FITTED)])
    L = np.stack([family.group_from_physical(g, x) for g, x in enumerate(own)])
    chains = [lone.chains[ensemble] for lone in samples.lone.values()]
    alone = [group_coordinates(family, g, chain, rng) for g, chain in enumerate(chains)]
    return outer_laws(family, samples.laws[ensemble], alone, family.shared_from_physical(shared), L, rng)


def _integrated(
    family: JointFamily, laws: OuterLaws, group: int, D: FloatArray, inner: int, rng: Generator
) -> tuple[FloatArray, FloatArray]:
    """Log marginal likelihood (n,) of a group given shared values, and that without each row (rows, n)."""
    repeated = np.repeat(D, inner, axis=0)
    L, log_law = laws.locals[group].sample(D, inner, rng)
    shared, _ = family.shared_to_physical(repeated)
    population, own = family._prior(shared, group, L)
    posterior = list(family.joint.groups.values())[group]
    sets = family.joint.of_group(shared, own)
    likelihood, terms = row_terms(posterior, sets, np.isfinite(population))
    weights = np.where(np.isfinite(terms).all(axis=1), population - log_law, -np.inf)
    total = weights + np.where(np.isfinite(weights), likelihood, 0.0)

    def mean(level: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore"):
            return log_mean(level.reshape(len(D), inner), axis=1)

    finite_terms = np.where(np.isfinite(weights)[:, None], terms, 0.0)
    return mean(total), np.array([mean(total - finite_terms[:, i]) for i in range(terms.shape[1])])


def row_terms(posterior: Posterior, x: FloatArray, candidates: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Log likelihood (n,), and log density (n, rows) of every row's readings given all others.

    Both are −inf outside the support and off ``candidates``.
    """
    total = np.full(len(x), -np.inf)
    terms = np.full((len(x), len(posterior.likelihood.observations)), -np.inf)
    inside = np.flatnonzero(candidates)
    inside = inside[np.isfinite(posterior.log_prior(x[inside]))]
    if inside.size:
        total[inside], terms[inside] = posterior.log_rows(x[inside])
    return total, terms


def weigh_plain(
    joint: JointPosterior,
    groups: Sequence[str],
    coordinates: Coordinates,
    proposals: Sequence[ProposalLaw],
    rng: Generator,
    draws: int = PLAIN,
) -> Weighed:
    """Weigh fresh draws of a posterior in which some groups, all or one, share every parameter."""
    each = -(-draws // len(proposals))
    u = np.concatenate([proposal.sample(each, rng) for proposal in proposals])
    pooled = log_mean([proposal.log_density(u) for proposal in proposals], axis=0)
    x, log_jacobian = coordinates.to_physical(u)
    prior = joint.groups[groups[0]].log_prior(x)
    candidates = np.isfinite(prior) & np.isfinite(log_jacobian)
    base = np.where(candidates, prior + np.where(candidates, log_jacobian, 0.0), -np.inf) - pooled
    shape = (len(proposals), each)
    levels, rows = [], []
    for name in groups:
        likelihood, terms = row_terms(joint.groups[name], x, candidates)
        inside = np.asarray(np.isfinite(terms).all(axis=1))
        total = np.where(inside, likelihood, -np.inf)
        levels.append(total.reshape(shape))
        without = [
            np.where(inside, total - term, -np.inf).reshape(shape) for term in np.where(inside[:, None], terms, 0.0).T
        ]
        rows.append(np.array(without))
    return Weighed(base.reshape(shape), np.array(levels), tuple(rows))


@dataclass(frozen=True)
class PriorShares:
    """Log share of a stated prior inside the physical support of all groups, and of all but each one."""

    whole: float
    error: float
    without: tuple[float, ...]


def joint_shares(joint: JointPosterior, rng: Generator, *, outer: int = 4000, inner: int = 16) -> PriorShares:
    """Of a joint prior: shared values from their laws, every group's locals integrated out by draws."""
    D = np.repeat(joint.draw_shared(outer, rng), inner, axis=0)
    drawn = ((posterior, joint.of_group(D, joint.draw_group(D, rng))) for posterior in joint.groups.values())
    inside = [(posterior.reasons(x) == INSIDE).reshape(outer, inner).mean(axis=1) for posterior, x in drawn]
    return _shares(np.array(inside))


def plain_shares(joint: JointPosterior, groups: Sequence[str], rng: Generator, *, draws: int = 40000) -> PriorShares:
    """Of the prior of a posterior in which some groups share every parameter."""
    x = joint.first.prior.sample(draws, rng)
    return _shares(np.array([(joint.groups[name].reasons(x) == INSIDE).astype(float) for name in groups]))


def _shares(inside: FloatArray) -> PriorShares:
    whole = inside.prod(axis=0)
    without = [np.log(np.delete(inside, g, axis=0).prod(axis=0).mean()) for g in range(len(inside))]
    error = whole.std() / np.sqrt(len(whole)) / whole.mean()
    return PriorShares(float(np.log(whole.mean())), float(error), tuple(map(float, without)))
