"""Importance weights: their effective number, means by them, resampling, tempering and Pareto smoothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import logsumexp

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.stats.diagnostics import array_stats


def relative(log_weights: FloatArray) -> FloatArray:
    """Weights of any shape whose greatest is one; all 0 where no log weight is finite."""
    top = log_weights.max()
    return np.asarray(np.exp(log_weights - top)) if np.isfinite(top) else np.zeros_like(log_weights)


def normalised(log_weights: FloatArray) -> FloatArray:
    """Weights (n,) that sum to one."""
    return np.asarray(np.exp(log_weights - logsumexp(log_weights)))


def effective_number(weights: FloatArray) -> float:
    """Effective number of draws of weights of any scale (Kong 1992); 0 where none has any."""
    squares = (weights**2).sum()
    return float(weights.sum() ** 2 / squares) if squares > 0 else 0.0


def log_mean(log_values: ArrayLike, axis: int | None = None) -> FloatArray:
    """Log of the mean of what is given by its log."""
    values = np.asarray(log_values, dtype=np.float64)
    return np.asarray(logsumexp(values, axis=axis) - np.log(values.size if axis is None else values.shape[axis]))


def weighted_log_mean(log_weights: FloatArray, log_values: FloatArray) -> tuple[float, float]:
    """Log of the weighted mean of values given by their log, and its Monte Carlo error (delta method).

    ``log_weights`` (n,) sum to one as weights.
    """
    mean = float(logsumexp(log_weights + log_values))
    excess = np.exp(log_weights) * np.expm1(log_values - mean)
    return mean, float(np.sqrt((excess**2).sum()))


def weighted_quantiles(values: FloatArray, weights: FloatArray, probabilities: Sequence[float]) -> FloatArray:
    """Quantiles (k, d) of weighted values (n, d); every value stands at the middle of its share."""
    order = np.argsort(values, axis=0, kind="stable")
    quantiles = np.empty((len(probabilities), values.shape[1]))
    for column, ranks in enumerate(order.T):
        share = weights[ranks]
        below = np.cumsum(share) - 0.5 * share
        quantiles[:, column] = np.interp(probabilities, below / share.sum(), values[ranks, column])
    return quantiles


def systematic(weights: FloatArray, n: int, rng: Generator) -> IntArray:
    """Indices (n,) drawn in proportion to weights (k,) by systematic resampling."""
    steps = np.cumsum(weights) / weights.sum()
    return np.minimum(np.searchsorted(steps, (np.arange(n) + rng.random()) / n), len(weights) - 1)


def largest_power(log_factors: FloatArray, most: float, wanted: float, log_weights: FloatArray | float = 0.0) -> float:
    """Largest power, at most ``most``, of factors (n,) that leaves weights an effective number ``wanted``.

    Logs of both are finite.
    """

    def excess(power: float) -> float:
        return effective_number(relative(log_weights + power * log_factors)) - wanted

    if excess(most) >= 0:
        return most
    return float(brentq(excess, 0.0, most, xtol=1e-300, rtol=1e-6, maxiter=1000))  # powers can be very small


def pareto_smoothed(log_weights: FloatArray) -> tuple[FloatArray, float]:
    """Importance weights (n,) with a Pareto-smoothed tail, and its shape k̂ (Vehtari et al. 2024).

    Returns log weights that sum to one. A k̂ above :func:`pareto_limit` means that they cannot be relied on;
    it is infinite where the tail cannot be fitted, as so few draws have all the weight or the tail is one
    weight over and over, and 0 where the largest fifth of the weights are one and the same.
    """
    raw = np.asarray(log_weights, dtype=float)
    plain = raw - logsumexp(raw)
    ordered, n = np.sort(raw), len(raw)
    tail = int(3 * n**0.5 if n > 225 else n / 5)  # weights that the law is fitted to, as ArviZ takes them
    if np.ptp(ordered[-max(5, n // 5) :]) == 0.0:
        return plain, 0.0
    if tail < 5 or np.ptp(ordered[-tail:]) == 0.0:  # the same draw over and over, from a walker that stood
        return plain, np.inf
    with np.errstate(divide="ignore", invalid="ignore"):
        smoothed, k = array_stats().psislw(-raw)
    if np.isnan(smoothed).any() or np.isnan(k):
        return plain, np.inf
    return np.asarray(smoothed), float(k)


def pareto_limit(draws: int) -> float:
    """Largest k̂ at which this number of draws gives reliable means (Vehtari et al. 2024, eq. (13))."""
    return float(min(1.0 - 1.0 / np.log10(draws), 0.7))
