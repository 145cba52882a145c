"""Dependence of several laws through their normal scores z, of which each alone is standard normal.

So every parameter keeps its own law, to the last digits. A Gaussian copula takes the scores as jointly
normal. Mixture copulas follow ridges that bend: latent values y have a mixture of normal laws as their joint
law, and Φ(z_i) is the probability below y_i by the mixture's own marginal. A single component is the Gaussian
copula. Conditional laws are mixtures too.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.random import Generator, default_rng
from scipy.special import log_ndtr, ndtri_exp

from bayesterra.arrays import FloatArray, spaced
from bayesterra.errors import StudyError
from bayesterra.stats.mixture import StudentMixture, fit_mixture


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

    def marginal(self, at: Sequence[int]) -> "Dependence":
        """Dependence of some of the scores, in the order of ``at``."""

    def split(self, shared: int) -> "Split":
        """The same with the first ``shared`` scores common to groups and the others each group's own."""
        return Split(self, shared)


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

    def marginal(self, at: Sequence[int]) -> "GaussianCopula":
        """See :class:`Dependence`."""
        return GaussianCopula(self.correlation[np.ix_(at, at)])

    def split(self, shared: int) -> "GaussianSplit":
        """See :class:`Dependence`."""
        return GaussianSplit(self, shared)

    @cached_property
    def parts(self) -> tuple[FloatArray, FloatArray, float]:
        """R⁻¹ − 1, Cholesky factor of R and −½ log |R|; R may be empty."""
        factor = np.asarray(np.linalg.cholesky(self.correlation), dtype=np.float64)
        excess = np.asarray(np.linalg.inv(self.correlation) - np.eye(len(factor)))
        return excess, factor, -float(np.log(np.diagonal(factor)).sum())


@dataclass(frozen=True)
class JoinedDependence(Dependence):
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

    def marginal(self, at: Sequence[int]) -> "JoinedDependence":
        """See :class:`Dependence`."""
        sets = []
        for own, dependence in self.sets:
            places = tuple(place for place, i in enumerate(at) if i in own)
            if places:
                sets.append((places, dependence.marginal([own.index(at[place]) for place in places])))
        return JoinedDependence(tuple(sets))


@dataclass(frozen=True)
class Split:
    """Dependence among scores that groups share and those that one group has to itself.

    The shared scores have their own marginal; a group's are conditional on them, and groups are independent
    given them. So shared scores and those of any one group together have the whole dependence.
    """

    whole: Dependence  # dependence of k + d scores, the k shared ones first
    shared: int  # k, of which there may be none

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

    def first(self, normal: FloatArray) -> FloatArray:
        """Shared scores (n, k) from independent ones (n, k)."""
        return self._first.completed(np.empty((len(normal), 0)), normal)

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


FARTHEST = 37.0
"""Score beyond which nothing changes: Φ(−37) is the least probability that numbers hold."""
CLOSE = 1e-10
"""Last step, over 1 + |y|, of the search for a latent value; what Newton's method leaves is its square."""
STEPS = 100
"""Steps at most of that search; half a dozen serve."""
CORRELATION_DRAWS = 2**15
SINGULAR = 1e-9
"""Smallest eigenvalue of a covariance that can hold."""
COMPONENTS = (2, 4, 8, 12, 16, 24)
TRIED, FITTED = 4000, 20_000
"""Draws at most by which the number of components is chosen, and of the fit with it."""
THINNEST = 1e-7
"""Variance of scores that no ridge falls below, so that rounding leaves covariances what they are."""
EM_STEPS = 100
"""Steps of a fit at most."""
PATIENCE = 2
"""Numbers of components in a row without gain, after which no more are tried."""
FLOOR = 1e-4
"""Least eigenvalue of a component's covariance, in scores that the correlations are taken out of."""
_LOG_ROOT = 0.5 * float(np.log(2 * np.pi))


@dataclass(frozen=True)
class MixtureCopula(Dependence):
    """Scores whose latent values y have a mixture of k normal laws as their joint law.

    Attributes
    ----------
    weights : of the components, above 0; their sum is taken for 1.
    means : of y in each component, k rows of d.
    covariances : of y in each component, k matrices.

    Raises
    ------
    StudyError : numbers do not fit together, or no law has them.
    """

    weights: tuple[float, ...]
    means: tuple[tuple[float, ...], ...]
    covariances: tuple[tuple[tuple[float, ...], ...], ...]

    def __post_init__(self) -> None:
        k, d = len(self.weights), len(self.means[0]) if self.means else 0
        try:
            weights, means, covariances = (
                np.array(rows, dtype=np.float64) for rows in (self.weights, self.means, self.covariances)
            )
            fitting = means.shape == (k, d) and covariances.shape == (k, d, d) and k > 0 and d > 0
        except (TypeError, ValueError):
            fitting = False
        if not fitting:
            raise StudyError(
                "'weights', 'means' and 'covariances' must be k numbers, k rows of d and k matrices of d by d"
                f" (got {k} weights, {len(self.means)} means and {len(self.covariances)} covariances)"
            )
        if not ((weights > 0).all() and abs(weights.sum() - 1.0) < 1e-6):
            raise StudyError(f"'weights' must be above 0 and sum to 1 (got the sum {weights.sum():g})")
        for number, matrix in enumerate(covariances, start=1):
            least = float(np.linalg.eigvalsh(matrix)[0]) if np.isfinite(matrix).all() else np.nan
            if not (np.array_equal(matrix, matrix.T) and least > SINGULAR):
                raise StudyError(
                    "'covariances' must be symmetric with eigenvalues above 0"
                    f" (got {least:.2g} as the least one of matrix {number})"
                )
        if not np.abs(means).max() < FARTHEST:
            raise StudyError(f"'means' must lie within ±{FARTHEST:g}, as scores do")

    @cached_property
    def _mixture(self) -> StudentMixture:
        weights, covariances = np.array(self.weights), np.array(self.covariances)
        factors = np.asarray(np.linalg.cholesky(covariances))
        return StudentMixture(weights / weights.sum(), np.array(self.means), factors, np.inf)

    @cached_property
    def _marginals(self) -> "list[_Line]":
        """Marginal laws of the latent values."""
        mixture, logs = self._mixture, np.log(self._mixture.weights)[None]
        sds = np.sqrt(np.einsum("kii->ki", np.array(self.covariances)))
        return [_Line(logs, mixture.means[None, :, i], sds[None, :, i]) for i in range(sds.shape[1])]

    @cached_property
    def correlation(self) -> FloatArray:
        """See :class:`Dependence`; of many draws."""
        return np.asarray(np.corrcoef(self.sample(CORRELATION_DRAWS, default_rng(0)).T))

    def sample(self, n: int, rng: Generator) -> FloatArray:
        """Scores (n, d) of draws of the mixture."""
        y = self._mixture.sample(n, rng)
        return np.column_stack([law.score(y[:, i]) for i, law in enumerate(self._marginals)])

    def _latent(self, z: FloatArray) -> FloatArray:
        laws = self._marginals[: z.shape[1]]
        columns = [law.at_score(z[:, i]) for i, law in enumerate(laws)]
        return np.column_stack([np.empty((len(z), 0)), *columns])

    def log_density(self, z: FloatArray) -> FloatArray:
        """See :class:`Dependence`."""
        y = self._latent(z)
        own = sum(law.log_density(y[:, i]) for i, law in enumerate(self._marginals))
        return np.asarray(self._mixture.log_density(y) - own)

    def completed(self, given: FloatArray, normal: FloatArray) -> FloatArray:
        """See :class:`Dependence`.

        Each component's mean and weight follow from the values before.
        """
        k, y = given.shape[1], self._latent(given)
        weights, means, factors = (getattr(self._mixture, name) for name in ("weights", "means", "factors"))
        white, logs = np.zeros((len(normal), *means.shape)), np.tile(np.log(weights), (len(normal), 1))
        scores = np.empty_like(normal)
        for i, law in enumerate(self._marginals):
            middle = means[:, i] + np.einsum("nkj,kj->nk", white[:, :, :i], factors[:, i, :i])
            if i < k:
                value = y[:, i]
            else:
                value = _Line(logs, middle, factors[None, :, i, i]).at_score(normal[:, i - k])
                scores[:, i - k] = law.score(value) if i else normal[:, 0]
            white[:, :, i] = (value[:, None] - middle) / factors[:, i, i]
            logs = logs - 0.5 * white[:, :, i] ** 2 - np.log(factors[:, i, i])
            logs -= _log_sum(logs)[:, None]
        return scores

    def slope_and_curvature(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Slope (n, d) of :meth:`log_density`; curvature (n, d, d) of minus the log joint density.

        The curvature is the exact one without its negative part.
        """
        z = np.clip(z, -FARTHEST, FARTHEST)
        y, mixture = self._latent(z), self._mixture
        _, share, _ = mixture.weighed(y)
        precisions = np.linalg.inv(np.array(self.covariances))
        pulls = -np.einsum("kij,nkj->nki", precisions, y[:, None] - mixture.means)
        slope = np.einsum("nk,nki->ni", share, pulls)
        bend = np.einsum("nk,nki,nkj->nij", share, pulls, pulls) - slope[:, :, None] * slope[:, None, :]
        bend -= np.einsum("nk,kij->nij", share, precisions)
        own = [law.derivatives(y[:, i]) for i, law in enumerate(self._marginals)]
        level, first, second = (np.stack(columns, axis=1) for columns in zip(*own, strict=True))
        stretch = np.exp(-0.5 * z**2 - _LOG_ROOT - level)  # dy/dz
        log_bend = -z - first * stretch  # and of its logarithm
        along = slope * stretch * log_bend - 1.0 - stretch * (stretch * second + first * log_bend)
        whole = stretch[:, :, None] * bend * stretch[:, None, :] + along[:, :, None] * np.eye(z.shape[1])
        values, directions = np.linalg.eigh(-np.nan_to_num(whole))
        kept = (directions * np.maximum(values, 0.0)[:, None, :]) @ directions.swapaxes(1, 2)
        return (slope - first) * stretch, kept

    def marginal(self, at: Sequence[int]) -> "MixtureCopula":
        """See :class:`Dependence`."""
        means, covariances = np.array(self.means)[:, at], np.array(self.covariances)[:, at][:, :, at]
        return MixtureCopula.of(np.array(self.weights), means, covariances)

    @classmethod
    def of(cls, weights: FloatArray, means: FloatArray, covariances: FloatArray) -> "MixtureCopula":
        """The same from arrays (k,), (k, d) and (k, d, d)."""
        return cls(
            tuple(weights.tolist()),
            tuple(tuple(row) for row in means.tolist()),
            tuple(tuple(tuple(row) for row in matrix) for matrix in covariances.tolist()),
        )


@dataclass(frozen=True)
class _Line:
    """Mixtures of normal laws on a line (n or 1, k), one for each of n values, or the same for all."""

    log_weights: FloatArray
    means: FloatArray
    sds: FloatArray

    def score(self, y: FloatArray) -> FloatArray:
        """Normal scores (n,) of values (n,)."""
        t = (y[:, None] - self.means) / self.sds
        below, above = (_log_sum(self.log_weights + log_ndtr(side)) for side in (t, -t))
        with np.errstate(invalid="ignore"):
            z = np.where(below < above, ndtri_exp(np.minimum(below, 0.0)), -ndtri_exp(np.minimum(above, 0.0)))
        return np.asarray(np.clip(z, -FARTHEST, FARTHEST))

    def log_density(self, y: FloatArray) -> FloatArray:
        """Log density (n,) at values (n,)."""
        t = (y[:, None] - self.means) / self.sds
        return _log_sum(self.log_weights - 0.5 * t**2 - np.log(self.sds)) - _LOG_ROOT

    def derivatives(self, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Log density (n,) at values (n,), its first and its second derivative."""
        t = (y[:, None] - self.means) / self.sds
        terms = self.log_weights - 0.5 * t**2 - np.log(self.sds)
        level = _log_sum(terms)
        share = np.exp(terms - level[:, None])
        first = -(share * t / self.sds).sum(axis=1)
        second = (share * (t**2 - 1.0) / self.sds**2).sum(axis=1) - first**2
        return level - _LOG_ROOT, first, second

    def at_score(self, z: FloatArray) -> FloatArray:
        """Values (n,) at normal scores (n,), by Newton's method between the quantiles of the components."""
        n, k = len(z), self.means.shape[1]
        mirror, target = np.where(z > 0, -1.0, 1.0), -np.minimum(np.abs(z), FARTHEST)
        logs, means, sds = (
            np.broadcast_to(a, (n, k)) for a in (self.log_weights, mirror[:, None] * self.means, self.sds)
        )
        ends = means + sds * target[:, None]
        low, high = ends.min(axis=1), ends.max(axis=1)
        y = np.clip((np.exp(logs) * ends).sum(axis=1), low, high)
        open_ = np.flatnonzero(high - low > CLOSE * (1.0 + np.abs(y)))
        for _ in range(STEPS):
            if not open_.size:
                break
            t = (y[open_, None] - means[open_]) / sds[open_]
            level = _log_sum(logs[open_] - 0.5 * t**2 - np.log(sds[open_]))
            with np.errstate(all="ignore"):  # far above the middle no digits are left: halving serves
                now = ndtri_exp(np.minimum(_log_sum(logs[open_] + log_ndtr(t)), 0.0))
                new = y[open_] - (now - target[open_]) * np.exp(-0.5 * now**2 - level)
            above = ~(now < target[open_])
            high[open_] = np.where(above, y[open_], high[open_])
            low[open_] = np.where(above, low[open_], y[open_])
            close = CLOSE * (1.0 + np.abs(y[open_]))
            inside = (new > low[open_] - close) & (new < high[open_] + close)
            new = np.where(inside, new, 0.5 * (low[open_] + high[open_]))
            moved, y[open_] = np.abs(new - y[open_]), new
            open_ = open_[moved > close]
        return np.asarray(mirror * y)


def _log_sum(terms: FloatArray) -> FloatArray:
    """Log (n,) of the sum of exponentials of terms (n, k)."""
    peak = terms.max(axis=1, keepdims=True)
    return np.asarray((peak + np.log(np.exp(terms - peak).sum(axis=1, keepdims=True)))[:, 0])


def fit_mixture_copula(z: FloatArray) -> tuple[MixtureCopula, list[tuple[MixtureCopula, FloatArray]]]:
    """Fit a mixture copula to nearly independent scores (n, d); the same scores give the same fit.

    The number of components is the one with the greatest density of draws that were held out: every fourth
    one, under the fit to the others.

    Returns
    -------
    The fit to all, and for either half of some thousand the fit to it with the scores that it has not seen.
    """
    few, z = spaced(z, TRIED), spaced(z, FITTED)
    unseen = np.arange(len(few)) % 4 == 0
    best, least, idle = COMPONENTS[0], -np.inf, 0
    for components in COMPONENTS:
        level = float(_fitted(few[~unseen], components).log_density(few[unseen]).mean())
        idle += 1
        if level > least:
            best, least, idle = components, level, 0
        if idle == PATIENCE:
            break
    halves = ((few[::2], few[1::2]), (few[1::2], few[::2]))
    return _fitted(z, best), [(_fitted(seen, best), other) for seen, other in halves]


def _fitted(z: FloatArray, components: int) -> MixtureCopula:
    """The fit by expectation–maximisation, rounded to what a file says."""
    root, weights = np.asarray(np.linalg.cholesky(np.corrcoef(z.T))), np.ones(len(z))
    u = np.asarray(np.linalg.solve(root, z.T).T, dtype=np.float64)
    mixture = fit_mixture(u, weights, components, default_rng(0), dof=np.inf, steps=EM_STEPS, gain=1e-4, floor=FLOOR)
    factors = root @ mixture.factors
    covariances = np.round(factors @ factors.swapaxes(1, 2) + THINNEST * np.eye(z.shape[1]), 8)
    shares, means = np.round(mixture.weights, 8), np.round(mixture.means @ root.T, 8)
    return MixtureCopula.of(shares, means, np.tril(covariances) + np.tril(covariances, -1).swapaxes(1, 2))
