"""Laws of standardised residuals, symmetric and of unit scale: Gaussian, with heavier tails, or one's own."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.random import Generator
from scipy.optimize import nnls
from scipy.special import gammainccinv, gammaln, log_ndtr, ndtr, ndtri, ndtri_exp, stdtr, stdtrit

from bayesterra.arrays import FloatArray

NARROW = 1e-4
"""Width, in units of the scale, below which the law of an interval is the density of its middle."""
PARTS, FARTHEST = 32, 300.0
"""Normal laws in place of a heavy-tailed one, and the residual to which they stand for it."""


@dataclass(frozen=True)
class Tails:
    """Law of a standardised residual z: the normal law, from which others derive."""

    mark: ClassVar[str] = ""  # the letter that marks it in tables

    @property
    def name(self) -> str:
        """The kind of law."""
        return "Gaussian"

    @property
    def keys(self) -> Mapping[str, object]:
        """Keys of the law in the [noise] table of a study: none where an entry names no other law."""
        return {}

    @property
    def code(self) -> float:
        """Number by which compiled code knows the law; NaN where it does not."""
        return np.inf

    @property
    def words(self) -> str:
        """The law with its numbers in words; empty for a Gaussian one."""
        return ""

    @property
    def log_peak(self) -> float:
        """Log density at the centre."""
        return float(-0.5 * np.log(2 * np.pi))

    @property
    def information(self) -> tuple[float, float]:
        """Fisher information about place and scale."""
        return 1.0, 2.0

    @property
    def variance(self) -> float:
        """Variance, or a number in its place where that is infinite."""
        return 1.0

    @property
    def parts(self) -> tuple[FloatArray, FloatArray]:
        """Standard deviations (l,) of normal laws that it is a mixture of, and logs of their shares."""
        return np.ones(1), np.zeros(1)

    def log_density(self, z: FloatArray) -> FloatArray:
        """Log density of residuals of any shape."""
        return np.asarray(self.log_peak - 0.5 * z**2)

    def pull(self, z: FloatArray) -> FloatArray:
        """Minus the derivative of the log density."""
        return z

    def spread(self, z: FloatArray) -> FloatArray:
        """Variance of the normal law that pulls as much at residuals."""
        return np.ones_like(z)

    def cdf(self, z: FloatArray) -> FloatArray:
        """Probability below."""
        return np.asarray(ndtr(z))

    def log_cdf(self, z: FloatArray) -> FloatArray:
        """Log of the probability below, with its digits far out."""
        return np.asarray(log_ndtr(z))

    def log_mass(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """Log probability between residuals of any shape, by that below each; NaN where it has no digits."""
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            flipped = low + high > 0  # the tail with the digits
            low, high = np.where(flipped, -high, low), np.where(flipped, -low, high)
            below, above = self.log_cdf(low), self.log_cdf(high)
            return np.asarray(above + np.log(-np.expm1(np.minimum(below - above, 0.0))))

    def log_between(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """The same for ``low`` < ``high``, also of intervals that are narrow or beyond all digits."""
        apart = self.log_mass(low, high)
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            close = self.log_density(0.5 * (low + high)) + np.log(high - low)
        far = ~(apart > -np.inf) & np.isfinite(close)
        return np.where((high - low < NARROW) | far, close, np.nan_to_num(apart, nan=-np.inf, neginf=-np.inf))

    def pulls_between(self, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of the log probability of an interval by a shift of the law and by a stretch of it."""
        level, middle = self.log_between(low, high), 0.5 * (low + high)

        def times_density(z: FloatArray) -> FloatArray:
            return np.where(np.isfinite(z), np.exp(self.log_density(z) - level), 0.0)

        with np.errstate(invalid="ignore", over="ignore"):
            below, above = times_density(low), times_density(high)
            by_scale = np.where(below > 0, low * below, 0.0) - np.where(above > 0, high * above, 0.0)
            pull, close = self.pull(middle), high - low < NARROW
            return np.where(close, pull, below - above), np.where(close, pull * middle - 1.0, by_scale)

    def middle(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """Residuals (any shape) that halve the probability of intervals."""
        flipped = low + high > 0  # the tail with the digits
        low, high = np.where(flipped, -high, low), np.where(flipped, -low, high)
        level = np.maximum(0.5 * (self.cdf(low) + self.cdf(high)), 1e-300)
        return np.where(flipped, -self.quantile(level), self.quantile(level))

    def quantile(self, level: FloatArray) -> FloatArray:
        """Residuals below which a residual lies with probabilities ``level`` of any shape."""
        return np.asarray(ndtri(level))

    def normal_score(self, z: FloatArray) -> FloatArray:
        """Residuals as the normal ones that are as far out."""
        return z

    def draw(self, shape: tuple[int, ...], rng: Generator) -> FloatArray:
        """Draw residuals."""
        return rng.standard_normal(shape)


@dataclass(frozen=True)
class StudentT(Tails):
    """Student's law with ``dof`` degrees of freedom, whose tails let single readings be far out."""

    dof: float
    mark: ClassVar[str] = "t"

    @property
    def name(self) -> str:
        """See :class:`Tails`."""
        return "Student-t"

    @property
    def keys(self) -> Mapping[str, object]:
        """See :class:`Tails`."""
        return {"dof": self.dof}

    @property
    def code(self) -> float:
        """Degrees of freedom."""
        return self.dof

    @property
    def words(self) -> str:
        """See :class:`Tails`."""
        return f"t with {self.dof:g} dof"

    @cached_property
    def log_peak(self) -> float:
        """See :class:`Tails`."""
        half = 0.5 * self.dof
        return float(gammaln(half + 0.5) - gammaln(half) - 0.5 * np.log(self.dof * np.pi))

    @property
    def information(self) -> tuple[float, float]:
        """See :class:`Tails`; Lange, Little & Taylor 1989, J. Am. Stat. Assoc. 84, 881."""
        return (self.dof + 1.0) / (self.dof + 3.0), 2.0 * self.dof / (self.dof + 3.0)

    @property
    def variance(self) -> float:
        """See :class:`Tails`; 3 up to two degrees of freedom."""
        return 1.0 / (1.0 - 2.0 / max(self.dof, 2.1)) if self.dof > 2 else 3.0

    @cached_property
    def parts(self) -> tuple[FloatArray, FloatArray]:
        """See :class:`Tails`: a normal law of precision λ, which has a gamma law, summed over log λ."""
        half = 0.5 * self.dof
        top = float(np.log(gammainccinv(half, 1e-9) / half))
        low = max(np.log(0.2 * (self.dof + 1) / FARTHEST**2), top - PARTS * 1.2 / np.sqrt(half + 0.5))
        log_precision, step = np.linspace(low, top, PARTS, retstep=True)
        level = half * (np.log(half) + log_precision - np.exp(log_precision)) - gammaln(half)
        return np.exp(-0.5 * log_precision), np.asarray(level + np.log(step))

    def log_density(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        return np.asarray(self.log_peak - 0.5 * (self.dof + 1) * np.log1p(z**2 / self.dof))

    def pull(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        return (self.dof + 1.0) * z / (self.dof + z**2)

    def spread(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        return (self.dof + z**2) / (self.dof + 1.0)

    def cdf(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        return np.asarray(stdtr(self.dof, z))

    def log_cdf(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(stdtr(self.dof, z)))

    def quantile(self, level: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        return np.asarray(stdtrit(self.dof, level))

    def normal_score(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        score = ndtri(np.maximum(stdtr(self.dof, -np.abs(z)), 1e-300))
        return np.asarray(-np.sign(z) * score)

    def draw(self, shape: tuple[int, ...], rng: Generator) -> FloatArray:
        """See :class:`Tails`."""
        return rng.standard_t(self.dof, shape)


@runtime_checkable
class ResidualLaw(Protocol):
    """A law as frozen ones of ``scipy.stats`` are: functions of arrays of any shape."""

    def logpdf(self, x: Any, /) -> Any:
        """Log density."""

    def logcdf(self, x: Any, /) -> Any:
        """Log of the probability below."""

    def ppf(self, q: Any, /) -> Any:
        """Values below which a residual lies with probabilities."""


@dataclass(frozen=True)
class OwnTails(Tails):
    """A law of one's own, or any of ``scipy.stats`` that is symmetric about 0.

    Parameters
    ----------
    law : its functions.
    stated : keys and values by which a study states it, and which tell it from other laws.

    Raises
    ------
    ValueError : it is not symmetric about 0, ends somewhere, or its functions do not belong together.
    """

    law: ResidualLaw = field(compare=False)
    stated: tuple[tuple[str, object], ...]
    mark: ClassVar[str] = "o"

    def __post_init__(self) -> None:
        level = np.array([[0.5, 0.6, 0.8], [0.95, 0.99, 0.999]])
        z = self.quantile(level)
        if z.shape != level.shape or not np.isfinite(z).all():
            raise ValueError(f"'ppf' must return finite numbers, one for each probability (got {z})")
        if abs(z[0, 0]) > 1e-6 * z[0, 1]:
            raise ValueError(f"must be symmetric about 0 (its median is {z[0, 0]:.3g})")
        if not np.isfinite(far := self.log_density(np.array(FARTHEST))):
            raise ValueError(f"must have a density above 0 everywhere (its logpdf({FARTHEST:g}) is {far:g})")
        density, apart = np.exp(self.log_density(z)), 1e-4 * z[0, 1]
        rise = (np.exp(self.log_cdf(z + apart)) - np.exp(self.log_cdf(z - apart))) / (2 * apart)
        told = {
            "symmetric about 0: logpdf(-z) is not logpdf(z)": np.exp(self.log_density(-z)),
            "one law: 'logpdf' is not the derivative of 'logcdf'": rise,
            "one law: 'logcdf' does not undo 'ppf'": density * np.exp(self.log_cdf(z)) / level,
        }
        for what, value in told.items():
            if not np.allclose(value, density, rtol=1e-3, atol=0.0):
                raise ValueError(f"must be {what}")

    @property
    def name(self) -> str:
        """See :class:`Tails`; by which a study states it."""
        return self.words

    @property
    def keys(self) -> Mapping[str, object]:
        """See :class:`Tails`."""
        return {"residuals": dict(self.stated)}

    @property
    def code(self) -> float:
        """None: only NumPy knows it."""
        return np.nan

    @property
    def words(self) -> str:
        """See :class:`Tails`."""
        (_, name), *numbers = self.stated
        return f"{name} law" + "".join(f", {key} {value}" for key, value in numbers)

    @cached_property
    def log_peak(self) -> float:
        """See :class:`Tails`."""
        return float(self.log_density(np.zeros(1))[0])

    @cached_property
    def _even(self) -> FloatArray:
        """Residuals above 0 between which there is as much probability."""
        return self.quantile(0.5 + (np.arange(20_000) + 0.5) / 40_000)

    @cached_property
    def information(self) -> tuple[float, float]:
        """See :class:`Tails`."""
        pull = self.pull(self._even)
        return float(np.mean(pull**2)), float(np.mean((self._even * pull - 1.0) ** 2))

    @cached_property
    def variance(self) -> float:
        """See :class:`Tails`; 20 at most."""
        return min(float(np.mean(self._even**2)), 20.0)

    @cached_property
    def parts(self) -> tuple[FloatArray, FloatArray]:
        """See :class:`Tails`: the best mixture, within 2 % of the density wherever one in ten million is beyond.

        Raises
        ------
        ValueError : there is none.
        """
        z = self.quantile(1.0 - np.geomspace(0.5, 1e-7, 200))
        z = z[z < FARTHEST]
        narrowest = 0.02 * self._even[10_000]
        sd = np.exp(np.arange(np.log(narrowest), np.log(z[-1]), 0.12))
        unit = np.exp(-0.5 * (z[:, None] / sd) ** 2 - self.log_density(z)[:, None]) / (sd * np.sqrt(2 * np.pi))
        shares, _ = nnls(unit, np.ones(len(z)), maxiter=100_000)
        off = float(np.abs(unit @ shares - 1.0).max())
        if off > 0.02:
            raise ValueError(f"must be a mixture of normal laws (the nearest is off by {100 * off:.0f} %)")
        held = shares > 0
        return sd[held], np.log(shares[held] / shares.sum())

    def log_density(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        return np.asarray(self.law.logpdf(z), dtype=np.float64)

    def pull(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`; by a central difference."""
        step = 1e-5 * (1.0 + np.abs(z))
        return np.asarray((self.log_density(z - step) - self.log_density(z + step)) / (2.0 * step))

    def spread(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        away = np.maximum(np.abs(z), 1e-3)
        return np.asarray(away / np.maximum(self.pull(away), 1e-12))

    def cdf(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        return np.exp(self.log_cdf(z))

    def log_cdf(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        return np.asarray(self.law.logcdf(z), dtype=np.float64)

    def quantile(self, level: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        return np.asarray(self.law.ppf(level), dtype=np.float64)

    def normal_score(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        return np.asarray(-np.sign(z) * ndtri_exp(self.log_cdf(-np.abs(z))))

    def draw(self, shape: tuple[int, ...], rng: Generator) -> FloatArray:
        """See :class:`Tails`."""
        return self.quantile(rng.random(shape))


GAUSSIAN = Tails()
