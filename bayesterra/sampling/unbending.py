"""Straightening curved ridges: a triangular polynomial map fitted to points, and mixtures behind it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.sampling.mixture import RandomSource, StudentMixture, defended, fit_mixture

REACH = 4.0
"""Standardised coordinates beyond this bend nothing further: far out the map is a mere shift."""


@dataclass(frozen=True)
class Unbending:
    """An invertible map u → v that takes from each coordinate what the ones before it predict.

    v_j = z_j − g_j(z of the coordinates before j), z = (u − centre)/scale, g_j a quadratic polynomial with
    pure cubes. The map is triangular, so its Jacobian is the constant ∏ 1/scale.

    Attributes
    ----------
    order : the coordinates, drivers first.
    centre, scale : of the points (d,).
    coefficients : of g_j for every position in ``order``.
    """

    order: tuple[int, ...]
    centre: FloatArray
    scale: FloatArray
    coefficients: tuple[FloatArray, ...]

    @property
    def log_scale(self) -> float:
        """Log |du/dv|."""
        return float(np.log(self.scale).sum())

    def straighten(self, u: FloatArray) -> FloatArray:
        """Straight coordinates v (n, d) of points u (n, d)."""
        z = np.ascontiguousarray((u - self.centre) / self.scale)
        return self._moved(z, -1.0)

    def bend(self, v: FloatArray) -> FloatArray:
        """Points u (n, d) of straight coordinates v (n, d)."""
        return self.centre + self.scale * self._moved(np.ascontiguousarray(v), 1.0)

    def _moved(self, points: FloatArray, sign: float) -> FloatArray:
        """Points (n, d) with sign · g_j added to every coordinate."""
        from bayesterra.sampling import _polynomials  # numba is heavy: only where it is needed

        out = np.empty(points.shape)
        _polynomials.move(points, *self._packed, REACH, sign, out)
        return out

    @cached_property
    def _packed(self) -> tuple[IntArray, FloatArray]:
        """Order (d,) and all coefficients one after another, as compiled code takes them."""
        return np.array(self.order, dtype=np.int64), np.concatenate(self.coefficients)


@cache
def _pairs(k: int) -> tuple[IntArray, IntArray]:
    """Indices of all products of two of k coordinates."""
    first, second = np.triu_indices(k)
    return first, second


def _features(z: FloatArray) -> FloatArray:
    """Polynomial terms (n, f) of coordinates (n, k): 1, z_i, z_i z_j, z_i³."""
    near = np.clip(z, -REACH, REACH)
    k = near.shape[1]
    first, second = _pairs(k)
    products = near[:, first] * near[:, second]
    return np.concatenate([np.ones((len(near), 1)), near, products, near**3], axis=1)


def fit_unbending(u: FloatArray, weights: FloatArray, widths: FloatArray) -> Unbending:
    """Fit the map to weighted points (n, d) by ridge regression.

    Parameters
    ----------
    u, weights : points and their weights (n,).
    widths : standard deviations of the prior in these coordinates (d,); coordinates that the data hardly
        narrow are the drivers, those that they narrow most follow from them.
    """
    weights = weights / weights.sum()
    centre = weights @ u
    scale = np.sqrt(weights @ (u - centre) ** 2) + 1e-300
    z = (u - centre) / scale
    order = tuple(int(j) for j in np.argsort(-scale / widths, kind="stable"))
    coefficients: list[FloatArray] = []
    for position, j in enumerate(order):
        terms = _features(z[:, order[:position]])
        weighted = terms * weights[:, None]
        normal = terms.T @ weighted + 1e-4 * np.eye(terms.shape[1])
        coefficients.append(np.asarray(np.linalg.solve(normal, weighted.T @ z[:, j]), dtype=np.float64))
    return Unbending(order, centre, scale, tuple(coefficients))


@dataclass(frozen=True)
class Proposal:
    """A mixture in straight coordinates, drawn from and evaluated in the bent ones."""

    unbending: Unbending
    mixture: StudentMixture

    def sample(self, n: int, random: RandomSource) -> FloatArray:
        """Draw n independent points u (n, d)."""
        return self.unbending.bend(self.mixture.sample(n, random))

    def log_density(self, u: FloatArray) -> FloatArray:
        """Log density (n,) at points u (n, d)."""
        return self.mixture.log_density(self.unbending.straighten(u)) - self.unbending.log_scale


def fit_proposal(
    u: FloatArray, weights: FloatArray, widths: FloatArray, components: int, defence: float, rng: Generator
) -> Proposal:
    """Straighten weighted points (n, d), fit a mixture to them and add a wide component."""
    unbending = fit_unbending(u, weights, widths)
    straight = unbending.straighten(u)
    mixture = fit_mixture(straight, weights, components, rng)
    return Proposal(unbending, defended(mixture, straight, weights, defence))
