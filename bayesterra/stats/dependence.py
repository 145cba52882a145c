"""Dependence of several laws through their normal scores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import FloatArray


@dataclass(frozen=True)
class SharedCopula:
    """Gaussian copula of a study's prior among what groups share and what one group has to itself.

    The shared scores have the copula's own marginal; a group's are conditional on them, and groups are
    independent given them. So shared parameters and those of any one group together have the whole copula.

    Attributes
    ----------
    correlation : (k + d, k + d) of normal scores, the k shared ones first.
    shared : k, of which there may be none.
    """

    correlation: FloatArray
    shared: int

    @cached_property
    def _first(self) -> tuple[FloatArray, FloatArray, float]:
        """R⁻¹ − 1, Cholesky factor of R and −½ log |R| of the shared scores."""
        return _excess(self.correlation[: self.shared, : self.shared])

    @cached_property
    def _regression(self) -> FloatArray:
        """Mean (d, k) of a group's scores for each shared one."""
        k, R = self.shared, self.correlation
        return np.asarray(np.linalg.solve(R[:k, :k], R[:k, k:]).T)

    @cached_property
    def _rest(self) -> FloatArray:
        """Cholesky factor (d, d) of the covariance of a group's scores given the shared ones."""
        k, R = self.shared, self.correlation
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

    def conditional(self, of: int, others: Sequence[int]) -> tuple[FloatArray, float]:
        """Regression (k,) of one score on k others, and the standard deviation that remains."""
        R = self.correlation
        slope = np.linalg.solve(R[np.ix_(others, others)], R[others, of])
        return np.asarray(slope), float(np.sqrt(1.0 - slope @ R[others, of]))

    def draw_shared(self, n: int, rng: Generator) -> FloatArray:
        """Shared scores (n, k)."""
        return rng.standard_normal((n, self.shared)) @ self._first[1].T

    def draw_own(self, shared: FloatArray, rng: Generator) -> FloatArray:
        """One group's scores (n, d), given the shared ones of each row."""
        normal = rng.standard_normal((len(shared), len(self._rest)))
        return shared @ self._regression.T + normal @ self._rest.T


def _excess(correlation: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """R⁻¹ − 1, Cholesky factor of R and −½ log |R| of a matrix of correlations, which may be empty."""
    factor = np.asarray(np.linalg.cholesky(correlation), dtype=np.float64)
    excess = np.asarray(np.linalg.inv(correlation) - np.eye(len(correlation)))
    return excess, factor, -float(np.log(np.diagonal(factor)).sum())
