"""Laws from which a group's locals are drawn where they are integrated out, the population's among them.

A spread far below the error of a group makes the population a needle that no law fitted to draws has the
shape of: inner draws miss it, evidence comes out too low, and neither the error nor the tail of the weights
tells (the neck of the funnel: Neal 2003, Ann. Stat. 31, 732). So half of the draws are of a chain: every
hierarchical value from its population or from a fitted law, the less from the latter the smaller the spread;
then what is separate, from its fitted law given all these. Laws of the chain do not follow means and spreads
of populations, so that they hold far from all draws that they were fitted to. Weights
are over the density of both halves together (the balance heuristic of Veach and Guibas 1995), which is exact.
Where all spreads are small they are bounded by what the likelihood is at the shared values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import Generator
from scipy.stats import t as student_t

from bayesterra.arrays import BoolArray, FloatArray, spaced
from bayesterra.sampling.coordinates import Coordinates
from bayesterra.sampling.family import ConditionalLaw, JointFamily, fit_conditional, restricted
from bayesterra.sampling.moves import Laws
from bayesterra.stats.laws import log_population, population_score, population_value
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

    Attributes
    ----------
    fitted : of all shared values.
    others : of all but the spreads.
    columns : of the spreads.
    scales : of the half-t laws.
    """

    fitted: Proposal
    others: Proposal
    columns: tuple[int, ...]
    scales: FloatArray

    def sample(self, n: int, rng: Generator) -> FloatArray:
        """Draw n independent points (n, k)."""
        flat = round(n * FLAT)
        first, rest = self.fitted.sample(n - flat, rng), self.others.sample(flat, rng)
        second = np.empty((flat, first.shape[1]))
        second[:, self._rest(first.shape[1])] = rest
        heights = np.abs(rng.standard_t(HEAVY, (flat, len(self.columns)))) * self.scales
        second[:, self.columns] = np.log(np.maximum(heights, 1e-300))
        return np.concatenate([first, second])

    def log_density(self, D: FloatArray) -> FloatArray:
        """Log density (n,) at points (n, k)."""
        logs = D[:, self.columns]
        with np.errstate(over="ignore"):
            heights = np.exp(logs) / self.scales
        tail = student_t(HEAVY).logpdf(heights) + np.log(2.0) + logs - np.log(self.scales)
        flat = self.others.log_density(D[:, self._rest(D.shape[1])]) + tail.sum(axis=1)
        return np.asarray(np.logaddexp(np.log1p(-FLAT) + self.fitted.log_density(D), np.log(FLAT) + flat))

    def _rest(self, k: int) -> list[int]:
        return [column for column in range(k) if column not in self.columns]


def _defended(family: JointFamily, law: Proposal, D: FloatArray, rng: Generator) -> DefendedDrivers:
    columns = tuple(block[1] for block in family.blocks[1:])
    rest = np.delete(D, columns, axis=1)
    others = fit_proposal(rest, np.ones(len(D)), rest.std(axis=0) + 1e-300, 8, 0.1, rng)
    return DefendedDrivers(law, others, columns, 1.5 * np.exp(np.median(D[:, columns], axis=0)))


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
    return OuterLaws(_defended(family, laws.drivers, spaced(D, FITTED), rng), tuple(inner))
