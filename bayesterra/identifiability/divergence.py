"""Kullback–Leibler divergence between two laws of one quantity that are known by their draws."""

from __future__ import annotations

import numpy as np
from scipy.special import digamma

from bayesterra.arrays import FloatArray, IntArray


def divergence(draws: FloatArray, reference: FloatArray) -> tuple[float, float]:
    """Divergence (nats) of the law of ``draws`` (n,) from that of ``reference`` (m,), and its standard error.

    The mean over the draws of log p − log q. Both densities come from the width of a window of √n order
    statistics to either side, cut off at the ends of the sample, so that a law may end abruptly there
    (windows as Vasicek 1976; the digamma function makes the log of every width unbiased where the density is
    even). Error by the delta method: var(log p/q)/n + (mean(p/q) − 1)/m. Both sets must be nearly
    independent. A law many times narrower than the gaps of the reference has an error that says so.
    """
    k = round(np.sqrt(len(draws)))
    ratio = _log_density_within(np.sort(draws), k) - _log_density_at(np.sort(draws), np.sort(reference), k)
    error = ratio.var() / len(draws) + max(np.exp(ratio).mean() - 1.0, 0.0) / len(reference)
    return float(ratio.mean()), float(np.sqrt(error))


def _log_density_within(x: FloatArray, k: int) -> FloatArray:
    """Log density (n,) at sorted draws, each from the gaps of its own window."""
    place = np.arange(len(x))
    low, high = np.maximum(place - k, 0), np.minimum(place + k, len(x) - 1)
    return np.asarray(digamma(high - low) - np.log(_width(x[low], x[high])) - np.log(len(x)))


def _log_density_at(points: FloatArray, x: FloatArray, k: int) -> FloatArray:
    """Log density at points (n,) of the law of sorted draws (m,).

    The gap that a point falls into is longer than others, by as much as one gap more: the window from the
    k-th draw below to the k-th above has 2k − 1 gaps and the length of 2k.
    """
    below: IntArray = np.searchsorted(x, points)
    low, high = np.maximum(below - k, 0), np.minimum(below + k - 1, len(x) - 1)
    left, right = np.minimum(x[low], points), np.maximum(x[high], points)
    gaps = high - low + 1.0
    return np.asarray(digamma(gaps) - np.log(_width(left, right)) - np.log(len(x)))


def _width(left: FloatArray, right: FloatArray) -> FloatArray:
    return np.maximum(right - left, 1e-300)
