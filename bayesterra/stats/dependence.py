"""Dependence of several laws through their normal scores z, of which each alone is standard normal.

So every parameter keeps its own law. A Gaussian copula takes the scores as jointly normal; for ridges that
bend there is :mod:`bayesterra.stats.mixture_copula`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import FloatArray


class Dependence(Protocol):
    """Joint law of d normal scores that are standard normal each."""

    @property
    def correlation(self) -> FloatArray:
        """Correlation matrix (d, d) of the scores."""

    def log_density(self, z: FloatArray) -> FloatArray:
        """Log joint density (n,) of scores (n, d) over the product of their own densities."""

    def completed(self, given: FloatArray, normal: FloatArray) -> FloatArray:
        """Scores (n, d − k) after the first k, which are given (n, k), from independent ones (n, d − k).

        A score moves with its own independent one and those before it: its law given the scores before it.
        """

    def marginal(self, at: Sequence[int]) -> Dependence:
        """Dependence of some of the scores, in the order of ``at``."""

    def split(self, shared: int) -> Split:
        """The same with the first ``shared`` scores common to groups and the others each group's own."""


@dataclass(frozen=True)
class GaussianCopula:
    """Scores that are jointly normal with a ``correlation`` (d, d)."""

    correlation: FloatArray

    def log_density(self, z: FloatArray) -> FloatArray:
        """See :class:`Dependence`: −½ zᵀ(R⁻¹ − 1)z − ½ log |R|."""
        excess, _, level = self.parts
        return np.asarray(level - 0.5 * np.einsum("ni,ij,nj->n", z, excess, z, optimize=True))

    def completed(self, given: FloatArray, normal: FloatArray) -> FloatArray:
        """See :class:`Dependence`."""
        if given.shape[1] == 0:
            return np.asarray(normal @ self.parts[1].T)
        return self.split(given.shape[1]).completed(given, normal)

    def slope_and_curvature(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Slope (n, d) of :meth:`log_density`; curvature R⁻¹ (d, d) of minus the log joint density."""
        precision = np.asarray(np.linalg.inv(self.correlation))
        return -(z @ (precision - np.eye(len(precision)))), precision

    def marginal(self, at: Sequence[int]) -> GaussianCopula:
        """See :class:`Dependence`."""
        return GaussianCopula(self.correlation[np.ix_(at, at)])

    def split(self, shared: int) -> GaussianSplit:
        """See :class:`Dependence`."""
        return GaussianSplit(self, shared)

    @cached_property
    def parts(self) -> tuple[FloatArray, FloatArray, float]:
        """R⁻¹ − 1, Cholesky factor of R and −½ log |R|; R may be empty."""
        factor = np.asarray(np.linalg.cholesky(self.correlation), dtype=np.float64)
        excess = np.asarray(np.linalg.inv(self.correlation) - np.eye(len(factor)))
        return excess, factor, -float(np.log(np.diagonal(factor)).sum())


@dataclass(frozen=True)
class JoinedDependence:
    """Sets of scores, independent of each other: the positions in each set, rising, and its dependence."""

    sets: tuple[tuple[tuple[int, ...], Dependence], ...]

    @cached_property
    def correlation(self) -> FloatArray:
        """See :class:`Dependence`."""
        matrix = np.eye(sum(len(at) for at, _ in self.sets))
        for at, dependence in self.sets:
            matrix[np.ix_(at, at)] = dependence.correlation
        return matrix

    def log_density(self, z: FloatArray) -> FloatArray:
        """See :class:`Dependence`."""
        terms = (dependence.log_density(z[:, list(at)]) for at, dependence in self.sets)
        return sum(terms, start=np.zeros(len(z)))

    def completed(self, given: FloatArray, normal: FloatArray) -> FloatArray:
        """See :class:`Dependence`."""
        scores, k = np.empty_like(normal), given.shape[1]
        for at, dependence in self.sets:
            first, rest = [i for i in at if i < k], [i - k for i in at if i >= k]
            scores[:, rest] = dependence.completed(given[:, first], normal[:, rest])
        return scores

    def marginal(self, at: Sequence[int]) -> JoinedDependence:
        """See :class:`Dependence`."""
        sets = []
        for own, dependence in self.sets:
            places = tuple(place for place, i in enumerate(at) if i in own)
            if places:
                sets.append((places, dependence.marginal([own.index(at[place]) for place in places])))
        return JoinedDependence(tuple(sets))

    def split(self, shared: int) -> Split:
        """See :class:`Dependence`."""
        return Split(self, shared)


@dataclass(frozen=True)
class Split:
    """Dependence among scores that groups share and those that one group has to itself.

    The shared scores have their own marginal; a group's are conditional on them, and groups are independent
    given them. So shared scores and those of any one group together have the whole dependence.

    Attributes
    ----------
    whole : dependence of k + d scores, the k shared ones first.
    shared : k, of which there may be none.
    """

    whole: Dependence
    shared: int

    @cached_property
    def _first(self) -> Dependence:
        return self.whole.marginal(range(self.shared)) if self.shared else JoinedDependence(())

    def log_shared(self, z: FloatArray) -> FloatArray:
        """Log joint density (n,) of shared scores (n, k) over the product of their own densities."""
        return self._first.log_density(z)

    def log_own(self, shared: FloatArray, own: FloatArray) -> FloatArray:
        """Log density (n,) of a group's scores (n, d) given the shared ones, over that without dependence."""
        both = self.whole.log_density(np.concatenate([shared, own], axis=1))
        return np.asarray(both - self._first.log_density(shared))

    def conditional(self, of: int, others: Sequence[int]) -> tuple[FloatArray, float]:
        """Regression (k,) of one score on k others, and the standard deviation that remains."""
        R = self.whole.correlation
        slope = np.linalg.solve(R[np.ix_(others, others)], R[others, of])
        return np.asarray(slope), float(np.sqrt(1.0 - slope @ R[others, of]))

    def draw_shared(self, n: int, rng: Generator) -> FloatArray:
        """Shared scores (n, k)."""
        return self._first.completed(np.empty((n, 0)), rng.standard_normal((n, self.shared)))

    def draw_own(self, shared: FloatArray, rng: Generator) -> FloatArray:
        """One group's scores (n, d), given the shared ones of each row."""
        own = len(self.whole.correlation) - self.shared
        return self.completed(shared, rng.standard_normal((len(shared), own)))

    def completed(self, shared: FloatArray, normal: FloatArray) -> FloatArray:
        """One group's scores (n, d), given the shared ones of each row, from independent ones (n, d)."""
        return self.whole.completed(shared, normal)


@dataclass(frozen=True)
class GaussianSplit(Split):
    """The same of a Gaussian copula, in closed form."""

    whole: GaussianCopula

    @cached_property
    def _first(self) -> GaussianCopula:
        return self.whole.marginal(range(self.shared))

    @cached_property
    def _regression(self) -> FloatArray:
        """Mean (d, k) of a group's scores for each shared one."""
        k, R = self.shared, self.whole.correlation
        return np.asarray(np.linalg.solve(R[:k, :k], R[:k, k:]).T)

    @cached_property
    def _rest(self) -> FloatArray:
        """Cholesky factor (d, d) of the covariance of a group's scores given the shared ones."""
        k, R = self.shared, self.whole.correlation
        rest = R[k:, k:] - self._regression @ R[:k, k:]
        return np.asarray(np.linalg.cholesky(rest), dtype=np.float64)

    def log_shared(self, z: FloatArray) -> FloatArray:
        """See :class:`Split`."""
        excess, _, level = self._first.parts
        return np.asarray(level - 0.5 * np.einsum("ni,ij,nj->n", z, excess, z))

    def log_own(self, shared: FloatArray, own: FloatArray) -> FloatArray:
        """See :class:`Split`."""
        white = np.linalg.solve(self._rest, (own - shared @ self._regression.T).T)
        tied = 0.5 * ((own**2).sum(axis=1) - (white**2).sum(axis=0))
        return np.asarray(tied - np.log(np.diagonal(self._rest)).sum())

    def completed(self, shared: FloatArray, normal: FloatArray) -> FloatArray:
        """See :class:`Split`."""
        return shared @ self._regression.T + normal @ self._rest.T
