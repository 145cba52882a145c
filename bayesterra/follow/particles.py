"""Weighted particles: reweighting by a row, and moves that spread a resampled cloud again."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.random import Generator
from scipy.special import logsumexp

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.errors import SupportError
from bayesterra.likelihood.joint import Whole, whole_posterior
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import Posterior, likelihood_of
from bayesterra.sampling.coordinates import Coordinates, coordinates
from bayesterra.stats.mixture import effective_number, largest_power, relative, systematic, weighted_quantiles
from bayesterra.stats.transport import Proposal, fit_proposal
from bayesterra.study.observations import Observations
from bayesterra.study.study import Study

if TYPE_CHECKING:
    from bayesterra.follow.rows import Rows


@dataclass(frozen=True)
class Particles:
    """Particles and their weights."""

    x: FloatArray  # parameter sets (n, d), SI and radians
    log_likelihood: FloatArray  # log likelihood (n,) of all rows so far
    log_weights: FloatArray  # (n,), summing to one as weights

    @classmethod
    def even(cls, x: FloatArray, log_likelihood: FloatArray) -> "Particles":
        """Particles of equal weight."""
        return cls(x, log_likelihood, np.full(len(x), -np.log(len(x))))

    def __len__(self) -> int:
        return len(self.x)

    @property
    def weights(self) -> FloatArray:
        """Weights (n,)."""
        return np.asarray(np.exp(self.log_weights))

    @property
    def effective(self) -> float:
        """Effective number of particles (Kong 1992)."""
        return effective_number(relative(self.log_weights))

    @property
    def variance(self) -> float:
        """Monte Carlo variance of the log mean of the weights that particles have come to hold."""
        return 1.0 / self.effective - 1.0 / len(self)

    def weighed(self, log_terms: FloatArray) -> "tuple[Particles, float]":
        """The particles with log factors (n,) taken into its weights, and the log of their weighted mean."""
        log_weights = self.log_weights + log_terms
        total = float(logsumexp(log_weights))
        return replace(self, log_weights=log_weights - total), total

    def take(self, keep: BoolArray) -> "Particles":
        """Some of the particles, weights as they stand."""
        return Particles(self.x[keep], self.log_likelihood[keep], self.log_weights[keep])

    def log_share(self, chosen: BoolArray) -> float:
        """Log of the weight that some of the particles hold together."""
        return float(logsumexp(self.log_weights[chosen]))

    def quantiles(self, probabilities: Sequence[float]) -> FloatArray:
        """Quantiles (k, d) of every parameter."""
        return weighted_quantiles(self.x, self.weights, probabilities)


KEEP = 0.5
"""Effective share of the particles below which they are resampled and moved."""
FLOOR = 0.2
"""Share that a row may leave at once; where it would leave less, it is taken in by steps."""
STEP_KEEP = 0.4
"""Share of the effective particles that such a step leaves."""


@dataclass(frozen=True)
class Learned:
    """Particles after one more row."""

    particles: Particles  # particles of the posterior of all rows
    log_predictive: float  # log density of the row's readings given the earlier rows; all constants included
    variance: float  # Monte Carlo variance of the log evidence that the resamplings of this row settled
    rejuvenations: "tuple[Rejuvenation, ...]"  # one for every resampling


def learn(
    particles: Particles, levels: "Callable[[], Levels]", newest: FloatArray, before: FloatArray, rng: Generator
) -> Learned:
    """Take a row into the particles (iterated batch importance sampling, Chopin 2002, with tempering).

    Parameters
    ----------
    particles : of the earlier rows.
    levels : makes the densities of all rows, which are needed only where particles have to move.
    newest : log likelihood (n,) of the row for the particles of the cloud.
    before : draws of the prior (k, d).

    Raises
    ------
    SupportError : the row has no density for any particle.
    """
    n, done, total, variance = len(particles), 0.0, 0.0, 0.0
    events: list[Rejuvenation] = []
    if not (newest > -np.inf).any():
        raise SupportError("the model has no answer in this row for any soil that the earlier rows leave")
    while True:
        step = _step(particles.log_weights, newest, 1.0 - done)
        done = 1.0 if step >= 1.0 - done else done + step
        particles, gained = particles.weighed(step * newest)
        total += gained
        if done == 1.0 and particles.effective >= KEEP * n:
            break
        variance += particles.variance
        particles, newest, event = rejuvenate(particles, levels(), done, before, rng)
        events.append(event)
        if done == 1.0:
            break
    particles = replace(particles, log_likelihood=particles.log_likelihood + newest)
    return Learned(particles, total, variance, tuple(events))


def _step(log_weights: FloatArray, newest: FloatArray, rest: float) -> float:
    """Power of the row's likelihood to take in next: the rest of it, if enough particles are left."""
    if effective_number(relative(log_weights + rest * newest)) >= FLOOR * len(log_weights):
        return rest
    alive = newest > -np.inf
    log_weights, newest = log_weights[alive], newest[alive]
    return largest_power(newest, rest, STEP_KEEP * effective_number(relative(log_weights)), log_weights)


PAIRS = 100_000
"""Parameter sets times rows, at most, that are modelled at once: memory must not grow with the rows."""
PER_COMPONENT = 150
"""Particles for each component of the mixture that is proposed from."""
MOST_COMPONENTS = 12
DEFENCE = 0.1
FORGOTTEN = 0.1
"""Largest correlation with where they came from at which particles count as moved."""
TAIL = 0.1
"""Share of the particles in either tail, whose whereabouts must be forgotten too."""
FEWEST, MOST = 2, 40
"""Sweeps of one rejuvenation."""


@dataclass(frozen=True)
class Rejuvenation:
    """Effort of one rejuvenation, which spreads the particles again."""

    sweeps: int  # moves of every particle
    acceptance: float  # share of accepted independence proposals
    correlation: float  # largest correlation of where particles and their tails were with where they are
    limit: float  # at which they count as moved; ``FORGOTTEN``, or more where particles are too few to see that
    temperature: float  # power of the newest row's likelihood, 1 where it was taken in at once


@dataclass(frozen=True)
class Levels:
    """Log densities of a parameter set: prior, earlier rows, newest row."""

    posterior: Whole  # posterior of all rows, the newest one too
    earlier: Mapping[str, Posterior]  # posteriors of the rows before it, by group
    newest: Posterior  # posterior of the newest row; where rows hang together of all rows of its group
    group: str  # the newest row's

    @classmethod
    def of(cls, study: Study, rows: "Rows") -> "Levels":
        """Levels of all rows, of which the last is the newest."""
        last = len(rows) - 1
        newest, whole = rows.between(last, last + 1), whole_of(study, rows.first())
        earlier = whole_of(study, rows.first(last)).groups if last else {}
        group = group_of(study, newest)
        own = whole.groups[group]
        apart = Posterior(study.prior, likelihood_of(study, newest)) if own.likelihood.rows_apart else own
        return cls(whole, earlier, apart, group)

    @property
    def coordinates(self) -> Coordinates:
        """Sampling coordinates that suit these rows."""
        return coordinates(self.posterior)

    def __call__(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Log prior, and log likelihood of the earlier rows and of the newest, (n,) each; −inf outside."""
        prior = self.posterior.log_before(x)
        earlier, newest = np.full(len(x), -np.inf), np.full(len(x), -np.inf)
        inside = np.flatnonzero(prior > -np.inf)
        newest[inside] = self._of_group(self.group, self.newest, x[inside])
        inside = np.flatnonzero(newest > -np.inf)
        earlier[inside] = 0.0
        for group, own in self.earlier.items():
            level = self._of_group(group, own, x[inside])
            earlier[inside] += level
            if group == self.group and not own.likelihood.rows_apart:
                newest[inside] -= level
        return prior, earlier, newest

    def _of_group(self, group: str, own: Posterior, x: FloatArray) -> FloatArray:
        """Log likelihood (n,) of rows of a group."""
        return log_likelihoods(own, own.likelihood, values_of(self.posterior, group, x))


def whole_of(study: Study, rows: Observations) -> Whole:
    """Posterior of some rows of a study."""
    return whole_posterior(study.with_rows(rows), fewest=1)


def group_of(study: Study, row: Observations) -> str:
    """Group of a row; empty where a study has none."""
    return row.label(study.pooling.by)[0] if study.pooling else ""


def values_of(posterior: Whole, group: str, x: FloatArray) -> FloatArray:
    """Parameter sets (n, d) of a group among sets (n, all)."""
    return posterior.values_of_groups(x)[list(posterior.groups).index(group)]


def log_likelihoods(posterior: Posterior, likelihood: Likelihood, x: FloatArray) -> FloatArray:
    """Log likelihood (n,) of parameter sets (n, d), a part of them at a time."""
    size = max(16, PAIRS // max(1, len(likelihood.observations)))
    soil, noise = posterior.prior.soil_values(x), posterior.noise_values(x)
    blocks = [
        likelihood.log_likelihood(soil[start : start + size], noise[start : start + size])
        for start in range(0, len(x), size)
    ]
    return np.concatenate(blocks) if blocks else np.empty(0)


@dataclass
class _Points:
    """Particles in straight coordinates v and physical ones x; log prior there, Jacobians included; rows."""

    v: FloatArray
    x: FloatArray
    prior: FloatArray
    earlier: FloatArray
    newest: FloatArray

    def level(self, temperature: float) -> FloatArray:
        """Log density (n,) with the newest row's likelihood to a power."""
        inside = (self.prior > -np.inf) & (self.earlier > -np.inf) & (self.newest > -np.inf)
        total = np.full(len(self.v), -np.inf)
        total[inside] = self.prior[inside] + self.earlier[inside] + temperature * self.newest[inside]
        return total

    @classmethod
    def at(cls, v: FloatArray, proposal: Proposal, levels: Levels) -> "_Points":
        """Points of the target at straight coordinates (n, d)."""
        u, bent = proposal.transport_map.forward(v)
        x, log_jacobian = levels.coordinates.to_physical(u)
        log_jacobian = log_jacobian + bent
        safe = np.isfinite(log_jacobian) & np.isfinite(x).all(axis=1)
        prior, earlier, newest = levels(np.where(safe[:, None], x, np.nan))
        prior = np.where(safe & (prior > -np.inf), prior + np.where(safe, log_jacobian, 0.0), -np.inf)
        return cls(v, x, prior, earlier, newest)


def rejuvenate(
    particles: Particles, levels: Levels, temperature: float, before: FloatArray, rng: Generator
) -> tuple[Particles, FloatArray, Rejuvenation]:
    """Resample a weighted cloud and move its particles until they have forgotten where they came from.

    Parameters
    ----------
    particles : weighted for the earlier rows and the newest one to the power ``temperature``.
    before : draws of the prior (k, d); they say which coordinates the data have narrowed.

    Returns
    -------
    The cloud, evenly weighted, its likelihood that of the earlier rows; the newest row's log likelihood (n,);
    and what it took.
    """
    n = len(particles)
    proposal, u, alive = _fitted(particles, levels, before, rng)
    chosen = systematic(particles.weights[alive], n, rng)
    points = _Points.at(proposal.transport_map.inverse(u)[0][chosen], proposal, levels)
    values = np.column_stack([points.x, points.v])
    low, high = np.quantile(values, (TAIL, 1.0 - TAIL), axis=0)
    memory = _features(values, low, high)
    accepted = tried = sweeps = 0
    correlation, limit = 1.0, max(FORGOTTEN, 3.0 / np.sqrt(n))
    while sweeps < FEWEST or (sweeps < MOST and correlation > limit):
        independent = sweeps % 3 < 2
        v, log_ratio = _proposed(points.v, proposal, independent, rng)
        new = _Points.at(v, proposal, levels)
        with np.errstate(invalid="ignore"):
            log_ratio = log_ratio + new.level(temperature) - points.level(temperature)
        taken = np.log(rng.random(n)) < log_ratio
        for name in vars(points):
            getattr(points, name)[taken] = getattr(new, name)[taken]
        sweeps += 1
        if independent:
            accepted, tried = accepted + int(taken.sum()), tried + n
        # the largest correlation of what was with what is
        now = _features(np.column_stack([points.x, points.v]), low, high)
        norm = np.sqrt((memory**2).sum(axis=0) * (now**2).sum(axis=0))
        correlation = float(np.max((memory * now).sum(axis=0) / np.maximum(norm, 1e-300)))
    moved = Particles.even(points.x, points.earlier)
    return moved, points.newest, Rejuvenation(sweeps, accepted / tried, correlation, limit, temperature)


def _fitted(
    particles: Particles, levels: Levels, before: FloatArray, rng: Generator
) -> tuple[Proposal, FloatArray, IntArray]:
    """A proposal fitted to the weighted particles; those alive, in sampling coordinates and by number."""
    chosen = levels.coordinates
    alive = np.flatnonzero(particles.log_weights > -np.inf)
    with np.errstate(all="ignore"):
        u = chosen.from_physical(particles.x[alive])
        widths = _spread(chosen.from_physical(before))
    sound = np.isfinite(u).all(axis=1)
    u, alive = u[sound], alive[sound]
    components = max(1, min(MOST_COMPONENTS, int(particles.effective) // PER_COMPONENT))
    proposal = fit_proposal(u, particles.weights[alive], widths, components, DEFENCE, rng)
    return proposal, u, alive


def _spread(u: FloatArray) -> FloatArray:
    """Standard deviation of every coordinate over the prior's draws (k, d) that have one."""
    deviations = np.array([column[np.isfinite(column)].std() if np.isfinite(column).any() else 0 for column in u.T])
    return np.where(deviations > 0, deviations, 1.0)


def _proposed(v: FloatArray, proposal: Proposal, independent: bool, rng: Generator) -> tuple[FloatArray, FloatArray]:
    """Proposals (n, d), and log of the ratio of their proposal densities, old to new."""
    mixture = proposal.mixture
    if independent:
        new = mixture.sample(len(v), rng)
        return new, mixture.log_density(v) - mixture.log_density(new)
    n, d = v.shape
    first = rng.integers(n, size=n)
    second = (first + 1 + rng.integers(n - 1, size=n)) % n
    # steps along differences of random pairs (ter Braak 2006)
    step = 2.38 / np.sqrt(2 * d) * rng.uniform(0.3, 1.0, size=(n, 1)) * (v[first] - v[second])
    return v + step, np.zeros(n)


def _features(values: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Centred values and indicators of both tails, (n, 3 k): tails may be left long after the middle has mixed."""
    features = np.column_stack([values, values < low, values > high])
    return np.asarray(features - features.mean(axis=0), dtype=np.float64)
