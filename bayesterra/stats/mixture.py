"""Importance sampling: weights, their effective number, resampling and smoothing; mixtures to draw from.

Mixtures are of multivariate Student-t or normal laws: density, draws, weighted fits.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.random import Generator, RandomState
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import gammaln, logsumexp

from bayesterra.arrays import FloatArray, IntArray, in_parts
from bayesterra.models.kernels import compiled
from bayesterra.stats.diagnostics import array_stats


def relative(log_weights: FloatArray) -> FloatArray:
    """Weights of any shape whose greatest is one; all 0 where no log weight is finite."""
    top = log_weights.max()
    return np.asarray(np.exp(log_weights - top)) if np.isfinite(top) else np.zeros_like(log_weights)


def normalised(log_weights: FloatArray) -> FloatArray:
    """Weights (n,) that sum to one."""
    return np.asarray(np.exp(log_weights - logsumexp(log_weights)))


def effective_number(weights: FloatArray) -> float:
    """Effective number of draws of weights of any scale (Kong 1992); 0 where none has any."""
    squares = (weights**2).sum()
    return float(weights.sum() ** 2 / squares) if squares > 0 else 0.0


def log_mean(log_values: ArrayLike, axis: int | None = None) -> FloatArray:
    """Log of the mean of what is given by its log."""
    values = np.asarray(log_values, dtype=np.float64)
    return np.asarray(logsumexp(values, axis=axis) - np.log(values.size if axis is None else values.shape[axis]))


def weighted_log_mean(log_weights: FloatArray, log_values: FloatArray) -> tuple[float, float]:
    """Log of the weighted mean of values given by their log, and its Monte Carlo error (delta method).

    ``log_weights`` (n,) sum to one as weights.
    """
    mean = float(logsumexp(log_weights + log_values))
    weights = np.exp(log_weights)
    some = weights > 0  # what has no weight may be too great for a number
    excess = weights[some] * np.expm1(log_values[some] - mean)
    return mean, float(np.sqrt((excess**2).sum()))


def weighted_quantiles(values: FloatArray, weights: FloatArray, probabilities: Sequence[float]) -> FloatArray:
    """Quantiles (k, d) of weighted values (n, d); every value stands at the middle of its share."""
    order = np.argsort(values, axis=0, kind="stable")
    quantiles = np.empty((len(probabilities), values.shape[1]))
    for column, ranks in enumerate(order.T):
        share = weights[ranks]
        below = np.cumsum(share) - 0.5 * share
        quantiles[:, column] = np.interp(probabilities, below / share.sum(), values[ranks, column])
    return quantiles


def systematic(weights: FloatArray, n: int, rng: Generator) -> IntArray:
    """Indices (n,) drawn in proportion to weights (k,) by systematic resampling."""
    steps = np.cumsum(weights) / weights.sum()
    return np.minimum(np.searchsorted(steps, (np.arange(n) + rng.random()) / n), len(weights) - 1)


def largest_power(log_factors: FloatArray, most: float, wanted: float, log_weights: FloatArray | float = 0.0) -> float:
    """Largest power, at most ``most``, of factors (n,) that leaves weights an effective number ``wanted``.

    Logs of both are finite.
    """

    def excess(power: float) -> float:
        return effective_number(relative(log_weights + power * log_factors)) - wanted

    if excess(most) >= 0:
        return most
    return float(brentq(excess, 0.0, most, xtol=1e-300, rtol=1e-6, maxiter=1000))  # powers can be very small


def pareto_smoothed(log_weights: FloatArray) -> tuple[FloatArray, float]:
    """Importance weights (n,) with a Pareto-smoothed tail, and its shape k̂ (Vehtari et al. 2024).

    Returns log weights that sum to one. A k̂ above :func:`pareto_limit` means that they cannot be relied on;
    it is infinite where the tail cannot be fitted, as so few draws have all the weight or the tail is one
    weight over and over, and 0 where the largest fifth of the weights are one and the same.
    """
    raw = np.asarray(log_weights, dtype=float)
    plain = raw - logsumexp(raw)
    ordered, n = np.sort(raw), len(raw)
    tail = int(3 * n**0.5 if n > 225 else n / 5)  # weights that the law is fitted to, as ArviZ takes them
    if np.ptp(ordered[-max(5, n // 5) :]) == 0.0:
        return plain, 0.0
    if tail < 5 or np.ptp(ordered[-tail:]) == 0.0:  # the same draw over and over, from a walker that stood
        return plain, np.inf
    with np.errstate(divide="ignore", invalid="ignore"):
        smoothed, k = array_stats().psislw(-raw)
    if np.isnan(smoothed).any() or np.isnan(k):
        return plain, np.inf
    return np.asarray(smoothed), float(k)


def pareto_limit(draws: int) -> float:
    """Largest k̂ at which this number of draws gives reliable means (Vehtari et al. 2024, eq. (13))."""
    return float(min(1.0 - 1.0 / np.log10(draws), 0.7))


LEAST, MOST, POINTS = 1e-250, 1000, 4096
"""Least sum of products, and greatest exponent, beside which logarithms are not needed; points looked at at once."""


@compiled
def weigh(
    points: FloatArray, inverse: FloatArray, offsets: FloatArray, parts: FloatArray, dof: float, twice: int,
    distances: FloatArray, terms: FloatArray, totals: FloatArray,
) -> None:  # fmt: skip
    """Fill ``distances`` (n, k) with squared lengths of L⁻¹ u − offset for points (n, d), ``terms`` with t laws.

    These are parts / (1 + distance / dof)^(twice / 2), products alone, and ``totals`` (n,) are their sums; where
    ``twice`` is 0 none of both. ``inverse`` (d, d, k) holds the lower triangles L⁻¹ of all components, ``offsets``
    is (d, k).
    """
    d, k = offsets.shape
    white, base = np.empty(k), np.empty(k)
    for row in range(points.shape[0]):
        for c in range(k):
            distances[row, c] = 0.0
        for a in range(d):
            for c in range(k):
                white[c] = -offsets[a, c]
            for b in range(a + 1):
                value = points[row, b]
                for c in range(k):
                    white[c] += inverse[a, b, c] * value
            for c in range(k):
                distances[row, c] += white[c] * white[c]
        if twice:
            for c in range(k):
                base[c] = 1.0 / (1.0 + distances[row, c] / dof)
                terms[row, c] = parts[c] * math.sqrt(base[c]) if twice % 2 else parts[c]
            power = twice // 2
            while power:
                for c in range(k):
                    terms[row, c] *= base[c] if power % 2 else 1.0
                    base[c] *= base[c]
                power //= 2
            total = 0.0
            for c in range(k):
                total += terms[row, c]
            totals[row] = total


RandomSource = Generator | RandomState
"""NumPy's generators, new and legacy."""


class ProposalLaw(Protocol):
    """A law that proposals are drawn from, independently of where a walker stands."""

    def sample(self, n: int, random: RandomSource) -> FloatArray:
        """Draw n independent points (n, d)."""

    def log_density(self, u: FloatArray) -> FloatArray:
        """Log density (n,) at points (n, d)."""


@dataclass(frozen=True)
class StudentMixture:
    """A mixture of k Student-t laws in d dimensions with common degrees of freedom."""

    weights: FloatArray  # (k,), summing to one
    means: FloatArray  # (k, d)
    factors: FloatArray  # (k, d, d) lower Cholesky factors of the scale matrices
    dof: float  # degrees of freedom; infinite for normal laws

    @cached_property
    def _whitening(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Inverse factors (d, d, k) and what they make of the means (d, k); log constants (k,)."""
        d, inverse = self.means.shape[1], np.linalg.inv(self.factors)
        offsets = np.einsum("kij,kj->ik", inverse, self.means)
        log_det = np.log(np.diagonal(self.factors, axis1=1, axis2=2)).sum(axis=1)
        if np.isinf(self.dof):
            constants = -0.5 * d * np.log(2 * np.pi)
        else:
            constants = gammaln(0.5 * (self.dof + d)) - gammaln(0.5 * self.dof) - 0.5 * d * np.log(self.dof * np.pi)
        triangles: FloatArray = np.ascontiguousarray(np.moveaxis(inverse, 0, -1), dtype=np.float64)
        return triangles, np.ascontiguousarray(offsets), np.log(self.weights) + constants - log_det

    def weighed(self, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Log density (n,) at points (n, d), each component's share (n, k) in it, and its squared distance (n, k)."""
        inverse, offsets, constants = self._whitening
        totals, shares, peak = np.zeros(len(u)), np.empty((len(u), len(constants))), np.full(len(u), constants.max())
        distances, twice = np.empty_like(shares), self.dof + len(offsets)
        products = int(twice) if twice < MOST and twice == int(twice) else 0
        points, parts = np.ascontiguousarray(u, dtype=np.float64), np.exp(constants - constants.max())
        weigh(points, inverse, offsets, parts, float(self.dof), products, distances, shares, totals)
        if (far := np.flatnonzero(~(totals > LEAST))).size:
            lengths = distances[far]
            terms = constants - 0.5 * (lengths if np.isinf(self.dof) else twice * np.log1p(lengths / self.dof))
            peak[far] = np.nan_to_num(terms.max(axis=1), nan=0.0, neginf=0.0)
            shares[far] = np.exp(terms - peak[far, None])
            totals[far] = shares[far].sum(axis=1)
        with np.errstate(divide="ignore"):
            return peak + np.log(totals), shares / np.maximum(totals, 1e-300)[:, None], distances

    def log_density(self, u: FloatArray) -> FloatArray:
        """Log density (n,) at points (n, d)."""
        return in_parts(lambda part: self.weighed(part)[0], POINTS, u)

    def sample(self, n: int, random: RandomSource) -> FloatArray:
        """Draw n independent points (n, d)."""
        d, last = self.means.shape[1], len(self.weights) - 1
        chosen = np.minimum(np.searchsorted(np.cumsum(self.weights), random.random(n)), last)
        stretch = np.ones(n) if np.isinf(self.dof) else np.sqrt(self.dof / random.chisquare(self.dof, n))
        normal = random.standard_normal((n, d))
        steps = np.einsum("nij,nj->ni", self.factors[chosen], normal)
        return np.asarray(self.means[chosen] + stretch[:, None] * steps)


def fit_mixture(
    u: FloatArray, weights: FloatArray, components: int, rng: Generator, *, dof: float = 4.0, steps: int = 25,
    gain: float = 1e-3, floor: float | None = None,
) -> StudentMixture:  # fmt: skip
    """Fit a mixture to weighted points by expectation–maximisation (t laws: Liu and Rubin 1995).

    Parameters
    ----------
    u : points (n, d).
    weights : their weights (n,), any positive scale.
    components : number of components to start with; those that lose their points are dropped.
    rng : chooses the starting centres.
    dof : degrees of freedom, held.
    steps : EM steps at most; it stops when the mean log density gains less than ``gain``.
    floor : least eigenvalue of a component's covariance, in units of the points' variances; None shrinks
        covariances towards that of all points instead, where a component has few.
    """
    weights = weights / weights.sum()
    centre = weights @ u
    spread = np.sqrt(weights @ (u - centre) ** 2)
    scale = np.where(spread > 0, spread, 1.0)
    points = _Points.of((u - centre) / scale, weights)
    # centres on points drawn by weight, each with the points' own covariance shrunk by the number
    means = points.z[rng.choice(len(points.z), size=components, p=points.weights)]
    factors = np.repeat(root(points.spread)[None] * components ** (-1.0 / u.shape[1]), components, axis=0)
    mixture, level = StudentMixture(np.full(components, 1.0 / components), means, factors, dof), -np.inf
    for _ in range(steps):
        total, share, distances = mixture.weighed(points.z)
        new_level = float(weights @ total)
        if new_level - level < gain:
            break
        level = new_level
        mixture = _maximise(points, weights[:, None] * share, distances, mixture, floor)
    return StudentMixture(mixture.weights, centre + scale * mixture.means, scale[:, None] * mixture.factors, dof)


def with_defensive_component(
    mixture: StudentMixture, u: FloatArray, weights: FloatArray, share: float
) -> StudentMixture:
    """Add one wide component over all weighted points, so that nothing near them is proposed too rarely."""
    weights = weights / weights.sum()
    centre = weights @ u
    factor = 1.3 * root(_spread(u - centre, weights))
    factors = np.concatenate([mixture.factors, factor[None]])
    grown = np.append((1 - share) * mixture.weights, share), np.vstack([mixture.means, centre])
    return StudentMixture(*grown, factors, mixture.dof)


def root(covariance: FloatArray) -> FloatArray:
    """Cholesky factors of covariances (..., d, d).

    Where rounding left one indefinite, as points on a ridge of no width do, all get a little more of their
    diagonals, and as much more as it takes.
    """
    diagonal = np.eye(covariance.shape[-1]) * (covariance + 1e-300)
    for more in (0.0, 1e-6, 1e-3, 1.0):
        try:
            return np.asarray(np.linalg.cholesky(covariance + more * diagonal))
        except np.linalg.LinAlgError:
            continue
    return np.sqrt(np.maximum(diagonal, 0.0))


@dataclass(frozen=True)
class _Points:
    """Standardised points (n, d), their weights (n,), outer products (n, d d) and overall spread (d, d)."""

    z: FloatArray
    weights: FloatArray
    outer: FloatArray
    spread: FloatArray

    @classmethod
    def of(cls, z: FloatArray, weights: FloatArray) -> "_Points":
        outer = (z[:, :, None] * z[:, None, :]).reshape(len(z), -1)
        return cls(z, weights, outer, _spread(z, weights))


def _spread(centred: FloatArray, weights: FloatArray) -> FloatArray:
    """Covariance (d, d) of centred weighted points, kept positive definite."""
    covariance = (centred * weights[:, None]).T @ centred
    return np.asarray(covariance + np.diag(1e-9 * np.diagonal(covariance) + 1e-300))


def _maximise(
    points: _Points, share: FloatArray, distances: FloatArray, mixture: StudentMixture, floor: float | None
) -> StudentMixture:
    """One M step; covariances have a floor, or are shrunk towards the overall one where points are few."""
    d, mass = points.z.shape[1], share.sum(axis=0)
    effective = mass**2 / np.maximum((share**2).sum(axis=0), 1e-300)
    kept = (effective > 2 * d) & (mass > 1e-4)
    if not kept.any():
        return mixture
    share, mass, effective = share[:, kept], mass[kept], effective[kept]
    normal = np.isinf(mixture.dof)
    robust = share if normal else share * (mixture.dof + d) / (mixture.dof + distances[:, kept])
    total = robust.sum(axis=0)[:, None]
    means = (robust.T @ points.z) / total
    second = (robust.T @ points.outer).reshape(-1, d, d)
    scatter = (second - total[:, :, None] * means[:, :, None] * means[:, None, :]) / mass[:, None, None]
    if floor is not None:
        values, directions = np.linalg.eigh(scatter)
        raised = directions * np.maximum(values, floor)[:, None, :]
        factors = root(raised @ directions.swapaxes(1, 2))
        return StudentMixture(mass / mass.sum(), means, factors, mixture.dof)
    shrink = (d / (effective + d))[:, None, None]
    volume = (mass ** (2.0 / d))[:, None, None]
    factors = root((1 - shrink) * scatter + shrink * volume * points.spread)
    return StudentMixture(mass / mass.sum(), means, factors, mixture.dof)
