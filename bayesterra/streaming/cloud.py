"""Weighted particles: parameter sets that stand for a posterior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from bayesterra.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class Cloud:
    """Particles and their weights.

    Attributes
    ----------
    x : parameter sets (n, d), SI and radians.
    log_likelihood : log likelihood (n,) of all rows so far.
    log_weights : (n,), summing to one as weights.
    """

    x: FloatArray
    log_likelihood: FloatArray
    log_weights: FloatArray

    @classmethod
    def even(cls, x: FloatArray, log_likelihood: FloatArray) -> Cloud:
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
        return effective_number(self.log_weights)

    def weighed(self, log_terms: FloatArray) -> tuple[Cloud, float]:
        """The cloud with log factors (n,) taken into its weights, and the log of their weighted mean."""
        log_weights = self.log_weights + log_terms
        total = float(logsumexp(log_weights))
        return replace(self, log_weights=log_weights - total), total

    def take(self, keep: BoolArray) -> Cloud:
        """Some of the particles, weights as they stand."""
        return Cloud(self.x[keep], self.log_likelihood[keep], self.log_weights[keep])

    def log_share(self, chosen: BoolArray) -> float:
        """Log of the weight that some of the particles hold together."""
        return float(logsumexp(self.log_weights[chosen]))

    def quantiles(self, probabilities: Sequence[float]) -> FloatArray:
        """Quantiles (k, d) of every parameter."""
        return weighted_quantiles(self.x, self.weights, probabilities)

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation (d,) of every parameter."""
        mean = self.weights @ self.x
        return mean, np.sqrt(self.weights @ (self.x - mean) ** 2)


def effective_number(log_weights: FloatArray) -> float:
    """Effective number of log weights (n,) of any scale; 0 where all are −inf."""
    top = log_weights.max()
    if not np.isfinite(top):
        return 0.0
    weights = np.exp(log_weights - top)
    return float(weights.sum() ** 2 / (weights**2).sum())


def weighted_quantiles(values: FloatArray, weights: FloatArray, probabilities: Sequence[float]) -> FloatArray:
    """Quantiles (k, d) of weighted values (n, d); every value stands at the middle of its share."""
    order = np.argsort(values, axis=0, kind="stable")
    found = np.empty((len(probabilities), values.shape[1]))
    for column, ranks in enumerate(order.T):
        share = weights[ranks]
        below = np.cumsum(share) - 0.5 * share
        found[:, column] = np.interp(probabilities, below / share.sum(), values[ranks, column])
    return found
