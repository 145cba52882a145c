"""What is measured of every sampler: effective draws, R-hat, and whether 32 statistics are right.

A statistic is a mean: of a parameter, or of the indicator that it lies below the reference's 5, 50 or 95 %
point. So every kind of draws is judged the same way, each statistic with its own effective number of draws.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.stats.diagnostics import array_ess, array_r_hat, effective_size, r_hat, rank_scores, tail_indicators

PROBABILITIES = (0.05, 0.5, 0.95)
LIMIT = 4.0
"""Monte Carlo errors by which a statistic may be off."""
HERE = Path(__file__).parent


@dataclass(frozen=True)
class Reference:
    """Statistics of a long run.

    Attributes
    ----------
    draws : near-independent draws (n, d), physical.
    mean, sd : of the long run (d,).
    quantiles : 5, 50 and 95 % points (3, d).
    ess : effective draws behind them.
    """

    draws: FloatArray
    mean: FloatArray
    sd: FloatArray
    quantiles: FloatArray
    ess: float

    @classmethod
    def load(cls, drive: str) -> Reference:
        """The stored reference of a drive."""
        with np.load(HERE / f"reference-{drive}.npz") as stored:
            return cls(
                stored["draws"].astype(float),
                *(stored[name] for name in ("mean", "sd", "quantiles")),
                float(stored["ess"]),
            )

    def statistics(self, x: FloatArray) -> FloatArray:
        """Whatever 32 statistics are the means of (..., 4, d), for parameter sets (..., d)."""
        return np.stack([x, *((x < q).astype(float) for q in self.quantiles)], axis=-2)

    @property
    def expected(self) -> FloatArray:
        """The 32 means (4, d)."""
        shares = np.tile(np.array(PROBABILITIES)[:, None], (1, len(self.mean)))
        return np.vstack([self.mean, shares])

    @property
    def spread(self) -> FloatArray:
        """Standard deviations (4, d) behind the 32 means."""
        p = np.array(PROBABILITIES)[:, None]
        return np.vstack([self.sd, np.tile(np.sqrt(p * (1 - p)), (1, len(self.sd)))])

    def errors(self, means: FloatArray, ess: FloatArray) -> FloatArray:
        """By how many Monte Carlo errors, this one's and theirs, 32 means (4, d) are off."""
        return np.asarray((means - self.expected) / (self.spread * np.sqrt(1 / ess + 1 / self.ess)))


@dataclass(frozen=True)
class Measured:
    """What a sampler's draws are worth.

    Attributes
    ----------
    bulk, tail : smallest effective number of draws of a parameter.
    r_hat : largest one, NaN for weighted draws.
    errors : by how many Monte Carlo errors each of the 32 statistics is off (4, d).
    """

    bulk: float
    tail: float
    r_hat: float
    errors: FloatArray

    @property
    def worst(self) -> float:
        """The largest error."""
        return float(np.abs(self.errors).max())

    @property
    def right(self) -> bool:
        """Whether all 32 statistics are within ``LIMIT`` Monte Carlo errors."""
        return self.worst < LIMIT


def of_ensembles(chains: FloatArray, reference: Reference) -> Measured:
    """Draws (ensembles, steps, walkers, d): τ from the walker-averaged autocovariance."""
    columns = np.moveaxis(chains, -1, 0)
    parts = reference.statistics(chains)
    ess = np.array([[effective_size(parts[..., k, j]) for j in range(len(columns))] for k in range(4)])
    return Measured(
        min(effective_size(rank_scores(column)) for column in columns),
        min(effective_size(inside) for column in columns for inside in tail_indicators(column)),
        max(r_hat(column) for column in columns),
        reference.errors(parts.mean(axis=(0, 1, 2)), _filled(ess)),
    )


def of_chains(chains: FloatArray, reference: Reference) -> Measured:
    """Draws (chains, draws, d): ArviZ's estimators."""
    columns = np.moveaxis(chains, -1, 0)
    parts = reference.statistics(chains)
    ess = np.array([[array_ess(parts[..., k, j], "mean") for j in range(len(columns))] for k in range(4)])
    return Measured(
        min(array_ess(column) for column in columns),
        min(array_ess(column, "tail") for column in columns),
        max(array_r_hat(column) for column in columns),
        reference.errors(parts.mean(axis=(0, 1)), _filled(ess)),
    )


def of_weighted(x: FloatArray, log_weights: FloatArray, reference: Reference) -> Measured:
    """Weighted draws (n, d): Kish's effective number for all statistics."""
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    ess = float(1 / (weights**2).sum())
    means = np.einsum("n,nkd->kd", weights, reference.statistics(x))
    return Measured(ess, ess, np.nan, reference.errors(means, np.full(means.shape, ess)))


def _filled(ess: FloatArray) -> FloatArray:
    """A statistic that never varied has as few effective draws as the worst other one."""
    known = ess > 0
    return np.where(known, ess, ess[known].min() if known.any() else 1.0)
