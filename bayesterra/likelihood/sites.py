"""Normal laws in place of readings that have none: known by a limit only, or with heavy-tailed noise.

Expectation propagation: each reading becomes a normal law with which its value without noise has the moments
that it has given all other readings (Minka 2001, Uncertainty in Artificial Intelligence 17, 362; for
limits Cunningham, Hennig and Lacoste-Julien 2013, arXiv:1111.6832). Heavy-tailed noise is a mixture of
normal laws here, so that these moments are sums.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.special import logsumexp, ndtr, ndtri

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.models.kernels import compiled
from bayesterra.stats.tails import GAUSSIAN, Tails

VAGUE = 1e3
"""Where laws in place of limits begin, in standard deviations."""
FLATTEST = 1e-6
"""Precision of a law over that of what all else tells, at least: no digits are lost to its width."""
SHARE = 0.5
"""How far laws in place of what has heavy tails go in one round: so far that they settle."""
LEAST = 1e-8
"""Variance of what all else tells, at least, in units of that of the noise."""


def stand_in(
    told: FloatArray, variance: FloatArray, level: FloatArray, pull: FloatArray, bend: FloatArray,
    before: tuple[FloatArray, FloatArray] | None = None, step: FloatArray | float = 1.0,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Mean, standard deviation and log factor of normal laws that stand for what is known of a quantity.

    All else tells ``told`` of it, with ``variance``; ``level`` is the log probability then of what is known,
    ``pull`` and ``bend`` its first two derivatives by ``told``. Moments of the quantity are kept, or where
    a ``step`` is below 1 approached from the law ``before``, so that laws which hang together settle.
    """
    share = np.clip(1.0 + variance * bend, 1e-8, 1.0)
    gain = np.maximum(1.0 / share - 1.0, FLATTEST)  # precision of the law over that of all else
    mean, sd = told + variance * pull * (1.0 + 1.0 / gain), np.sqrt(variance / gain)
    if before is not None:
        old, new = (1.0 - step) * before[1] ** -2, step * sd**-2
        mean, sd = (old * before[0] + new * mean) / (old + new), (old + new) ** -0.5
    spread = variance + sd**2
    return mean, sd, level + 0.5 * (np.log(2 * np.pi * spread) + (mean - told) ** 2 / spread)


@dataclass(frozen=True)
class Sites:
    """Normal laws that stand for q readings, given all other readings."""

    row: IntArray  # of the readings
    column: IntArray  # of the readings
    low: FloatArray  # lower ends (q,) between which they lie
    high: FloatArray  # upper ends (q,); the same for a number
    scale: FloatArray  # of their noise (n, q)
    parts: FloatArray  # sds (q, l), in units of the scale, of the normal laws that the noise is a mixture of
    shares: FloatArray  # logs of their shares
    values: FloatArray  # readings in their place (n, q)
    sd: FloatArray  # standard deviations of these
    level: FloatArray  # what this leaves of the log probability (n, q)
    stretch: FloatArray  # derivatives (n, q) by the log of ``scale``, but for those by noise of these readings

    @classmethod
    def begun(
        cls, side: FloatArray, readings: FloatArray, scale: FloatArray, sd: FloatArray, tails: tuple[Tails, ...]
    ) -> "Sites":
        """Where they begin, with standard deviations ``sd`` (n, m, k).

        ``side`` (m, k) is 1 and −1 for readings (m, k) known to lie above and below what they say, 0 for
        numbers, NaN for readings that need none of this; ``scale`` (n, m, k) is of noise.
        """
        row, column = (~np.isnan(side)).nonzero()
        end, own = readings[row, column], side[row, column]
        low, high = np.where(own < 0, -np.inf, end), np.where(own > 0, np.inf, end)
        noise, spread = scale[:, row, column], sd[:, row, column]
        parts, shares = (part[column] for part in _mixtures(tails))
        none = np.zeros(spread.shape)
        return cls(row, column, low, high, noise, parts, shares, none + end, spread, none, none)

    def given(self, others: FloatArray, variance: FloatArray) -> "Sites":
        """As all other readings tell these (n, q); ``variance`` holds what stands in their place, too."""
        left, wide = self._left(variance), self.low < self.high
        moments = np.empty((*left.shape, 4))
        numbers(self.low - others, left, self.scale, self.parts, self.shares, moments)
        if wide.any():
            moments[:, wide] = self._between(others, left, wide)
        level, first, second, third = np.moveaxis(moments, -1, 0)
        step, before = np.where(wide, 1.0, SHARE), (self.values, self.sd)
        values, sd, rest = stand_in(others, left, level, first, second - first**2, before, step)
        stretch = self.scale**2 * (third - first**2 + 1.0 / (left + sd**2))
        return replace(self, values=values, sd=sd, level=rest, stretch=stretch)

    def _left(self, variance: FloatArray) -> FloatArray:
        return np.asarray(np.maximum(variance - self.sd**2, LEAST * self.scale**2))

    def _between(self, others: FloatArray, left: FloatArray, wide: BoolArray) -> FloatArray:
        """What :func:`numbers` fills, for limits (n, w, 4)."""
        low, high, root = (part[:, wide] for part in self._ends(others, left))
        level, (pull, bend) = GAUSSIAN.log_between(low, high), GAUSSIAN.pulls_between(low, high)
        total = np.asarray(logsumexp(level + self.shares[wide], axis=2))
        weight = np.exp(level + self.shares[wide] - total[..., None])
        twice = weight * bend / root**2
        sums = (weight * pull / root, twice, twice * self.parts[wide] ** 2)
        return np.stack([total, *(each.sum(axis=2) for each in sums)], axis=-1)

    def _ends(self, others: FloatArray, left: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Standardised ends (n, q, l) under the parts, and standard deviations of these."""
        root = np.hypot(np.sqrt(left)[..., None], self.scale[..., None] * self.parts)
        return (self.low - others)[..., None] / root, (self.high - others)[..., None] / root, root

    def scores(self, others: FloatArray, variance: FloatArray) -> FloatArray:
        """Normal scores (n, q) of the readings, of the middles of limits by probability."""
        low, high, _ = self._ends(others, self._left(variance))
        share = np.exp(self.shares)
        below, above = (0.5 * (share * (ndtr(t * low) + ndtr(t * high))).sum(axis=2) for t in (1.0, -1.0))
        score = ndtri(np.maximum(np.minimum(below, above), 1e-300))  # the tail with the digits
        return np.asarray(np.where(below < above, score, -score))

    def take(self, chosen: IntArray) -> "Sites":
        """Those of the sets, also repeatedly."""
        parts = {n: getattr(self, n)[chosen] for n in ("scale", "values", "sd", "level", "stretch")}
        return replace(self, **parts)


@compiled
def numbers(
    off: FloatArray, left: FloatArray, scale: FloatArray, parts: FloatArray, shares: FloatArray, out: FloatArray
) -> None:
    """Fill `out` (n, q, 4) for numbers that are ``off`` (n, q) what all else tells with a variance ``left``.

    With log probability, and the first two derivatives of the probability over it by what all else tells, the
    second also with every part of the noise times its variance in units of the scale.
    """
    level = np.empty(parts.shape[1])
    for i in range(off.shape[0]):
        for j in range(off.shape[1]):
            top, square = -np.inf, off[i, j] * off[i, j]
            for k in range(level.size):
                precision = 1.0 / (left[i, j] + (scale[i, j] * parts[j, k]) ** 2)
                level[k] = shares[j, k] + 0.5 * np.log(precision) - 0.5 * square * precision
                top = max(top, level[k])
            total = first = second = third = 0.0
            for k in range(level.size):
                precision = 1.0 / (left[i, j] + (scale[i, j] * parts[j, k]) ** 2)
                weight = np.exp(level[k] - top) * precision
                bend = weight * (square * precision - 1.0)
                total += weight / precision
                first += weight
                second += bend
                third += bend * parts[j, k] ** 2
            out[i, j, 0] = top + np.log(total) - 0.5 * np.log(2.0 * np.pi)
            out[i, j, 1], out[i, j, 2] = off[i, j] * first / total, second / total
            out[i, j, 3] = third / total


@cache
def _mixtures(tails: tuple[Tails, ...]) -> tuple[FloatArray, FloatArray]:
    """Standard deviations (k, l) and logs of shares of laws; what fills up shorter ones has no share."""
    count = max(len(law.parts[0]) for law in tails)
    sd, shares = np.ones((len(tails), count)), np.full((len(tails), count), -np.inf)
    for i, law in enumerate(tails):
        sd[i, : len(law.parts[0])], shares[i, : len(law.parts[0])] = law.parts
    return sd, shares
