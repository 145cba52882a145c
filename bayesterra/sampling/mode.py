"""The posterior mode, found by optimisation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import LinearConstraint, minimize

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.likelihood.posterior import Posterior
from bayesterra.parameters import SIZES

STARTS = 8
EDGE = 1e-9


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


def find_mode(posterior: Posterior, draws: FloatArray, guesses: Sequence[Mapping[str, float]] = ()) -> Mode:
    """Maximise the posterior density of the soil parameters, noise held at its posterior median.

    Parameters
    ----------
    posterior : the density.
    draws : posterior draws (n, d); the densest of them are starting points, their spread sets the scales.
    guesses : further starting points, soil parameters by name.
    """
    soil = np.array([not name.startswith(SIZES) for name in posterior.names])
    held = np.where(soil, draws, np.median(draws, axis=0))
    density = posterior.log_density(held)
    starts = held[np.argsort(-density, kind="stable")[_spaced(len(held))]]
    median = dict(zip(posterior.names, np.median(held, axis=0), strict=True))
    others = [[{**median, **guess}[name] for name in posterior.names] for guess in guesses]
    starts = np.vstack([starts, *others])
    starts = starts[posterior.log_density(starts) > -np.inf]
    objective = _Objective(posterior, soil, np.cov(held[:, soil].T).reshape(soil.sum(), -1))
    ends = np.array([objective.climb(start) for start in starts])
    levels = posterior.log_density(ends)
    best = int(levels.argmax())
    agreeing = int((levels > levels[best] - 0.01).sum())
    return Mode(ends[best], float(levels[best]), agreeing, len(starts))


def densest(posterior: Posterior, draws: FloatArray) -> Mode:
    """The densest of posterior draws (n, d), where no optimiser has an answer."""
    density = posterior.log_density(draws)
    best = int(density.argmax())
    return Mode(draws[best], float(density[best]), 0, 0)


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
        """Climb from a starting point (d,) inside the support; returns the best point met."""
        factor: FloatArray = np.asarray(np.linalg.cholesky(self.covariance), dtype=np.float64)
        rows, low, high = self._limits()
        x = start
        for _ in range(6):  # a restart forgets a stale curvature estimate
            base = x[self.soil]
            inside = LinearConstraint(rows @ factor, low - rows @ base, high - rows @ base)
            step = minimize(
                self._slope(x, factor),
                np.zeros(len(base)),
                jac=True,
                method="SLSQP",
                constraints=[inside],
                options={"maxiter": 200, "ftol": 1e-12},
            )
            new = self._at(x, base + factor @ step.x)
            before, after = self.posterior.log_density(np.stack([x, new]))
            if not after > before:
                break
            x = new
            if after - before < 1e-7:
                break
        return x

    def _limits(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Linear limits of the support: the prior's ranges, and θ2 < θm < θ1 at the outermost slips."""
        names = [name for name, soil in zip(self.posterior.names, self.soil, strict=True) if soil]
        ranges = np.array([self.posterior.prior.laws[name].range for name in names], dtype=np.float64)
        rows, low, high = [np.eye(len(names))], [ranges[:, 0]], [ranges[:, 1]]
        fixed, slip = self.posterior.prior.fixed, self.posterior.likelihood.forward.conditions.slip
        for s in (slip.min(), slip.max()):
            factors = {"c1": 1.0, "c2": float(s)}
            fixed_sum = sum(factors[name] * fixed[name] for name in factors if name in fixed)
            weights = dict.fromkeys(names, 0.0)
            for name in factors.keys() - fixed.keys():
                weights[self.posterior.prior.root(name)] += factors[name]
            rows.append(np.array([list(weights.values())]))
            low.append(np.array([max(fixed.get("c3", -1.0), -1.0) - fixed_sum + EDGE]))
            high.append(np.array([1.0 - fixed_sum - EDGE]))
        lowest, highest = np.concatenate(low), np.concatenate(high)
        limited = np.isfinite(lowest) | np.isfinite(highest)
        return np.vstack(rows)[limited], lowest[limited], highest[limited]

    def _at(self, x: FloatArray, soil_values: FloatArray) -> FloatArray:
        """Put soil values into a parameter set, inside the prior's ranges to the last digit."""
        moved = x.copy()
        moved[self.soil] = soil_values
        ranges = np.array([law.range for law in self.posterior.prior.laws.values()])
        return np.asarray(np.clip(moved, ranges[:, 0], ranges[:, 1]))

    def _slope(self, x: FloatArray, factor: FloatArray) -> Callable[[FloatArray], tuple[float, FloatArray]]:
        """Value and gradient by central differences, one-sided at an edge of the support."""
        widths = 1e-4 * np.sqrt(np.diagonal(self.covariance))
        steps = np.zeros((len(widths), len(x)))
        steps[:, self.soil] = np.diag(widths)

        def value_and_gradient(y: FloatArray) -> tuple[float, FloatArray]:
            centre = self._at(x, x[self.soil] + factor @ y)
            level = self.posterior.log_density(np.vstack([centre, centre + steps, centre - steps]))
            if np.isneginf(level[0]):
                return 1e10, np.zeros(len(widths))
            ahead, behind = level[1 : len(widths) + 1], level[len(widths) + 1 :]
            run = widths * ((ahead > -np.inf).astype(float) + (behind > -np.inf))
            ahead, behind = (np.where(np.isneginf(side), level[0], side) for side in (ahead, behind))
            slope = np.divide(ahead - behind, run, out=np.zeros_like(run), where=run > 0)
            return -float(level[0]), -factor.T @ slope

        return value_and_gradient
