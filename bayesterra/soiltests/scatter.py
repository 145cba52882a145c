"""How the curve of one test departs from the mean curve, and how probable its readings therefore are.

log y(x) = log f(x) + δ(x) + seating, for each test on its own:

- δ, the deviation of this test, is a stationary Gaussian process over the log of sinkage or displacement with
  covariance σ_t² exp(−|Δ log x| / ℓ) (Ornstein–Uhlenbeck). A test keeps its deviation over a distance ℓ:
  what lies closer together tells little that is new, and a hundred readings of one test are no hundred tests.
- The zero of the sinkage of a plate test is wrong by z_0, the same in all tests, and by ζ ~ N(0, σ_0²), one
  value for each test. To first order ζ shifts log p by n ζ / (z + z_0).

With ``independent`` readings there is neither memory nor an error of the zero: each departs on its own, as
least squares assume. That overstates what a test tells, and exists to show by how much.

The process is Markov, so that differences of neighbours are independent: the likelihood costs one pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.soiltests._densities import log_densities
from bayesterra.soiltests.data import Readings


@dataclass(frozen=True)
class Spread:
    """Values of what describes the scatter, (n,) each; no memory: independent readings.

    Attributes
    ----------
    scatter : σ_t.
    memory : ℓ; None where readings are independent.
    shift : standard deviation of log p from the seating times z: n σ_0, m; None where there is none.
    offset : common zero error of the sinkage, m; None where there is none.
    """

    scatter: FloatArray
    memory: FloatArray | None
    shift: FloatArray | None
    offset: FloatArray | None = None

    def true_path(self, path: FloatArray) -> FloatArray:
        """Path (n, m), or (m,) where zeros are right, of what reads ``path`` (m,)."""
        return path if self.offset is None else path + self.offset[:, None]


@dataclass(frozen=True)
class Scatter:
    """The Gaussian law of residuals of log readings about the mean curve."""

    readings: Readings

    @cached_property
    def _first(self) -> BoolArray:
        first = np.zeros(len(self.readings), dtype=np.bool_)
        first[self.readings.starts] = True
        return first

    @cached_property
    def _gaps(self) -> FloatArray:
        """Log distance to the reading before (m,), infinite at the first of a test."""
        gaps = np.diff(np.log(self.readings.path), prepend=0.0)
        return np.where(self._first, np.inf, gaps)

    def log_likelihoods(self, residuals: FloatArray, spread: Spread) -> FloatArray:
        """Log density (n, t) of the residuals (n, m) of every test; a density of log stresses."""
        none = np.zeros(len(spread.scatter))
        memory = none if spread.memory is None else spread.memory
        shift = none if spread.shift is None else spread.shift
        offset = none if spread.offset is None else spread.offset
        ends = np.append(self.readings.starts, len(self.readings))
        found: FloatArray = log_densities(
            np.ascontiguousarray(residuals),
            spread.scatter,
            memory,
            shift,
            self._gaps,
            self.readings.path,
            offset,
            ends,
        )
        return found

    def _kept(self, spread: Spread) -> FloatArray:
        """Correlation (n, m) with the reading before."""
        if spread.memory is None:
            return np.zeros((len(spread.scatter), len(self.readings)))
        return np.exp(-self._gaps / spread.memory[:, None])

    def deviations(self, spread: Spread, rng: Generator) -> FloatArray:
        """Draw residuals (n, m) of new tests with the paths of these."""
        kept = self._kept(spread)
        noise = spread.scatter[:, None] * np.sqrt(1.0 - kept**2) * rng.standard_normal(kept.shape)
        for i in np.flatnonzero(~self._first):
            noise[:, i] += kept[:, i] * noise[:, i - 1]
        if spread.shift is not None:
            zeros = spread.shift[:, None] * rng.standard_normal((len(noise), len(self.readings.tests)))
            noise += zeros[:, self.readings.test] / spread.true_path(self.readings.path)
        return noise


def covariance(path: FloatArray, spread: Spread) -> FloatArray:
    """Covariance (n, m, m) of the log readings of one test at sinkages or displacements ``path`` (m,)."""
    along = np.log(path)
    distance = np.abs(along[:, None] - along)
    if spread.memory is None:
        kept = np.broadcast_to(np.eye(len(path)), (len(spread.scatter), len(path), len(path)))
    else:
        kept = np.exp(-distance / spread.memory[:, None, None])
    result = spread.scatter[:, None, None] ** 2 * kept
    if spread.shift is not None:
        seat = spread.shift[:, None] / spread.true_path(path)
        result = result + seat[:, :, None] * seat[:, None, :]
    return np.asarray(result)


def marginal_sd(path: FloatArray, spread: Spread) -> FloatArray:
    """Standard deviation (n, m) of log readings of a new test."""
    variance = np.broadcast_to(spread.scatter[:, None] ** 2, (len(spread.scatter), len(path)))
    if spread.shift is not None:
        variance = variance + (spread.shift[:, None] / spread.true_path(path)) ** 2
    return np.sqrt(variance)
