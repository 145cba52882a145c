"""The range of a parameter that figures show, and densities of draws on it; all in field units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.parameters import PARAMETERS
from bayesterra.results import Result, field_values

BINS = 400
TAIL = 0.001


@dataclass(frozen=True)
class Axis:
    """A range, linear or logarithmic.

    Attributes
    ----------
    low, high : its ends, field units.
    log : whether equal distances are equal ratios.
    bounds : the ends of the prior's range, infinite where it has none.
    """

    low: float
    high: float
    log: bool
    bounds: tuple[float, float]

    def position(self, values: FloatArray | float) -> FloatArray:
        """Position along the axis, 0 at its low and 1 at its high end; beyond for values outside."""
        low, high = self._scaled(self.low), self._scaled(self.high)
        return np.asarray((self._scaled(values) - low) / (high - low))

    def grid(self, n: int) -> FloatArray:
        """``n`` values at equal distances along the axis."""
        low, high = self._scaled(self.low), self._scaled(self.high)
        values = np.linspace(low, high, n)
        return np.asarray(10.0**values if self.log else values)

    def _scaled(self, values: FloatArray | float) -> FloatArray:
        if not self.log:
            return np.asarray(values, dtype=np.float64)
        return np.log10(np.maximum(values, np.finfo(float).tiny))


def axis(result: Result, name: str) -> Axis:
    """The range of a free parameter's prior, without the outer thousandth of priors without bounds.

    It is widened where the posterior reaches beyond that.
    """
    law, scale = result.study.prior.laws[name], PARAMETERS[name].scale
    low, high = (end / scale for end in law.range)
    draws = field_values(name, result.values()[:, result.names.index(name)])
    tails = law.quantile(np.array([TAIL, 1.0 - TAIL])) / scale
    reach = np.quantile(draws, [TAIL, 1.0 - TAIL])
    return Axis(
        low if np.isfinite(low) else float(min(tails[0], reach[0])),
        high if np.isfinite(high) else float(max(tails[1], reach[1])),
        law.dist == "loguniform",
        (low, high),
    )


def density(draws: FloatArray, along: Axis, n: int = 200) -> FloatArray:
    """Density of draws (m,) at ``n`` places at equal distances along an axis, greatest value 1.

    A Gaussian kernel of Silverman's (1986, eq. 3.31) width for 4000 draws at most, mirrored at the ends.
    """
    position = along.position(draws)
    inside = position[(position >= 0) & (position <= 1)]
    if inside.size < 2:
        return np.zeros(n)
    counts, edges = np.histogram(inside, bins=BINS, range=(0.0, 1.0))
    smooth = _smoothed(counts.astype(np.float64), _width(inside) * BINS)
    heights = np.interp(np.linspace(0, 1, n), 0.5 * (edges[1:] + edges[:-1]), smooth)
    return np.asarray(heights / heights.max())


def _width(position: FloatArray) -> float:
    quartiles = np.quantile(position, [0.25, 0.75])
    spread = min(float(position.std()), float(quartiles[1] - quartiles[0]) / 1.34)
    return float(0.9 * max(spread, 1.0 / BINS) * min(position.size, 4000) ** -0.2)


def _smoothed(counts: FloatArray, width: float) -> FloatArray:
    """Smooth bins with a Gaussian of ``width`` bins, mirrored at both ends."""
    reach = min(len(counts), int(np.ceil(4 * width)) + 1)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(width, 0.3)) ** 2)
    padded = np.pad(counts, reach, mode="symmetric")
    return np.convolve(padded, kernel / kernel.sum(), mode="valid")
