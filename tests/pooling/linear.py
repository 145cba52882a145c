"""A hierarchical family with exact moments: linear and Gaussian given the spread, which a grid sums over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from bayesterra.arrays import FloatArray
from bayesterra.pooling.populations import log_population

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

    blocks = ((0,), (1, 2))
    widths = np.ones(2)

    @property
    def groups(self) -> int:
        return len(self.y)

    def log_prior(self, D: FloatArray) -> FloatArray:
        tau = np.exp(D[:, 2])
        spread = _normal(tau, 0.0, 1.0) + np.log(2.0) + D[:, 2]
        return _normal(D[:, 0], 0.0, 1.0) + _normal(D[:, 1], 0.0, 2.0) + spread

    def log_population(self, group: int, D: FloatArray, L: FloatArray) -> FloatArray:
        return log_population(L[:, 0], D[:, 1], np.exp(D[:, 2]), FREE) + _normal(L[:, 1], 0.0, 1.0)

    def terms(self, group: int, D: FloatArray, L: FloatArray) -> tuple[FloatArray, FloatArray]:
        first, second = L[:, 0] + D[:, 0], 0.5 * L[:, 0] + L[:, 1] - D[:, 0]
        one, two = self.y[group]
        likelihood = _normal(first, one, self.sd) + _normal(second, two, self.sd)
        return self.log_population(group, D, L), likelihood

    def refreshed(self, D: FloatArray, L: FloatArray, rng: Generator) -> FloatArray:
        """A few random-walk steps of m and log τ given the locals."""
        D = D.copy()

        def level(at: FloatArray) -> FloatArray:
            return self.log_prior(at) + sum(
                (self.log_population(g, at, L[g]) for g in range(self.groups)), start=np.zeros(len(at))
            )

        for _ in range(6):
            new = D.copy()
            new[:, 1:] += rng.standard_normal((len(D), 2)) * np.array([0.3, 0.6])
            taken = np.log(rng.random(len(D))) < level(new) - level(D)
            D[taken] = new[taken]
        return D

    def start(self, n: int, rng: Generator) -> tuple[FloatArray, FloatArray]:
        """Draws of the prior, drivers (n, 3) and locals (groups, n, 2)."""
        tau = np.abs(rng.standard_normal(n))
        D = np.column_stack([rng.standard_normal(n), 2.0 * rng.standard_normal(n), np.log(tau)])
        a = D[:, 1] + tau * rng.standard_normal((self.groups, n))
        return D, np.stack([a, rng.standard_normal((self.groups, n))], axis=2)

    def exact(self) -> tuple[FloatArray, FloatArray, float]:
        """Mean and sd of s, m, τ, a_1, b_1, a_2, ...; log evidence."""
        taus, G = np.linspace(1e-4, 6.0, 4000), self.groups
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
            )
            means.append(np.insert(mean, 2, tau))
            squares.append(np.insert(variance + mean**2, 2, tau**2))
        weights = np.exp(np.array(levels) - logsumexp(levels))
        mean, square = weights @ np.array(means), weights @ np.array(squares)
        log_z = float(logsumexp(levels) + np.log(taus[1] - taus[0]))
        return mean, np.sqrt(square - mean**2), log_z


def simulated(groups: int, tau: float, sd: float, seed: int) -> Linear:
    """Readings of groups whose a_g spread by ``tau``."""
    rng = np.random.default_rng(seed)
    a, b = 0.7 + tau * rng.standard_normal(groups), rng.standard_normal(groups)
    exact = np.column_stack([a + 0.4, 0.5 * a + b - 0.4])
    return Linear(exact + sd * rng.standard_normal(exact.shape), sd)
