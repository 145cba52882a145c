"""Joint posterior in unbounded coordinates, and conditional laws of some coordinates given others."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import Generator, default_rng

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.joint import JointPosterior
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior
from bayesterra.sampling.coordinates import LEAVING, Block, Coordinates, Logarithm, NormalScore, coordinates
from bayesterra.stats.laws import Law, log_population
from bayesterra.stats.mixture import StudentMixture, fit_mixture, with_defensive_component
from bayesterra.stats.transport import STEPS, TransportMap, fit_transport_map
from bayesterra.study.priors import Entry, Prior

SLICES, TRIES = 2, 60
"""Slice steps of every mean and spread in one refreshment, and most tries of a step, which may end where it began."""
WIDTH_DRAWS = 1000


def restricted(posterior: Posterior, names: Sequence[str]) -> Coordinates:
    """Sampling coordinates of some of a posterior's parameters, in the order of ``names``."""
    held = {name: law.median for name, law in posterior.prior.laws.items() if name not in names}
    held |= {name: 1.0 for name in LEAVING if name in held}  # unknown: contact angles are mapped one by one
    entries: dict[str, Entry] = {**posterior.prior.entries, **held}
    prior = posterior.prior
    return coordinates(Posterior(Prior(entries, prior.width, reads=prior.reads), posterior.likelihood))


@dataclass(frozen=True)
class JointFamily:
    """A joint posterior in coordinates: see :class:`bayesterra.sampling.moves.Family`.

    Shared parameters and those of a group have the coordinates of an ordinary posterior, each set on its own;
    population means have the normal score of their law, spreads the log.
    """

    joint: JointPosterior

    @property
    def groups(self) -> int:
        """Number of groups."""
        return len(self.joint.groups)

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return tuple(self.joint.groups)

    @cached_property
    def blocks(self) -> tuple[tuple[int, ...], ...]:
        """Columns of shared parameters, then of mean and spread of each population."""
        k = len(self.joint.shared)
        pairs = [(k + 2 * i, k + 2 * i + 1) for i in range(len(self.joint.populations))]
        return (tuple(range(k)), *pairs)

    @cached_property
    def _shared(self) -> Coordinates:
        return restricted(self.joint.first, self.joint.shared)

    @cached_property
    def _own(self) -> tuple[Coordinates, ...]:
        return tuple(restricted(posterior, self.joint.local) for posterior in self.joint.groups.values())

    @cached_property
    def _hyper(self) -> Coordinates:
        blocks: list[tuple[tuple[int, ...], Block]] = []
        for i, (mean, _) in enumerate(self.joint.hyper.values()):
            blocks += [((2 * i,), NormalScore(mean)), ((2 * i + 1,), Logarithm())]
        return Coordinates(tuple(blocks))

    @cached_property
    def widths(self) -> FloatArray:
        """Standard deviations (d,) of a group's locals under the cut prior."""
        posterior = self.joint.first
        columns = [posterior.names.index(name) for name in self.joint.local]
        x = draw_cut_prior(posterior, WIDTH_DRAWS, default_rng(0)).x[:, columns]
        return np.asarray(self._own[0].from_physical(x).std(axis=0))

    def shared_to_physical(self, D: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Physical shared values (n, k) and log Jacobian (n,)."""
        k = len(self.joint.shared)
        shared, first = self._shared.to_physical(D[:, :k])
        hyper, second = self._hyper.to_physical(D[:, k:])
        return np.concatenate([shared, hyper], axis=1), first + second

    def shared_from_physical(self, x: FloatArray) -> FloatArray:
        """Coordinates of physical shared values (n, k)."""
        k = len(self.joint.shared)
        return np.concatenate([self._shared.from_physical(x[:, :k]), self._hyper.from_physical(x[:, k:])], axis=1)

    def group_to_physical(self, group: int, L: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Physical locals (n, d) of a group and log Jacobian (n,)."""
        return self._own[group].to_physical(L)

    def group_from_physical(self, group: int, x: FloatArray) -> FloatArray:
        """Coordinates of a group's physical locals (n, d)."""
        return self._own[group].from_physical(x)

    def placed(self, D: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Physical shared values (n, k); see :class:`bayesterra.sampling.moves.Family`."""
        x, log_jacobian = self.shared_to_physical(D)
        finite = np.asarray(np.isfinite(x).all(axis=1) & np.isfinite(log_jacobian))
        level = self.joint.log_prior_of_shared(np.where(finite[:, None], x, 0.0))
        return x, np.where(finite, level + np.where(finite, log_jacobian, 0.0), -np.inf)

    def log_population(self, group: int, S: FloatArray, L: FloatArray) -> tuple[FloatArray]:
        """See :class:`bayesterra.sampling.moves.Family`."""
        return (self._prior(S, group, L)[0],)

    def _prior(self, shared: FloatArray, group: int, L: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log density given physical shared values, Jacobian included, and physical locals."""
        own, log_jacobian = self.group_to_physical(group, L)
        finite = np.asarray(np.isfinite(own).all(axis=1) & np.isfinite(log_jacobian))
        level = self.joint.log_prior_of_group(shared, np.where(finite[:, None], own, 0.0))
        return np.where(finite, level + np.where(finite, log_jacobian, 0.0), -np.inf), own

    def terms(self, group: int, S: FloatArray, L: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`bayesterra.sampling.moves.Family`."""
        population, own = self._prior(S, group, L)
        likelihood = np.full(len(S), -np.inf)
        alive = np.flatnonzero(np.isfinite(population))
        if alive.size:
            name = self._names[group]
            likelihood[alive] = self.joint.log_likelihood_of_group(name, S[alive], own[alive])
        return population, likelihood

    def rescaled(self, group: int, S: FloatArray, L: FloatArray, new: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`bayesterra.sampling.moves.Family`."""
        own, log_jacobian = self.group_to_physical(group, L)
        inside = np.ones(len(L), dtype=bool)
        for i, name in enumerate(self.joint.hyper):
            at, column = len(self.joint.shared) + 2 * i, self.joint.local.index(name)
            with np.errstate(all="ignore"):  # a spread of nothing, or of 1e300, is turned away below
                ratio = new[:, at + 1] / S[:, at + 1]
                moved = new[:, at] + ratio * (own[:, column] - S[:, at])
                log_jacobian = log_jacobian + np.log(ratio)
            low, high = self.joint.laws[name].range
            inside &= (moved >= low) & (moved <= high) & np.isfinite(log_jacobian)
            own[:, column] = np.where(inside, moved, own[:, column])
        with np.errstate(all="ignore"):  # contact angles, say, may have left their range together
            L_new = self.group_from_physical(group, own)
            log_jacobian = log_jacobian - self.group_to_physical(group, L_new)[1]
        inside &= np.asarray(np.isfinite(L_new).all(axis=1)) & np.isfinite(log_jacobian)
        return np.where(inside[:, None], L_new, np.nan), np.where(inside, log_jacobian, -np.inf)

    @property
    def chances(self) -> int:
        """See :class:`bayesterra.sampling.moves.Family`."""
        return SLICES * 2 * len(self.joint.hyper) * (1 + TRIES)

    def refreshed(self, D: FloatArray, S: FloatArray, L: FloatArray, chance: FloatArray) -> tuple[FloatArray]:
        """Slice steps of every mean and spread given the groups' values."""
        k, steps = len(self.joint.shared), iter(chance.T.reshape(-1, 1 + TRIES, len(D)))
        own = np.stack([self.group_to_physical(g, L[:, g])[0] for g in range(self.groups)])
        shared = S.copy()
        for i, (name, laws) in enumerate(self.joint.hyper.items()):
            values = own[:, :, self.joint.local.index(name)]
            at, limits = k + 2 * i, self.joint.laws[name].range
            tied = self.joint.dependence_on(name, shared, own) if name in self.joint.tied_local else None
            for _ in range(SLICES):
                for column, law in zip((at, at + 1), laws, strict=True):
                    shared[:, column] = _sliced(shared, column, at, values, law, limits, tied, next(steps))
        new = self.shared_from_physical(shared)
        new[:, :k] = D[:, :k]
        return (np.where(np.asarray(np.isfinite(new).all(axis=1))[:, None], new, D),)


def _sliced(
    shared: FloatArray, column: int, at: int, values: FloatArray, law: Law, limits: tuple[float, float],
    tied: Callable[[FloatArray, FloatArray], FloatArray] | None, chance: FloatArray,
) -> FloatArray:  # fmt: skip
    """One slice step (Neal 2003) of a mean or spread in its probability scale; ``tied``: what correlations add.

    ``chance`` (1 + TRIES, n): numbers between 0 and 1, of the level and of each try.
    """
    mean, spread = shared[:, at].copy(), shared[:, at + 1].copy()

    def level(chosen: FloatArray) -> FloatArray:
        pair = (chosen, spread) if column == at else (mean, chosen)
        log_density = np.asarray(log_population(values, pair[0], pair[1], limits).sum(axis=0))
        if tied is None:
            return log_density
        alive = np.isfinite(log_density)
        safe = (np.where(alive, new, now) for new, now in zip(pair, shared[:, at : at + 2].T, strict=True))
        return np.where(alive, log_density + tied(*safe), -np.inf)

    now = shared[:, column]
    floor, place = level(now) + np.log(chance[0]), law.cdf(now)
    low, high, result = np.zeros(len(now)), np.ones(len(now)), now.copy()
    open_ = np.ones(len(now), dtype=bool)
    for part in chance[1:]:
        tried = low + part * (high - low)
        x = law.quantile(tried)
        inside = open_ & (level(x) > floor)
        result[inside] = x[inside]
        open_ &= ~inside
        if not open_.any():
            break
        below = open_ & (tried < place)
        low[below], high[open_ & ~below] = tried[below], tried[open_ & ~below]
    return result


@dataclass(frozen=True)
class ConditionalLaw:
    """Law of coordinates (n, d) given others (n, k)."""

    transport_map: TransportMap  # map of given and other coordinates together; the given ones are only standardised
    mixture: StudentMixture  # law of both in straight coordinates, k + d of them
    given: int  # k, at least 1

    @cached_property
    def _marginal(self) -> StudentMixture:
        k, of = self.given, self.mixture
        return StudentMixture(of.weights, of.means[:, :k], of.factors[:, :k, :k], of.dof)

    @cached_property
    def _inverses(self) -> FloatArray:
        """Inverse factors of the given coordinates (components, k, k)."""
        return np.asarray(np.linalg.inv(self._marginal.factors), dtype=np.float64)

    @cached_property
    def _log_scale(self) -> float:
        return float(np.log(self.transport_map.scale[: self.given]).sum())

    def _standard(self, others: FloatArray) -> FloatArray:
        k = self.given
        return np.asarray((others - self.transport_map.centre[:k]) / self.transport_map.scale[:k])

    def inverse(self, others: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Straight coordinates v (n, d) of points (n, d), and log |d points/dv| (n,)."""
        v, log_jacobian = self.transport_map.inverse(np.concatenate([others, points], axis=1))
        return v[:, self.given :], log_jacobian - self._log_scale

    def forward(self, others: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (n, d) of straight coordinates v (n, d), and log |d points/dv| (n,)."""
        u, log_jacobian = self.transport_map.forward(np.concatenate([self._standard(others), v], axis=1))
        return u[:, self.given :], log_jacobian - self._log_scale

    def log_density(self, others: FloatArray, points: FloatArray) -> FloatArray:
        """Log density (n,) of points (n, d) given the others."""
        return self._log_straight(others, *self.inverse(others, points))

    def _log_straight(self, others: FloatArray, v: FloatArray, log_jacobian: FloatArray) -> FloatArray:
        at = self._standard(others)
        both = self.mixture.log_density(np.concatenate([at, v], axis=1))
        return both - self._marginal.log_density(at) - log_jacobian

    def log_given(self, others: FloatArray) -> FloatArray:
        """Log density (n,) of the given coordinates themselves under the law of both."""
        return self._marginal.log_density(self._standard(others)) - self._log_scale

    def sample(self, others: FloatArray, rng: Generator) -> tuple[FloatArray, FloatArray]:
        """One point for each row of ``others``, (n, d), and its log density (n,)."""
        k, at, of = self.given, self._standard(others), self.mixture
        _, each, distances = self._marginal.weighed(at)
        shares = np.cumsum(each, axis=1)
        chosen = (shares < rng.random((len(at), 1)) * shares[:, -1:]).sum(axis=1)
        white = np.einsum("nij,nj->ni", self._inverses[chosen], at - of.means[chosen, :k])
        factors, dof = of.factors[chosen], of.dof + k
        stretch = np.sqrt((of.dof + distances[np.arange(len(at)), chosen]) / rng.chisquare(dof, len(at)))
        normal = stretch[:, None] * rng.standard_normal((len(at), of.means.shape[1] - k))
        v = of.means[chosen, k:] + np.einsum("nij,nj->ni", factors[:, k:, :k], white)
        v += np.einsum("nij,nj->ni", factors[:, k:, k:], normal)
        points, log_jacobian = self.forward(others, v)
        return points, self._log_straight(others, v, log_jacobian)


DEFENCE = 0.1
"""Share of a wide component beside those that are fitted."""


def fit_conditional(
    others: FloatArray, points: FloatArray, widths: FloatArray, rng: Generator, *, components: int = 8
) -> ConditionalLaw:
    """Fit the law of points (n, d) given others (n, k) to draws of both.

    ``widths`` (d,) are standard deviations of the points before the data.
    """
    u, weights = np.concatenate([others, points], axis=1), np.ones(len(points))
    scales = np.concatenate([np.ones(others.shape[1]), widths])
    transport_map = fit_transport_map(u, weights, scales, others.shape[1])
    v, _ = transport_map.inverse(u)
    mixture = with_defensive_component(fit_mixture(v, weights, components, rng, steps=STEPS), v, weights, DEFENCE)
    return ConditionalLaw(transport_map, mixture, others.shape[1])
