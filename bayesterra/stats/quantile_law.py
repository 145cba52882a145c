"""Laws by a table of their quantiles: what draws said of a parameter, kept as a prior.

The table holds values at normal scores z, where Φ(z) is the probability below the value. Between its scores
z(x) is the monotone rational quadratic of Gregory and Delbourgo (1982, IMA J. Numer. Anal. 2, 123-130), whose
slopes come from the table and whose inverse is known in closed form (Durkan et al. 2019, Neural Spline Flows,
eq. (6) to (8)). Beyond the table the law is normal; where that would soon lead beyond an end of the range,
probability instead goes to 0 towards the end as a power of the distance. Density, probabilities and quantiles
are those of one map x(z), so they agree to the last digits.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import log_ndtr, ndtr, ndtri, ndtri_exp

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError
from bayesterra.stats.laws import Law

TABULATED = "tabulated"
REACH = 8.0
"""Score within which a normal tail must not lead beyond the range; 6e-16 of the probability lies beyond."""
LEAST = 3
"""Rows that a table needs."""


@dataclass(frozen=True)
class QuantileLaw(Law):
    """A law on ``[lower, upper]`` with given values at given normal scores.

    Parameters
    ----------
    scores : normal scores, rising, with 0 inside.
    values : the values there (SI), rising, inside the range.

    Raises
    ------
    StudyError : scores or values do not rise, are too few, or lie outside the range.
    """

    dist: str = TABULATED
    scores: tuple[float, ...] = ()
    values: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if len(self.scores) != len(self.values) or len(self.scores) < LEAST:
            lengths = f"{len(self.scores)} and {len(self.values)}"
            raise StudyError(f"'scores' and 'values' must be equally many, at least {LEAST} (got {lengths})")
        if not self.lower < self.upper:
            raise StudyError(f"'lower' must be below 'upper' (got {self.lower:g} and {self.upper:g})")
        for name, column in (("scores", self.scores), ("values", self.values)):
            fall = np.flatnonzero(~(np.diff(column) > 0))
            if fall.size:
                pair = f"{column[fall[0]]:g} and {column[fall[0] + 1]:g}"
                raise StudyError(f"'{name}' must rise (got {pair})")
        if not -REACH < self.scores[0] < 0.0 < self.scores[-1] < REACH:
            ends = f"{self.scores[0]:g} and {self.scores[-1]:g}"
            raise StudyError(f"'scores' must begin below 0, end above it, within ±{REACH:g} (got {ends})")
        if not self.lower < self.values[0] < self.values[-1] < self.upper:
            ends = f"{self.values[0]:g} and {self.values[-1]:g}"
            raise StudyError(f"'values' must lie between 'lower' and 'upper' (got {ends})")

    @cached_property
    def range(self) -> tuple[float, float]:
        """Lowest and highest value of the law."""
        return self.lower, self.upper

    @cached_property
    def crowds(self) -> tuple[float, float]:
        """None: densities are finite at the ends."""
        return 0.0, 0.0

    @cached_property
    def _map(self) -> "_Map":
        return _Map.through(np.array(self.scores), np.array(self.values), self.range)

    def score(self, x: FloatArray) -> FloatArray:
        """Normal scores of values ``x`` (any shape); those outside the range have the score of its end."""
        return self._map.score_and_slope(np.clip(x, *self.range))[0]

    def at_score(self, z: FloatArray) -> FloatArray:
        """Values at normal scores ``z`` (any shape)."""
        return np.asarray(np.clip(self._map.value(np.asarray(z)), *self.range))

    def log_density(self, x: FloatArray) -> FloatArray:
        """Log density at ``x`` (any shape), −inf outside the range."""
        x = np.asarray(x, dtype=np.float64)
        inside = (x >= self.lower) & (x <= self.upper)
        z, log_slope = self._map.score_and_slope(np.where(inside, x, self.values[0]))
        density = -0.5 * z**2 - 0.5 * np.log(2 * np.pi) + log_slope
        return np.where(inside, density, -np.inf)

    def cdf(self, x: FloatArray) -> FloatArray:
        """Probability of a value up to ``x`` (any shape)."""
        x = np.asarray(x)
        between = np.where(x >= self.upper, 1.0, ndtr(self.score(x)))
        return np.where(x <= self.lower, 0.0, between)

    def survival(self, x: FloatArray) -> FloatArray:
        """Probability of a value above ``x`` (any shape), to the last digit where it is small."""
        x = np.asarray(x)
        between = np.where(x >= self.upper, 0.0, ndtr(-self.score(x)))
        return np.where(x <= self.lower, 1.0, between)

    def quantile(self, q: FloatArray) -> FloatArray:
        """Value below which the probability is ``q`` (any shape)."""
        return self.at_score(ndtri(q))

    def upper_quantile(self, q: FloatArray) -> FloatArray:
        """Value above which the probability is ``q`` (any shape)."""
        return self.at_score(-ndtri(q))

    def widened(self, factor: float) -> "QuantileLaw":
        """The law whose values at scores z are those of this one at ``factor`` · z, at the same scores."""
        if factor == 1.0:
            return self
        values = [float(f"{value:.6g}") for value in self.at_score(factor * np.array(self.scores))]
        below = [self.lower, *values]  # at bounds they meet
        rising = [i for i, value in enumerate(values) if below[i] < value < self.upper]
        scores, values = ([column[i] for i in rising] for column in (self.scores, values))
        return QuantileLaw(
            lower=self.lower, upper=self.upper, source=self.source, scores=tuple(scores), values=tuple(values)
        )

    def __str__(self) -> str:
        low, middle, high = self.quantile(np.array([0.05, 0.5, 0.95]))
        return f"tabulated (median {middle:g}, 90 % {low:g} to {high:g})"


@dataclass(frozen=True)
class _Tail:
    """The map beyond a table's first row (score, value, slope); ``power``: γ of x − end ∝ Φ(z)^γ, 0 where normal."""

    z: float
    x: float
    slope: float
    end: float
    power: float

    @classmethod
    def of(cls, z: float, x: float, slope: float, end: float) -> "_Tail":
        """The tail that goes on from a row with its slope."""
        room = x - end
        if room > slope * (REACH + z):
            return cls(z, x, slope, end, 0.0)
        hazard = float(np.exp(-0.5 * z**2 - 0.5 * np.log(2 * np.pi) - log_ndtr(z)))
        power = min(slope / (hazard * room), 1.0)  # above 1 the density would grow without limit at the end
        return cls(z, x, power * hazard * room, end, power)

    def value(self, z: FloatArray) -> FloatArray:
        """Values at scores below that of the row."""
        if not self.power:
            return self.x + (z - self.z) * self.slope
        return np.asarray(self.end + (self.x - self.end) * np.exp(self.power * (log_ndtr(z) - log_ndtr(self.z))))

    def score_and_slope(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Score and log dz/dx of values below that of the row."""
        if not self.power:
            return self.z + (x - self.x) / self.slope, np.full(x.shape, -np.log(self.slope))
        room = self.x - self.end
        log_share = np.log(np.maximum((x - self.end) / room, 1e-300))
        log_below = log_ndtr(self.z) + log_share / self.power
        z = np.maximum(ndtri_exp(log_below), -1e100)
        log_density = log_below - log_share - np.log(self.power * room)
        return z, log_density + 0.5 * z**2 + 0.5 * np.log(2 * np.pi)


@dataclass(frozen=True)
class _Map:
    """z(x) and x(z) of a table: knots z, x (k,), slopes dz/dx there, and the tails."""

    z: FloatArray
    x: FloatArray
    slopes: FloatArray
    below: _Tail
    above: _Tail

    @classmethod
    def through(cls, z: FloatArray, x: FloatArray, ends: tuple[float, float]) -> "_Map":
        """Slopes are geometric means of those of the neighbouring secants, extrapolated at the ends."""
        logs = np.log(np.diff(x) / np.diff(z))
        middle = 0.5 * (logs[1:] + logs[:-1])
        slopes = np.exp([1.5 * logs[0] - 0.5 * logs[1], *middle, 1.5 * logs[-1] - 0.5 * logs[-2]])
        below = _Tail.of(float(z[0]), float(x[0]), float(slopes[0]), ends[0])
        above = _Tail.of(-float(z[-1]), -float(x[-1]), float(slopes[-1]), -ends[1])
        slopes[[0, -1]] = below.slope, above.slope
        return cls(z, x, 1.0 / slopes, below, above)

    def _parts(self, among: FloatArray, of: FloatArray) -> tuple[FloatArray, ...]:
        """Start, width, height, secant and both end slopes of the intervals in which values lie."""
        k = np.clip(np.searchsorted(among, of, side="right") - 1, 0, len(among) - 2)
        width, height = np.diff(self.x)[k], np.diff(self.z)[k]
        return self.x[k], self.z[k], width, height, height / width, self.slopes[k], self.slopes[k + 1]

    def score_and_slope(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Scores and log dz/dx of values inside the range (any shape)."""
        shape, x = np.shape(x), np.ravel(x)
        start, z_start, width, height, secant, first, last = self._parts(self.x, x)
        t = np.clip((x - start) / width, 0.0, 1.0)
        bend = t * (1 - t)
        below = secant + (first + last - 2 * secant) * bend
        z = z_start + height * (secant * t**2 + first * bend) / below
        slope = secant**2 * (last * t**2 + 2 * secant * bend + first * (1 - t) ** 2) / below**2
        log_slope = np.log(slope)
        left, right = x < self.x[0], x > self.x[-1]
        if left.any():
            z[left], log_slope[left] = self.below.score_and_slope(x[left])
        if right.any():
            mirrored, log_slope[right] = self.above.score_and_slope(-x[right])
            z[right] = -mirrored
        return z.reshape(shape), log_slope.reshape(shape)

    def value(self, z: FloatArray) -> FloatArray:
        """Values at scores (any shape)."""
        shape, z = np.shape(z), np.ravel(z)
        start, z_start, width, height, secant, first, last = self._parts(self.z, z)
        up = np.clip(z - z_start, 0.0, height)
        excess = up * (first + last - 2 * secant)
        a, b, c = height * (secant - first) + excess, height * first - excess, -secant * up
        x = start + width * 2 * c / (-b - np.sqrt(np.maximum(b**2 - 4 * a * c, 0.0)))
        left, right = z < self.z[0], z > self.z[-1]
        if left.any():
            x[left] = self.below.value(z[left])
        if right.any():
            x[right] = -self.above.value(-z[right])
        return x.reshape(shape)
