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
