"""Soil tests as experiments: mean curves, scatter of tests about them, likelihood and its derivatives.

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

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.models.kernels import compiled
from bayesterra.parameters import OFFSET
from bayesterra.study.entries import SCATTER
from bayesterra.study.priors import Prior
from bayesterra.study.soil_tests import Readings, SoilTest


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
    """Values of what describes the scatter, (n,) each; no memory: independent readings."""

    scatter: FloatArray  # σ_t
    memory: FloatArray | None  # ℓ; None where readings are independent
    shift: FloatArray | None  # standard deviation of log p from the seating times z: n σ_0, m; None where there is none
    offset: FloatArray | None = None  # common zero error of the sinkage, m; None where there is none

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


STEP = 1e-5
"""Step of differences of the covariance, as a share of a parameter's value or of what is typical of it."""


@dataclass(frozen=True)
class Experiment:
    """A series of plate or shear tests: conditions, law of the soil, and scatter of the readings about it.

    The likelihood is a density of the readings themselves and holds every constant.
    """

    test: SoilTest  # readings, and which parameters of the study the series reads
    prior: Prior  # that holds them; parameter sets (n, d) are those of its free parameters

    @property
    def readings(self) -> Readings:
        """Readings that are used."""
        return self.test.readings

    def only(self, chosen: BoolArray) -> "Experiment":
        """The same with some of its tests (t,) only."""
        return replace(self, test=replace(self.test, readings=self.readings.only(chosen)))

    def _values(self, x: FloatArray, own: str) -> FloatArray | None:
        """Values (n,) of what the series calls ``own``; None where it has none."""
        return self.prior.column(self.test.names[own], x) if own in self.test.names else None

    def soil(self, x: FloatArray) -> FloatArray:
        """Soil parameters (n, 3) of parameter sets (n, d)."""
        return np.column_stack([self.prior.column(name, x) for name in self.test.soil])

    def spread(self, x: FloatArray) -> Spread:
        """Values that describe the scatter, of parameter sets (n, d)."""
        names, seating = self.test.names, self._values(x, "seating")
        shift = None if seating is None else np.abs(self.prior.column(names["n"], x)) * seating
        scatter = self.prior.column(names["scatter"], x)
        return Spread(scatter, self._values(x, "memory"), shift, self._values(x, OFFSET))

    @cached_property
    def _scatter(self) -> Scatter:
        return Scatter(self.readings)

    def log_likelihoods(self, x: FloatArray) -> FloatArray:
        """Log likelihood (n, t) of every test, at parameter sets (n, d) inside the support."""
        log_stress, spread = np.log(self.readings.stress), self.spread(x)
        densities = self._scatter.log_likelihoods(log_stress - self.mean(x, spread), spread)
        return densities - np.add.reduceat(log_stress, self.readings.starts)

    def log_likelihood(self, x: FloatArray) -> FloatArray:
        """Log likelihood (n,) of parameter sets (n, d) inside the support; −inf where a curve underflows."""
        with np.errstate(all="ignore"):
            total = self.log_likelihoods(x).sum(axis=1)
        return np.where(np.isfinite(total), total, -np.inf)

    def mean(self, x: FloatArray, spread: Spread) -> FloatArray:
        """Log of the mean stress (n, m) at the true sinkages or displacements of the readings."""
        readings = self.readings
        return readings.model.log_stress(self.soil(x), spread.true_path(readings.path), readings.level)

    def draw(self, x: FloatArray, rng: Generator) -> FloatArray:
        """Draw stresses (n, m) of new tests at the same sinkages or displacements; ``x`` (n, d)."""
        spread = self.spread(x)
        return np.exp(self.mean(x, spread) + self._scatter.deviations(spread, rng))

    def physical(self, x: FloatArray) -> BoolArray:
        """True (n,) where parameter sets (n, d) are physical under all plates or normal stresses."""
        inside = self.readings.model.physical(self.soil(x), self.readings.levels)
        for own, low in (("scatter", 0.0), ("memory", 0.0), (OFFSET, -self.readings.path.min())):
            if (values := self._values(x, own)) is not None:
                inside = inside & (values > low)
        return np.asarray(inside)

    def _placed(self, names: Mapping[str, int]) -> dict[str, int]:
        """Columns of the free parameters among what the series reads, by its own names."""
        roots = {own: self.prior.root(name) for own, name in self.test.names.items()}
        return {own: names[root] for own, root in roots.items() if root in names}

    def slopes(self, x: FloatArray) -> FloatArray:
        """Derivatives (n, m, d) of the log mean stress by the free parameters."""
        readings, places = self.readings, self._placed({name: i for i, name in enumerate(self.prior.names)})
        spread, soil = self.spread(x), self.soil(x)
        path = spread.true_path(readings.path)
        local = readings.model.slopes(soil, path, readings.level)
        slopes = np.zeros((len(x), len(readings), x.shape[1]))
        for i, own in enumerate(readings.model.parameters):
            if own in places:
                slopes[:, :, places[own]] += local[:, :, i]
        if OFFSET in places:
            slopes[:, :, places[OFFSET]] += soil[:, 2:] / path
        return slopes

    def score(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Gradient of the log likelihood (n, d), and Fisher information of the readings.

        The latter as sensitivities of white residuals (n, m, d), whose product AᵀA is that of the mean curve, and
        the matrix (n, d, d) of the scatter. Derivatives of the covariance are by differences.
        """
        spread, slopes = self.spread(x), self.slopes(x)
        residuals = (np.log(self.readings.stress) - self.mean(x, spread))[..., None]
        gradient, white, information = np.zeros(x.shape), np.empty(slopes.shape), np.zeros((*x.shape, x.shape[1]))
        places = self._placed({name: i for i, name in enumerate(self.prior.names)})
        moved = [i for own, i in places.items() if own in (*SCATTER["plate"], "n")]
        steps = {i: STEP * np.maximum(np.abs(x[:, i]), np.abs(x[:, i]).mean() + 1e-300) for i in moved}
        ends = {i: [self.spread(x + sign * step[:, None] * (np.arange(x.shape[1]) == i)) for sign in (1, -1)]
                for i, step in steps.items()}  # fmt: skip
        for test in range(len(self.readings.tests)):
            own = self.readings.test == test
            path = self.readings.path[own]
            root = np.linalg.cholesky(covariance(path, spread))
            white[:, own], residual = (np.linalg.solve(root, part[:, own]) for part in (slopes, residuals))
            gradient += np.einsum("nmd,nm->nd", white[:, own], residual[..., 0])
            bends = {}
            for i, (ahead, behind) in ends.items():
                slope = (covariance(path, ahead) - covariance(path, behind)) / (2.0 * steps[i][:, None, None])
                half = np.linalg.solve(root, slope)
                bends[i] = np.linalg.solve(root, half.transpose(0, 2, 1))
                told = np.einsum("nm,nmk,nk->n", residual[..., 0], bends[i], residual[..., 0])
                gradient[:, i] += 0.5 * (told - np.einsum("nmm->n", bends[i]))
            for i, first in bends.items():
                for j, second in bends.items():
                    information[:, i, j] += 0.5 * (first * second).sum(axis=(1, 2))
        return gradient, white, information
