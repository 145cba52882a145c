"""Whether probability integral transforms are uniform: a band for their empirical distribution."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.random import default_rng
from scipy.stats import binom

from bayesterra.arrays import FloatArray


@lru_cache
def ecdf_band(n: int, probability: float = 0.95, simulations: int = 2000) -> tuple[FloatArray, FloatArray]:
    """Simultaneous band of the empirical distribution of n uniform values (Säilynoja et al. 2022).

    Returns lower and upper ends at 1/n, 2/n, ..., 1, such that the whole curve lies inside with the
    probability given; found by simulation with a fixed stream.
    """
    points = np.arange(1, n + 1) / n
    values = np.sort(default_rng(0).random((simulations, n)), axis=1)
    counts = np.array([np.searchsorted(one, points, side="right") for one in values])
    tails = np.minimum(binom.cdf(counts, n, points), binom.sf(counts - 1, n, points))[:, :-1].min(axis=1)
    level = np.quantile(tails, 1.0 - probability)
    return binom.ppf(level, n, points) / n, binom.isf(level, n, points) / n


def calibrated(pit: Sequence[float]) -> bool:
    """Whether PIT values, NaN left out, keep inside the 95 % band of uniform ones."""
    values = np.sort([p for p in pit if np.isfinite(p)])
    low, high = ecdf_band(len(values))
    share = np.searchsorted(values, np.arange(1, len(values) + 1) / len(values), side="right") / len(values)
    return bool(((share >= low) & (share <= high)).all())
