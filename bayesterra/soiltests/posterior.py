"""Posterior of soil tests: mean curves, scatter of tests about them, prior and likelihood.

log y(x) = log f(x) + δ(x) + seating, for each test on its own:

- δ, the deviation of this test, is a stationary Gaussian process over the log of sinkage or displacement with
  covariance σ_t² exp(−|Δ log x| / ℓ) (Ornstein–Uhlenbeck). A test keeps its deviation over a distance ℓ:
  what lies closer together tells little that is new, and a hundred readings of one test are no hundred tests.
- The zero of the sinkage of a plate test is wrong by z_0, the same in all tests, and by ζ ~ N(0, σ_0²), one
  value for each test. To first order ζ shifts log p by n ζ / (z + z_0).

With ``independent`` readings there is neither memory nor an error of the zero: each departs on its own, as
least squares assume. That overstates what a test tells, and exists to show by how much.

The process is Markov, so that differences of neighbours are independent: the likelihood costs one pass.
Mean curves f are those of :mod:`bayesterra.models.soil_tests`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.likelihood.posterior import INSIDE, OUTSIDE_PHYSICS, OUTSIDE_PRIOR
from bayesterra.models.kernels import compiled
from bayesterra.parameters import MODULI, OFFSET
from bayesterra.sampling.coordinates import Block, Coordinates, Logarithm, NormalScore, Strength
from bayesterra.soiltests.study import Readings, SoilTest
from bayesterra.stats.laws import Law


@compiled
def log_densities(
    residuals: FloatArray,
    scatter: FloatArray,
    memory: FloatArray,
    shift: FloatArray,
    gaps: FloatArray,
    path: FloatArray,
    offset: FloatArray,
    ends: IntArray,
) -> FloatArray:
    """Log density (n, t) of every test; memory 0 means that readings are independent."""
    densities = np.empty((len(residuals), len(ends) - 1))
    for k in range(len(residuals)):
        for test in range(len(ends) - 1):
            squares = both = size = logs = before = above = 0.0
            for i in range(ends[test], ends[test + 1]):
                kept = np.exp(-gaps[i] / memory[k]) if memory[k] > 0 else 0.0
                variance = 1.0 - kept * kept
                # innovations of the process, and of the column 1/z by which the seating enters
                column = 1.0 / (path[i] + offset[k])
                white, seat = residuals[k, i] - kept * before, column - kept * above
                before, above = residuals[k, i], column
                squares += white * white / variance
                both += white * seat / variance
                size += seat * seat / variance
                logs += 0.5 * np.log(variance)
            inverse, number = scatter[k] ** -2, ends[test + 1] - ends[test]
            logs += number * (np.log(scatter[k]) + 0.5 * np.log(2.0 * np.pi))
            seating = shift[k] ** 2  # one column more, by Woodbury's identity
            squares = inverse * (squares - seating * inverse * both**2 / (1.0 + seating * inverse * size))
            densities[k, test] = -0.5 * (squares + np.log1p(seating * inverse * size)) - logs
    return densities


@dataclass(frozen=True)
class Spread:
    """Values of what describes the scatter, (n,) each; no memory: independent readings.

    Attributes
    ----------
    scatter : σ_t.
    memory : ℓ; None where readings are independent.
    shift : standard deviation of log p from the seating times z: n σ_0, m; None where there is none.
    offset : common zero error of the sinkage, m; None where there is none.
    """

    scatter: FloatArray
    memory: FloatArray | None
    shift: FloatArray | None
    offset: FloatArray | None = None

    def true_path(self, path: FloatArray) -> FloatArray:
        """Path (n, m), or (m,) where zeros are right, of what reads ``path`` (m,)."""
        return path if self.offset is None else path + self.offset[:, None]


@dataclass(frozen=True)
class Scatter:
    """The Gaussian law of residuals of log readings about the mean curve."""

    readings: Readings

    @cached_property
    def _first(self) -> BoolArray:
        first = np.zeros(len(self.readings), dtype=np.bool_)
        first[self.readings.starts] = True
        return first

    @cached_property
    def _gaps(self) -> FloatArray:
        """Log distance to the reading before (m,), infinite at the first of a test."""
        gaps = np.diff(np.log(self.readings.path), prepend=0.0)
        return np.where(self._first, np.inf, gaps)

    def log_likelihoods(self, residuals: FloatArray, spread: Spread) -> FloatArray:
        """Log density (n, t) of the residuals (n, m) of every test; a density of log stresses."""
        none = np.zeros(len(spread.scatter))
        memory, shift, offset = (
            none if values is None else values for values in (spread.memory, spread.shift, spread.offset)
        )
        ends = np.append(self.readings.starts, len(self.readings))
        densities: FloatArray = log_densities(
            np.ascontiguousarray(residuals), spread.scatter, memory, shift, self._gaps, self.readings.path,
            offset, ends,
        )  # fmt: skip
        return densities

    def deviations(self, spread: Spread, rng: Generator) -> FloatArray:
        """Draw residuals (n, m) of new tests with the paths of these."""
        kept = np.zeros((len(spread.scatter), len(self.readings)))  # correlation with the reading before
        if spread.memory is not None:
            kept = np.exp(-self._gaps / spread.memory[:, None])
        noise = spread.scatter[:, None] * np.sqrt(1.0 - kept**2) * rng.standard_normal(kept.shape)
        for i in np.flatnonzero(~self._first):
            noise[:, i] += kept[:, i] * noise[:, i - 1]
        if spread.shift is not None:
            zeros = spread.shift[:, None] * rng.standard_normal((len(noise), len(self.readings.tests)))
            noise += zeros[:, self.readings.test] / spread.true_path(self.readings.path)
        return noise


def covariance(path: FloatArray, spread: Spread) -> FloatArray:
    """Covariance (n, m, m) of the log readings of one test at sinkages or displacements ``path`` (m,)."""
    along = np.log(path)
    distance = np.abs(along[:, None] - along)
    kept = np.eye(len(path)) if spread.memory is None else np.exp(-distance / spread.memory[:, None, None])
    result = spread.scatter[:, None, None] ** 2 * kept
    if spread.shift is not None:
        seat = spread.shift[:, None] / spread.true_path(path)
        result = result + seat[:, :, None] * seat[:, None, :]
    return np.asarray(result)


def marginal_sd(path: FloatArray, spread: Spread) -> FloatArray:
    """Standard deviation (n, m) of log readings of a new test."""
    variance = np.tile(spread.scatter[:, None] ** 2, len(path))
    if spread.shift is not None:
        variance = variance + (spread.shift[:, None] / spread.true_path(path)) ** 2
    return np.sqrt(variance)


def structural(readings: Readings, x: FloatArray, free: BoolArray) -> BoolArray:
    """True for each soil parameter (3,) that this design could determine, from prior draws ``x`` (n, 3), cut.

    A parameter is lost where a direction that it takes part in changes no reading: k_c and k_φ under plates
    of one radius, c and φ under one normal stress. Only parameters that are ``free`` (3,) count.
    """
    lost = np.zeros((free.sum(), free.sum()))
    for matrix in readings.model.slopes(x, readings.path, readings.level)[:, :, free]:
        norms = np.linalg.norm(matrix, axis=0)
        _, values, rows = np.linalg.svd(matrix / np.where(norms > 0, norms, 1.0))
        rank = int((values > 1e-9 * values[0]).sum())
        lost += rows[rank:].T @ rows[rank:]
    determined = np.ones(3, dtype=np.bool_)
    determined[free] = np.diagonal(lost) / len(x) < 1e-3
    return determined


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
        """Quantities (n, d) that the laws are about, of parameter sets (n, d)."""
        with np.errstate(over="ignore"):
            return x * np.exp(self._log_stretch(x))

    def log_density(self, x: FloatArray) -> FloatArray:
        """Log density (n,) of parameter sets (n, d), before the physical cut."""
        stretch = self._log_stretch(x)
        stated = self.stated(x)
        terms = [law.log_density(stated[:, i]) for i, law in enumerate(self.laws.values())]
        return np.asarray(np.sum(terms, axis=0) + stretch.sum(axis=1))

    def values(self, x: FloatArray) -> dict[str, FloatArray]:
        """Values (n,) of every parameter, free or fixed, of parameter sets (n, d)."""
        fixed = {name: entry for name, entry in self.entries.items() if name not in self.laws}
        filled = {name: np.full(len(x), value) for name, value in fixed.items()}
        return {**filled, **dict(zip(self.names, x.T, strict=True))}


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
        values = self.prior.values(x)
        return np.column_stack([values[name] for name in self.readings.model.parameters])

    def spread(self, x: FloatArray) -> Spread:
        """Values that describe the scatter, of parameter sets (n, d)."""
        values = self.prior.values(x)
        shift = np.abs(values["n"]) * values["seating"] if "seating" in values else None
        return Spread(values["scatter"], values.get("memory"), shift, values.get(OFFSET))

    @cached_property
    def _scatter(self) -> Scatter:
        return Scatter(self.readings)

    def log_likelihoods(self, x: FloatArray) -> FloatArray:
        """Log likelihood (n, t) of every test, at parameter sets (n, d) inside the support."""
        log_stress, spread = np.log(self.readings.stress), self.spread(x)
        densities = self._scatter.log_likelihoods(log_stress - self._mean(x, spread), spread)
        return densities - np.add.reduceat(log_stress, self.readings.starts)

    def _mean(self, x: FloatArray, spread: Spread) -> FloatArray:
        """Log of the mean stress (n, m) at the true sinkages or displacements of the readings."""
        readings = self.readings
        return readings.model.log_stress(self.soil(x), spread.true_path(readings.path), readings.level)

    def simulate(self, x: FloatArray, rng: Generator) -> FloatArray:
        """Draw stresses (n, m) of new tests at the same sinkages or displacements; ``x`` (n, d)."""
        spread = self.spread(x)
        return np.exp(self._mean(x, spread) + self._scatter.deviations(spread, rng))

    def reasons(self, x: FloatArray) -> IntArray:
        """Reason why each parameter set (n, d) has no density; see :mod:`bayesterra.likelihood.posterior`."""
        codes = np.where(self._physical(x), INSIDE, OUTSIDE_PHYSICS)
        return np.where(np.isneginf(self.prior.log_density(x)), OUTSIDE_PRIOR, codes)

    def _physical(self, x: FloatArray) -> BoolArray:
        inside = self.readings.model.physical(self.soil(x), self.readings.levels)
        return np.asarray(inside & (self.prior.values(x).get(OFFSET, 0.0) > -self.readings.path.min()))

    def log_prior_and_likelihood(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log prior and log likelihood, each (n,), both −inf outside the support."""
        x = np.atleast_2d(np.asarray(x, dtype=np.float64))
        finite = np.asarray(np.isfinite(x).all(axis=1))
        safe = np.where(finite[:, None], x, 1.0)
        prior, likelihood = self.prior.log_density(safe), np.full(len(x), -np.inf)
        inside = np.flatnonzero(finite & ~np.isneginf(prior) & self._physical(safe))
        if inside.size:
            with np.errstate(all="ignore"):  # a curve that underflows has no likelihood
                total = self.log_likelihoods(x[inside]).sum(axis=1)
            likelihood[inside] = np.where(np.isfinite(total), total, -np.inf)
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
        """See :class:`bayesterra.sampling.coordinates.Block`."""
        n = x[:, 2:]
        pressures = np.log(x[:, :1] / np.array(self.radii) + x[:, 1:2]) + n * np.log(self.sinkage)
        first = self.score.from_physical(x[:, :1] * self.reference**n) if self._single else pressures[:, :1]
        return np.column_stack([first, pressures[:, 1:], n])

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`bayesterra.sampling.coordinates.Block`."""
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
    soil: tuple[str, ...] = readings.model.parameters
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
