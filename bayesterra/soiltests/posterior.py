"""Prior and likelihood of soil tests joined, and the coordinates in which they are sampled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.coordinates import Block, Coordinates, Logarithm, NormalScore, Strength
from bayesterra.laws import Law
from bayesterra.parameters import MODULI, OFFSET
from bayesterra.posteriors import INSIDE, OUTSIDE_PHYSICS, OUTSIDE_PRIOR
from bayesterra.soiltests.curves import log_curve, physical
from bayesterra.soiltests.data import Readings
from bayesterra.soiltests.quantities import KINDS
from bayesterra.soiltests.scatter import Scatter, Spread
from bayesterra.soiltests.study import SoilTest


@dataclass(frozen=True)
class Laws:
    """Laws of the free parameters, and the values of the others.

    The laws are independent. A modulus in Pa/m^n means nothing without its n: a law that is flat in k_c and
    k_φ prefers large n, the more the smaller the sinkages. So their laws can be stated at a sinkage z, as
    laws of k_c z^n and k_φ z^n, the parts of the pressure there.

    Attributes
    ----------
    entries : a law or a value of every parameter.
    reference : that sinkage, m; at 1 m the laws are those of k_c and k_φ.
    """

    entries: Mapping[str, Law | float]
    reference: float = 1.0

    @cached_property
    def laws(self) -> dict[str, Law]:
        """Laws of the free parameters."""
        return {name: entry for name, entry in self.entries.items() if isinstance(entry, Law)}

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters, the columns of every parameter array."""
        return tuple(self.laws)

    def sample(self, n: int, rng: Generator) -> FloatArray:
        """Draw parameter sets (n, d), before the physical cut."""
        x = np.column_stack([law.sample(n, rng) for law in self.laws.values()])
        return x * np.exp(-self._log_stretch(x))

    def _log_stretch(self, x: FloatArray) -> FloatArray:
        """Log of what each parameter (n, d) is to be multiplied with to become what its law is about."""
        stretch = np.zeros_like(x)
        if self.reference != 1.0:
            moduli = [self.names.index(name) for name in MODULI]
            stretch[:, moduli] = x[:, [self.names.index("n")]] * np.log(self.reference)
        return stretch

    def stated(self, x: FloatArray) -> FloatArray:
        """What the laws are about (n, d), of parameter sets (n, d)."""
        with np.errstate(over="ignore"):
            return x * np.exp(self._log_stretch(x))

    def log_density(self, x: FloatArray) -> FloatArray:
        """Log density (n,) of parameter sets (n, d), before the physical cut."""
        stretch = self._log_stretch(x)
        stated = self.stated(x)
        parts = [law.log_density(stated[:, i]) for i, law in enumerate(self.laws.values())]
        return np.asarray(np.sum(parts, axis=0) + stretch.sum(axis=1))

    def column(self, x: FloatArray, name: str) -> FloatArray | None:
        """Values (n,) of a parameter, free or fixed; None where there is none of that name."""
        if name in self.laws:
            return x[:, self.names.index(name)]
        return np.full(len(x), float(self.entries[name])) if name in self.entries else None  # type: ignore[arg-type]


@dataclass(frozen=True)
class TestPosterior:
    """Posterior density of the free parameters of a soil test; SI and radians.

    The density is one of the readings themselves and holds every constant; the prior is the stated one, set
    to zero outside the physical range and not renormalised.
    """

    prior: Laws
    readings: Readings

    __test__ = False  # not a test of pytest

    @classmethod
    def of(cls, test: SoilTest) -> TestPosterior:
        """The posterior of a soil test."""
        return cls(Laws(test.entries, test.reference), test.readings)

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters: those of the soil first, then of the scatter."""
        return self.prior.names

    def soil(self, x: FloatArray) -> FloatArray:
        """Soil parameters (n, 3) of parameter sets (n, d)."""
        columns = [self.prior.column(x, name) for name in KINDS[self.readings.kind]]
        return np.column_stack([column for column in columns if column is not None])

    def spread(self, x: FloatArray) -> Spread:
        """What describes the scatter, of parameter sets (n, d)."""
        scatter = self.prior.column(x, "scatter")
        seating = self.prior.column(x, "seating")
        exponent = self.soil(x)[:, 2]
        shift = None if seating is None else np.abs(exponent) * seating
        assert scatter is not None  # noqa: S101 (every soil test has one)
        return Spread(scatter, self.prior.column(x, "memory"), shift, self.prior.column(x, OFFSET))

    @cached_property
    def _scatter(self) -> Scatter:
        return Scatter(self.readings)

    @cached_property
    def _log_stress(self) -> FloatArray:
        return np.log(self.readings.stress)

    def log_likelihoods(self, x: FloatArray) -> FloatArray:
        """Log likelihood (n, t) of every test, at parameter sets (n, d) inside the support."""
        readings = self.readings
        spread = self.spread(x)
        mean = log_curve(readings.kind, self.soil(x), spread.true_path(readings.path), readings.level)
        densities = self._scatter.log_likelihoods(self._log_stress - mean, spread)
        return densities - np.add.reduceat(self._log_stress, readings.starts)

    def simulate(self, x: FloatArray, rng: Generator) -> FloatArray:
        """Draw stresses (n, m) of new tests at the same sinkages or displacements; ``x`` (n, d)."""
        readings, spread = self.readings, self.spread(x)
        mean = log_curve(readings.kind, self.soil(x), spread.true_path(readings.path), readings.level)
        return np.exp(mean + self._scatter.deviations(spread, rng))

    def reasons(self, x: FloatArray) -> IntArray:
        """Why each parameter set (n, d) has no density; see :class:`bayesterra.posteriors.Density`."""
        inside = physical(self.readings.kind, self.soil(x), self.readings.levels)
        if (offset := self.prior.column(x, OFFSET)) is not None:
            inside &= offset > -self.readings.path.min()
        found = np.where(inside, INSIDE, OUTSIDE_PHYSICS)
        return np.where(np.isneginf(self.prior.log_density(x)), OUTSIDE_PRIOR, found)

    def log_prior_and_likelihood(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log prior and log likelihood, each (n,), both −inf outside the support."""
        x = np.atleast_2d(np.asarray(x, dtype=np.float64))
        finite = np.asarray(np.isfinite(x).all(axis=1))
        safe = np.where(finite[:, None], x, 1.0)
        inside = np.flatnonzero(finite & (self.reasons(safe) == INSIDE))
        prior, likelihood = np.full(len(x), -np.inf), np.full(len(x), -np.inf)
        if inside.size:
            prior[inside] = self.prior.log_density(x[inside])
            with np.errstate(all="ignore"):  # a curve that underflows has no likelihood
                found = self.log_likelihoods(x[inside]).sum(axis=1)
            likelihood[inside] = np.where(np.isfinite(found), found, -np.inf)
        return np.where(likelihood > -np.inf, prior, -np.inf), likelihood

    def log_density(self, x: FloatArray) -> FloatArray:
        """Log posterior density (n,) of parameter sets (n, d); −inf outside the support, never NaN."""
        prior, likelihood = self.log_prior_and_likelihood(x)
        return prior + np.where(likelihood > -np.inf, likelihood, 0.0)


@dataclass(frozen=True)
class Bearing:
    """k_c, k_φ and n as logs of the pressure under two plates at a typical sinkage, and n.

    With plates of one radius there is one such pressure, and the normal score of k_c in place of the other.

    Attributes
    ----------
    radii : smallest and largest plate radius, m.
    sinkage : typical sinkage, m.
    score : of k_c z^n at the sinkage where its law is stated ...
    reference : which is this, m.
    """

    radii: tuple[float, float]
    sinkage: float
    score: NormalScore
    reference: float = 1.0

    @property
    def _single(self) -> bool:
        return self.radii[0] == self.radii[1]

    def from_physical(self, x: FloatArray) -> FloatArray:
        """See :class:`bayesterra.coordinates.Block`."""
        n = x[:, 2:]
        pressures = np.log(x[:, :1] / np.array(self.radii) + x[:, 1:2]) + n * np.log(self.sinkage)
        first = self.score.from_physical(x[:, :1] * self.reference**n) if self._single else pressures[:, :1]
        return np.column_stack([first, pressures[:, 1:], n])

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`bayesterra.coordinates.Block`."""
        n = u[:, 2:]
        small, large = self.radii
        last = np.exp(u[:, 1:2] - n * np.log(self.sinkage))
        if self._single:
            stated, term = self.score.to_physical(u[:, :1])
            kc = stated * self.reference**-n
            stretched = np.log(last[:, 0]) - n[:, 0] * np.log(self.reference)
            return np.column_stack([kc, last - kc / large, n]), term + stretched
        first = np.exp(u[:, :1] - n * np.log(self.sinkage))
        kc = (first - last) / (1.0 / small - 1.0 / large)
        jacobian = np.log(first[:, 0]) + np.log(last[:, 0]) - np.log(1.0 / small - 1.0 / large)
        return np.column_stack([kc, last - kc / large, n]), jacobian


def coordinates(posterior: TestPosterior) -> Coordinates:
    """Sampling coordinates: stresses at what is typical of the readings, and logs of the scatter."""
    names, laws, readings = posterior.names, posterior.prior.laws, posterior.readings
    soil: tuple[str, ...] = KINDS[readings.kind]
    block: Block | None = None
    typical = float(np.exp(np.median(np.log(readings.path))))
    if readings.kind == "plate" and set(soil) <= set(names):
        radii = float(readings.levels.min()), float(readings.levels.max())
        block = Bearing(radii, typical, NormalScore(laws["kc"]), posterior.prior.reference)
    elif readings.kind == "shear" and {"c", "phi"} <= set(names):
        soil = tuple(name for name in soil if name in names)
        block = Strength(float(np.median(readings.levels)), typical)
    choices: list[tuple[tuple[str, ...], Block]] = [(soil, block)] if block else []
    taken = soil if block else ()
    for name in names:
        if name not in taken:
            scale = name in ("scatter", "memory", "seating", "K")
            choices.append(((name,), Logarithm() if scale else NormalScore(laws[name])))
    return Coordinates(tuple((tuple(map(names.index, group)), each) for group, each in choices))
