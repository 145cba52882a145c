"""Data cloning: the posterior if the same readings had been made K times over (Lele et al. 2007, 2010).

The likelihood is raised to the power K = 1, 2, 4, …. Where the data determine a quantity its variance falls
as 1/K, slope −1 on log–log axes; where they do not, it stays what the prior makes it, slope 0. The directions
are those of the posterior's covariance against the cut prior's at the last K, in normal scores under the
stated laws. A ridge that bends in these keeps some spread across itself at every K.

Each power's draws come by importance sampling from a mixture fitted to the draws of the power before. Errors
are Monte Carlo errors only: a slope that is still changing with K shows in ``late_slope``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.random import Generator

from bayesterra.arrays import FloatArray
from bayesterra.coordinates import NormalScore, coordinates
from bayesterra.diagnostics import pareto_limit, pareto_smoothed
from bayesterra.identifiability.contraction import covariance, eigen_directions
from bayesterra.identifiability.groups import in_words, spaced
from bayesterra.laws import Law
from bayesterra.posteriors import Posterior
from bayesterra.sampling.adaptation import Densities
from bayesterra.sampling.importance import effective_draws, normalised, systematic
from bayesterra.sampling.sampler import Target
from bayesterra.sampling.unbending import fit_proposal

POWERS = (1, 2, 4, 8, 16, 32, 64)
DRAWS = 8192
"""Weighted draws at each power."""
FITTED = 1024
COMPONENTS = 4
DEFENCE = 0.1
ATTEMPTS = 3
"""Fits at each power, each to the draws of the one before, until its weights can be relied on."""
SHORTEST = 1.1
"""Ratio of powers that is not divided any further."""
LATE = 3
"""Powers, the last ones, that the late slope is of: two doublings."""
ENOUGH = 400
"""Effective draws below which the variances at a power are not relied on."""
ESTIMABLE, NOT_ESTIMABLE = -0.75, -0.25
"""Late slopes below and above which a quantity counts as estimable and as not."""


@dataclass(frozen=True)
class Cloned:
    """Variances at every power, and how they fall.

    Attributes
    ----------
    powers : K (k,).
    sd : standard deviations of the parameters (k, d), SI.
    eigenvalues : of the posterior's covariance against the cut prior's (k, d), the largest first.
    parameters : one row per parameter: parameter, slope (of log variance against log K, all powers), error,
        late_slope (the last two doublings), late_error, word (``estimable``, ``not estimable``,
        ``undecided``; ``unreliable`` where the weights behind the late slope are).
    directions : as ``parameters`` for the eigenvalues, the largest first, with combination (in words, in
        prior sds) in place of parameter.
    sampling : one row per power: power, effective (draws), k_hat, limit, reliable.
    """

    powers: tuple[int, ...]
    sd: FloatArray
    eigenvalues: FloatArray
    parameters: pd.DataFrame
    directions: pd.DataFrame
    sampling: pd.DataFrame

    @property
    def reliable(self) -> bool:
        """Whether the weights at every power can be relied on."""
        return bool(self.sampling["reliable"].all())


@dataclass(frozen=True)
class Cloud:
    """Weighted draws at one power.

    Attributes
    ----------
    u : sampling coordinates, or physical parameters, (n, d).
    log_likelihood : to the power 1 (n,).
    log_weights : summing to one (n,).
    k_hat : Pareto shape of the weights; NaN where they are all the same.
    """

    u: FloatArray
    log_likelihood: FloatArray
    log_weights: FloatArray
    k_hat: float = np.nan

    @property
    def effective(self) -> float:
        """Effective number of draws."""
        return effective_draws(np.exp(self.log_weights))

    @property
    def reliable(self) -> bool:
        """Whether enough draws are effective and the tail of the weights is light."""
        heavy = self.k_hat > pareto_limit(len(self.u))
        return self.effective >= ENOUGH and not heavy


def cloning(
    posterior: Posterior,
    prior: FloatArray,
    draws: FloatArray,
    rng: Generator,
    *,
    powers: Sequence[int] = POWERS,
) -> Cloned:
    """Clone the data of a posterior of which draws (n, d) are known; draws (m, d) of its cut prior."""
    target = Target(posterior, coordinates(posterior))
    start = target.coordinates.from_physical(spaced(draws, DRAWS))
    found = clouds(target.densities, start, powers, rng)
    physical = [replace(cloud, u=target.coordinates.to_physical(cloud.u)[0]) for cloud in found]
    laws = posterior.prior.laws.values()
    return cloned(posterior.names, powers, physical, prior, partial(_scores, tuple(laws)))


def _scores(laws: Sequence[Law], x: FloatArray) -> FloatArray:
    """Normal scores (n, d) of parameter sets (n, d) under their stated laws, which are smooth."""
    return np.column_stack(
        [NormalScore(law).from_physical(column) for law, column in zip(laws, x.T, strict=True)]
    )


def clouds(densities: Densities, start: FloatArray, powers: Sequence[int], rng: Generator) -> list[Cloud]:
    """Weighted draws at every power, the first being that of the draws ``start`` (n, d)."""
    even = np.full(len(start), -np.log(len(start)))
    found = [Cloud(start, densities(start)[1], even)]
    for before, power in pairwise(powers):
        found.append(_lifted(found[-1], before, power, densities, rng))
    return found


def _lifted(cloud: Cloud, before: float, power: float, densities: Densities, rng: Generator) -> Cloud:
    """Draws at a power from those at a power before, by way of powers in between where it is far."""
    weights = normalised(cloud.log_weights + (power - before) * cloud.log_likelihood)
    if effective_draws(weights) < ENOUGH and power / before > SHORTEST:
        middle = float(np.sqrt(before * power))
        return _lifted(_lifted(cloud, before, middle, densities, rng), middle, power, densities, rng)
    points, components = cloud.u[systematic(weights, FITTED, rng)], COMPONENTS
    for _ in range(ATTEMPTS):
        cloud = _drawn(points, components, power, densities, rng)
        if cloud.reliable:
            break
        points, components = cloud.u[systematic(np.exp(cloud.log_weights), 2 * FITTED, rng)], 2 * COMPONENTS
    return cloud


def _drawn(points: FloatArray, components: int, power: float, densities: Densities, rng: Generator) -> Cloud:
    """Importance draws at a power from a mixture fitted to points (n, d) near it."""
    proposal = fit_proposal(points, np.ones(len(points)), points.std(axis=0), components, DEFENCE, rng)
    u = proposal.sample(DRAWS, rng)
    log_prior, log_likelihood = densities(u)
    inside = np.isfinite(log_prior) & np.isfinite(log_likelihood)
    u, log_likelihood = u[inside], log_likelihood[inside]
    log_weights = log_prior[inside] + power * log_likelihood - proposal.log_density(u)
    smoothed, k_hat = pareto_smoothed(log_weights)
    return Cloud(u, log_likelihood, smoothed, k_hat)


def cloned(
    names: Sequence[str],
    powers: Sequence[int],
    found: Sequence[Cloud],
    prior: FloatArray,
    to_scores: Callable[[FloatArray], FloatArray],
) -> Cloned:
    """Variances and slopes of weighted draws at every power, here in physical units.

    ``prior`` holds draws (m, d) of the cut prior; ``to_scores`` makes normal scores of both.
    """
    single, before = np.eye(len(names)), covariance(to_scores(prior))
    physical = [cloud.u for cloud in found]
    scored = [to_scores(x) for x in physical]
    weights = [np.exp(cloud.log_weights) for cloud in found]
    spectra = [
        eigen_directions(before, np.atleast_2d(np.cov(z.T, aweights=w)))[1][:, ::-1]
        for z, w in zip(scored, weights, strict=True)
    ]
    own = [_spread(x, single, w) for x, w in zip(physical, weights, strict=True)]
    along = [_spread(z, turned, w) for z, turned, w in zip(scored, spectra, weights, strict=True)]
    words = [in_words(names, column) for column in spectra[-1].T]
    sound = all(cloud.reliable for cloud in found[-LATE:])
    return Cloned(
        powers=tuple(powers),
        sd=np.sqrt([variances for variances, _ in own]),
        eigenvalues=np.array([variances for variances, _ in along]),
        parameters=_slopes("parameter", names, powers, own, sound=sound),
        directions=_slopes("combination", words, powers, along, sound=sound),
        sampling=_sampling(powers, found),
    )


Spread = tuple[FloatArray, FloatArray]
"""Variances (d,) of weighted draws and their relative standard errors (d,)."""


def _spread(x: FloatArray, directions: FloatArray, weights: FloatArray) -> Spread:
    """Variances of draws (n, d) along directions (d, d), columns."""
    along = x @ directions
    squared = (along - weights @ along) ** 2
    variances = weights @ squared
    return variances, np.sqrt(weights**2 @ (squared / variances - 1.0) ** 2)


def _sampling(powers: Sequence[int], found: Sequence[Cloud]) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "power": list(powers),
            "effective": [cloud.effective for cloud in found],
            "k_hat": [cloud.k_hat for cloud in found],
            "limit": [pareto_limit(len(cloud.u)) for cloud in found],
            "reliable": [cloud.reliable for cloud in found],
        }
    )


def _slopes(
    kind: str, labels: Sequence[str], powers: Sequence[int], spreads: Sequence[Spread], *, sound: bool
) -> pd.DataFrame:
    variances, errors = (np.array(values) for values in zip(*spreads, strict=True))
    slope, error = fitted_slope(powers, variances, errors)
    late, late_error = fitted_slope(powers[-LATE:], variances[-LATE:], errors[-LATE:])
    return pd.DataFrame(
        {
            kind: list(labels),
            "slope": slope,
            "error": error,
            "late_slope": late,
            "late_error": late_error,
            "word": [word(*each) if sound else "unreliable" for each in zip(late, late_error, strict=True)],
        }
    )


def fitted_slope(powers: Sequence[int], variances: FloatArray, errors: FloatArray) -> Spread:
    """Slopes (d,) of log variances (k, d) against log power, weighted by their relative errors (k, d)."""
    total = (errors**-2.0).sum(axis=0)
    weights = errors**-2.0 / total
    x = np.log(np.asarray(powers, dtype=np.float64))[:, None]
    x = x - (weights * x).sum(axis=0)
    spread = (weights * x**2).sum(axis=0)
    return (weights * x * np.log(variances)).sum(axis=0) / spread, 1.0 / np.sqrt(total * spread)


def word(slope: float, error: float) -> str:
    """Whether a late slope, two errors allowed for, says ``estimable``, ``not estimable`` or neither."""
    if slope + 2.0 * error <= ESTIMABLE:
        return "estimable"
    return "not estimable" if slope - 2.0 * error >= NOT_ESTIMABLE else "undecided"
