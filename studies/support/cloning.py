"""Data cloning and power-scaling: what more of the same data would narrow, and the prior's hold on each parameter.

The likelihood is raised to the power K = 1, 2, 4, …. Where the data determine a quantity its variance falls
as 1/K, slope −1 on log–log axes; where they do not, it stays what the prior makes it, slope 0. The directions
are those of the posterior's covariance against the cut prior's at the last K, in normal scores under the
stated laws. A ridge that bends in these keeps some spread across itself at every K.

Each power's draws come by importance sampling from a mixture fitted to the draws of the power before. Errors
are Monte Carlo errors only: a slope that is still changing with K shows in ``late_slope``.

Power-scaling (Kallioinen et al. 2024): likelihood or prior to the powers α = 0.99 and 1.01 by importance
weights; the sensitivity is the cumulative Jensen–Shannon distance (Nguyen and Vreeken 2015) by which a
parameter's law moves, per doubling of α. The likelihood is scaled so.

A flat law to any power is the same flat law: ordinary power-scaling of the prior is silent there, whatever
the prior does. So a law is scaled in the parameter's normal score z under it, where every law is the standard
normal one: weights exp(−(α − 1) z²/2), which for α > 1 draw it in around its median and for α < 1 push it out
towards its ends. For a normal law that is ordinary power-scaling; the result does not change with the scale
that a parameter is stated in. Laws that depend on each other are scaled together, by weights
exp(−(α − 1) zᵀR⁻¹z/2) where they correlate. The physical cut is not scaled: it is no opinion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.random import Generator, SeedSequence, default_rng
from scipy.sparse.csgraph import connected_components

from bayesterra.arrays import FloatArray, spaced
from bayesterra.identifiability.verdicts import STRUCTURAL, covariance, eigen_directions, in_words
from bayesterra.likelihood.joint import Whole, whole_posterior
from bayesterra.sampling.adaptation import Densities
from bayesterra.sampling.coordinates import coordinates
from bayesterra.sampling.joint import sample_whole
from bayesterra.sampling.sampler import PRIOR_DRAWS, Target, thin
from bayesterra.stats.dependence import MixtureCopula
from bayesterra.stats.laws import Law
from bayesterra.stats.mixture import effective_number, normalised, pareto_limit, pareto_smoothed, systematic
from bayesterra.stats.transport import fit_proposal
from bayesterra.study.study import Study

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
        """True where the weights at every power can be relied on."""
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
        return effective_number(np.exp(self.log_weights))

    @property
    def reliable(self) -> bool:
        """True where enough draws are effective and the tail of the weights is light."""
        heavy = self.k_hat > pareto_limit(len(self.u))
        return self.effective >= ENOUGH and not heavy


def cloning(
    posterior: Whole, prior: FloatArray, draws: FloatArray, rng: Generator, *, powers: Sequence[int] = POWERS
) -> Cloned:
    """Clone the data of a posterior of which draws (n, d) are known; draws (m, d) of its cut prior."""
    target = Target(posterior, coordinates(posterior))
    start = target.coordinates.from_physical(spaced(draws, DRAWS))
    samples = clouds(target.densities, start, powers, rng)
    physical = [replace(cloud, u=target.coordinates.to_physical(cloud.u)[0]) for cloud in samples]
    return cloned(posterior.names, powers, physical, prior, posterior.prior.scores)


def clouds(densities: Densities, start: FloatArray, powers: Sequence[int], rng: Generator) -> list[Cloud]:
    """Weighted draws at every power, the first being that of the draws ``start`` (n, d)."""
    even = np.full(len(start), -np.log(len(start)))
    samples = [Cloud(start, densities(start)[1], even)]
    for before, power in pairwise(powers):
        samples.append(_lifted(samples[-1], before, power, densities, rng))
    return samples


def _lifted(cloud: Cloud, before: float, power: float, densities: Densities, rng: Generator) -> Cloud:
    """Draws at a power from those at a power before, by way of powers in between where it is far."""
    weights = normalised(cloud.log_weights + (power - before) * cloud.log_likelihood)
    if effective_number(weights) < ENOUGH and power / before > SHORTEST:
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
    samples: Sequence[Cloud],
    prior: FloatArray,
    to_scores: Callable[[FloatArray], FloatArray],
) -> Cloned:
    """Variances and slopes of weighted draws at every power, here in physical units.

    ``prior`` holds draws (m, d) of the cut prior; ``to_scores`` makes normal scores of both.
    """
    single, before = np.eye(len(names)), covariance(to_scores(prior))
    physical = [cloud.u for cloud in samples]
    scored = [to_scores(x) for x in physical]
    weights = [np.exp(cloud.log_weights) for cloud in samples]
    spectra = [
        eigen_directions(before, np.atleast_2d(np.cov(z.T, aweights=w)))[1][:, ::-1]
        for z, w in zip(scored, weights, strict=True)
    ]
    own = [_spread(x, single, w) for x, w in zip(physical, weights, strict=True)]
    along = [_spread(z, turned, w) for z, turned, w in zip(scored, spectra, weights, strict=True)]
    words = [in_words(names, column) for column in spectra[-1].T]
    sound = all(cloud.reliable for cloud in samples[-LATE:])
    return Cloned(
        powers=tuple(powers),
        sd=np.sqrt([variances for variances, _ in own]),
        eigenvalues=np.array([variances for variances, _ in along]),
        parameters=_slopes("parameter", names, powers, own, sound=sound),
        directions=_slopes("combination", words, powers, along, sound=sound),
        sampling=pd.DataFrame(
            {
                "power": list(powers),
                **{name: [getattr(cloud, name) for cloud in samples] for name in ("effective", "k_hat")},
                "limit": [pareto_limit(len(cloud.u)) for cloud in samples],
                "reliable": [cloud.reliable for cloud in samples],
            }
        ),
    )


CLONES = (1, 2, 4, 8, 16)
"""Up to sixteen times the readings: what that many do not narrow, a campaign will not."""


def cloned_words(study: Study, seed: int) -> list[str]:
    """Word of data cloning for every parameter of a study, of the draws that ``identify`` takes with this seed.

    Empty where the weights cannot be relied on, or the slope leaves it open.
    """
    posterior = whole_posterior(study)
    analysing, sampling, drawing = SeedSequence(seed).spawn(3)
    prior = posterior.cut_prior(PRIOR_DRAWS, default_rng(drawing))
    draws = thin(sample_whole(posterior, study.sampling, sampling, lambda progress: None).chains).flat
    rng = default_rng(analysing.spawn(4)[3])
    words = cloning(posterior, prior, draws, rng, powers=CLONES).parameters["word"]
    return [word if word in ("estimable", "not estimable") else "" for word in words]


def cloning_objection(verdict: str, cloned: str) -> str:
    """What data cloning says against a verdict; nothing where they agree."""
    if verdict == "determined" and cloned == "not estimable":
        return "more of the same data would not narrow it"
    unknown = verdict in ("repeats its prior", STRUCTURAL)
    return "more of the same data would narrow it" if unknown and cloned == "estimable" else ""


Spread = tuple[FloatArray, FloatArray]
"""Variances (d,) of weighted draws and their relative standard errors (d,)."""


def _spread(x: FloatArray, directions: FloatArray, weights: FloatArray) -> Spread:
    """Variances of draws (n, d) along directions (d, d), columns."""
    along = x @ directions
    squared = (along - weights @ along) ** 2
    variances = weights @ squared
    return variances, np.sqrt(weights**2 @ (squared / variances - 1.0) ** 2)


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
    """Word for a late slope, two errors allowed for: ``estimable``, ``not estimable`` or neither."""
    if slope + 2.0 * error <= ESTIMABLE:
        return "estimable"
    return "not estimable" if slope - 2.0 * error >= NOT_ESTIMABLE else "undecided"


ALPHAS = (0.99, 1.01)
SENSITIVE = 0.05
"""Sensitivity from which a law counts as moved (Kallioinen et al. 2024)."""
REPEATED = 0.5
"""Share of the cut prior's own sensitivity to a law from which the posterior follows that law."""

POWER_DRAWS = 4000

SHUFFLES = 20


@dataclass(frozen=True)
class PowerScaling:
    """Sensitivity of every parameter to prior and likelihood.

    A normal posterior that is all likelihood, or all prior, has the sensitivity 0.089 to it.

    Attributes
    ----------
    table : one row per parameter: parameter, prior (sensitivity to all laws at once), own (to the
        parameter's own law), cut_own (of the cut prior itself to that law), strongest (whose law moves it
        most), strongest_law (how much), likelihood, noise (95 % point of the likelihood's for a parameter
        that has nothing to do with it), silent (whether ordinary power-scaling cannot see the law because it
        is flat), word.
    by_law : sensitivity of every parameter (rows) to every parameter's law (columns), (d, d).
    k_hat : greatest Pareto shape of the weights.
    limit : greatest shape at which they can be relied on.
    """

    table: pd.DataFrame
    by_law: FloatArray
    k_hat: float
    limit: float

    @property
    def reliable(self) -> bool:
        """True where the weights have a light tail."""
        return self.k_hat <= self.limit


def power_scaling(posterior: Whole, prior: FloatArray, draws: FloatArray, rng: Generator) -> PowerScaling:
    """Scale prior and likelihood around nearly independent posterior draws (n, d); the cut prior's (m, d)."""
    draws, prior = spaced(draws, POWER_DRAWS), spaced(prior, POWER_DRAWS)
    laws = list(posterior.prior.laws.values())
    flat = [bool(np.ptp(law.log_density(x)) < 1e-9) for law, x in zip(laws, draws.T, strict=True)]
    likelihood = Reweighted(posterior.log_prior_and_likelihood(draws)[1])
    joint = posterior.prior.score_correlation
    flat = [own and i not in posterior.prior.correlated for i, own in enumerate(flat)]
    stated = Stated(posterior.names, laws, flat, joint, posterior.prior.mixed)
    return scaled(stated, likelihood, prior, draws, noise=likelihood.noise(rng))


@dataclass(frozen=True)
class Stated:
    """The free parameters, their laws, which of these are flat, and how their normal scores depend."""

    names: Sequence[str]
    laws: Sequence[Law]
    flat: Sequence[bool]
    correlation: FloatArray | None = None
    mixed: Sequence[tuple[list[int], MixtureCopula]] = ()

    def densities(self, x: FloatArray) -> list[Reweighted]:
        """Log densities of the normal scores of parameter sets (n, d), parameter by parameter.

        Parameters that depend on each other in the prior have one law together, which is scaled as a whole.
        """
        by_parameter, links = self._parts(x), self._joint != 0
        for columns, _ in self.mixed:
            links[np.ix_(columns, columns)] = True
        joined = connected_components(links)[1]
        return [Reweighted(by_parameter[:, joined == label].sum(axis=1)) for label in joined]

    def together(self, x: FloatArray) -> Reweighted:
        """Log density of the normal scores of parameter sets (n, d) under all laws at once."""
        return Reweighted(self._parts(x).sum(axis=1))

    def _parts(self, x: FloatArray) -> FloatArray:
        """Terms (n, d) of −½ zᵀR⁻¹z, one for every parameter; those of a joint law belong together.

        What a mixture adds stands with the first of its parameters.
        """
        z = np.column_stack([law.score(column) for law, column in zip(self.laws, x.T, strict=True)])
        terms = np.asarray(-0.5 * z * np.linalg.solve(self._joint, z.T).T)
        for columns, mixture in self.mixed:
            terms[:, columns[0]] += mixture.log_density(z[:, columns])
        return terms

    @property
    def _joint(self) -> FloatArray:
        return np.eye(len(self.names)) if self.correlation is None else self.correlation


def scaled(
    stated: Stated, likelihood: Reweighted, prior: FloatArray, draws: FloatArray, *, noise: float
) -> PowerScaling:
    """Sensitivities of draws (n, d) whose likelihood is known, beside those of the cut prior's (m, d)."""
    by_law, cut = stated.densities(draws), stated.densities(prior)
    together = stated.together(draws)
    moved = np.array([[each.sensitivity(x) for each in by_law] for x in draws.T])
    strongest = (moved + 1e-12 * np.eye(len(moved))).argmax(axis=1)  # of a joint law, the parameter's own
    table = pd.DataFrame(
        {
            "parameter": list(stated.names),
            "prior": [together.sensitivity(x) for x in draws.T],
            "own": np.diagonal(moved),
            "cut_own": [each.sensitivity(x) for each, x in zip(cut, prior.T, strict=True)],
            "strongest": [stated.names[i] for i in strongest],
            "strongest_law": moved.max(axis=1),
            "likelihood": [likelihood.sensitivity(x) for x in draws.T],
            "noise": noise,
            "silent": list(stated.flat),
        }
    )
    columns = ["own", "cut_own", "strongest_law", "likelihood"]
    table["word"] = [power_word(*row) for row in table[columns].to_numpy(dtype=np.float64)]
    k_hat = max(each.k_hat for each in (likelihood, together, *by_law, *cut))
    return PowerScaling(table, moved, k_hat, pareto_limit(len(draws)))


def power_word(own: float, cut_own: float, strongest: float, likelihood: float) -> str:
    """Word for what a parameter follows.

    ``repeats its prior``: it follows its own law at least half as far as the cut prior does, and the
    likelihood does not move it. ``another's prior``: not that, but the law of another parameter moves it
    and the likelihood does not. ``prior and data``: both do. ``data``: the likelihood alone. ``unmoved``:
    nothing does.
    """
    if likelihood >= SENSITIVE:
        return "prior and data" if strongest >= SENSITIVE else "data"
    if own >= max(REPEATED * cut_own, SENSITIVE):
        return "repeats its prior"
    return "another's prior" if strongest >= SENSITIVE else "unmoved"


@dataclass(frozen=True)
class Reweighted:
    """Draws reweighted by a log density (n,) to the powers ``ALPHAS`` − 1."""

    log_density: FloatArray

    @cached_property
    def _smoothed(self) -> list[tuple[FloatArray, float]]:
        if np.ptp(self.log_density) == 0.0:  # nothing is reweighted, and there is no tail to smooth
            return [(np.full(len(self.log_density), -np.log(len(self.log_density))), -np.inf)] * len(ALPHAS)
        return [pareto_smoothed((alpha - 1.0) * self.log_density) for alpha in ALPHAS]

    @property
    def k_hat(self) -> float:
        """Greatest Pareto shape of the weights."""
        return max(k for _, k in self._smoothed)

    def sensitivity(self, x: FloatArray) -> float:
        """Distance by which the law of draws (n,) moves per doubling of the power."""
        order = np.argsort(x)
        moved = [distance(x[order], np.exp(log_weights[order])) for log_weights, _ in self._smoothed]
        return float(np.mean(np.array(moved) / np.abs(np.log2(ALPHAS))))

    def noise(self, rng: Generator) -> float:
        """95 % point of the sensitivity of draws that do not depend on the density."""
        strangers = (rng.standard_normal(len(self.log_density)) for _ in range(SHUFFLES))
        return float(np.quantile([self.sensitivity(x) for x in strangers], 0.95))


def distance(x: FloatArray, weights: FloatArray) -> float:
    """Cumulative Jensen–Shannon distance of sorted draws (n,) with weights and without, between 0 and 1.

    Nguyen and Vreeken (2015), normalised as in Kallioinen et al. (2024), eq. (10); the greater one of the
    distances between cumulative and between survival functions.
    """
    gaps = np.diff(x)
    even = np.arange(1, len(x)) / len(x)
    weighted = np.clip(np.cumsum(weights / weights.sum())[:-1], 1e-300, 1.0 - 1e-16)
    return max(_one_sided(even, weighted, gaps), _one_sided(1.0 - even, 1.0 - weighted, gaps))


def _one_sided(p: FloatArray, q: FloatArray, gaps: FloatArray) -> float:
    """Distance between step functions p and q of widths ``gaps``; their linear terms cancel in the sum."""
    middle = np.log2(0.5 * (p + q))
    total = gaps @ (p * (np.log2(p) - middle) + q * (np.log2(q) - middle))
    return float(np.sqrt(max(total, 0.0) / (gaps @ (p + q))))
