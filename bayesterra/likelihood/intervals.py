"""Readings that stand for an interval: rounded to a step, or known to lie below or above a limit.

An instrument adds its noise and then shows the nearest step. A reading y with step δ stands for all values
in [y − δ/2, y + δ/2], and its probability is that of the interval under the law of the noise around the
modelled value. The likelihood takes that probability over δ, which goes over into a density as δ falls.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray, IntArray
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
