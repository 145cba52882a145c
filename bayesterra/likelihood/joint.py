"""Joint posterior of several groups of rows: what they share, what is their own, and populations."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal, TypeAlias

import numpy as np
from numpy.random import Generator
from scipy.special import ndtri

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.errors import StudyError, SupportError
from bayesterra.likelihood.posterior import INSIDE, OUTSIDE_PRIOR, Posterior, checked_sets, likelihood_of, posterior
from bayesterra.stats.dependence import MixtureCopula, Split
from bayesterra.stats.laws import Law, log_population, population_score, population_value
from bayesterra.study.groups import Pooling
from bayesterra.study.study import Study

MEAN, SPREAD = "mean", "spread"


def name_in_group(name: str, group: str) -> str:
    """Name of a group's own value, ``K[Wh11]``; the name itself without groups."""
    return f"{name}[{group}]" if group else name


@dataclass(frozen=True)
class JointPosterior:
    """Posterior density of all parameters of a study with groups.

    p(shared) p(populations) ∏_g p(locals_g | shared, populations) likelihood_g, every constant included. The
    prior is the stated one, set to zero where any group's parameters are outside the physical support.
    Stated correlations hold among what is shared and what a group has. A hierarchical value enters them by
    its normal score under the law of its population, whose mean and spread are independent of all else.
    """

    pooling: Pooling  # the role of every free parameter
    groups: Mapping[str, Posterior]  # of each group's rows alone, by its name; all have the same parameters
    grouped: ClassVar[Literal[True]] = True

    @cached_property
    def first(self) -> Posterior:
        """The first group's, for what all have in common."""
        return next(iter(self.groups.values()))

    @property
    def laws(self) -> Mapping[str, Law]:
        """The stated law of every parameter."""
        return self.first.prior.laws

    @property
    def shared(self) -> tuple[str, ...]:
        """Parameters that all groups share."""
        return self.pooling.shared

    @property
    def populations(self) -> tuple[str, ...]:
        """Hierarchical parameters."""
        return tuple(self.pooling.hierarchical)

    @cached_property
    def hyper(self) -> dict[str, tuple[Law, Law]]:
        """Laws of mean and spread of every population."""
        populations = self.pooling.hierarchical
        return {name: population.laws(self.laws[name]) for name, population in populations.items()}

    @cached_property
    def local(self) -> tuple[str, ...]:
        """Parameters that every group has its own value of, in the package's order."""
        return tuple(name for name in self.first.names if name not in self.shared)

    @cached_property
    def shared_and_hyper(self) -> tuple[str, ...]:
        """Shared parameters, then mean and spread of every population: ``K.mean``, ``K.spread``."""
        return (*self.shared, *(f"{name}.{part}" for name in self.populations for part in (MEAN, SPREAD)))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """All parameters: shared values, then those of each group in turn, ``K[Wh11]``."""
        return (*self.shared_and_hyper, *(name_in_group(name, group) for group in self.groups for name in self.local))

    @cached_property
    def prior(self) -> "JointPrior":
        """The stated prior of all parameters."""
        return JointPrior(self)

    @cached_property
    def places(self) -> tuple[IntArray, ...]:
        """Columns of parameter sets (n, all) that are the parameters of every group."""
        own, shared = self.first.names, self.shared
        whole = ([name if name in shared else name_in_group(name, group) for name in own] for group in self.groups)
        return tuple(np.array([self.names.index(name) for name in names], dtype=np.int64) for names in whole)

    @cached_property
    def copula(self) -> Split | None:
        """Dependence of the parameters that have any; None where the laws are independent.

        A mixture of scores holds for values under the prior's own laws. One with a hierarchical parameter,
        whose values lie within a population, is taken by its correlations.
        """
        prior = self.first.prior
        if not prior.correlated:
            return None
        at = [prior.names.index(name) for name in (*self.tied_shared, *self.tied_local)]
        whole = prior.dependence(self.populations).marginal([prior.correlated.index(i) for i in at])
        return whole.split(len(self.tied_shared))

    @cached_property
    def tied_shared(self) -> tuple[str, ...]:
        """Shared parameters that correlate with another one."""
        return tuple(name for name in self.shared if self._correlates(name))

    @cached_property
    def tied_local(self) -> tuple[str, ...]:
        """Parameters of each group that correlate with another one."""
        return tuple(name for name in self.local if self._correlates(name))

    def _correlates(self, name: str) -> bool:
        return self.first.prior.names.index(name) in self.first.prior.correlated

    def population(self, name: str, shared: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and spread (n,) of a population among shared values."""
        at = len(self.shared) + 2 * self.populations.index(name)
        return shared[:, at], shared[:, at + 1]

    def _shared_scores(self, shared: FloatArray) -> FloatArray:
        scores = [self.laws[name].score(shared[:, self.shared.index(name)]) for name in self.tied_shared]
        return np.column_stack([np.empty((len(shared), 0)), *scores])

    def _own_scores(self, shared: FloatArray, own: FloatArray) -> FloatArray:
        scores = [self.score(name, shared, own) for name in self.tied_local]
        return np.column_stack([np.empty((len(own), 0)), *scores])

    def score(self, name: str, shared: FloatArray, own: FloatArray) -> FloatArray:
        """Normal score (n,) of a local under its population or, where it has none, its own law."""
        values, law = own[:, self.local.index(name)], self.laws[name]
        if name not in self.populations:
            return law.score(values)
        return population_score(values, *self.population(name, shared), law.range)

    def score_before(self, i: int, shared: FloatArray, own: FloatArray) -> tuple[FloatArray, float]:
        """Mean (n,) and standard deviation of a hierarchical value's normal score under its population.

        Given what is shared and the hierarchical values before the ``i``-th among locals (n, d).
        """
        name, k = self.populations[i], len(self.tied_shared)
        if self.copula is None or name not in self.tied_local:
            return np.zeros(len(shared)), 1.0
        before = [other for other in self.populations[:i] if other in self.tied_local]
        scores = [self._shared_scores(shared), *(self.score(other, shared, own) for other in before)]
        at = [*range(k), *(k + self.tied_local.index(other) for other in before)]
        middle, width = self.copula.conditional(k + self.tied_local.index(name), at)
        return np.asarray(np.column_stack(scores) @ middle), width

    def log_dependence(self, shared: FloatArray, own: FloatArray) -> FloatArray:
        """Term of correlations in the log density (n,) of a group's locals inside their ranges."""
        if self.copula is None or not self.tied_local:
            return np.zeros(len(own))
        return self.copula.log_own(self._shared_scores(shared), self._own_scores(shared, own))

    def dependence_on(
        self, name: str, shared: FloatArray, own: FloatArray
    ) -> Callable[[FloatArray, FloatArray], FloatArray]:
        """Term of correlations in the log density (n,) of all groups' locals (groups, n, d).

        As a function of mean and spread (n,) of a population that correlates, all other shared values held.
        """
        shared_scores = np.tile(self._shared_scores(shared), (len(own), 1))
        scores = np.concatenate([self._own_scores(shared, group_own) for group_own in own])
        column, limits = self.tied_local.index(name), self.laws[name].range
        values = own[:, :, self.local.index(name)]

        def added(mean: FloatArray, spread: FloatArray) -> FloatArray:
            if self.copula is None:
                return np.zeros(len(mean))
            scores[:, column] = population_score(values, mean, spread, limits).ravel()
            return np.asarray(self.copula.log_own(shared_scores, scores).reshape(len(own), -1).sum(axis=0))

        return added

    @cached_property
    def _columns(self) -> tuple[list[int], list[int]]:
        """Columns of shared and of local parameters among a group's own."""
        names = self.first.names
        return [names.index(n) for n in self.shared], [names.index(n) for n in self.local]

    def split(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Shared values (n, k) and locals (groups, n, d) of parameter sets (n, all)."""
        k = len(self.shared_and_hyper)
        group_values = x[:, k:].reshape(len(x), len(self.groups), len(self.local))
        return x[:, :k], np.ascontiguousarray(np.moveaxis(group_values, 1, 0))

    def joined(self, shared: FloatArray, group_values: FloatArray) -> FloatArray:
        """The inverse of :meth:`split`, for any leading shape: (..., k) and (..., groups, d)."""
        flat = group_values.reshape(*group_values.shape[:-2], len(self.groups) * len(self.local))
        return np.concatenate([shared, flat], axis=-1)

    def of_group(self, shared: FloatArray, own: FloatArray) -> FloatArray:
        """Parameter sets (n, names of a group) from shared values (n, k) and a group's locals (n, d)."""
        x, (columns, own_columns) = np.empty((len(shared), len(self.first.names))), self._columns
        x[:, columns], x[:, own_columns] = shared[:, : len(columns)], own
        return x

    def values_of_groups(self, x: FloatArray) -> tuple[FloatArray, ...]:
        """Parameter sets (n, names of a group) of every group, of parameter sets (n, all)."""
        shared, group_values = self.split(x)
        return tuple(self.of_group(shared, own) for own in group_values)

    def one_group(self, group: str, x: FloatArray, rng: Generator) -> tuple[Posterior, FloatArray]:
        """Posterior with the parameters of a group, and its sets (n, names of a group) among ``x`` (n, all).

        Those of a group that has no rows here come from the populations and priors.
        """
        if group in self.groups:
            return self.groups[group], self.values_of_groups(x)[list(self.groups).index(group)]
        shared = self.split(x)[0]
        return self.first, self.of_group(shared, self.draw_untested(shared, rng))

    def log_prior_of_shared(self, shared: FloatArray) -> FloatArray:
        """Log density (n,) of shared parameters, means and spreads under their stated laws."""
        total = np.zeros(len(shared))
        for i, name in enumerate(self.shared):
            total += self.laws[name].log_density(shared[:, i])
        for name, laws in self.hyper.items():
            mean, spread = self.population(name, shared)
            total += laws[0].log_density(mean) + laws[1].log_density(spread)
            total = np.where(spread > 0, total, -np.inf)
        total = np.where(np.isfinite(total), total, -np.inf)
        return total + self.log_dependence_of_shared(shared)

    def log_dependence_of_shared(self, shared: FloatArray) -> FloatArray:
        """Term of correlations in the log density (n,) of the shared parameters."""
        if self.copula is None or not self.tied_shared:
            return np.zeros(len(shared))
        return self.copula.log_shared(self._shared_scores(shared))

    def log_prior_of_group(self, shared: FloatArray, own: FloatArray) -> FloatArray:
        """Log density (n,) of a group's locals (n, d) given shared values (n, k), before the physical cut."""
        total = np.zeros(len(own))
        for i, name in enumerate(self.local):
            if name in self.populations:
                mean, spread = self.population(name, shared)
                total += log_population(own[:, i], mean, spread, self.laws[name].range)
            else:
                total += self.laws[name].log_density(own[:, i])
        total = np.where(np.isfinite(total), total, -np.inf)
        if self.copula is not None:
            alive = np.flatnonzero(np.isfinite(total))
            total[alive] += self.log_dependence(shared[alive], own[alive])
        return total

    def log_likelihood_of_group(self, group: str, shared: FloatArray, own: FloatArray) -> FloatArray:
        """Log likelihood (n,) of a group's rows; −inf outside its physical support."""
        return self.groups[group].log_prior_and_likelihood(self.of_group(shared, own))[1]

    def log_density(self, x: FloatArray) -> FloatArray:
        """Log posterior density (n,) of sets ``x`` (n, d); ValueError without one column for each of ``names``."""
        prior, likelihood = self.log_prior_and_likelihood(x)
        return prior + np.where(np.isfinite(prior), likelihood, 0.0)

    def log_prior(self, x: FloatArray) -> FloatArray:
        """Log density (n,) of the stated prior, −inf outside the ranges and physical ranges of any group."""
        finite = np.asarray(np.isfinite(x).all(axis=1))
        D, L = self.split(np.where(finite[:, None], x, 0.0))
        prior = np.where(finite, self.log_prior_of_shared(D), -np.inf)
        for alone, own in zip(self.groups.values(), L, strict=True):
            alive = np.flatnonzero(np.isfinite(prior))
            prior[alive] += self.log_prior_of_group(D[alive], own[alive])
            alive = alive[np.isfinite(prior[alive])]
            prior[alive[np.isneginf(alone.log_prior(self.of_group(D[alive], own[alive])))]] = -np.inf
        return np.where(np.isfinite(prior), prior, -np.inf)

    def log_before(self, x: FloatArray) -> FloatArray:
        """Log prior (n,): there are no soil tests beside groups."""
        return self.log_prior(x)

    def log_prior_and_likelihood(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log prior and log likelihood, each (n,), both −inf outside the support."""
        x = checked_sets(x, self.names)
        finite = np.asarray(np.isfinite(x).all(axis=1))
        D, L = self.split(np.where(finite[:, None], x, 0.0))
        prior, likelihood = np.where(finite, self.log_prior_of_shared(D), -np.inf), np.zeros(len(D))
        for group, own in zip(self.groups, L, strict=True):
            alive = np.flatnonzero(np.isfinite(prior))
            prior[alive] += self.log_prior_of_group(D[alive], own[alive])
            alive = alive[np.isfinite(prior[alive])]
            likelihood[alive] += self.log_likelihood_of_group(group, D[alive], own[alive])
            prior = np.where(likelihood > -np.inf, prior, -np.inf)
        return prior, np.where(np.isfinite(prior), likelihood, -np.inf)

    @property
    def rows_apart(self) -> bool:
        """True where the rows of every group are independent given its parameters."""
        return all(own.likelihood.rows_apart for own in self.groups.values())

    def log_rows(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log likelihood (n,), and log density (n, rows) of every row of the table given all other rows."""
        values = self.values_of_groups(x)
        each = [own.log_rows(v) for own, v in zip(self.groups.values(), values, strict=True)]
        rows = np.concatenate([own.likelihood.observations.rows for own in self.groups.values()])
        terms = np.concatenate([terms for _, terms in each], axis=1)[:, np.argsort(rows)]
        return np.sum([total for total, _ in each], axis=0), terms

    def reasons(self, x: FloatArray) -> IntArray:
        """Reason why each set (n, all) has no density: that of the first group without one."""
        reasons = np.where(np.isneginf(self.log_prior_of_shared(self.split(x)[0])), OUTSIDE_PRIOR, INSIDE)
        for values, own in zip(self.values_of_groups(x), self.groups.values(), strict=True):
            inside = np.flatnonzero(reasons == INSIDE)
            reasons[inside] = own.reasons(values[inside])
        return reasons

    def cut_prior(self, n: int, rng: Generator) -> FloatArray:
        """Draws (n, all) of the prior cut to the support of every group, see :func:`draw_joint_prior`."""
        return draw_joint_prior(self, n, rng)

    def draw_shared(self, n: int, rng: Generator) -> FloatArray:
        """Shared parameters, means and spreads (n, k) from their stated laws."""
        return self.shared_values(rng.standard_normal((n, len(self.shared_and_hyper))))

    def shared_values(self, normal: FloatArray) -> FloatArray:
        """Shared parameters, means and spreads (n, k) at independent normal scores (n, k)."""
        z, tied = normal.copy(), [self.shared.index(name) for name in self.tied_shared]
        if self.copula is not None:
            z[:, tied] = self.copula.first(z[:, tied])
        named = zip(self.shared_and_hyper, z.T, strict=True)
        columns = [self.prior.laws[name].at_score(score) for name, score in named]
        return np.column_stack([np.empty((len(z), 0)), *columns])

    def draw_group(self, shared: FloatArray, rng: Generator) -> FloatArray:
        """Locals (n, d) of one group for each row of shared values, before the physical cut."""
        return self.own_values(shared, rng.standard_normal((len(shared), len(self.local))))

    def own_values(self, shared: FloatArray, normal: FloatArray) -> FloatArray:
        """Locals (n, d) of one group at independent normal scores (n, d), given shared values (n, k)."""
        z, tied = normal.copy(), [self.local.index(name) for name in self.tied_local]
        if self.copula is not None and tied:
            z[:, tied] = self.copula.completed(self._shared_scores(shared), z[:, tied])
        own = np.empty_like(z)
        for i, name in enumerate(self.local):
            law = self.laws[name]
            if name in self.populations:
                own[:, i] = population_value(z[:, i], *self.population(name, shared), law.range)
            else:
                own[:, i] = law.at_score(z[:, i])
        return own

    def draw_untested(self, shared: FloatArray, rng: Generator) -> FloatArray:
        """Locals (n, d) of a group that was not tested, in the physical ranges where the prior has any."""
        own = self.draw_group(shared, rng)
        for _ in range(1000):
            outside = np.flatnonzero(~np.isfinite(self.first.log_prior(self.of_group(shared, own))))
            if not outside.size:
                break
            own[outside] = self.draw_group(shared[outside], rng)
        return own


@dataclass(frozen=True)
class JointPrior:
    """Stated prior of all parameters of a joint posterior, in the order of its names, before the cut."""

    joint: JointPosterior

    @cached_property
    def laws(self) -> dict[str, Law]:
        """Stated laws; of a value within a population that of its quantity, which has its range and scale."""
        hyper = [law for pair in self.joint.hyper.values() for law in pair]
        shared, own = ([self.joint.laws[n] for n in names] for names in (self.joint.shared, self.joint.local))
        return dict(zip(self.joint.names, shared + hyper + own * len(self.joint.groups), strict=True))

    def stated(self, x: FloatArray) -> FloatArray:
        """What the laws are about: the parameter sets (n, all) themselves."""
        return x

    def sample(self, n: int, rng: Generator) -> FloatArray:
        """Draw parameter sets (n, all)."""
        return self.quantile(rng.random((n, len(self.joint.names))))

    def quantile(self, q: FloatArray) -> FloatArray:
        """Parameter sets (n, all) at probabilities ``q`` (n, all): independent uniform ones give draws.

        A value within a population is the quantile of that one.
        """
        joint, z, k = self.joint, ndtri(q), len(self.joint.shared_and_hyper)
        shared = joint.shared_values(z[:, :k])
        groups = np.split(z[:, k:], len(joint.groups), axis=1)
        return joint.joined(shared, np.stack([joint.own_values(shared, own) for own in groups], axis=1))

    def scores(self, x: FloatArray) -> FloatArray:
        """Normal scores (n, all) of parameter sets; of a value within a population, given mean and spread."""
        shared, groups = self.joint.split(x)
        scores = [self.laws[n].score(shared[:, i]) for i, n in enumerate(self.joint.shared_and_hyper)]
        scores += [self.joint.score(name, shared, own) for own in groups for name in self.joint.local]
        return np.column_stack(scores)

    @cached_property
    def score_correlation(self) -> FloatArray:
        """Correlations (all, all) of the scores; a mixture has those of its scores."""
        joint, matrix = self.joint, np.eye(len(self.joint.names))
        if joint.copula is None:
            return matrix
        whole, k = joint.copula.whole.correlation, joint.copula.shared
        across = whole[k:, :k] @ np.linalg.solve(whole[:k, :k], whole[:k, k:])  # by what both share
        shared = [joint.names.index(name) for name in joint.tied_shared]
        own = [[joint.names.index(name_in_group(n, g)) for n in joint.tied_local] for g in joint.groups]
        matrix[np.ix_(shared, shared)] = whole[:k, :k]
        for first in own:
            matrix[np.ix_(first, shared)], matrix[np.ix_(shared, first)] = whole[k:, :k], whole[:k, k:]
            for second in own:
                matrix[np.ix_(first, second)] = whole[k:, k:] if first is second else across
        return matrix

    @cached_property
    def correlated(self) -> list[int]:
        """Columns of parameters that depend on another one, as those within a population do."""
        others = np.asarray((self.score_correlation - np.eye(len(self.joint.names))).any(axis=1))
        within = {name_in_group(name, group) for name in self.joint.populations for group in self.joint.groups}
        return [i for i, name in enumerate(self.joint.names) if others[i] or name in within]

    @property
    def mixed(self) -> list[tuple[list[int], MixtureCopula]]:
        """None: mixtures count by the correlations of their scores."""
        return []


Whole: TypeAlias = Posterior | JointPosterior
"""Posterior of all parameters of a study, with or without groups."""


def joint_posterior(study: Study, fewest: int = 2) -> JointPosterior:
    """Joint posterior of a study; StudyError without [pooling], or with rows in use of fewer groups."""
    if study.pooling is None:
        raise StudyError("the study needs a [pooling] table")
    used, by = study.observations.used(), study.pooling.by
    labels = np.array(used.label(by), dtype=object)
    names = list(dict.fromkeys(labels))
    if len(names) < fewest:
        raise StudyError(f"[pooling] needs rows in use of at least two groups in '{by}' (got one)")
    groups = {n: Posterior(study.prior, likelihood_of(study, used.take(labels == n))) for n in names}
    return JointPosterior(study.pooling, groups)


def whole_posterior(study: Study, fewest: int = 2) -> Whole:
    """The posterior of all parameters of a study, without groups or with ``fewest`` of them or more."""
    return posterior(study) if study.pooling is None else joint_posterior(study, fewest)


def draw_joint_prior(
    joint: JointPosterior, n: int, rng: Generator, *, batch: int = 20000, most: int | None = 400
) -> FloatArray:
    """Parameter sets (n, d) of the joint prior cut to the support of every group, by rejection.

    Where that would take too long, survivors are drawn again after every group (sequential importance
    resampling): then draws have values of earlier groups in common.

    Parameters
    ----------
    batch : sets tried at once.
    most : tried sets per draw beyond which they are drawn again; None for draws that are all apart.

    Raises
    ------
    SupportError : no draw of a batch lies in the support of a group, or none of very many in that of all.
    """
    kept: list[FloatArray] = []
    tried = accepted = 0
    while accepted < n:
        if most is not None and tried >= 10 * batch and accepted * most < 10 * n:
            return _resampled(joint, n, rng, batch)
        if tried >= MOST_BATCHES * batch and not accepted:
            raise SupportError(f"none of {tried} draws of the prior fits the conditions of all groups")
        D = joint.draw_shared(batch, rng)
        L = np.empty((len(joint.groups), batch, len(joint.local)))
        alive = np.arange(batch)
        for g, alone in enumerate(joint.groups.values()):
            L[g, alive] = joint.draw_group(D[alive], rng)
            x = joint.of_group(D[alive], L[g, alive])
            alive = alive[alone.reasons(x) == 0]
            if not alive.size:
                break
        kept.append(joint.joined(D[alive], np.moveaxis(L[:, alive], 0, 1)))
        tried, accepted = tried + batch, accepted + len(alive)
    return np.concatenate(kept)[:n]


def _resampled(joint: JointPosterior, n: int, rng: Generator, batch: int) -> FloatArray:
    """The same by sequential importance resampling."""
    D = joint.draw_shared(batch, rng)
    L = np.empty((len(joint.groups), batch, len(joint.local)))
    for g, (name, alone) in enumerate(joint.groups.items()):
        L[g] = joint.draw_group(D, rng)
        alive = np.flatnonzero(alone.reasons(joint.of_group(D, L[g])) == 0)
        if not alive.size:
            raise SupportError(f"no draw of the prior fits the conditions of group {name}")
        chosen = rng.choice(alive, size=batch)
        D, L = D[chosen], L[:, chosen]
    return joint.joined(D, np.moveaxis(L, 0, 1))[:n]


MOST_BATCHES = 10_000
