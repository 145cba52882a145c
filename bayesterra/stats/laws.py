"""Probability laws: any continuous ``scipy.stats`` law, cut to a range; populations.

A population is a normal law cut to a range, of one mean and spread for each value.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.random import Generator
from scipy import stats
from scipy.special import erf, ndtr, ndtri, ndtri_exp

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.errors import StudyError, check_number
from bayesterra.stats.tails import GAUSSIAN

RANGED = ("uniform", "loguniform")
"""Laws whose range is given by ``lower`` and ``upper`` themselves."""
FINITE = (*RANGED, "norm", "halfnorm")
"""Common laws whose density is finite everywhere."""
CROWDED = 1e-6
"""Probability that numbers cannot tell from an end, from which only normal scores do justice to it."""
TOO_CROWDED = 0.5
"""Such a probability, both ends together, beyond which numbers do not represent the law."""
SLOW = frozenset(
    (
        "dpareto_lognorm", "gausshyper", "genhyperbolic", "geninvgauss", "irwinhall", "ksone", "kstwo",
        "levy_stable", "norminvgauss", "rel_breitwigner", "studentized_range", "vonmises", "vonmises_line",
    )
)  # fmt: skip
"""Laws of which scipy takes 2 ms to 1 s for a quantile, measured over all; many thousands are needed."""
MOST = 1e30
"""SI, at most, of a finite limit or argument of a law: beyond, sums and squares overflow."""


@dataclass(frozen=True)
class _Flat:
    """The law that is flat on [low, high], without the cost of ``scipy.stats``."""

    low: float
    high: float

    def support(self) -> tuple[float, float]:
        return self.low, self.high

    def cdf(self, x: FloatArray | float) -> FloatArray:
        return np.clip((np.asarray(x) - self.low) / (self.high - self.low), 0.0, 1.0)

    def sf(self, x: FloatArray | float) -> FloatArray:
        return np.clip((self.high - np.asarray(x)) / (self.high - self.low), 0.0, 1.0)

    def ppf(self, q: FloatArray | float) -> FloatArray:
        return np.asarray(self.low + np.asarray(q) * (self.high - self.low))

    def isf(self, q: FloatArray | float) -> FloatArray:
        return np.asarray(self.high - np.asarray(q) * (self.high - self.low))


@dataclass(frozen=True)
class _Normal:
    """The normal law or its upper ``half``, without the cost of ``scipy.stats`` and equal to it to the last bit."""

    loc: float
    scale: float
    half: bool

    def support(self) -> tuple[float, float]:
        return self.loc if self.half else -np.inf, np.inf

    def _deviation(self, x: FloatArray | float) -> FloatArray:
        z = (np.asarray(x) - self.loc) / self.scale
        return np.maximum(z, 0.0) if self.half else z

    def cdf(self, x: FloatArray | float) -> FloatArray:
        z = self._deviation(x)
        return np.asarray(erf(z / np.sqrt(2)) if self.half else ndtr(z))

    def sf(self, x: FloatArray | float) -> FloatArray:
        return np.asarray((2 if self.half else 1) * ndtr(-self._deviation(x)))

    def ppf(self, q: FloatArray | float) -> FloatArray:
        return np.asarray(ndtri((1 + np.asarray(q)) / 2.0 if self.half else q) * self.scale + self.loc)

    def isf(self, q: FloatArray | float) -> FloatArray:
        return np.asarray(-ndtri(np.asarray(q) / 2 if self.half else q) * self.scale + self.loc)


@dataclass(frozen=True)
class Law:
    """A one-dimensional probability law on ``[lower, upper]``.

    Parameters
    ----------
    dist : name of a continuous ``scipy.stats`` law.
    shape : its own arguments (``loc``, ``scale``, ``a``, ...), SI units.
    lower, upper : the law is cut to this range and renormalised; for ``uniform`` and ``loguniform`` they
        are the range itself.
    source : where the law comes from, in words; two laws that differ in nothing else are equal.

    Raises
    ------
    StudyError : unknown law or argument, an empty range, no probability inside it, or most of it nearer to an
        end than numbers can tell.
    """

    dist: str
    shape: Mapping[str, float] = field(default_factory=dict)
    lower: float = -np.inf
    upper: float = np.inf
    source: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        distribution = getattr(stats, self.dist, None) if isinstance(self.dist, str) else None
        if not isinstance(distribution, stats.rv_continuous):
            raise StudyError(f"'dist' must be the name of a continuous scipy.stats law (got {self.dist!r})")
        if self.dist in SLOW:
            raise StudyError(
                f"the law {self.dist} is too slow: scipy needs milliseconds or more for every quantile;"
                ' give some of them, { dist = "tabulated", scores = [...], values = [...] } with values'
                " at normal scores such as -3 to 3, or take another law"
            )
        if not isinstance(self.shape, Mapping):
            raise StudyError(f"arguments of a law must be numbers by name (got {self.shape!r:.60})")
        for name, value in {**self.shape, "lower": self.lower, "upper": self.upper}.items():
            check_number(name, value)
            if np.isfinite(value) and abs(value) > MOST:
                raise StudyError(f"'{name}' must lie within ±{MOST:g} (got {value:g})")
        if not self.lower < self.upper:
            raise StudyError(f"'lower' must be below 'upper' (got {self.lower:g} and {self.upper:g})")
        if self.dist in RANGED and not np.isfinite([self.lower, self.upper]).all():
            raise StudyError(f"a {self.dist} law needs finite 'lower' and 'upper'")
        if self.dist == "loguniform" and self.lower <= 0:
            raise StudyError(f"'lower' of a loguniform law must be above 0 (got {self.lower:g})")
        if self.dist in RANGED and self.shape:
            raise StudyError(f"a {self.dist} law takes 'lower' and 'upper' only (got {', '.join(self.shape)})")
        self._check_mass()

    @property
    def logarithmic(self) -> bool:
        """True where the law is even or bell-shaped in equal ratios, not in equal distances."""
        return self.dist == "loguniform" or (self.dist == "lognorm" and not self.shape.get("loc"))

    def _check_mass(self) -> None:
        try:
            with np.errstate(all="ignore"):
                mass = self._mass
                middle = self.median if mass > 0 else 0.0
        except (TypeError, ValueError, ArithmeticError) as error:
            raise StudyError(f"wrong arguments for {self.dist}: {error}") from error
        if not np.isfinite([mass, middle]).all():
            raise StudyError(f"{self.dist} is not defined for {_listed(self.shape)}")
        if mass <= 0:
            raise StudyError(
                f"{self.dist} with {_listed(self.shape)} has no probability between {self.lower:g} and {self.upper:g}"
            )
        if sum(self.crowds) > TOO_CROWDED:
            raise StudyError(
                f"{self.dist} with {_listed(self.shape)} has {sum(self.crowds):.0%} of its probability nearer"
                " to an end of its range than numbers can tell: cut it by 'lower' and 'upper'"
            )

    @cached_property
    def _base(self) -> Any:
        if self.dist == "uniform":
            return _Flat(self.lower, self.upper)
        if self.dist == "loguniform":
            return stats.loguniform(self.lower, self.upper)
        loc, scale = self.shape.get("loc", 0.0), self.shape.get("scale", 1.0)
        plain = set(self.shape) <= {"loc", "scale"} and np.isfinite(loc) and scale > 0
        if self.dist in ("norm", "halfnorm") and plain:
            return _Normal(loc, scale, self.dist == "halfnorm")
        return getattr(stats, self.dist)(**self.shape)

    @cached_property
    def _below(self) -> tuple[float, float]:
        """Probability of the uncut law below the lower and below the upper limit."""
        return float(self._base.cdf(self.lower)), float(self._base.cdf(self.upper))

    @cached_property
    def _above(self) -> tuple[float, float]:
        """Probability of the uncut law above the lower and above the upper limit."""
        return float(self._base.sf(self.lower)), float(self._base.sf(self.upper))

    @cached_property
    def _upper_tail(self) -> bool:
        """True where the range lies in the upper tail, where survival functions keep the digits."""
        return self._below[0] > 0.5

    @cached_property
    def _lower_tail(self) -> bool:
        """True where the range lies in the lower tail."""
        return self._below[1] < 0.5

    @cached_property
    def _mass(self) -> float:
        """Probability of the uncut law inside the range."""
        if self._upper_tail:
            return self._above[0] - self._above[1]
        return self._below[1] - self._below[0]

    @cached_property
    def _log_mass(self) -> float:
        return float(np.log(self._mass))

    def _log_density_inside(self, x: FloatArray) -> FloatArray:
        """Log density at points inside the range; common laws without the cost of ``scipy.stats``."""
        if self.dist == "uniform":
            return np.full(x.shape, -np.log(self.upper - self.lower))
        if self.dist == "loguniform":
            return np.asarray(-np.log(x) - np.log(np.log(self.upper / self.lower)))
        if self.dist in ("norm", "halfnorm"):
            loc, scale = self.shape.get("loc", 0.0), self.shape.get("scale", 1.0)
            peak = (np.log(2.0) if self.dist == "halfnorm" else 0.0) - np.log(scale * np.sqrt(2 * np.pi))
            return np.asarray(peak - self._log_mass - 0.5 * ((x - loc) / scale) ** 2)
        density = np.asarray(self._base.logpdf(x) - self._log_mass)
        return np.where(np.isposinf(density), -np.inf, density)  # a pole is a point without probability

    @cached_property
    def range(self) -> tuple[float, float]:
        """Lowest and highest value that the cut law can take."""
        low, high = self._base.support()
        return max(self.lower, float(low)), min(self.upper, float(high))

    @cached_property
    def _inside(self) -> tuple[float, float]:
        """Lowest and highest value that is drawn: the ends, or their neighbours where these have no density."""
        low, high = self.range
        if self.dist in FINITE:
            return low, high
        return self._neighbour(low, high), self._neighbour(high, low)

    def _neighbour(self, end: float, other: float) -> float:
        """The first value with a density on the way from an end to the other one."""
        width = abs(other - end)
        with np.errstate(all="ignore"):
            if not np.isfinite(end) or np.isfinite(self._log_density_inside(np.array([end]))[0]):
                return end
            steps = np.ldexp(abs(np.nextafter(end, other) - end), np.arange(1100))
            values = end + np.sign(other - end) * steps[steps < 0.5 * min(width, 1e300)]
            finite = np.flatnonzero(np.isfinite(self._log_density_inside(values)))
        return float(values[finite[0]]) if finite.size else end

    @cached_property
    def crowds(self) -> tuple[float, float]:
        """Probability of the lowest and of the highest value that is drawn; large only at a pole.

        Near 0 numbers lie close enough for any pole, near 1 they are 1e-16 apart: half the probability of a
        beta law with a = b = 0.02, shifted to [1, 3], is nearer to its ends than that.
        """
        if self.dist in FINITE:
            return 0.0, 0.0
        low, high = self._inside
        with np.errstate(all="ignore"):
            shares = self.cdf(np.array(low)), self.survival(np.array(high))
        return np.nan_to_num(shares[0]).item(), np.nan_to_num(shares[1]).item()

    @property
    def crowded(self) -> bool:
        """True where some of its probability is nearer to an end of the range than numbers can tell."""
        return max(self.crowds) > CROWDED

    def log_density(self, x: FloatArray) -> FloatArray:
        """Log density at ``x`` (any shape), −inf outside the range."""
        low, high = self.range
        inside = (x >= low) & (x <= high)
        with np.errstate(over="ignore"):  # a value far out in the tail has the log density −inf
            if inside.all():
                return self._log_density_inside(x)
            return np.where(inside, self._log_density_inside(np.where(inside, x, self.median)), -np.inf)

    def cdf(self, x: FloatArray) -> FloatArray:
        """Probability of a value up to ``x`` (any shape)."""
        x = np.clip(x, self.lower, self.upper)
        if self._upper_tail:
            return np.asarray((self._above[0] - self._base.sf(x)) / self._mass)
        return np.asarray((self._base.cdf(x) - self._below[0]) / self._mass)

    def survival(self, x: FloatArray) -> FloatArray:
        """Probability of a value above ``x`` (any shape), to the last digit where it is small."""
        x = np.clip(x, self.lower, self.upper)
        if self._lower_tail:
            return np.asarray((self._below[1] - self._base.cdf(x)) / self._mass)
        return np.asarray((self._base.sf(x) - self._above[1]) / self._mass)

    def upper_quantile(self, q: FloatArray) -> FloatArray:
        """Value above which the probability is ``q`` (any shape), the inverse of :meth:`survival`."""
        if self._lower_tail:
            raw = self._base.ppf(self._below[1] - np.asarray(q) * self._mass)
        else:
            raw = self._base.isf(self._above[1] + np.asarray(q) * self._mass)
        return np.asarray(np.clip(raw, *self._inside))

    def quantile(self, q: FloatArray) -> FloatArray:
        """Value below which the probability is ``q`` (any shape)."""
        if self._upper_tail:
            raw = self._base.isf(self._above[0] - np.asarray(q) * self._mass)
        else:
            raw = self._base.ppf(self._below[0] + np.asarray(q) * self._mass)
        return np.asarray(np.clip(raw, *self._inside))

    def score(self, x: FloatArray) -> FloatArray:
        """Normal scores Φ⁻¹(cdf) of values ``x`` (any shape)."""
        below, above = (np.clip(tail(x), 1e-300, 1.0) for tail in (self.cdf, self.survival))
        return np.asarray(np.where(below < above, ndtri(np.minimum(below, 0.5)), -ndtri(np.minimum(above, 0.5))))

    def at_score(self, z: FloatArray) -> FloatArray:
        """Values at normal scores ``z`` (any shape), the inverse of :meth:`score`."""
        # each half from its own tail: 1 − Φ(z) keeps no digits above z = 8
        x, upper = np.empty_like(z), z > 0
        x[~upper] = self.quantile(ndtr(z[~upper]))
        x[upper] = self.upper_quantile(ndtr(-z[upper]))
        return x

    @cached_property
    def median(self) -> float:
        """The value that half of the probability lies below."""
        return float(self.quantile(np.array(0.5)))

    def sample(self, n: int, rng: Generator) -> FloatArray:
        """Draw ``n`` independent values, shape (n,)."""
        return self.quantile(rng.random(n))

    def __str__(self) -> str:
        inside = _listed(self.shape)
        limits = "" if self.dist in RANGED or not np.isfinite([self.lower, self.upper]).any() else "cut to "
        if limits or self.dist in RANGED:
            limits += f"[{self.lower:g}, {self.upper:g}]"
        return " ".join(part for part in (self.dist, f"({inside})" if inside else "", limits) if part)


def _listed(shape: Mapping[str, float]) -> str:
    return ", ".join(f"{key}={value:g}" for key, value in shape.items())


Range = tuple[float, float]
FAINTEST = -690.0
"""Log probability below which a score goes no further out, as in :meth:`Law.score`."""


def log_mass(mean: FloatArray, spread: FloatArray, limits: Range) -> FloatArray:
    """Log probability (any shape) of normal laws inside a range."""
    return GAUSSIAN.log_mass((limits[0] - mean) / spread, (limits[1] - mean) / spread)


def log_population(values: FloatArray, mean: FloatArray, spread: FloatArray, limits: Range) -> FloatArray:
    """Log density of values (any shape) of wheels given mean and spread of their population.

    Normal(mean, spread²) cut to ``limits``, the constant of the cut included; −inf outside them.
    """
    inside = (values >= limits[0]) & (values <= limits[1]) & (spread > 0)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        density = -0.5 * ((values - mean) / spread) ** 2 - np.log(spread) - 0.5 * np.log(2 * np.pi)
        log_density = density - log_mass(mean, spread, limits)
    return np.where(inside & np.isfinite(log_density), log_density, -np.inf)


def draw_population(mean: FloatArray, spread: FloatArray, limits: Range, rng: Generator) -> FloatArray:
    """One value of every population, the shape of ``mean``."""
    return _within(rng.random(np.shape(mean)), _ends(mean, spread, limits), mean, spread, limits)


def population_value(score: FloatArray, mean: FloatArray, spread: FloatArray, limits: Range) -> FloatArray:
    """Values at normal scores (any shape) of the laws of populations, the inverse of their score."""
    ends = _ends(mean, spread, limits)
    return _within(ndtr(np.where(ends[2], -score, score)), ends, mean, spread, limits)


def population_score(values: FloatArray, mean: FloatArray, spread: FloatArray, limits: Range) -> FloatArray:
    """Normal scores (any shape) of values inside the limits under the laws of their populations."""
    with np.errstate(over="ignore", invalid="ignore"):  # spreads of next to nothing, ranges without mass
        low, at, high = ((edge - mean) / spread for edge in (limits[0], values, limits[1]))
        whole = GAUSSIAN.log_mass(low, high)
        below, above = (
            np.clip(np.nan_to_num(part - whole, nan=-np.inf), FAINTEST, 0.0)
            for part in (GAUSSIAN.log_mass(low, at), GAUSSIAN.log_mass(at, high))
        )
    return np.asarray(np.where(below < above, ndtri_exp(below), -ndtri_exp(above)))


def _ends(mean: FloatArray, spread: FloatArray, limits: Range) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Standardised limits, and whether digits are kept in the upper tail."""
    with np.errstate(invalid="ignore"):  # limits at both infinities
        low, high = (limits[0] - mean) / spread, (limits[1] - mean) / spread
        return low, high, np.asarray(low + high > 0)


def _within(
    q: FloatArray, ends: tuple[FloatArray, FloatArray, BoolArray], mean: FloatArray, spread: FloatArray, limits: Range
) -> FloatArray:
    """Values between which and the end of the range with the digits a share ``q`` of a population lies."""
    low, high, flipped = ends
    below, above = np.where(flipped, -high, low), np.where(flipped, -low, high)
    score = ndtri(ndtr(below) + q * (ndtr(above) - ndtr(below)))
    return np.asarray(np.clip(mean + spread * np.where(flipped, -score, score), *limits))
