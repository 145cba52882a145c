"""Evidence, and what each row or group adds to it, by importance sampling from frozen laws.

Of a joint posterior the outer draws are shared values D; given these every group's locals are integrated out
by a few inner draws from its law, Ẑ_g(D), which is unbiased. Groups being independent given D,

    Z = E[p(D) ∏_g Ẑ_g(D) / q(D)],

and the same draws, with one group or one row left out of the product, give what the others predict for it
(integrated importance sampling: Vehtari et al. 2016, J. Machine Learning Research 17, 103).

Locals are drawn from laws that have the population's among them. A spread far below the error of a group makes the
population a needle that no law fitted to draws has the shape of: inner draws miss it, evidence comes out too low, and
neither the error nor the tail of the weights tells (the neck of the funnel: Neal 2003, Ann. Stat. 31, 732). So half of
the draws are of a chain: every hierarchical value from its population or from a fitted law, the less from the latter
the smaller the spread; then what is separate, from its fitted law given all these. Laws of the chain do not follow
means and spreads of populations, so that they hold far from all draws that they were fitted to. Weights are over the
density of both halves together (the balance heuristic of Veach and Guibas 1995), which is exact. Where all spreads are
small they are bounded by what the likelihood is at the shared values.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import Generator
from scipy.stats import t as student_t

from bayesterra.arrays import BoolArray, FloatArray, spaced
from bayesterra.likelihood.joint import JointPosterior
from bayesterra.likelihood.posterior import INSIDE, Posterior
from bayesterra.sampling.coordinates import Coordinates
from bayesterra.sampling.evidence import Evidence, summed
from bayesterra.sampling.family import ConditionalLaw, JointFamily, fit_conditional, restricted
from bayesterra.sampling.joint import JointSamples, group_coordinates
from bayesterra.sampling.moves import Laws
from bayesterra.stats.laws import log_population, population_score, population_value
from bayesterra.stats.mixture import ProposalLaw, log_mean, pareto_limit, pareto_smoothed
from bayesterra.stats.transport import Proposal, fit_proposal

LEAST, GREATEST = 0.1, 0.9
"""Share of a chain's draws that the population itself has, where spreads are great and where small."""
FLAT, HEAVY = 0.3, 4.0
"""Share of shared values whose spreads are drawn from half-t laws, and degrees of freedom of these."""
FITTED = 2048
"""Most draws that the laws of a chain are fitted to."""


@dataclass(frozen=True)
class MarginalLaw:
    """Law of coordinates (n, d) where there are no others (n, 0) that they could depend on."""

    proposal: Proposal

    def sample(self, others: FloatArray, rng: Generator) -> tuple[FloatArray, FloatArray]:
        """One point for each row of ``others``, (n, d), and its log density (n,)."""
        points = self.proposal.sample(len(others), rng)
        return points, self.proposal.log_density(points)

    def log_density(self, others: FloatArray, points: FloatArray) -> FloatArray:
        """Log density (n,) of points (n, d)."""
        return self.proposal.log_density(points)


@dataclass(frozen=True)
class PopulationChain:
    """Law of a group's locals given shared values: hierarchical values one by one, then separate ones.

    Attributes
    ----------
    family, group : whose.
    fitted : of every hierarchical parameter given what is shared and those before it, then, if there are any,
        of all separate ones given what is shared and all hierarchical ones; each in its own coordinates.
    scales : standard deviations of the hierarchical values, physical.
    """

    family: JointFamily
    group: int
    fitted: tuple[ConditionalLaw | MarginalLaw, ...]
    scales: FloatArray

    @cached_property
    def _blocks(self) -> tuple[tuple[list[int], Coordinates], ...]:
        return _blocks(self.family, self.group)

    def sample(self, D: FloatArray, inner: int, rng: Generator) -> FloatArray:
        """``inner`` locals (n inner, d) per row of shared values (n, k); NaN where it has no coordinates."""
        joint, repeated = self.family.joint, np.repeat(D, inner, axis=0)
        shared, _ = self.family.shared_to_physical(repeated)
        own = np.empty((len(repeated), len(joint.local)))
        others = repeated[:, : len(joint.shared)]
        for i, (columns, coordinates) in enumerate(self._blocks):
            w = self.fitted[i].sample(others, rng)[0]
            own[:, columns] = coordinates.to_physical(w)[0]
            if i < len(joint.populations):
                mine = self._stratified(i, shared, inner, rng)
                own[mine, columns[0]] = self._of_population(i, shared[mine], own[mine], rng)
                w[mine] = _coordinates(coordinates, own[mine][:, columns])
            others = np.concatenate([others, np.nan_to_num(w, posinf=0.0, neginf=0.0)], axis=1)
        with np.errstate(all="ignore"):  # contact angles, say, may be out of their range together
            L = self.family.group_from_physical(self.group, own)
        return np.where(np.isfinite(L).all(axis=1, keepdims=True), L, np.nan)

    def log_density(self, D: FloatArray, L: FloatArray) -> FloatArray:
        """Log density (n,) of locals (n, d) given shared values (n, k), in the family's coordinates."""
        shared = self.family.shared_to_physical(D)[0]
        own, total = self.family.group_to_physical(self.group, L)
        others = D[:, : len(self.family.joint.shared)]
        for i, (columns, coordinates) in enumerate(self._blocks):
            w = np.nan_to_num(_coordinates(coordinates, own[:, columns]), posinf=0.0, neginf=0.0)
            level = self.fitted[i].log_density(others, w) - coordinates.to_physical(w)[1]
            if i < len(self.family.joint.populations):
                share = self._share(i, shared)
                level = np.logaddexp(np.log(share) + self._log_population(i, shared, own), np.log1p(-share) + level)
            total, others = total + level, np.concatenate([others, w], axis=1)
        return total

    def _share(self, i: int, shared: FloatArray) -> FloatArray:
        """Share (n,) of draws that a population has."""
        ratio = np.minimum(self._laws(i, shared)[1] / self.scales[i], 1e6)
        return np.asarray(np.clip(1.0 / (1.0 + ratio**2), LEAST, GREATEST))

    def _stratified(self, i: int, shared: FloatArray, inner: int, rng: Generator) -> BoolArray:
        """Mask (n inner,) of the population's draws: as many of each ``inner`` as its share says."""
        n = len(shared) // inner
        places = rng.permuted(np.tile(np.arange(inner), (n, 1)), axis=1) + rng.random((n, 1))
        return np.asarray(places.ravel() < inner * self._share(i, shared))

    def _laws(self, i: int, shared: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and spread (n,) of a population."""
        return self.family.joint.population(self.family.joint.populations[i], shared)

    def _of_population(self, i: int, shared: FloatArray, own: FloatArray, rng: Generator) -> FloatArray:
        """Values (n,) given what is shared and the hierarchical values before them."""
        joint = self.family.joint
        middle, width = joint.score_before(i, shared, own)
        z = middle + width * rng.standard_normal(len(shared))
        limits = joint.laws[joint.populations[i]].range
        return population_value(z, *self._laws(i, shared), limits)

    def _log_population(self, i: int, shared: FloatArray, own: FloatArray) -> FloatArray:
        """Log density (n,) of these."""
        joint = self.family.joint
        limits = joint.laws[joint.populations[i]].range
        values, laws = own[:, joint.local.index(joint.populations[i])], self._laws(i, shared)
        level = log_population(values, *laws, limits)
        middle, width = joint.score_before(i, shared, own)
        if width == 1.0:
            return level
        z = population_score(values, *laws, limits)
        return np.asarray(level + 0.5 * z**2 - 0.5 * ((z - middle) / width) ** 2 - np.log(width))


def _blocks(family: JointFamily, group: int) -> tuple[tuple[list[int], Coordinates], ...]:
    """Columns of locals, and their coordinates: of every hierarchical one, then of all separate ones."""
    joint = family.joint
    posterior = list(joint.groups.values())[group]
    separate = tuple(name for name in joint.local if name not in joint.populations)
    sets = [*((name,) for name in joint.populations), *([separate] if separate else [])]
    return tuple(([joint.local.index(n) for n in names], restricted(posterior, names)) for names in sets)


def _coordinates(coordinates: Coordinates, x: FloatArray) -> FloatArray:
    with np.errstate(all="ignore"):  # what lies outside has none
        return coordinates.from_physical(x)


def fit_chain(
    family: JointFamily, group: int, shared: FloatArray, alone: FloatArray, L: FloatArray, rng: Generator
) -> PopulationChain:
    """Fit the chain of a group to draws of what is shared (n, k) and of its locals (n, d).

    ``alone`` are locals from the group's posterior alone, whose scale is that of its likelihood.
    """
    own, others = family.group_to_physical(group, L)[0], shared
    fitted: list[ConditionalLaw | MarginalLaw] = []
    for columns, coordinates in _blocks(family, group):
        w, widths = coordinates.from_physical(own[:, columns]), np.ones(len(columns))
        if others.shape[1]:
            fitted.append(fit_conditional(others, w, widths, rng))
        else:
            fitted.append(MarginalLaw(fit_proposal(w, np.ones(len(w)), widths, 8, 0.1, rng)))
        others = np.concatenate([others, w], axis=1)
    at = [family.joint.local.index(name) for name in family.joint.populations]
    scales = family.group_to_physical(group, alone)[0][:, at].std(axis=0)
    return PopulationChain(family, group, tuple(fitted), scales + 1e-300)


@dataclass(frozen=True)
class InnerLaw:
    """Law of a group's locals given shared values, to integrate them out.

    One is fitted to all locals together; a chain makes half of the draws where anything has a population.
    """

    fitted: ConditionalLaw
    chain: PopulationChain | None

    def sample(self, D: FloatArray, inner: int, rng: Generator) -> tuple[FloatArray, FloatArray]:
        """``inner`` locals (n inner, d) per row of shared values (n, k), one after another; log density.

        Where locals are NaN, being outside the support, the density is 1.
        """
        if self.chain is None:
            return self.fitted.sample(np.repeat(D, inner, axis=0), rng)
        half, repeated = inner // 2, np.repeat(D, inner, axis=0)
        first, _ = self.fitted.sample(np.repeat(D, inner - half, axis=0), rng)
        second = self.chain.sample(D, half, rng)
        d = first.shape[1]
        halves = [first.reshape(len(D), inner - half, d), second.reshape(len(D), half, d)]
        L = np.concatenate(halves, axis=1).reshape(-1, d)
        level, finite = np.zeros(len(L)), np.flatnonzero(np.isfinite(L).all(axis=1))
        level[finite] = np.logaddexp(
            np.log((inner - half) / inner) + self.fitted.log_density(repeated[finite], L[finite]),
            np.log(half / inner) + self.chain.log_density(repeated[finite], L[finite]),
        )
        return L, level


@dataclass(frozen=True)
class DefendedDrivers:
    """Law of shared values: a fitted one, and beside it one whose spreads reach down to nothing.

    In the second, spreads are independent of all else and their density is that of a half-t law, which is
    flat at zero. Half-normal priors are, and data that agree do not tell small spreads apart.
    """

    fitted: Proposal  # of all shared values
    others: Proposal  # of all but the spreads
    columns: tuple[int, ...]  # of the spreads
    scales: FloatArray  # of the half-t laws

    def sample(self, n: int, rng: Generator) -> FloatArray:
        """Draw n independent points (n, k)."""
        flat = round(n * FLAT)
        first, rest = self.fitted.sample(n - flat, rng), self.others.sample(flat, rng)
        second = np.empty((flat, first.shape[1]))
        second[:, np.delete(np.arange(first.shape[1]), self.columns)] = rest
        heights = np.abs(rng.standard_t(HEAVY, (flat, len(self.columns)))) * self.scales
        second[:, self.columns] = np.log(np.maximum(heights, 1e-300))
        return np.concatenate([first, second])

    def log_density(self, D: FloatArray) -> FloatArray:
        """Log density (n,) at points (n, k)."""
        logs = D[:, self.columns]
        with np.errstate(over="ignore"):
            heights = np.exp(logs) / self.scales
        tail = student_t(HEAVY).logpdf(heights) + np.log(2.0) + logs - np.log(self.scales)
        flat = self.others.log_density(np.delete(D, self.columns, axis=1)) + tail.sum(axis=1)
        return np.asarray(np.logaddexp(np.log1p(-FLAT) + self.fitted.log_density(D), np.log(FLAT) + flat))


@dataclass(frozen=True)
class OuterLaws:
    """Laws of the shared values, and of every group's locals to integrate out."""

    drivers: Proposal | DefendedDrivers
    locals: tuple[InnerLaw, ...]


Draws = Sequence[tuple[FloatArray, FloatArray]]
"""Of every group, what is shared (n, k) and its locals (n, d)."""


def outer_laws(
    family: JointFamily, laws: Laws, alone: Draws, D: FloatArray, L: FloatArray, rng: Generator
) -> OuterLaws:
    """Laws to weigh with: those given and, where there are populations, chains beside them.

    Chains are fitted to draws of both the groups alone and all together: so they are right where populations
    are wide as well as where groups draw each other out of their own posteriors.

    ``alone`` are draws of the groups' own posteriors; D (n, k) and L (groups, n, d) those of all together.
    """
    if not family.joint.populations:
        return OuterLaws(laws.drivers, tuple(InnerLaw(law, None) for law in laws.locals))
    k, inner = len(family.joint.shared), []
    for g, (draws, law) in enumerate(zip(alone, laws.locals, strict=True)):
        S, own = (spaced(part, FITTED) for part in draws)
        shared = np.concatenate([spaced(D[:, :k], FITTED), S])
        chain = fit_chain(family, g, shared, own, np.concatenate([spaced(L[g], FITTED), own]), rng)
        inner.append(InnerLaw(law, chain))
    columns = tuple(block[1] for block in family.blocks[1:])
    D = spaced(D, FITTED)
    rest = np.delete(D, columns, axis=1)
    others = fit_proposal(rest, np.ones(len(D)), rest.std(axis=0) + 1e-300, 8, 0.1, rng)
    scales = 1.5 * np.exp(np.median(D[:, columns], axis=0))
    return OuterLaws(DefendedDrivers(laws.drivers, others, columns, scales), tuple(inner))


OUTER, INNER = 4096, 16
"""Draws of shared values, and of every group's locals for each of them."""
PLAIN = 16384
"""Draws of a posterior without groups of its own."""


@dataclass(frozen=True)
class Weighed:
    """Log importance weights in parts; s strata of n draws each."""

    base: FloatArray  # log prior over proposal of what all groups share (s, n)
    groups: FloatArray  # log likelihood of every group, its locals integrated out (groups, s, n)
    rows: tuple[FloatArray, ...]  # the same without one of the group's rows, for every group (rows of the group, s, n)
    apart: FloatArray | None = None  # as ``base``, each stratum over its own proposal; None where not known

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

    def left_out(self, group: int, row: int | None = None) -> "LeftOutShare":
        """Prediction of all else for a group, or for one of its rows."""
        whole = self.base + self.groups.sum(axis=0)
        others = self.base + np.delete(self.groups, group, axis=0).sum(axis=0)
        without = others if row is None else others + self.rows[group][row]
        flat, left = whole.ravel(), np.where(np.isnan(without), -np.inf, without).ravel()
        log_z, log_left = map(log_mean, (flat, left))
        deviation = np.exp(flat - log_z) - np.exp(left - log_left)
        k, error = pareto_smoothed(left[np.isfinite(left)])[1], float(deviation.std() / np.sqrt(flat.size))
        return LeftOutShare(float(log_z - log_left), error, k, pareto_limit(flat.size))


@dataclass(frozen=True)
class LeftOutShare:
    """Log predictive density of readings left out."""

    elpd: float  # the log density
    error: float  # its Monte Carlo error
    k: float  # Pareto shape of the weights without these readings
    limit: float  # above which neither can be relied on

    @property
    def reliable(self) -> bool:
        """True where the error can be relied on."""
        return self.k <= self.limit


def weigh_joint(samples: JointSamples, rng: Generator, *, outer: int = OUTER, inner: int = INNER) -> Weighed:
    """Weigh fresh draws of the laws of all ensembles of a joint posterior."""
    family = JointFamily(samples.joint)
    return weigh(family, [_laws(family, samples, e, rng) for e in range(len(samples.laws))], outer, inner, rng)


def weigh(
    family: JointFamily, laws: Sequence[OuterLaws], outer: int, inner: int, rng: Generator, *, rows_out: bool = True
) -> Weighed:
    """Weigh fresh draws of laws of a joint posterior; no row is left out of it but with ``rows_out``."""
    each = -(-outer // len(laws))
    D = [law.drivers.sample(each, rng) for law in laws]
    everywhere = np.concatenate(D)
    levels = np.array([law.drivers.log_density(everywhere) for law in laws])
    shape = (len(laws), each)
    prior = family.placed(everywhere)[1].reshape(shape)
    base = prior - log_mean(levels, axis=0).reshape(shape)
    apart = prior - np.array([level.reshape(shape)[e] for e, level in enumerate(levels)])
    groups = np.empty((family.groups, *shape))
    rows: list[list[FloatArray]] = [[] for _ in range(family.groups)]
    for e, law in enumerate(laws):
        for g in range(family.groups):
            groups[g, e], without = _integrated(family, law, g, D[e], inner, rng, rows_out)
            rows[g].append(without)
    return Weighed(base, groups, tuple(np.stack(strata, axis=1) for strata in rows), apart)


def _laws(family: JointFamily, samples: JointSamples, ensemble: int, rng: Generator) -> OuterLaws:
    """Laws to weigh with, from one ensemble's draws of all groups together and of each alone."""
    flat = np.concatenate(samples.chains[ensemble].swapaxes(0, 1))  # walker after walker, so that some are of all
    shared, own = family.joint.split(flat[:: max(1, len(flat) // FITTED)])
    L = np.stack([family.group_from_physical(g, x) for g, x in enumerate(own)])
    chains = [lone.chains[ensemble] for lone in samples.lone.values()]
    alone = [group_coordinates(family, g, chain, rng) for g, chain in enumerate(chains)]
    return outer_laws(family, samples.laws[ensemble], alone, family.shared_from_physical(shared), L, rng)


def _integrated(
    family: JointFamily, laws: OuterLaws, group: int, D: FloatArray, inner: int, rng: Generator, rows_out: bool
) -> tuple[FloatArray, FloatArray]:
    """Log marginal likelihood (n,) of a group given shared values, and that without each row (rows, n)."""
    repeated = np.repeat(D, inner, axis=0)
    L, log_law = laws.locals[group].sample(D, inner, rng)
    shared, _ = family.shared_to_physical(repeated)
    if rows_out:
        population, own = family._prior(shared, group, L)
        posterior = list(family.joint.groups.values())[group]
        likelihood, terms = row_terms(posterior, family.joint.of_group(shared, own), np.isfinite(population))
    else:
        population, likelihood = family.terms(group, shared, L)
        terms = np.empty((len(L), 0))
    inside = np.isfinite(population) & np.isfinite(likelihood) & np.isfinite(terms).all(axis=1) & np.isfinite(log_law)
    weights = np.where(inside, population - log_law, -np.inf)
    total = weights + np.where(np.isfinite(weights), likelihood, 0.0)

    def mean(level: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore"):
            return log_mean(level.reshape(len(D), inner), axis=1)

    finite_terms = np.where(np.isfinite(weights)[:, None], terms, 0.0)
    without = [mean(total - finite_terms[:, i]) for i in range(terms.shape[1])]
    return mean(total), np.array(without).reshape(-1, len(D))


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
