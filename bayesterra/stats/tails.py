"""Laws of standardised residuals, symmetric and of unit scale: Gaussian, or with heavier tails."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import Generator
from scipy.special import gammaln, ndtr, ndtri, stdtr, stdtrit

from bayesterra.arrays import FloatArray


class Tails(ABC):
    """Law of a standardised residual z.

    Attributes
    ----------
    name, mark : in words, and the letter that marks it in tables.
    """

    name: str
    mark: str

    @property
    @abstractmethod
    def keys(self) -> Mapping[str, object]:
        """Keys of the law in the [noise] table of a study."""

    @property
    @abstractmethod
    def code(self) -> float:
        """Number by which compiled code knows the law."""

    @property
    @abstractmethod
    def words(self) -> str:
        """The law with its numbers in words; empty for a Gaussian one."""

    @property
    @abstractmethod
    def log_peak(self) -> float:
        """Log density at the centre."""

    @property
    @abstractmethod
    def information(self) -> tuple[float, float]:
        """Fisher information about place and scale."""

    @property
    @abstractmethod
    def variance(self) -> float:
        """Variance, or a number in its place where that is infinite."""

    @abstractmethod
    def log_density(self, z: FloatArray) -> FloatArray:
        """Log density of residuals of any shape."""

    @abstractmethod
    def pull(self, z: FloatArray) -> FloatArray:
        """Minus the derivative of the log density."""

    @abstractmethod
    def cdf(self, z: FloatArray) -> FloatArray:
        """Probability below."""

    @abstractmethod
    def quantile(self, level: float) -> float:
        """Residual below which a residual lies with probability ``level``."""

    @abstractmethod
    def normal_score(self, z: FloatArray) -> FloatArray:
        """Residuals as the normal ones that are as far out."""

    @abstractmethod
    def draw(self, shape: tuple[int, ...], rng: Generator) -> FloatArray:
        """Draw residuals."""


@dataclass(frozen=True)
class Gaussian(Tails):
    """Normal law."""

    name = "Gaussian"
    mark = ""
    code = np.inf
    words = ""
    log_peak = float(-0.5 * np.log(2 * np.pi))
    information = (1.0, 2.0)
    variance = 1.0

    @property
    def keys(self) -> Mapping[str, object]:
        """None: the law of noise whose entry names no other."""
        return {}

    def log_density(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        return np.asarray(self.log_peak - 0.5 * z**2)

    def pull(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        return z

    def cdf(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        return np.asarray(ndtr(z))

    def quantile(self, level: float) -> float:
        """See :class:`Tails`."""
        return float(ndtri(level))

    def normal_score(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        return z

    def draw(self, shape: tuple[int, ...], rng: Generator) -> FloatArray:
        """See :class:`Tails`."""
        return rng.standard_normal(shape)


@dataclass(frozen=True)
class StudentT(Tails):
    """Student's law with ``dof`` degrees of freedom, whose tails let single readings be far out."""

    dof: float
    name = "Student-t"
    mark = "t"

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

    def log_density(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        return np.asarray(self.log_peak - 0.5 * (self.dof + 1) * np.log1p(z**2 / self.dof))

    def pull(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        return (self.dof + 1.0) * z / (self.dof + z**2)

    def cdf(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        return np.asarray(stdtr(self.dof, z))

    def quantile(self, level: float) -> float:
        """See :class:`Tails`."""
        return float(stdtrit(self.dof, level))

    def normal_score(self, z: FloatArray) -> FloatArray:
        """See :class:`Tails`."""
        score = ndtri(np.maximum(stdtr(self.dof, -np.abs(z)), 1e-300))
        return np.asarray(-np.sign(z) * score)

    def draw(self, shape: tuple[int, ...], rng: Generator) -> FloatArray:
        """See :class:`Tails`."""
        return rng.standard_t(self.dof, shape)


GAUSSIAN = Gaussian()
