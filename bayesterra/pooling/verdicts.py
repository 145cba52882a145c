"""Whether a parameter belongs to the soil or to each wheel: the evidence for one value against several.

From the groups' posteriors alone, π_g, and the prior p of a parameter θ, all other parameters being each
group's own, the Bayes factor of one common θ against one for each group is

    B = ∫ p(θ) ∏_g [π_g(θ)/p(θ)] dθ / ∫ p(θ) ∏_g [p_g(θ)/p(θ)] dθ,

p_g being the prior of group g cut to its physical support; the second integral is what the cut alone makes of
it. Both are taken in normal scores of the stated prior, where p is standard normal.

Values that differ by less than a wide prior allows would pass for one value by this factor alone (Lindley
1957). So a second alternative has its say: values of each group from a normal population, in scores, whose
mean has the prior's law and whose spread is half-normal with a scale of half the prior's standard deviation.
A common value must beat both, and is beaten by either.

That question leaves the other parameters open, so that what moves together, such as K and φ, hides
differences. :func:`sharing_as_stated` asks the other one: with what the study shares being shared, does a
parameter that each group has to itself have one value? With π(θ_1, …, θ_G) from the joint posterior,

    B = ∫ p(θ) π(θ, …, θ) / ∏_g p(θ) dθ,

over the same of the cut priors, which are taken as independent; likewise for the population. π is taken to be
the groups' marginal laws tied by a Gaussian copula.

All laws are fitted mixtures with tails a little heavier than normal ones: a large factor against one value is
understated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator, default_rng
from scipy.linalg import toeplitz
from scipy.special import logsumexp, ndtri

from bayesterra.arrays import FloatArray
from bayesterra.coordinates import NormalScore
from bayesterra.laws import Law
from bayesterra.pooling.copula import Copula, fit_copula
from bayesterra.sampling.mixture import StudentMixture, fit_mixture

STRONG = 3.0
"""Log Bayes factor (natural units) from which on the data decide: odds of 20 to 1, which Kass and Raftery
(1995, J. Am. Stat. Assoc. 90, 773) call strong."""
CONSTANT, DEPENDENT, OPEN = "soil constant", "dependent", "cannot tell"
FITTED, COMPONENTS, DOF = 4000, 6, 100.0
POINTS = 8000
GRID, SPREADS, PAIR_SPREADS = 901, 24, 10
FINE, DRAWN, WIDER = 4501, 2000, 1.3
SPREAD_SCALE = 0.5
"""Scale of the population's spread, in scores."""
REACH = 4.5
"""Largest score that counts. Beyond it there is next to no prior, and a fitted tail over the prior's, to the
power of the number of groups, would only multiply errors of the fit."""


@dataclass(frozen=True)
class Sharing:
    """What the groups' own posteriors say of one or several parameters having one value.

    Attributes
    ----------
    names : the parameters, judged together.
    own : log Bayes factor of common values against values of each group under the stated prior.
    population : the same against values of each group from one population.
    error : standard error of both, from the spread between ensembles.
    by : what groups the rows, for the wording.
    """

    names: tuple[str, ...]
    own: float
    population: float
    error: float
    by: str

    @property
    def log_factor(self) -> float:
        """Log Bayes factor of common values against the better of the two alternatives."""
        return min(self.own, self.population)

    @property
    def verdict(self) -> str:
        """``soil constant``, ``wheel-dependent`` (or ``site-``, ``run-``) or ``cannot tell``.

        Two standard errors must lie beyond the threshold.
        """
        if self.log_factor - 2 * self.error > STRONG:
            return CONSTANT
        if self.log_factor + 2 * self.error < -STRONG:
            return f"{self.by}-{DEPENDENT}"
        return OPEN


def sharing(
    names: Sequence[str],
    laws: Mapping[str, Law],
    posteriors: Sequence[FloatArray],
    priors: Sequence[FloatArray],
    by: str,
) -> Sharing:
    """Judge whether parameters have one value in all groups.

    Parameters
    ----------
    names : parameters to judge together, the columns of the draws.
    posteriors : for every group, draws of its own posterior (ensembles, n, k).
    priors : for every group, draws of its cut prior (n, k).
    """
    scores = [NormalScore(laws[name]) for name in names]

    def scored(x: FloatArray) -> FloatArray:
        return np.concatenate([s.from_physical(x[:, i : i + 1]) for i, s in enumerate(scores)], axis=1)

    before = _levels([scored(x) for x in priors], default_rng(0))
    each = [
        _levels([scored(x[e]) for x in posteriors], default_rng(1 + e)) - before
        for e in range(len(posteriors[0]))
    ]
    return _judged(tuple(names), np.array(each), by)


def sharing_as_stated(
    name: str, law: Law, draws: FloatArray, priors: Sequence[FloatArray], by: str
) -> Sharing:
    """Judge whether a parameter has one value in all groups, all others being as the study states them.

    Parameters
    ----------
    draws : of the joint posterior, the parameter's value in every group (ensembles, n, groups).
    priors : for every group, draws of its cut prior (n,).
    """
    score = NormalScore(law)

    def scored(x: FloatArray) -> FloatArray:
        return score.from_physical(x.reshape(-1, 1)).reshape(x.shape)

    before = _on_grid([_fitted(scored(x[:, None]), default_rng(0)) for x in priors])
    each = [_among(scored(x), default_rng(1 + e)) - before for e, x in enumerate(draws)]
    return _judged((name,), np.array(each), by)


def _judged(names: tuple[str, ...], each: FloatArray, by: str) -> Sharing:
    """From the log integrals (ensembles, 2) for a common value and for a population."""
    common, population = each.mean(axis=0)
    against = each[:, 0] - np.maximum(0.0, each[:, 1])
    error = float(max(against.std(ddof=1), each[:, 0].std(ddof=1)) / np.sqrt(len(each)))
    return Sharing(names, float(common), float(common - population), error, by)


def _levels(draws: Sequence[FloatArray], rng: Generator) -> FloatArray:
    """Log of the integrals for a common value and for a population; 0 for values of each group's own."""
    fits = [_fitted(z, rng) for z in draws]
    if draws[0].shape[1] == 1:
        return _on_grid(fits)
    return np.array([_log_common(fits, draws, rng), _log_population(draws)])


def _on_grid(fits: Sequence[StudentMixture]) -> FloatArray:
    """Both integrals of a single score, on a grid."""
    z = np.linspace(-REACH, REACH, GRID)
    step, normal = z[1] - z[0], _log_normal(z)
    ratios = np.array([fit.log_density(z[:, None]) - normal for fit in fits])
    common = logsumexp(normal + ratios.sum(axis=0)) + np.log(step)
    # spreads at equal shares of their prior; sums over a grid need spreads that it resolves
    spreads = np.maximum(_spreads(), 2.0 * step)
    top = ratios.max(axis=1, keepdims=True)
    levels = []
    for spread in spreads:
        kernel = toeplitz(np.exp(-0.5 * ((z - z[0]) / spread) ** 2))
        blurred = kernel @ np.exp(ratios - top).T * step / (spread * np.sqrt(2 * np.pi))
        levels.append(logsumexp(normal + (np.log(blurred + 1e-300) + top.T).sum(axis=1)) + np.log(step))
    return np.array([common, logsumexp(levels) - np.log(SPREADS)])


def _spreads() -> FloatArray:
    """Spreads of a population at equal shares of their prior."""
    return np.asarray(SPREAD_SCALE * ndtri(0.5 + 0.5 * (np.arange(SPREADS) + 0.5) / SPREADS))


def _among(z: FloatArray, rng: Generator) -> FloatArray:
    """Both integrals of one score of all groups, from draws (n, groups) of it."""
    groups = z.shape[1]
    law = fit_copula(z, [_fitted(column[:, None], rng) for column in z.T])
    at = np.linspace(-REACH, REACH, FINE)
    level = law.log_density(np.repeat(at[:, None], groups, axis=1)) - (groups - 1) * _log_normal(at)
    common = logsumexp(level) + np.log(at[1] - at[0])
    likely = fit_mixture(at[:, None], np.exp(level - level.max()), COMPONENTS, rng, dof=DOF)
    fresh = law.sample(DRAWN, rng)
    levels = [_population(law, fresh, likely, spread, rng) for spread in _spreads()]
    return np.array([common, logsumexp(levels) - np.log(SPREADS)])


def _population(
    law: Copula, fresh: FloatArray, likely: StudentMixture, spread: float, rng: Generator
) -> float:
    """Log of ∫ law · N(0, s² I + 1 1ᵀ) / N(0, I): values about a mean that is standard normal.

    By importance sampling, half of it from the law itself (``fresh``), which serves where that is narrower
    than the spread, half with the spread about common values that are likely, which serves where it is wider.
    """
    groups = fresh.shape[1]
    chosen = rng.choice(len(likely.weights), size=len(fresh), p=likely.weights)
    wide = WIDER * likely.factors[:, 0, 0]
    means = likely.means[chosen, 0] + wide[chosen] * rng.standard_normal(len(fresh))
    z = np.concatenate([fresh, means[:, None] + spread * rng.standard_normal((len(fresh), groups))])
    log_law = law.log_density(z)
    ratio = _log_about(z, 0.0, 1.0, spread) - _log_normal(z).sum(axis=1)
    parts = [
        np.log(weight) + _log_about(z, mean, sd, spread)
        for weight, mean, sd in zip(likely.weights, likely.means[:, 0], wide, strict=True)
    ]
    proposal = np.logaddexp(log_law, logsumexp(parts, axis=0)) - np.log(2.0)
    return float(logsumexp(log_law + ratio - proposal) - np.log(len(z)))


def _log_about(z: FloatArray, mean: float, sd: float, spread: float) -> FloatArray:
    """Log density (n,) of values (n, groups) with a spread about a value that is normal itself."""
    groups, apart = z.shape[1], z - mean
    all_ = spread**2 + groups * sd**2  # Sherman and Morrison 1950: inverse and determinant
    form = ((apart**2).sum(axis=1) - apart.sum(axis=1) ** 2 * sd**2 / all_) / spread**2
    logs = 2.0 * (groups - 1) * np.log(spread) + np.log(all_) + groups * np.log(2.0 * np.pi)
    return np.asarray(-0.5 * (form + logs))


def _beyond_prior(precision: FloatArray) -> FloatArray:
    """What a posterior's precision has over that of the standard normal prior; never less than nothing."""
    values, vectors = np.linalg.eigh(precision - np.eye(len(precision)))
    return np.asarray((vectors * np.maximum(values, 1e-3)) @ vectors.T)


def _log_normal(z: FloatArray) -> FloatArray:
    return np.asarray(-0.5 * z**2 - 0.5 * np.log(2 * np.pi))


def _log_common(fits: Sequence[StudentMixture], draws: Sequence[FloatArray], rng: Generator) -> float:
    """Log of ∫ φ ∏ [density_g / φ] over scores, φ standard normal, by importance sampling."""
    precision = [np.linalg.inv(np.cov(z.T) + 1e-12 * np.eye(z.shape[1])) for z in draws]
    k, excess = draws[0].shape[1], len(draws) - 1
    total = sum(precision, start=np.zeros((k, k)))
    centre = np.linalg.solve(
        total, sum((p @ z.mean(axis=0) for p, z in zip(precision, draws, strict=True)), start=np.zeros(k))
    )
    overlap = StudentMixture(
        np.ones(1), centre[None], 1.5 * np.linalg.cholesky(np.linalg.inv(total))[None], 4.0
    )
    laws = [*fits, overlap]
    shares = np.append(np.full(len(fits), 0.5 / len(fits)), 0.5)
    points = np.concatenate(
        [law.sample(round(share * POINTS), rng) for law, share in zip(laws, shares, strict=True)]
    )
    each = np.array([law.log_density(points) for law in laws])
    proposal = logsumexp(each + np.log(shares)[:, None], axis=0)
    level = each[:-1].sum(axis=0) - excess * _log_normal(points).sum(axis=1) - proposal
    level = np.where((np.abs(points) <= REACH).all(axis=1), level, -np.inf)
    return float(logsumexp(level) - np.log(len(points)))


def _log_population(draws: Sequence[FloatArray]) -> float:
    """Log of the integral for a population of several scores, every group's density taken as normal."""
    k = draws[0].shape[1]
    one = SPREAD_SCALE * ndtri(0.5 + 0.5 * (np.arange(PAIR_SPREADS) + 0.5) / PAIR_SPREADS)
    levels = [
        _gaussian_population(draws, np.array(spreads))
        for spreads in np.stack(np.meshgrid(*[one] * k), axis=-1).reshape(-1, k)
    ]
    return float(logsumexp(levels) - np.log(len(levels)))


def _gaussian_population(draws: Sequence[FloatArray], spreads: FloatArray) -> float:
    """The same for given spreads (k,); all integrals are Gaussian."""
    k, inverse = len(spreads), np.diag(spreads**-2.0)
    Q, r, total = np.eye(k), np.zeros(k), 0.0
    for z in draws:
        mean, covariance = z.mean(axis=0), np.cov(z.T)
        precision = np.linalg.inv(covariance)
        A, b = _beyond_prior(np.asarray(precision, dtype=float)), precision @ mean
        M = np.linalg.inv(inverse + A)
        total += -0.5 * mean @ b - 0.5 * np.linalg.slogdet(covariance)[1]
        total += 0.5 * (np.linalg.slogdet(inverse)[1] + np.linalg.slogdet(M)[1] + b @ M @ b)
        Q += inverse - inverse @ M @ inverse
        r += inverse @ M @ b
    return float(total - 0.5 * np.linalg.slogdet(Q)[1] + 0.5 * r @ np.linalg.solve(Q, r))


def _fitted(z: FloatArray, rng: Generator) -> StudentMixture:
    chosen = z[rng.choice(len(z), size=min(FITTED, len(z)), replace=False)]
    return fit_mixture(chosen, np.ones(len(chosen)), COMPONENTS, rng, dof=DOF)
