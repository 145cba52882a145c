"""Groups with a conjugate likelihood, so that every evidence has a closed form."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.random import Generator
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.likelihood.joint import JointPosterior, joint_posterior
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import Posterior
from bayesterra.study.groups import Pooling
from bayesterra.study.study import Study

STANDARD = {"dist": "norm", "loc": 0.0, "scale": 1.0}
NOISE_OF_SECOND = 0.3


@dataclass(frozen=True)
class Readings(Likelihood):
    """Two readings of n0 and n1, n0 + n1/2 and n1, with normal errors, in the place of the wheel's."""

    y: FloatArray = field(default_factory=lambda: np.zeros(2))
    sd: float = 1.0

    def log_likelihood(self, soil: FloatArray, noise_values: FloatArray) -> FloatArray:
        """Log density (n,) of both readings."""
        n0, n1 = soil[:, 1], soil[:, 2]
        first = -0.5 * ((self.y[0] - n0 - 0.5 * n1) / self.sd) ** 2 - np.log(self.sd * np.sqrt(2 * np.pi))
        second = -0.5 * ((self.y[1] - n1) / NOISE_OF_SECOND) ** 2
        return np.asarray(first + second - np.log(NOISE_OF_SECOND * np.sqrt(2 * np.pi)))

    def status(self, soil: FloatArray) -> IntArray:
        """Every parameter set has outcomes."""
        return np.zeros(len(soil), dtype=np.intp)


@dataclass(frozen=True)
class Gaussian:
    """Readings (groups, 2) and all that follows from them in closed form."""

    y: FloatArray
    sd: float

    @property
    def groups(self) -> int:
        """Number of groups."""
        return len(self.y)

    def joint(self, study: Study, pooling: Pooling) -> JointPosterior:
        """The joint posterior of n0 and n1 of a study that has wheels and rows for its coordinates."""
        first = joint_posterior(study).first
        given = first.likelihood
        parts = {
            f"g{i}": Posterior(first.prior, Readings(given.forward, given.observations, given.noise, y=y, sd=self.sd))
            for i, y in enumerate(self.y)
        }
        return JointPosterior(pooling, parts)

    def chains(self, ensembles: int, n: int, rng: Generator) -> dict[str, FloatArray]:
        """Draws of each group's own posterior (ensembles, n/10, 10, 2)."""
        H, R = np.array([[1.0, 0.5], [0.0, 1.0]]), np.diag([self.sd**2, NOISE_OF_SECOND**2])
        covariance = np.linalg.inv(np.eye(2) + H.T @ np.linalg.solve(R, H))
        means = [covariance @ H.T @ np.linalg.solve(R, y) for y in self.y]
        size = (ensembles, n // 10, 10)
        return {f"g{i}": rng.multivariate_normal(m, covariance, size) for i, m in enumerate(means)}

    def log_evidence(self, n0: FloatArray, n1: FloatArray | None = None, both: FloatArray | None = None) -> float:
        """Of readings, values of the groups having the prior covariances (groups, groups)."""
        covariance = self._covariance(n0, n1, both)
        return float(multivariate_normal(np.zeros(len(covariance)), covariance).logpdf(self.y.T.ravel()))

    def _covariance(self, n0: FloatArray, n1: FloatArray | None = None, both: FloatArray | None = None) -> FloatArray:
        """Prior covariance of all first readings, then of all second ones."""
        G = self.groups
        second = np.eye(G) if n1 is None else n1
        cross = np.zeros((G, G)) if both is None else both
        covariance = np.zeros((2 * G, 2 * G))
        covariance[:G, :G] = n0 + 0.25 * second + 0.5 * (cross + cross.T) + self.sd**2 * np.eye(G)
        covariance[:G, G:] = cross + 0.5 * second
        covariance[G:, :G] = covariance[:G, G:].T
        covariance[G:, G:] = second + NOISE_OF_SECOND**2 * np.eye(G)
        return covariance

    @property
    def own(self) -> float:
        """Log evidence of values of each group's own."""
        return self.log_evidence(np.eye(self.groups))

    @property
    def common(self) -> float:
        """Log evidence of one value of n0."""
        return self.log_evidence(np.ones((self.groups, self.groups)))

    @property
    def population(self) -> float:
        """Log evidence of values of n0 from one population, its spread half-normal of scale 1/2."""
        spreads, whole = (np.arange(1000) + 0.5) * 3.0 / 1000, np.eye(2 * self.groups)
        whole[self.groups :] = 0.0
        at_one = self._covariance(np.ones((self.groups, self.groups)))
        factors = np.linalg.cholesky(at_one + spreads[:, None, None] ** 2 * whole)
        white = np.linalg.solve(factors, np.tile(self.y.T.ravel()[:, None], (len(spreads), 1, 1)))[..., 0]
        scales = np.diagonal(factors, axis1=1, axis2=2)
        levels = -0.5 * (white**2).sum(axis=1) - np.log(scales * np.sqrt(2 * np.pi)).sum(axis=1)
        weights = -0.5 * (spreads / 0.5) ** 2
        return float(logsumexp(levels + weights) - logsumexp(weights))

    @property
    def log_factor(self) -> float:
        """Log Bayes factor of one value against the better alternative."""
        return self.common - max(self.own, self.population)

    def spread_to(self, factor: float) -> Gaussian:
        """The same, what readings say of n0 drawn apart or together until the log Bayes factor is ``factor``.

        Raises
        ------
        ValueError : groups that agree in full have a lower one.
        """
        second, low, high = 0.5 * self.y[:, 1], 0.0, 200.0
        first = self.y[:, 0] - second
        for _ in range(60):
            way = 0.5 * (low + high)
            y = np.column_stack([first.mean() + way * (first - first.mean()) + second, self.y[:, 1]])
            low, high = (way, high) if replace(self, y=y).log_factor > factor else (low, way)
        if high < 1e-9:
            raise ValueError(f"groups that agree in full have a log Bayes factor below {factor}")
        return replace(self, y=y)


def gaussian(groups: int, sd: float, rng: Generator) -> Gaussian:
    """Readings of groups whose values differ a little."""
    n0, n1 = 0.2 + 0.01 * rng.standard_normal(groups), 0.3 * rng.standard_normal(groups)
    exact = np.column_stack([n0 + 0.5 * n1, n1])
    return Gaussian(exact + np.array([sd, NOISE_OF_SECOND]) * rng.standard_normal((groups, 2)), sd)
