"""From the prior to a proposal: tempered sequential Monte Carlo, then a mixture fitted to what it found.

Each ensemble does this alone, from its own draws of the prior, so that ensembles share nothing and their
agreement means something. Everything here ends before draws are kept.

Components are added where the proposal falls short (incremental mixture sampling, Raftery and Bao 2010).
An independent proposal that is thin somewhere leaves walkers standing there: a point whose importance weight
is a hundred times the mean is left once in some hundred steps. So that is where components are added, a few at
a time, each fitted to the points around the greatest weight. A proposal's own draws do not tell where it is thin:
points of the last temperatures, which reach farther into the tails, are looked at too.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.random import Generator
from scipy.spatial import KDTree

from bayesterra.arrays import FloatArray
from bayesterra.stats import mixture as mixtures
from bayesterra.stats.transport import Proposal, TransportMap, fit_proposal

Densities = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Sampling coordinates (n, d) in; log prior and log likelihood out, (n,) each."""

FLATTENING = 0.8
"""Power of the importance weights in the final fit: a proposal should be wider than its target."""


@dataclass(frozen=True)
class AdaptationOptions:
    """Size of the adaptation.

    Attributes
    ----------
    particles : number of points that travel from prior to posterior.
    keep : share of effective points kept at each temperature.
    sweeps : differential-evolution steps at each temperature.
    components : components of the final mixture, at most.
    refinements : draws per particle in each round of importance sampling that refines the mixture.
    more, enough : further rounds, which take place while less than this share of the draws is effective.
    defence : share of a wide component in the final mixture.
    shores : components added at last where the proposal is thinnest beside the posterior, at most.
    climbs : steps uphill from each draw of the prior that lies above its neighbours.
    """

    particles: int = 1024
    keep: float = 0.35
    sweeps: int = 4
    components: int = 24
    refinements: tuple[int, ...] = (4, 4, 8)
    more: tuple[int, ...] = (16, 16)
    enough: float = 0.3
    defence: float = 0.1
    shores: int = 160
    climbs: int = 150


OF_SOIL_TESTS = AdaptationOptions(particles=512, components=8, refinements=(4, 8), more=(), shores=12)
"""Size for soil tests without wheels, whose posteriors are simple in their coordinates."""


@dataclass(frozen=True)
class Adaptation:
    """Result of the adaptation."""

    u: FloatArray  # points spread like the posterior (n, d), the starting points of the walkers
    temperatures: tuple[float, ...]  # the inverse temperatures travelled
    evaluations: int  # parameter sets evaluated
    proposal: Proposal  # the frozen proposal
    efficiency: float  # effective share of draws of the proposal before its last fit and its shores
    log_evidence: float  # log of the mean importance weight of those same draws, which no fit had seen before


@dataclass
class _Particles:
    """Points on their way, with the densities at each."""

    u: FloatArray
    log_prior: FloatArray
    log_likelihood: FloatArray

    def level(self, temperature: float) -> FloatArray:
        """Log density (n,) at an inverse temperature."""
        rest = np.where(np.isneginf(self.log_likelihood), -np.inf, temperature * self.log_likelihood)
        return self.log_prior + rest

    def resampled(self, log_weights: FloatArray, rng: Generator) -> "_Particles":
        """As many points, drawn by weight."""
        chosen = mixtures.systematic(mixtures.relative(log_weights), len(self.u), rng)
        return _Particles(self.u[chosen], self.log_prior[chosen], self.log_likelihood[chosen])

    def accept(self, new: "_Particles", log_ratio: FloatArray, rng: Generator) -> None:
        """Metropolis step: take the new points where a uniform draw allows."""
        taken = np.log(rng.random(len(self.u))) < log_ratio
        self.u[taken] = new.u[taken]
        self.log_prior[taken] = new.log_prior[taken]
        self.log_likelihood[taken] = new.log_likelihood[taken]


def adapt(
    densities: Densities,
    start: FloatArray,
    options: AdaptationOptions,
    rng: Generator,
    watch: Callable[[str], None] = lambda step: None,
) -> Adaptation:
    """Carry points from the prior to the posterior and fit a proposal to them.

    Parameters
    ----------
    densities : log prior and log likelihood in sampling coordinates.
    start : draws of the cut prior in sampling coordinates (particles, d).
    watch : told what is at work, step by step.
    """
    particles = _Particles(start.copy(), *densities(start))
    watch("peaks")
    peaks = _climbed(start, particles.level(1.0), densities, options.climbs, rng)
    evaluations, temperature, travelled = len(start) + len(peaks[0]), 0.0, [0.0]
    hot = deque[tuple[FloatArray, FloatArray]](maxlen=HOT)
    while temperature < 1.0:
        step = _next_step(particles.log_likelihood, 1.0 - temperature, options.keep)
        temperature = 1.0 if temperature + step > 1.0 - 1e-9 else temperature + step
        particles = particles.resampled(step * particles.log_likelihood, rng)
        evaluations += _move(particles, densities, temperature, start.std(axis=0), options, rng)
        travelled.append(temperature)
        hot.append((particles.u.copy(), particles.level(1.0)))
        watch(f"temperature {temperature:.3g}")
    widths = start.std(axis=0)
    proposal = _fitted(particles.u, np.full(len(start), 1.0), widths, options, rng)
    spread = hot[-1]
    if _missed((spread, peaks), proposal):
        log_target, draws = partial(_log_target, densities), len(start) // 2
        proposal = add_components(proposal, *spread, log_target, rng, components=MODES, draws=draws, further=peaks)
        evaluations += MODES * draws
    tails = (np.concatenate([u for u, _ in hot]), np.concatenate([level for _, level in hot]))
    refined = refine(proposal, particles.u, widths, densities, options, rng, watch, tails)
    proposal, efficiency, log_evidence, draws = refined
    evaluations += draws
    return Adaptation(particles.u, tuple(travelled), evaluations, proposal, efficiency, log_evidence)


def _next_step(log_likelihood: FloatArray, most: float, keep: float) -> float:
    """Largest temperature step that keeps the wanted share of effective points."""
    alive = log_likelihood[log_likelihood > -np.inf]  # a draw of the prior may round to just outside
    return mixtures.largest_power(alive, most, keep * len(alive))


def _fitted(
    u: FloatArray, weights: FloatArray, widths: FloatArray, options: AdaptationOptions, rng: Generator
) -> Proposal:
    return fit_proposal(u, weights, widths, options.components, options.defence, rng)


def _move(
    particles: _Particles,
    densities: Densities,
    temperature: float,
    widths: FloatArray,
    options: AdaptationOptions,
    rng: Generator,
) -> int:
    """Spread resampled points by a fitted independence step and differential evolution; returns the cost."""
    n, d = particles.u.shape
    components = max(2, options.components // 4)
    guess = fit_proposal(particles.u, np.full(n, 1.0), widths, components, options.defence, rng)
    for sweep in range(options.sweeps + 2):
        if sweep < 2:
            u = guess.sample(n, rng)
            log_ratio = guess.log_density(particles.u) - guess.log_density(u)
        else:
            u, log_ratio = particles.u + _differences(particles.u, d, sweep, rng), np.zeros(n)
        new = _Particles(u, *densities(u))
        log_ratio += new.level(temperature) - particles.level(temperature)
        particles.accept(new, log_ratio, rng)
    return int(n) * (options.sweeps + 2)


def _differences(u: FloatArray, d: int, sweep: int, rng: Generator) -> FloatArray:
    """Steps (n, d) along differences of random pairs (ter Braak 2006), long and short ones in turn."""
    n = len(u)
    first = rng.integers(n, size=n)
    second = (first + 1 + rng.integers(n - 1, size=n)) % n
    scale = 2.38 / np.sqrt(2 * d) * (1.0 if sweep % 2 else 0.4)
    return np.asarray(scale * (u[first] - u[second]))


NEXT = 10
"""Neighbours that a draw of the prior must lie above."""


def _climbed(
    u: FloatArray, level: FloatArray, densities: Densities, steps: int, rng: Generator
) -> tuple[FloatArray, FloatArray]:
    """Points (k, d) met on the way up from points (n, d), and the log density there (k,).

    A peak too narrow for any particle to keep to it is seen as a point above its neighbours. From each the way goes
    up by random steps, longer after a good one and shorter after others (Rechenberg's rule).
    """
    spread, n = u.std(axis=0) + 1e-300, len(u)
    near = KDTree(u / spread).query(u / spread, min(NEXT, n - 1) + 1)
    top = np.flatnonzero((level[near[1][:, 1:]] < level[:, None]).all(axis=1))
    at, height, size = u[top], level[top], near[0][top, 1] / np.sqrt(u.shape[1])
    met, heights = [u[:0]], [level[:0]]
    for _ in range(steps if len(top) else 0):
        new = at + size[:, None] * spread * rng.standard_normal(at.shape)
        found = _log_target(densities, new)
        up = found > height
        at, height = np.where(up[:, None], new, at), np.where(up, found, height)
        size *= np.where(up, 1.5, 1.5**-0.25)
        met.append(new)
        heights.append(found)
    return np.concatenate(met), np.concatenate(heights)


HOT = 4
"""Last temperatures whose points show where the proposal is thin."""
MODES, MISSED = 8, 8.0
"""Components added where the fit to the particles has missed a mode, and the log weight that tells so."""


def _missed(points: Sequence[tuple[FloatArray, FloatArray]], proposal: Proposal) -> bool:
    """Whether points (n, d) and their log density, the first lot spread like the target, tell of a mode missed."""
    log_weights = [level - proposal.log_density(u) for u, level in points]
    return bool(np.concatenate(log_weights).max() > np.median(log_weights[0]) + MISSED)


def refine(
    proposal: Proposal, u: FloatArray, widths: FloatArray, densities: Densities, options: AdaptationOptions,
    rng: Generator, watch: Callable[[str], None] = lambda step: None,
    tails: tuple[FloatArray, FloatArray] | None = None,
) -> tuple[Proposal, float, float, int]:  # fmt: skip
    """Improve a proposal by adaptive multiple importance sampling (Cornuet et al. 2012).

    Draws of all rounds so far are weighed against the mixture of all their proposals and the fit is made
    anew; the points ``u`` (n, d) stay in as an anchor. Last, components are added where the proposal is thin at
    draws or at points of ``tails``, coordinates (m, d) and log density (m,).

    Returns
    -------
    The frozen proposal; the effective share of the draws of the last round, which no fit had seen before, and
    the log of their mean importance weight, both of its forerunner (all rounds together underrate the
    evidence: later proposals are dense just where earlier draws lie); the number of draws of all rounds and
    of the components added.
    """
    drawn = _Drawn(np.empty((0, u.shape[1])), np.empty(0), [], [])
    efficiency, log_evidence, enough = np.nan, np.nan, -np.inf
    for number, draws in enumerate((*options.refinements, *options.more)):
        if number >= len(options.refinements) and efficiency >= options.enough:
            break
        watch(f"proposal, round {number + 1}")
        efficiency, log_evidence = drawn.extend(proposal, draws * len(u), densities, rng)
        log_weights = drawn.log_weights()
        # truncated weights (Ionides 2008) keep one stray draw from ruling the fit
        mean = float(mixtures.log_mean(log_weights))
        excess, enough = log_weights - mean, mean + THICK
        truncated = np.minimum(excess, 0.5 * np.log(len(log_weights)))
        chosen = mixtures.systematic(np.exp(FLATTENING * truncated), 5 * len(u), rng)
        weights = np.repeat([1.0, 0.5], [len(chosen), len(u)])
        proposal = _fitted(np.concatenate([drawn.u[chosen], u]), weights, widths, options, rng)
    watch("proposal, thin places")
    tried = (drawn.u, drawn.log_target, partial(_log_target, densities))
    shores, draws, fitted = options.shores, len(u) // 4, len(proposal.mixture.weights)
    proposal = add_components(proposal, *tried, rng, components=shores, draws=draws, further=tails, enough=enough)
    added = len(proposal.mixture.weights) - fitted
    return proposal, efficiency, log_evidence, len(drawn.u) + added * draws


def _log_target(densities: Densities, u: FloatArray) -> FloatArray:
    log_prior, log_likelihood = densities(u)
    return np.where(np.isneginf(log_prior), -np.inf, log_prior + log_likelihood)


@dataclass
class _Drawn:
    """Draws of several proposals: coordinates, log target, the proposals and their log densities."""

    u: FloatArray
    log_target: FloatArray
    proposals: list[tuple[Proposal, int]]
    log_proposals: list[FloatArray]

    def extend(self, proposal: Proposal, n: int, densities: Densities, rng: Generator) -> tuple[float, float]:
        """Draw n points from one more proposal; effective share and log mean weight of these draws alone."""
        new = proposal.sample(n, rng)
        target = _log_target(densities, new)
        self.log_proposals = [
            np.concatenate([old, earlier.log_density(new)])
            for old, (earlier, _) in zip(self.log_proposals, self.proposals, strict=True)
        ]
        self.u, self.log_target = np.concatenate([self.u, new]), np.concatenate([self.log_target, target])
        self.log_proposals.append(proposal.log_density(self.u))
        self.proposals.append((proposal, n))
        alone = target - self.log_proposals[-1][-n:]
        return mixtures.effective_number(mixtures.relative(alone)) / n, float(mixtures.log_mean(alone))

    def log_weights(self) -> FloatArray:
        """Log importance weights against the mixture of all proposals."""
        shares = [np.log(n / len(self.u)) for _, n in self.proposals]
        pooled = [share + density for share, density in zip(shares, self.log_proposals, strict=True)]
        return np.asarray(self.log_target - np.logaddexp.reduce(pooled, axis=0))


SHARE = 0.2
"""Weight of all components together, where as many are added as may be."""
NEIGHBOURS = 200
"""Points around the greatest weight that a component is fitted to."""
WIDENING = 1.3
ABREAST = 4
"""Components, at most and an eighth of all, that are added before their draws are weighed in one call."""
THICK, CALM = 3.0, 5
"""Log of a weight, over the mean one, that walkers leave soon; looks in a row without a greater one that end it."""
THIN = 0.25
"""Share of the points given, those of the greatest weights, among which thin places are looked for."""


def add_components(
    proposal: Proposal, u: FloatArray, level: FloatArray, log_target: Callable[[FloatArray], FloatArray],
    rng: Generator, *, components: int, draws: int, further: tuple[FloatArray, FloatArray] | None = None,
    enough: float = -np.inf,
) -> Proposal:  # fmt: skip
    """Add components to a proposal where its importance weights are greatest.

    Parameters
    ----------
    u, level : points (n, d) that cover the target, and its log density there (n,), −inf outside the support.
    log_target : the log density itself.
    components : number of components to add, at most; 0 adds none.
    draws : draws of each new component, among which the next greatest weight is looked for too.
    further : more points and their log density; distances are measured without them, as they lie far and wide.
    enough : log weight up to which a place is not thin: where looks in a row find no greater one, that is the end.
    """
    if not components:
        return proposal
    straight, share = proposal.transport_map, SHARE / components
    mixture = replace(proposal.mixture, weights=(1.0 - SHARE) * proposal.mixture.weights)
    more = further or (u[:0], level[:0])
    places = _Places(straight, mixture.dof, len(u) + len(more[0]) + components * draws)
    places.add(u, level, mixture)
    places.add(*more, mixture)
    abreast, calm = min(ABREAST, max(1, components // 8)), 0
    for begun in range(0, components, abreast):
        calm = calm + 1 if places.greatest <= enough else 0
        if calm == CALM:
            break
        new = [places.component(share) for _ in range(min(abreast, components - begun))]
        weights = np.append(mixture.weights, np.full(len(new), share))
        means, factors = (
            np.concatenate([getattr(each, name) for each in (mixture, *new)]) for name in ("means", "factors")
        )
        mixture = mixtures.StudentMixture(weights, means, factors, mixture.dof)
        u, _ = straight.forward(np.concatenate([component.sample(draws, rng) for component in new]))
        places.add(u, log_target(u), mixture)
    return Proposal(straight, replace(mixture, weights=mixture.weights / mixture.weights.sum()))


class _Places:
    """Evaluated points, in straight coordinates, with the log density of a growing mixture; room for so many."""

    def __init__(self, straight: TransportMap, dof: float, room: int) -> None:
        self._straight, self._dof, self._n = straight, dof, 0
        self._v = np.empty((room, len(straight.centre)))
        self._log_target, self._log_proposal = np.empty(room), np.empty(room)

    def add(self, u: FloatArray, log_p: FloatArray, mixture: mixtures.StudentMixture) -> None:
        """Take in points (n, d) where the target has log density ``log_p`` (n,)."""
        v, log_jacobian = self._straight.inverse(u)
        level = log_p + log_jacobian
        inside = np.isfinite(level) & np.isfinite(v).all(axis=1)
        v, level = v[inside], level[inside]
        log_proposal, start = mixture.log_density(v), self._n
        if not start:
            self._spread = v.std(axis=0) + 1e-300
            thin = np.argsort(log_proposal - level)[: max(1, int(THIN * len(v)))]
            v, level, log_proposal = v[thin], level[thin], log_proposal[thin]
        self._n += len(v)
        new = slice(start, self._n)
        self._v[new], self._log_target[new], self._log_proposal[new] = v, level, log_proposal

    @property
    def greatest(self) -> float:
        """The greatest log weight."""
        return float((self._log_target[: self._n] - self._log_proposal[: self._n]).max())

    def component(self, share: float) -> mixtures.StudentMixture:
        """Add to the mixture a component about the greatest weight, as wide as the weighted points next to it."""
        v, now = self._v[: self._n], self._log_proposal[: self._n]
        log_weights = self._log_target[: self._n] - now
        centre = v[np.argmax(log_weights)]
        away = (v - centre) / self._spread
        near = np.sort(np.argpartition((away**2).sum(axis=1), min(NEIGHBOURS, self._n) - 1)[:NEIGHBOURS])
        weights = np.exp(log_weights[near] - log_weights[near].max())
        weights = 0.5 * weights / weights.sum() + 0.5 / len(near)
        offsets = v[near] - centre
        covariance = (offsets * weights[:, None]).T @ offsets + 1e-9 * np.diag(self._spread**2)
        factor = WIDENING * mixtures.root(covariance)
        component = mixtures.StudentMixture(np.ones(1), centre[None], np.asarray(factor)[None], self._dof)
        np.logaddexp(now, np.log(share) + component.log_density(v), out=now)
        return component
