"""Readings that no normal law tells: rounded to a step, beyond a limit, or with heavy tails; and laws in their place.

An instrument adds its noise and then shows the nearest step. A reading y with step δ stands for all values in
[y − δ/2, y + δ/2]; the likelihood takes their probability over δ, which goes over into a density as δ falls.

Expectation propagation: each reading becomes a normal law with which its value without noise has the moments
that it has given all other readings (Minka 2001, Uncertainty in Artificial Intelligence 17, 362; for
limits Cunningham, Hennig and Lacoste-Julien 2013, arXiv:1111.6832). Heavy-tailed noise is a mixture of
normal laws here, so that these moments are sums.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from scipy.special import logsumexp, ndtr, ndtri

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.models.kernels import compiled
from bayesterra.stats.tails import GAUSSIAN, Tails
from bayesterra.study.noise import Noise
from bayesterra.study.observations import Observations


@dataclass(frozen=True)
class Intervals:
    """Readings that stand for all values which an instrument shows as them: rounded, or beyond a limit."""

    noise: Sequence[Noise]  # of the channels
    lower: FloatArray  # limits (m, k) at which readings end, −inf where they do not
    upper: FloatArray  # likewise, +inf where they do not
    readings: FloatArray  # (m, k) as measured: one of the steps of what is rounded; NaN where there is none
    rounding: bool = True  # steps are intervals; else rounding is one more error of the noise

    @classmethod
    def of(
        cls, rows: Observations, noise: Sequence[Noise], readings: FloatArray, *, rounding: bool
    ) -> "Intervals | None":
        """Those of some rows; None where every reading is a number to its last digit."""
        if not rows.limits and not (rounding and any(entry.resolution for entry in noise)):
            return None
        return cls(noise, *cls.ends(rows, noise), readings, rounding)

    @staticmethod
    def ends(rows: Observations, noise: Sequence[Noise]) -> tuple[FloatArray, FloatArray]:
        """Limits (m, k) of the readings of some rows."""
        none = np.tile([-np.inf, np.inf], (len(rows), 1))
        both = np.stack([rows.limits.get(entry.channel, none) for entry in noise], axis=1)
        return both[..., 0], both[..., 1]

    @cached_property
    def steps(self) -> FloatArray:
        """Steps (k,) of rounding, 0 for none."""
        return np.array([entry.resolution * self.rounding for entry in self.noise])

    def recorded(self, values: FloatArray) -> FloatArray:
        """Readings (..., m, k) that an instrument makes of values: rounded, then held at the limits."""
        for i in np.flatnonzero(self.steps):
            start, step = np.nan_to_num(self.readings[:, i]), self.steps[i]
            values[..., i] = start + step * np.round((values[..., i] - start) / step)
        return np.clip(values, self.lower, self.upper)

    def limited(self, readings: FloatArray) -> BoolArray:
        """Readings (m, k) that are known by a limit only."""
        return np.asarray((readings <= self.lower) | (readings >= self.upper))

    def sides(self, readings: FloatArray) -> FloatArray:
        """1 for readings (m, k) known to lie above a limit, −1 for those below one, 0 for all others."""
        return np.where(readings >= self.upper, 1.0, np.where(readings <= self.lower, -1.0, 0.0))

    def between(
        self, i: int, readings: FloatArray, predicted: FloatArray, scale: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Standardised ends (n, m) of what the readings (m, k) of a channel stand for."""
        values, half = readings[:, i], 0.5 * self.steps[i]
        low = np.where(values <= self.lower[:, i], -np.inf, values - half)
        high = np.where(values >= self.upper[:, i], np.inf, values + half)
        low = np.where(values >= self.upper[:, i], values, low)
        high = np.where(values <= self.lower[:, i], values, high)
        return (low - predicted[:, :, i]) / scale[:, :, i], (high - predicted[:, :, i]) / scale[:, :, i]

    def channels(self, readings: FloatArray) -> list[tuple[int, IntArray]]:
        """Channels of which a reading (m, k) stands for an interval, and the rows where it does."""
        limited = self.limited(readings)
        rows = [np.flatnonzero(~np.isnan(readings[:, i]) & (limited[:, i] | (step > 0)))
                for i, step in enumerate(self.steps)]  # fmt: skip
        return [(i, chosen) for i, chosen in enumerate(rows) if chosen.size]

    def replace_densities(
        self, density: FloatArray, readings: FloatArray, predicted: FloatArray, scale: FloatArray
    ) -> None:
        """Put log probabilities of intervals, over their steps, in place of log densities (n, m, k)."""
        limited = self.limited(readings)
        for i, rows in self.channels(readings):
            low, high = self.between(i, readings, predicted, scale)
            level = self.noise[i].tails.log_between(low[:, rows], high[:, rows])
            density[:, rows, i] = level - np.where(limited[rows, i], 0.0, np.log(self.steps[i] or 1.0))

    def replace_pulls(self, pull: FloatArray, stretch: FloatArray, predicted: FloatArray, scale: FloatArray) -> None:
        """Put derivatives of log probabilities of the readings by place and scale in place of densities'."""
        for i, rows in self.channels(self.readings):
            low, high = self.between(i, self.readings, predicted, scale)
            by_place, by_scale = self.noise[i].tails.pulls_between(low[:, rows], high[:, rows])
            pull[:, rows, i], stretch[:, rows, i] = (part / scale[:, rows, i] for part in (by_place, by_scale))

    def at_middles(self, standard: FloatArray, predicted: FloatArray, scale: FloatArray) -> FloatArray:
        """Standardised residuals (n, m, k), those of readings known by a limit put at its middle."""
        limited = self.limited(self.readings)
        for i, _ in self.channels(self.readings):
            rows = np.flatnonzero(limited[:, i])
            low, high = self.between(i, self.readings, predicted, scale)
            standard[:, rows, i] = self.noise[i].tails.middle(low[:, rows], high[:, rows])
        return standard


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
