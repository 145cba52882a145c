"""Transport map: a triangular polynomial map that straightens curved ridges, fitted to points."""

import math
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.models.kernels import compiled
from bayesterra.stats.mixture import RandomSource, StudentMixture, fit_mixture, with_defensive_component


@compiled
def move(
    points: FloatArray,
    order: IntArray,
    coefficients: FloatArray,
    spreads: FloatArray,
    limits: tuple[float, float],
    inverse: bool,
    out: FloatArray,
    log_jacobian: FloatArray,
) -> None:
    """Fill ``out`` (n, d) with points (n, d) moved by the map, and ``log_jacobian`` (n,) with log |dz/dv|.

    Bent z_j = g_j + exp(h_j) v_j, with polynomials g_j and linear h_j of the bent coordinates before j: these
    are in ``points`` where the map straightens, in ``out``, where they have just been made, where it bends.
    Terms as in ``_features``; ``limits``: reach of the coordinates, and of the slopes of h_j.
    """
    d = points.shape[1]
    reach, most = limits
    near = np.empty(d)
    for row in range(points.shape[0]):
        first = linear = 0
        total = 0.0
        for position in range(d):
            j = order[position]
            g, h = coefficients[first], 0.0
            products, cubes = first + 1 + position, first + 1 + position + position * (position + 1) // 2
            for i in range(position):
                g += near[i] * (coefficients[first + 1 + i] + coefficients[cubes + i] * near[i] * near[i])
                h += spreads[linear + 1 + i] * near[i]
                for k in range(i, position):
                    g += coefficients[products] * near[i] * near[k]
                    products += 1
            h = spreads[linear] + min(max(h, -most), most)
            first, linear = cubes + position, linear + 1 + position
            if inverse:
                bent = points[row, j]
                out[row, j] = (bent - g) * math.exp(-h)
            else:
                bent = g + math.exp(h) * points[row, j]
                out[row, j] = bent
            total += h
            near[position] = min(max(bent, -reach), reach)
        log_jacobian[row] = total


REACH = 4.0
"""Standardised coordinates beyond this bend nothing further: far out the map is a mere shift."""
MOST = 3.0
"""Largest log by which a coordinate's spread varies."""
ROUNDS, HEAVY = 8, 4.0
"""Steps of the fit of the spreads, and the degrees of freedom of the residuals' law in it."""


@dataclass(frozen=True)
class TransportMap:
    """An invertible map u → v that takes from each coordinate what the ones before it predict.

    v_j = (z_j − g_j) exp(−h_j), z = (u − centre)/scale, with g_j a quadratic polynomial with pure cubes and
    h_j a linear function of the z before j. So curved ridges become straight, widening ones even.
    """

    order: tuple[int, ...]  # the coordinates, drivers first
    centre: FloatArray  # of the points (d,)
    scale: FloatArray  # of the points (d,)
    coefficients: tuple[FloatArray, ...]  # of g_j for every position in ``order``
    spreads: tuple[FloatArray, ...]  # of h_j likewise

    def inverse(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Straight coordinates v (n, d) of points u (n, d), and log |du/dv| (n,)."""
        z = np.ascontiguousarray((u - self.centre) / self.scale)
        return self._moved(z, inverse=True)

    def forward(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points u (n, d) of straight coordinates v (n, d), and log |du/dv| (n,)."""
        z, log_jacobian = self._moved(np.ascontiguousarray(v), inverse=False)
        return self.centre + self.scale * z, log_jacobian

    def _moved(self, points: FloatArray, *, inverse: bool) -> tuple[FloatArray, FloatArray]:
        out, log_jacobian = np.empty(points.shape), np.empty(len(points))
        move(points, *self._packed, (REACH, MOST), inverse, out, log_jacobian)
        return out, log_jacobian + self._log_scale

    @cached_property
    def _log_scale(self) -> float:
        return float(np.log(self.scale).sum())

    @cached_property
    def _packed(self) -> tuple[IntArray, FloatArray, FloatArray]:
        """Order (d,) and all coefficients one after another, as compiled code takes them."""
        order = np.array(self.order, dtype=np.int64)
        return order, np.concatenate(self.coefficients), np.concatenate(self.spreads)


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


def fit_transport_map(u: FloatArray, weights: FloatArray, widths: FloatArray, first: int = 0) -> TransportMap:
    """Fit the map to weighted points (n, d) by ridge regression.

    Parameters
    ----------
    u, weights : points and their weights (n,).
    widths : standard deviations of the prior in these coordinates (d,); coordinates that the data hardly
        narrow are the drivers, those that they narrow most follow from them.
    first : so many of the first coordinates come before all others and stay as they are, standardised.
    """
    weights = weights / weights.sum()
    centre = weights @ u
    scale = np.sqrt(weights @ (u - centre) ** 2) + 1e-300
    z = (u - centre) / scale
    others = first + np.argsort(-scale[first:] / widths[first:], kind="stable")
    order = (*range(first), *(int(j) for j in others))
    coefficients: list[FloatArray] = []
    spreads: list[FloatArray] = []
    for position, j in enumerate(order):
        before = z[:, order[:position]]
        terms = _features(before)
        if position < first:
            coefficients.append(np.zeros(terms.shape[1]))
            spreads.append(np.zeros(1 + position))
            continue
        residual = z[:, j] - terms @ _least_squares(terms, z[:, j], weights)
        spreads.append(_spreads(before, residual, weights))
        even = weights * np.exp(-2.0 * _log_spread(before, spreads[-1]))
        coefficients.append(_least_squares(terms, z[:, j], even / even.sum()))
    return TransportMap(order, centre, scale, tuple(coefficients), tuple(spreads))


def _least_squares(terms: FloatArray, values: FloatArray, weights: FloatArray) -> FloatArray:
    """Coefficients of weighted ridge regression."""
    weighted = terms * weights[:, None]
    normal = terms.T @ weighted + 1e-4 * np.eye(terms.shape[1])
    return np.asarray(np.linalg.solve(normal, weighted.T @ values), dtype=np.float64)


def _log_spread(before: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Log spread h (n,) at coordinates (n, k)."""
    varying = np.clip(before, -REACH, REACH) @ coefficients[1:]
    return np.asarray(coefficients[0] + np.clip(varying, -MOST, MOST))


def _spreads(before: FloatArray, residual: FloatArray, weights: FloatArray) -> FloatArray:
    """Coefficients of the log spread of residuals (n,) over coordinates (n, k): scoring for a t law."""
    terms = np.column_stack([np.ones(len(before)), np.clip(before, -REACH, REACH)])
    weighted = terms * weights[:, None]
    information = terms.T @ weighted + np.diag([0.0, *np.full(before.shape[1], 1e-3)])
    start = 0.5 * np.log(weights @ residual**2 + 1e-300)
    coefficients = np.array([start, *np.zeros(before.shape[1])])
    for _ in range(ROUNDS):
        squares = residual**2 * np.exp(-2.0 * _log_spread(before, coefficients))
        excess = (HEAVY + 1.0) * squares / (HEAVY + squares) - 1.0
        slope = weighted.T @ excess - np.array([0.0, *(1e-3 * coefficients[1:])])
        coefficients = coefficients + 0.5 * (HEAVY + 3.0) / HEAVY * np.linalg.solve(information, slope)
    return np.asarray(coefficients)


@dataclass(frozen=True)
class Proposal:
    """A mixture in straight coordinates, drawn from and evaluated in the bent ones."""

    transport_map: TransportMap
    mixture: StudentMixture

    def sample(self, n: int, random: RandomSource) -> FloatArray:
        """Draw n independent points u (n, d)."""
        return self.transport_map.forward(self.mixture.sample(n, random))[0]

    def log_density(self, u: FloatArray) -> FloatArray:
        """Log density (n,) at points u (n, d)."""
        v, log_jacobian = self.transport_map.inverse(u)
        return self.mixture.log_density(v) - log_jacobian


STEPS = 8
"""Steps of a proposal's fit: after more of them it is no better to draw from."""


def fit_proposal(
    u: FloatArray, weights: FloatArray, widths: FloatArray, components: int, defensive_weight: float, rng: Generator
) -> Proposal:
    """Straighten weighted points (n, d), fit a mixture to them and add a wide component."""
    transport_map = fit_transport_map(u, weights, widths)
    straight, _ = transport_map.inverse(u)
    mixture = fit_mixture(straight, weights, components, rng, steps=STEPS)
    return Proposal(transport_map, with_defensive_component(mixture, straight, weights, defensive_weight))
