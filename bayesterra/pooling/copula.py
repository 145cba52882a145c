"""Joint law of one quantity in several groups: any law in each group, tied together by a Gaussian copula."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import Generator
from scipy.special import ndtri, stdtr
from scipy.stats import rankdata

from bayesterra.arrays import FloatArray
from bayesterra.sampling.mixture import StudentMixture

POINTS, REACH = 4001, 9.0
"""At how many points normal scores are tabulated, and how far about every component of a law, in its standard
deviations; beyond, where there is nothing of the law, they stay what they are at the ends."""


@dataclass(frozen=True)
class Copula:
    """Law of the same quantity in G groups.

    Attributes
    ----------
    laws : of each group alone, in one dimension.
    correlation : (G, G), of normal scores.
    """

    laws: tuple[StudentMixture, ...]
    correlation: FloatArray

    @cached_property
    def _factor(self) -> FloatArray:
        return np.asarray(np.linalg.cholesky(self.correlation), dtype=np.float64)

    @cached_property
    def _tables(self) -> tuple[tuple[FloatArray, FloatArray], ...]:
        """Normal scores of each group at points of it, both rising."""
        tables = []
        for law in self.laws:
            width = REACH * law.factors[:, 0, 0]
            ends = (law.means[:, 0] - width).min(), (law.means[:, 0] + width).max()
            at = np.linspace(*ends, POINTS)
            tables.append((_score(law, at), at))
        return tuple(tables)

    def log_density(self, z: FloatArray) -> FloatArray:
        """Log density (n,) at points (n, G)."""
        alone = [law.log_density(at[:, None]) for law, at in zip(self.laws, z.T, strict=True)]
        scores = np.array([np.interp(at, x, s) for at, (s, x) in zip(z.T, self._tables, strict=True)])
        white = np.linalg.solve(self._factor, scores)
        tied = 0.5 * ((scores**2).sum(axis=0) - (white**2).sum(axis=0))
        return np.asarray(np.sum(alone, axis=0) + tied - np.log(np.diagonal(self._factor)).sum())

    def sample(self, n: int, rng: Generator) -> FloatArray:
        """Draw points (n, G)."""
        scores = rng.standard_normal((n, len(self.laws))) @ self._factor.T
        columns = [np.interp(s, *table) for s, table in zip(scores.T, self._tables, strict=True)]
        return np.column_stack(columns)


def fit_copula(z: FloatArray, laws: Sequence[StudentMixture]) -> Copula:
    """Tie laws of each group to what draws (n, G) of all say of their dependence."""
    scores = ndtri((rankdata(z, axis=0) - 0.5) / len(z))
    return Copula(tuple(laws), np.asarray(np.corrcoef(scores.T), dtype=np.float64))


def _score(law: StudentMixture, at: FloatArray) -> FloatArray:
    """Normal scores (n,) of points (n,); exact in both tails."""
    t = (at[:, None] - law.means[:, 0]) / law.factors[:, 0, 0]
    below, above = (np.maximum(stdtr(law.dof, side) @ law.weights, 1e-300) for side in (t, -t))
    return np.asarray(np.where(below < above, ndtri(below), -ndtri(above)))


@dataclass(frozen=True)
class SharedCopula:
    """Gaussian copula of a study's prior among what groups share and what one group has to itself.

    The shared scores have the copula's own marginal; a group's are conditional on them, and groups are
    independent given them. So shared parameters and those of any one group together have the whole copula.

    Attributes
    ----------
    correlation : (k + d, k + d) of normal scores, the k shared ones first.
    given : k, of which there may be none.
    """

    correlation: FloatArray
    given: int

    @cached_property
    def _first(self) -> tuple[FloatArray, FloatArray, float]:
        """R⁻¹ − 1, Cholesky factor of R and −½ log |R| of the shared scores."""
        return _excess(self.correlation[: self.given, : self.given])

    @cached_property
    def _regression(self) -> FloatArray:
        """Mean (d, k) of a group's scores for each shared one."""
        k, R = self.given, self.correlation
        return np.asarray(np.linalg.solve(R[:k, :k], R[:k, k:]).T)

    @cached_property
    def _rest(self) -> FloatArray:
        """Cholesky factor (d, d) of the covariance of a group's scores given the shared ones."""
        k, R = self.given, self.correlation
        rest = R[k:, k:] - self._regression @ R[:k, k:]
        return np.asarray(np.linalg.cholesky(rest), dtype=np.float64)

    def log_shared(self, z: FloatArray) -> FloatArray:
        """Log joint density (n,) of shared scores (n, k) over the product of their own densities."""
        excess, _, level = self._first
        return np.asarray(level - 0.5 * np.einsum("ni,ij,nj->n", z, excess, z))

    def log_own(self, shared: FloatArray, own: FloatArray) -> FloatArray:
        """Log density (n,) of a group's scores (n, d) given the shared ones, over that without dependence."""
        white = np.linalg.solve(self._rest, (own - shared @ self._regression.T).T)
        tied = 0.5 * ((own**2).sum(axis=1) - (white**2).sum(axis=0))
        return np.asarray(tied - np.log(np.diagonal(self._rest)).sum())

    def draw_shared(self, n: int, rng: Generator) -> FloatArray:
        """Shared scores (n, k)."""
        return rng.standard_normal((n, self.given)) @ self._first[1].T

    def draw_own(self, shared: FloatArray, rng: Generator) -> FloatArray:
        """One group's scores (n, d), given the shared ones of each row."""
        normal = rng.standard_normal((len(shared), len(self._rest)))
        return shared @ self._regression.T + normal @ self._rest.T


def _excess(correlation: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """R⁻¹ − 1, Cholesky factor of R and −½ log |R| of a matrix of correlations, which may be empty."""
    factor = np.asarray(np.linalg.cholesky(correlation), dtype=np.float64)
    excess = np.asarray(np.linalg.inv(correlation) - np.eye(len(correlation)))
    return excess, factor, -float(np.log(np.diagonal(factor)).sum())
