"""A hierarchical family with exact moments: linear and Gaussian given the spread, which a grid sums over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.random import Generator
from scipy.special import logsumexp, ndtri
from scipy.stats import multivariate_normal

from bayesterra.arrays import FloatArray, spaced
from bayesterra.sampling.family import fit_conditional
from bayesterra.sampling.joint import begun, flattened, refitted, warmed_up
from bayesterra.sampling.moves import PooledEnsemble, run_together
from bayesterra.stats.diagnostics import diagnose
from bayesterra.stats.laws import log_population

FREE = (-np.inf, np.inf)


def _normal(x: FloatArray, mean: FloatArray | float, sd: FloatArray | float) -> FloatArray:
    return np.asarray(-0.5 * ((x - mean) / sd) ** 2 - np.log(sd) - 0.5 * np.log(2 * np.pi))


@dataclass(frozen=True)
class Linear:
    """Drivers s, m and log τ; locals a_g ~ N(m, τ²) and b_g ~ N(0, 1).

    Readings: a_g + s and a_g/2 + b_g − s, with noise of ``sd`` each; the prior of s and m is N(0, 1) and
    N(0, 4), that of τ half-normal with scale 1.
    """

    y: FloatArray
    sd: float

    @property
    def blocks(self) -> tuple[tuple[int, ...], ...]:
        """The shared s; mean and log spread."""
        return (0,), (1, 2)

    @property
    def widths(self) -> FloatArray:
        """Both of order one."""
        return np.ones(2)

    @property
    def groups(self) -> int:
        """Number of groups."""
        return len(self.y)

    def log_prior(self, D: FloatArray) -> FloatArray:
        """Of s, m and log τ."""
        tau = np.exp(D[:, 2])
        spread = _normal(tau, 0.0, 1.0) + np.log(2.0) + D[:, 2]
        return np.asarray(_normal(D[:, 0], 0.0, 1.0) + _normal(D[:, 1], 0.0, 2.0) + spread)

    def placed(self, D: FloatArray) -> tuple[FloatArray, FloatArray]:
        """They are taken as they are."""
        return D, self.log_prior(D)

    def log_population(self, group: int, S: FloatArray, L: FloatArray) -> tuple[FloatArray]:
        """Of a_g and b_g."""
        return (log_population(L[:, 0], S[:, 1], np.exp(S[:, 2]), FREE) + _normal(L[:, 1], 0.0, 1.0),)

    def terms(self, group: int, S: FloatArray, L: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The same, and the likelihood."""
        first, second = L[:, 0] + S[:, 0], 0.5 * L[:, 0] + L[:, 1] - S[:, 0]
        one, two = self.y[group]
        likelihood = _normal(first, one, self.sd) + _normal(second, two, self.sd)
        return self.log_population(group, S, L)[0], likelihood

    def rescaled(self, group: int, S: FloatArray, L: FloatArray, new: FloatArray) -> tuple[FloatArray, FloatArray]:
        """a_g with its distance from m in units of τ held; b_g as it is."""
        moved = new[:, 1] + np.exp(new[:, 2] - S[:, 2]) * (L[:, 0] - S[:, 1])
        return np.column_stack([moved, L[:, 1]]), new[:, 2] - S[:, 2]

    @property
    def chances(self) -> int:
        """Three for each step."""
        return 18

    def refreshed(self, D: FloatArray, S: FloatArray, L: FloatArray, chance: FloatArray) -> tuple[FloatArray]:
        """A few random-walk steps of m and log τ given the locals."""
        D = D.copy()

        def level(at: FloatArray) -> FloatArray:
            return self.log_prior(at) + sum(
                (self.log_population(g, at, L[:, g])[0] for g in range(self.groups)), start=np.zeros(len(at))
            )

        for one, two, three in chance.T.reshape(6, 3, len(D)):
            new = D.copy()
            new[:, 1:] += ndtri(np.column_stack([one, two])) * np.array([0.3, 0.6])
            taken = np.log(three) < level(new) - level(D)
            D[taken] = new[taken]
        return (D,)

    def start(self, n: int, rng: Generator) -> tuple[FloatArray, FloatArray]:
        """Draws of the prior, drivers (n, 3) and locals (groups, n, 2)."""
        tau = np.abs(rng.standard_normal(n))
        D = np.column_stack([rng.standard_normal(n), 2.0 * rng.standard_normal(n), np.log(tau)])
        a = D[:, 1] + tau * rng.standard_normal((self.groups, n))
        return D, np.stack([a, rng.standard_normal((self.groups, n))], axis=2)

    def exact(self) -> tuple[FloatArray, FloatArray, float]:
        """Mean and sd of s, m, τ, a_1, b_1, a_2, ...; log evidence."""
        # a grid that is dense near zero, by its own measure
        root, G = (np.arange(1500) + 0.5) / 1500, self.groups
        taus = 6.0 * root**2
        y = self.y.ravel()
        levels, means, squares = [], [], []
        for tau in taus:
            prior = np.zeros((2 + 2 * G, 2 + 2 * G))
            prior[0, 0], prior[1, 1] = 1.0, 4.0
            a, b = 2 + 2 * np.arange(G), 3 + 2 * np.arange(G)
            prior[np.ix_(a, a)] = 4.0
            prior[a, 1] = prior[1, a] = 4.0
            prior[a, a] += tau**2
            prior[b, b] = 1.0
            H = np.zeros((2 * G, 2 + 2 * G))
            H[::2, 0], H[1::2, 0] = 1.0, -1.0
            H[2 * np.arange(G), a], H[2 * np.arange(G) + 1, a] = 1.0, 0.5
            H[2 * np.arange(G) + 1, b] = 1.0
            spread = H @ prior @ H.T + self.sd**2 * np.eye(2 * G)
            gain = np.linalg.solve(spread, H @ prior).T
            mean, variance = gain @ y, np.diagonal(prior - gain @ H @ prior)
            levels.append(
                multivariate_normal(np.zeros(2 * G), spread).logpdf(y)
                - 0.5 * tau**2
                + np.log(2.0 / np.sqrt(2 * np.pi))
                + np.log(12.0 * np.sqrt(tau / 6.0) / 1500)
            )
            means.append(np.insert(mean, 2, tau))
            squares.append(np.insert(variance + mean**2, 2, tau**2))
        weights = np.exp(np.array(levels) - logsumexp(levels))
        mean, square = weights @ np.array(means), weights @ np.array(squares)
        log_z = float(logsumexp(levels))
        return mean, np.sqrt(square - mean**2), log_z


def simulated(groups: int, tau: float, sd: float, seed: int) -> Linear:
    """Readings of groups whose a_g spread by ``tau``."""
    rng = np.random.default_rng(seed)
    a, b = 0.7 + tau * rng.standard_normal(groups), rng.standard_normal(groups)
    exact = np.column_stack([a + 0.4, 0.5 * a + b - 0.4])
    return Linear(exact + sd * rng.standard_normal(exact.shape), sd)


def started(family: Linear, seed: int) -> PooledEnsemble:
    """An ensemble with its first laws."""
    rng = np.random.default_rng(seed)
    return begun(family, *family.start(600, rng), 32, rng)


def test_some_of_flattened_draws_are_of_all_walkers() -> None:
    """Laws are fitted to every so many draws: 128 walkers of 500 sweeps, one in 32, would be four of the walkers."""
    walkers = np.tile(np.arange(128.0), (500, 1))[..., None]
    flat, locals_ = flattened(walkers, np.stack([walkers, walkers], axis=1))
    for draws in (flat, *locals_):
        assert set(spaced(draws, 2048)[:, 0]) == set(range(128))


@pytest.mark.slow
def test_moves_have_the_exact_posterior() -> None:
    """Where the groups have one value, so that the spread piles up at zero: the hard case."""
    family = simulated(4, 0.0, 0.2, 3)
    D, L, accepted = run_together(warmed_up([started(family, e) for e in range(4)], (20, 40, 80)), 300)
    own = np.moveaxis(L, 2, 3).reshape(*D.shape[:3], -1)
    chains = np.concatenate([D[..., :2], np.exp(D[..., 2:]), own], axis=3)
    mean, sd, _ = family.exact()
    found = diagnose([str(i) for i in range(chains.shape[-1])], chains, accepted, 1000)
    flat = chains.reshape(-1, chains.shape[-1])
    z = (flat.mean(axis=0) - mean) / sd * np.sqrt(found.ess_bulk)
    assert found.worst_r_hat < 1.01
    assert found.ess > 1500
    assert np.abs(z).max() < 4.5
    assert np.abs(flat.std(axis=0) / sd - 1.0).max() < 0.08


def test_conditional_law_is_normalised_and_drawn_from() -> None:
    """Its density integrates to one given any point, and its draws have that density."""
    rng = np.random.default_rng(0)
    given = rng.standard_normal((3000, 1))
    points = (0.5 * given**2 + np.exp(0.3 * given) * rng.standard_normal((3000, 1))).reshape(-1, 1)
    law = fit_conditional(given, points, np.ones(1), rng, components=4)
    grid = np.linspace(-60.0, 60.0, 24001)[:, None]
    for at in (-1.0, 0.0, 1.5):
        level = law.log_density(np.full_like(grid, at), grid)
        assert np.trapezoid(np.exp(level), grid[:, 0]) == pytest.approx(1.0, abs=2e-3)
    same = np.full((20000, 1), 1.5)
    drawn, level = law.sample(same, rng)
    np.testing.assert_allclose(level, law.log_density(same, drawn), atol=1e-9)
    mass = np.exp(law.log_density(np.full_like(grid, 1.5), grid)) * (grid[1, 0] - grid[0, 0])
    median = grid[np.searchsorted(np.cumsum(mass), 0.5), 0]
    assert np.mean(drawn < median) == pytest.approx(0.5, abs=0.015)


def test_ensembles_that_ask_together_move_as_each_does_alone() -> None:
    """Also where one of them makes a move more; what an ensemble draws depends on its own numbers only."""
    family = simulated(3, 0.5, 0.2, 3)
    alone = [run_together([started(family, seed)], 12) for seed in range(3)]
    together = run_together([started(family, seed) for seed in range(3)], 12)
    for e, parts in enumerate(alone):
        for part, of_all in zip(parts, together, strict=True):
            np.testing.assert_allclose(of_all[e], part[0], rtol=1e-9)
    assert not np.allclose(together[0][0], together[0][1])


def test_laws_are_fitted_anew_to_what_was_found() -> None:
    """Laws fitted to bad starting points are replaced by better ones; the walkers stay where they are."""
    family, rng = simulated(4, 0.5, 0.2, 3), np.random.default_rng(5)
    D, L = family.start(600, rng)
    ensemble = begun(family, D + rng.standard_normal(D.shape), 3.0 * L, 32, rng)
    found = run_together([ensemble], 60)
    before = ensemble.counts.shares["locals anew"]
    better = refitted(ensemble, found[0][0, 30:], found[1][0, 30:])
    np.testing.assert_array_equal(better.walkers.D, ensemble.walkers.D)
    run_together([better], 30)
    assert better.counts.shares["locals anew"] > before + 0.1
