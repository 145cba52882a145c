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
    points: FloatArray, order: IntArray, coefficients: FloatArray, spreads: FloatArray, limits: tuple[float, float],
    inverse: bool, out: FloatArray, log_jacobian: FloatArray,
) -> None:  # fmt: skip
    """Fill ``out`` (n, d) with points (n, d) moved by the map, and ``log_jacobian`` (n,) with log |dz/dv|.

    Bent z_j = g_j + exp(h_j) v_j, with polynomials g_j and linear h_j of the bent coordinates before j: these
    are in ``points`` where the map straightens, in ``out``, where they have just been made, where it bends.
    Terms as in ``_terms``; ``limits``: reach of the coordinates, and of the slopes of h_j.
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
def _terms(k: int) -> tuple[IntArray, tuple[IntArray, ...]]:
    """Terms of the polynomials of k coordinates: 1, z_i, z_i z_j, z_i³.

    Returns the factors (3, f) of each, 0 for the number one, i + 1 for z_i, those of the first coordinates first; and
    for p = 0 … k in which order :func:`move` takes those of p coordinates.
    """
    found: list[list[tuple[int, int, int]]] = []
    for p in range(k + 1):
        own = range(1, p + 1)
        products = [(0, i, j) for i in own for j in range(i, p + 1)]
        found.append([(0, 0, 0), *((0, 0, i) for i in own), *products, *((i, i, i) for i in own)])
    every = sorted(found[-1], key=lambda factors: factors[::-1])
    orders = tuple(np.array([every.index(factors) for factors in terms]) for terms in found)
    return np.array(every).T, orders


def fit_transport_map(u: FloatArray, weights: FloatArray, widths: FloatArray, first: int = 0) -> TransportMap:
    """Fit the map to weighted points (n, d) by ridge regression.

    Parameters
    ----------
    u, weights : points and their weights (n,).
    widths : standard deviations of the prior in these coordinates (d,); coordinates that the data hardly
        narrow are the drivers, those that they narrow most follow from them.
    first : so many of the first coordinates come before all others and stay as they are, standardised.
    """
    weights, d = weights / weights.sum(), u.shape[1]
    centre = weights @ u
    scale = np.sqrt(weights @ (u - centre) ** 2) + 1e-300
    others = first + np.argsort(-scale[first:] / widths[first:], kind="stable")
    order = (*range(first), *(int(j) for j in others))
    z = np.ascontiguousarray(((u - centre) / scale)[:, order])
    linear = np.concatenate([np.ones((len(z), 1)), np.clip(z[:, :-1], -REACH, REACH)], axis=1)
    (one, two, three), orders = _terms(d - 1)
    terms = linear[:, one] * linear[:, two] * linear[:, three]
    weighted = terms * weights[:, None]
    normal, products, plain = terms.T @ weighted, weighted.T @ z, np.zeros((terms.shape[1], d))
    for p in range(first, d):
        f = len(orders[p])
        plain[:f, p] = _ridge(normal[:f, :f], products[:f, p])
    spreads, log_spread = _spreads(linear, z - terms @ plain, weights)
    even = weights[:, None] * np.exp(-2.0 * log_spread)
    even /= even.sum(axis=0)
    coefficients = [np.zeros(len(orders[p])) for p in range(first)]
    for p in range(first, d):
        before = terms[:, : len(orders[p])]
        weighted = before * even[:, p, None]
        coefficients.append(_ridge(before.T @ weighted, weighted.T @ z[:, p])[orders[p]])
    kept = tuple(spreads[p, : 1 + p] if p >= first else np.zeros(1 + p) for p in range(d))
    return TransportMap(order, centre, scale, tuple(coefficients), kept)


def _ridge(normal: FloatArray, products: FloatArray) -> FloatArray:
    """Coefficients of weighted ridge regression."""
    return np.asarray(np.linalg.solve(normal + 1e-4 * np.eye(len(normal)), products), dtype=np.float64)


def _log_spread(linear: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Log spreads (n, d) at 1 and coordinates (n, d), for coefficients (d, d)."""
    varying = linear[:, 1:] @ coefficients[:, 1:].T
    return np.asarray(coefficients[:, 0] + np.minimum(np.maximum(varying, -MOST), MOST))


def _spreads(linear: FloatArray, residual: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients (d, d) of log spreads over 1 and the coordinates before, and log spreads (n, d).

    Scoring for a t law of residuals (n, d), of all coordinates at once.
    """
    d, weighted, squared = linear.shape[1], linear * weights[:, None], residual**2
    ridge = np.array([0.0, *np.full(d - 1, 1e-3)])
    information, inverse = linear.T @ weighted + np.diag(ridge), np.zeros((d, d, d))
    for p in range(d):
        inverse[p, : 1 + p, : 1 + p] = np.linalg.inv(information[: 1 + p, : 1 + p])
    coefficients = np.zeros((d, d))
    coefficients[:, 0] = 0.5 * np.log(weights @ squared + 1e-300)
    for _ in range(ROUNDS):
        squares = squared * np.exp(-2.0 * _log_spread(linear, coefficients))
        excess = (HEAVY + 1.0) * squares / (HEAVY + squares) - 1.0
        slope = excess.T @ weighted - ridge * coefficients
        coefficients = coefficients + 0.5 * (HEAVY + 3.0) / HEAVY * np.einsum("pij,pj->pi", inverse, slope)
    return coefficients, _log_spread(linear, coefficients)


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
