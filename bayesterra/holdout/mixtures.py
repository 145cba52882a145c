"""Predictive laws as mixtures, and how well a reading agrees with them.

The continuous ranked probability score of a law F at a reading y,

    CRPS(F, y) = ∫ (F(x) − 1{x ≥ y})² dx = E|X − y| − ½ E|X − X'|,

has the unit of the reading and is the smaller the better; for a law without width it is the absolute error
(Gneiting and Raftery 2007). For a mixture of normals both expectations are known in closed form (Grimit et
al. 2006).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import gammaln, logsumexp, ndtr, ndtri, stdtr, stdtrit

from bayesterra.arrays import FloatArray

_CUTS = np.array([0.001, 0.01, 0.05, 0.15, 0.3, 0.5, 0.7, 0.85, 0.95, 0.99, 0.999])
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
_U, _DU = 0.5 * (_NODES + 1), 0.5 * _WEIGHTS


@dataclass(frozen=True)
class Mixture:
    """Equal parts of normal or Student-t laws.

    Attributes
    ----------
    centre, scale : of every part (n,).
    dof : degrees of freedom of all parts; infinite for normal ones.
    """

    centre: FloatArray
    scale: FloatArray
    dof: float = np.inf

    def cdf(self, x: FloatArray) -> FloatArray:
        """Probability (k,) below each of ``x`` (k,)."""
        z = (np.asarray(x)[:, None] - self.centre) / self.scale
        return np.asarray((ndtr(z) if np.isinf(self.dof) else stdtr(self.dof, z)).mean(axis=1))

    def log_density(self, y: float) -> float:
        """Log of the density at ``y``."""
        z = (y - self.centre) / self.scale
        if np.isinf(self.dof):
            log = -0.5 * z**2 - 0.5 * np.log(2 * np.pi)
        else:
            half = 0.5 * self.dof
            peak = gammaln(half + 0.5) - gammaln(half) - 0.5 * np.log(self.dof * np.pi)
            log = peak - (half + 0.5) * np.log1p(z**2 / self.dof)
        return float(logsumexp(log - np.log(self.scale)) - np.log(len(z)))

    def quantiles(self, levels: FloatArray) -> FloatArray:
        """Quantiles (k,) at levels (k,) inside (0, 1); one lies between those of the parts."""
        return np.array([self._quantile(float(level)) for level in levels])

    def _quantile(self, level: float) -> float:
        standard = ndtri(level) if np.isinf(self.dof) else stdtrit(self.dof, level)
        of_parts = self.centre + self.scale * standard
        low, high = float(of_parts.min()), float(of_parts.max())
        width = high - low
        if width <= 1e-12 * max(abs(low), abs(high)):
            return low
        margin = 1e-6 * width  # rounding must not leave the root outside
        return float(
            brentq(
                lambda x: float(self.cdf(np.array([x]))[0]) - level, low - margin, high + margin,
                xtol=1e-10 * width,
            )
        )  # fmt: skip

    def crps(self, y: float) -> float:
        """Continuous ranked probability score of a reading ``y``, in its unit."""
        if not np.isinf(self.dof):
            return self._integrated(y)
        square = self.scale**2
        between = _mean_size(self.centre[:, None] - self.centre, square[:, None] + square)
        return float(_mean_size(self.centre - y, square).mean() - 0.5 * between.mean())

    def _integrated(self, y: float) -> float:
        """The integral that defines the score, piece by piece between quantiles, tails mapped to (0, 1)."""
        cuts = np.unique(np.append(self.quantiles(_CUTS), y))
        widths = np.diff(cuts)
        x = (cuts[:-1, None] + widths[:, None] * _U).ravel()
        weight = (widths[:, None] * _DU).ravel()
        reach = float(cuts[-1] - cuts[0]) or 1.0
        tail, stretch = reach * _U / (1 - _U), reach * _DU / (1 - _U) ** 2
        x = np.concatenate([x, cuts[-1] + tail, cuts[0] - tail])
        weight = np.concatenate([weight, stretch, stretch])
        return float((self.cdf(x) - (x >= y)) ** 2 @ weight)


def _mean_size(mean: FloatArray, variance: FloatArray) -> FloatArray:
    """E|X| of normal X."""
    sd = np.sqrt(variance)
    z = mean / sd
    return np.asarray(mean * (2 * ndtr(z) - 1) + 2 * sd * np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi))
