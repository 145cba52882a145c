"""The posterior mode, found by optimisation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import LinearConstraint, minimize

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.parameters import NOISE_PREFIX
from bayesterra.posterior import Posterior

STARTS = 8


@dataclass(frozen=True)
class Mode:
    """The most probable parameter set.

    Attributes
    ----------
    x : parameters (d,) in the posterior's order; estimated noise stands at its posterior median, because the
        joint mode of a spread and what spreads is no fair summary of either.
    log_density : log posterior density there.
    agreeing : how many of the optimiser's starts ended within 0.01 of it in log density.
    starts : how many starts there were.
    """

    x: FloatArray
    log_density: float
    agreeing: int
    starts: int


def find_mode(posterior: Posterior, draws: FloatArray) -> Mode:
    """Maximise the posterior density of the soil parameters, noise held at its posterior median.

    Parameters
    ----------
    posterior : the density.
    draws : posterior draws (n, d); the densest of them are starting points, their spread sets the scales.
    """
    soil = np.array([not name.startswith(NOISE_PREFIX) for name in posterior.names])
    held = np.where(soil, draws, np.median(draws, axis=0))
    density = posterior.log_density(held)
    starts = held[np.argsort(-density, kind="stable")[_spaced(len(held))]]
    objective = _Objective(posterior, soil, np.cov(held[:, soil].T).reshape(soil.sum(), -1))
    ends = np.array([objective.climb(start) for start in starts])
    levels = posterior.log_density(ends)
    best = int(levels.argmax())
    agreeing = int((levels > levels[best] - 0.01).sum())
    return Mode(ends[best], float(levels[best]), agreeing, len(starts))


def _spaced(n: int) -> list[int]:
    """Ranks of the starting points: the densest, then ever further down the list."""
    return sorted({min(n - 1, int(n * 0.5 * (i / (STARTS - 1)) ** 2)) for i in range(STARTS)})


@dataclass(frozen=True)
class _Objective:
    """Negative log density of the soil parameters in coordinates whitened by the draws' covariance."""

    posterior: Posterior
    soil: BoolArray
    covariance: FloatArray

    def climb(self, start: FloatArray) -> FloatArray:
        """Climb from a starting point (d,) inside the prior's range; returns the best point met."""
        factor: FloatArray = np.asarray(np.linalg.cholesky(self.covariance), dtype=np.float64)
        ranges = np.array([law.range for law in self.posterior.prior.laws.values()], dtype=np.float64)
        low, high = ranges[self.soil].T
        x = start
        for _ in range(3):  # a restart forgets a stale curvature estimate
            base = x[self.soil]
            inside = LinearConstraint(factor, low - base, high - base)
            step = minimize(
                self._slope(x, factor, low, high),
                np.zeros(len(base)),
                jac=True,
                method="SLSQP",
                constraints=[inside],
                options={"maxiter": 200, "ftol": 1e-12},
            )
            new = self._at(x, np.clip(base + factor @ step.x, low, high))
            before, after = self.posterior.log_density(np.stack([x, new]))
            if not after > before:
                break
            x = new
            if after - before < 1e-9:
                break
        return x

    def _at(self, x: FloatArray, soil_values: FloatArray) -> FloatArray:
        moved = x.copy()
        moved[self.soil] = soil_values
        return moved

    def _slope(
        self, x: FloatArray, factor: FloatArray, low: FloatArray, high: FloatArray
    ) -> Callable[[FloatArray], tuple[float, FloatArray]]:
        """Value and gradient by central differences, one-sided at an edge of the support."""
        d, width = len(low), 1e-4 * np.sqrt(np.diagonal(self.covariance))

        def value_and_gradient(y: FloatArray) -> tuple[float, FloatArray]:
            centre = np.clip(x[self.soil] + factor @ y, low, high)
            points = np.repeat(centre[None], 2 * d + 1, axis=0)
            points[1 : d + 1] += np.diag(np.minimum(width, high - centre))
            points[d + 1 :] -= np.diag(np.minimum(width, centre - low))
            sets = np.repeat(x[None], len(points), axis=0)
            sets[:, self.soil] = points
            level = self.posterior.log_density(sets)
            if np.isneginf(level[0]):
                return 1e10, np.zeros(d)
            level = np.where(np.isneginf(level), level[0], level)
            run = np.diagonal(points[1 : d + 1] - points[d + 1 :])
            return -float(level[0]), -factor.T @ ((level[1 : d + 1] - level[d + 1 :]) / run)

        return value_and_gradient
