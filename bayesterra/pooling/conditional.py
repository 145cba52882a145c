"""Laws of some coordinates given others: straightened, then a mixture of Student-t laws conditioned."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import FloatArray
from bayesterra.sampling.mixture import StudentMixture, defended, fit_mixture
from bayesterra.sampling.unbending import Unbending, fit_unbending


@dataclass(frozen=True)
class ConditionalLaw:
    """Law of coordinates (n, d) given others (n, k).

    Attributes
    ----------
    unbending : map of given and other coordinates together; the given ones are only standardised.
    mixture : law of both in straight coordinates, k + d of them.
    given : k, at least 1.
    """

    unbending: Unbending
    mixture: StudentMixture
    given: int

    @cached_property
    def _marginal(self) -> StudentMixture:
        k, of = self.given, self.mixture
        return StudentMixture(of.weights, of.means[:, :k], of.factors[:, :k, :k], of.dof)

    @cached_property
    def _inverses(self) -> FloatArray:
        """Inverse factors of the given coordinates (components, k, k)."""
        return np.asarray(np.linalg.inv(self._marginal.factors), dtype=np.float64)

    @cached_property
    def _log_scale(self) -> float:
        return float(np.log(self.unbending.scale[: self.given]).sum())

    def _standard(self, given: FloatArray) -> FloatArray:
        k = self.given
        return np.asarray((given - self.unbending.centre[:k]) / self.unbending.scale[:k])

    def straighten(self, given: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Straight coordinates v (n, d) of points (n, d), and log |d points/dv| (n,)."""
        v, log_jacobian = self.unbending.straighten(np.concatenate([given, points], axis=1))
        return v[:, self.given :], log_jacobian - self._log_scale

    def bend(self, given: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (n, d) of straight coordinates v (n, d), and log |d points/dv| (n,)."""
        u, log_jacobian = self.unbending.bend(np.concatenate([self._standard(given), v], axis=1))
        return u[:, self.given :], log_jacobian - self._log_scale

    def log_density(self, given: FloatArray, points: FloatArray) -> FloatArray:
        """Log density (n,) of points (n, d) given the others."""
        return self._log_straight(given, *self.straighten(given, points))

    def _log_straight(self, given: FloatArray, v: FloatArray, log_jacobian: FloatArray) -> FloatArray:
        at = self._standard(given)
        both = self.mixture.log_density(np.concatenate([at, v], axis=1))
        return both - self._marginal.log_density(at) - log_jacobian

    def log_given(self, given: FloatArray) -> FloatArray:
        """Log density (n,) of the given coordinates themselves under the law of both."""
        return self._marginal.log_density(self._standard(given)) - self._log_scale

    def sample(self, given: FloatArray, rng: Generator) -> tuple[FloatArray, FloatArray]:
        """One point for each row of ``given``, (n, d), and its log density (n,)."""
        k, at, of = self.given, self._standard(given), self.mixture
        distances = self._marginal.distances(at)
        terms = self._marginal.log_terms(distances)
        shares = np.cumsum(np.exp(terms - terms.max(axis=1, keepdims=True)), axis=1)
        chosen = (shares < rng.random((len(at), 1)) * shares[:, -1:]).sum(axis=1)
        white = np.einsum("nij,nj->ni", self._inverses[chosen], at - of.means[chosen, :k])
        factors, dof = of.factors[chosen], of.dof + k
        stretch = np.sqrt((of.dof + distances[np.arange(len(at)), chosen]) / rng.chisquare(dof, len(at)))
        normal = stretch[:, None] * rng.standard_normal((len(at), of.means.shape[1] - k))
        v = of.means[chosen, k:] + np.einsum("nij,nj->ni", factors[:, k:, :k], white)
        v += np.einsum("nij,nj->ni", factors[:, k:, k:], normal)
        points, log_jacobian = self.bend(given, v)
        return points, self._log_straight(given, v, log_jacobian)


def fit_conditional(
    given: FloatArray,
    points: FloatArray,
    widths: FloatArray,
    rng: Generator,
    *,
    components: int = 8,
    defence: float = 0.1,
) -> ConditionalLaw:
    """Fit the law of points (n, d) given others (n, k) to draws of both.

    Parameters
    ----------
    widths : standard deviations (d,) of the points before the data; see ``sampling.unbending``.
    components : of the mixture, at most; ``defence`` is the share of a wide one beside them.
    """
    u, weights = np.concatenate([given, points], axis=1), np.ones(len(points))
    scales = np.concatenate([np.ones(given.shape[1]), widths])
    unbending = fit_unbending(u, weights, scales, given.shape[1])
    v, _ = unbending.straighten(u)
    mixture = defended(fit_mixture(v, weights, components, rng), v, weights, defence)
    return ConditionalLaw(unbending, mixture, given.shape[1])
