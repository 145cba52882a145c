"""Estimated noise integrated out: sampling sees the soil alone, and standard deviations are drawn given it.

Given the soil, n Gaussian readings of a channel meet their unknown standard deviation σ through the sum S of their
squared residuals only, so that the integral over its prior is a function of one number,

    log ∫ p(σ) (2π σ²)^(−n/2) exp(−S / 2σ²) dσ,

tabulated once. Not so where a size hangs on what is modelled, where readings are rounded, known by a limit, correlated
or of a latent load, where a law has Student's or one's own tails, or where the prior of σ depends on another parameter.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.random import Generator
from scipy.interpolate import make_interp_spline

from bayesterra.arrays import FloatArray, in_parts
from bayesterra.likelihood.forward import Outcomes, Squares
from bayesterra.likelihood.likelihood import DOUBLES, Likelihood
from bayesterra.likelihood.posterior import Posterior
from bayesterra.stats.laws import Law
from bayesterra.stats.tails import GAUSSIAN

TAIL, NODES, HALVES = 1e-20, 16, 24
"""Probability left out at an end of a law; points of Gauss and Legendre in every panel over log σ; times that the
panels at the ends are halved, as far too small or too great residuals push σ there."""
MOST = 12_000
"""Points of a quadrature, at most: wider laws of more readings are sampled."""
EXACT, PROBES, KNOTS = 1e-10, 201, (512, 1024, 2048, 4096, 8192, 16384, 32768)
"""Error of the table between its knots, as a share of a value above 1; places to test it; numbers of knots to try."""
WINDOWS, COARSE, FINE, FAINT, NEWTON = 512, 2000, 48, 20.0, 4
"""Sums of squares, and steps over a law, by which is found where it counts for a draw; cells of that part; the log
density below the peak that does not; steps of Newton's within a cell."""


@dataclass(frozen=True)
class NoiseIntegral:
    """Integral over the prior of a standard deviation σ, by the sum of squared residuals of ``count`` readings."""

    law: Law
    count: int
    finer: int = 1  # times that panels are cut

    @cached_property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest log σ that counts."""
        tails = self.law.quantile(np.array(TAIL)), self.law.upper_quantile(np.array(TAIL))
        return float(np.log(tails[0])), float(np.log(tails[1]))

    @cached_property
    def panels(self) -> int:
        """Panels of the quadrature, each 1.4 standard deviations of log σ wide or less, and ever less at the ends."""
        wide = (self.ends[1] - self.ends[0]) * np.sqrt(max(self.count, 8))
        return 2 * HALVES + self.finer * (4 + int(np.ceil(wide)))

    @cached_property
    def _quadrature(self) -> tuple[FloatArray, FloatArray]:
        """Values of log σ (k,), and log weights without the residuals."""
        points, weights = np.polynomial.legendre.leggauss(NODES)
        edges = np.linspace(*self.ends, self.panels - 2 * HALVES + 1)
        first, last, shares = np.diff(edges)[0], np.diff(edges)[-1], 0.5 ** np.arange(1, HALVES + 1)
        edges = np.sort(np.concatenate([edges, edges[0] + first * shares, edges[-1] - last * shares]))
        half = 0.5 * np.diff(edges)[:, None]
        t = (edges[:-1, None] + half * (1 + points)).ravel()
        return t, np.log((half * weights).ravel()) + self._without(t)

    def _without(self, t: FloatArray) -> FloatArray:
        """Log density of log σ, (k,), times that of readings without residuals."""
        prior = self.law.log_density(np.clip(np.exp(t), *self.law.range))
        return np.asarray(prior + t + self.count * (GAUSSIAN.log_peak - t))

    def exactly(self, sums: FloatArray) -> FloatArray:
        """Log integrals (n,) by quadrature."""
        t, weights = self._quadrature
        half = 0.5 * np.exp(-2 * t)

        def part(sums: FloatArray) -> FloatArray:
            terms = weights - sums[:, None] * half
            most = np.maximum(terms.max(axis=1), -1e300)  # finite, where residuals overflow
            with np.errstate(divide="ignore"):
                return np.asarray(np.log(np.exp(terms - most[:, None]).sum(axis=1)) + most)

        return in_parts(part, max(1, int(DOUBLES / len(t))), sums)

    @cached_property
    def told(self) -> bool:
        """Whether the table agrees with finer quadratures, as it does not where a law bends within its range."""
        _, low, high = self._table
        sums = np.exp(np.linspace(low, high, PROBES))
        finer = replace(self, finer=2).exactly(sums)
        return bool((np.abs(self(sums) - finer) <= 10 * EXACT * np.maximum(1.0, np.abs(finer))).all())

    @cached_property
    def _table(self) -> tuple[Callable[[FloatArray], FloatArray], float, float]:
        """A spline over log S of the log integral less its fall at the end, and where it begins and ends."""
        low, high = (np.log(2.0) + 2 * end for end in self.ends)
        low, high = low + np.log(1e-13), high + np.log(1e4 * max(self.count, 1))
        for knots in KNOTS:
            t = np.linspace(low, high, 2 * knots + 1)
            values = self.exactly(np.exp(t)) + np.exp(t - 2 * self.ends[1]) / 2
            spline: Callable[[FloatArray], FloatArray] = make_interp_spline(t[::2], values[::2], k=5)
            if (np.abs(spline(t[1::2]) - values[1::2]) <= EXACT * np.maximum(1.0, np.abs(values[1::2]))).all():
                break
        return spline, low, high

    def __call__(self, sums: FloatArray) -> FloatArray:
        """Log integrals (n,) for sums of squared residuals (n,); NaN for NaN."""
        spline, low, high = self._table
        t = np.log(np.maximum(sums, np.exp(low)))
        total = spline(np.minimum(t, high)) - sums / (2 * np.exp(2 * self.ends[1]))
        far = t > high
        total[far] = self.exactly(sums[far])
        return np.asarray(total)

    @cached_property
    def _windows(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Log S (w,) over the table, and the lowest and the highest log σ that count from each to the next."""
        _, low, high = self._table
        places, grid = np.linspace(low, high, WINDOWS), np.linspace(*self.ends, COARSE + 1)
        density = self._without(grid) - 0.5 * np.exp(places[:, None] - 2 * grid)
        counts = density > density.max(axis=1, keepdims=True) - FAINT
        first = grid[np.maximum(counts.argmax(axis=1) - 1, 0)]
        last = grid[np.minimum(COARSE + 1 - counts[:, ::-1].argmax(axis=1), COARSE)]
        following = np.minimum(np.arange(1, WINDOWS + 1), WINDOWS - 1)
        return places, np.minimum(first, first[following]), np.maximum(last, last[following])

    def draw(self, sums: FloatArray, rng: Generator) -> FloatArray:
        """Draw σ (n,) given sums of squared residuals (n,), by the inverse of their distribution function.

        Its error is below 2e-4; below and above the table S is what it is at its ends.
        """
        return in_parts(self._drawn, int(DOUBLES / FINE / 8), sums, rng.random(len(sums)))

    def _drawn(self, sums: FloatArray, shares: FloatArray) -> FloatArray:
        """Values of σ (n,) below which these shares (n,) lie: by Simpson's rule, cubic between its cells."""
        places, first, last = self._windows
        s = np.clip(np.log(np.maximum(sums, np.exp(places[0]))), places[0], places[-1])
        at = np.searchsorted(places, s, side="right") - 1
        low, width = first[at], (last - first)[at] / FINE
        t = low[:, None] + 0.5 * width[:, None] * np.arange(2 * FINE + 1)
        density = self._without(t.ravel()).reshape(t.shape) - 0.5 * np.exp(s[:, None] - 2 * t)
        density = np.exp(density - density.max(axis=1, keepdims=True))
        cells = (density[:, :-2:2] + 4 * density[:, 1::2] + density[:, 2::2]) / 6
        mass = np.cumsum(cells, axis=1)
        asked, rows = shares * mass[:, -1], np.arange(len(t))
        cell = np.minimum((mass < asked[:, None]).sum(axis=1), FINE - 1)
        area, begin, end = cells[rows, cell], density[rows, 2 * cell], density[rows, 2 * cell + 2]
        rest = np.clip(asked - mass[rows, cell] + area, 0.0, area)
        x = rest / np.maximum(area, 1e-300)
        for _ in range(NEWTON):
            slope = begin + x * (6 * area - 4 * begin - 2 * end + 3 * x * (begin + end - 2 * area))
            value = x * (begin + x * (3 * area - 2 * begin - end + x * (begin + end - 2 * area)))
            x = np.clip(x - (value - rest) / np.maximum(slope, 1e-3 * area + 1e-300), 0.0, 1.0)
        return np.asarray(np.exp(low + width * (cell + x)))


@dataclass(frozen=True)
class IntegratedNoise(Likelihood):
    """Likelihood of which every estimated standard deviation is integrated out.

    ``integrals`` are those of the channels, None where noise is stated; ``units`` (m, channels) are the stated standard
    deviations, 1 of what is estimated. It takes no noise values: (n, 0).
    """

    integrals: tuple[NoiseIntegral | None, ...] = ()
    units: FloatArray = field(default_factory=lambda: np.empty((0, 0)))

    def log_told(self, sums: Sequence[Squares], outcomes: Outcomes, noise_values: FloatArray) -> FloatArray:
        """Log likelihood (n,) of readings of which these are the squares, by ``outcomes`` of the nodes."""
        return self._log(np.column_stack([own(outcomes[name]) for name, own in zip(self.channels, sums, strict=True)]))

    def log_density(self, outcomes: Outcomes, noise_values: FloatArray) -> FloatArray:
        """Log likelihood (n,), −inf where the model has no answer."""
        total = np.full(len(outcomes.status), -np.inf)
        answered = outcomes.status == 0
        total[answered] = self._log(self._sums(outcomes)[answered])
        return total

    def _sums(self, outcomes: Outcomes) -> FloatArray:
        """Sums (n, channels) of squared residuals, in units of what is stated of their standard deviations."""
        with np.errstate(over="ignore"):  # forces of 1e200 N have the log density −inf
            return np.asarray(np.nansum(((self.measured - self.predicted(outcomes)) / self.units) ** 2, axis=1))

    def _log(self, sums: FloatArray) -> FloatArray:
        total = np.zeros(len(sums))
        for i, integral in enumerate(self.integrals):
            total += self._stated[i] - 0.5 * sums[:, i] if integral is None else integral(sums[:, i])
        return total

    @cached_property
    def _stated(self) -> FloatArray:
        """Log density (channels,) of readings without residuals, where noise is stated."""
        logs = GAUSSIAN.log_peak - np.log(self.units)
        return np.asarray(np.where(np.isnan(self.measured), 0.0, logs).sum(axis=0))

    def integrated_out(self, soil: FloatArray, rng: Generator) -> FloatArray:
        """Estimated standard deviations (n, k), SI, drawn from the posterior given the soil (n, p)."""
        sums = in_parts(self._sums_of, self.at_once, soil)
        pairs = zip(self.integrals, sums.T, strict=True)
        return np.column_stack([integral.draw(own, rng) for integral, own in pairs if integral is not None])

    def _sums_of(self, soil: FloatArray) -> FloatArray:
        """Sums (n, channels) of soil arrays (n, p), by nodes where these tell the rows."""
        if (nodes := self.forward.nodes) is None or self.squares is None:
            return self._sums(self.forward(soil))
        outcomes, told = self.forward.at_nodes(nodes, soil)
        named = zip(self.channels, self.squares, strict=True)
        sums = np.column_stack([own(outcomes[name]) for name, own in named])
        if not told.all():
            sums[~told] = self._sums(self.forward(soil[~told]))
        return sums


@dataclass(frozen=True)
class Integrated(Posterior):
    """Posterior of a study with estimated noise integrated out; ``whole`` is the posterior of all parameters."""

    whole: Posterior = field(kw_only=True)

    def completed(self, x: FloatArray, rng: Generator) -> FloatArray:
        """Parameter sets (n, d) of the whole, SI and radians: those of the soil (n, k), and noise drawn given them."""
        full, names = np.empty((len(x), len(self.whole.names))), self.whole.names
        estimated = [noise.parameter for noise in self.likelihood.noise if noise.parameter]
        full[:, [names.index(name) for name in self.names]] = x
        drawn = self.likelihood.integrated_out(self.prior.soil_values(x), rng)
        full[:, [names.index(name) for name in estimated]] = drawn
        return full


def integrated(posterior: Posterior) -> Integrated | None:
    """The same posterior with estimated noise integrated out, which is no longer among the names.

    None where nothing is estimated, where one of the estimates cannot be integrated out, or nothing else is free.
    """
    prior, whole = posterior.prior, posterior.likelihood
    names = {noise.parameter for noise in whole.noise if noise.parameter}
    joined = (name for several in (*prior.correlation, *prior.mixtures) for name in several.split(", "))
    if not names or not names < set(prior.laws) or names & {*prior.ties.values(), *joined}:
        return None
    if type(whole) is not Likelihood or (units := whole.stated_scales) is None:
        return None
    counts = (~np.isnan(whole.measured)).sum(axis=0)
    integrals = tuple(
        NoiseIntegral(prior.laws[noise.parameter], int(n)) if noise.parameter else None
        for noise, n in zip(whole.noise, counts, strict=True)
    )
    if not all(NODES * each.panels <= MOST and each.told for each in integrals if each):
        return None
    rest = replace(prior, entries={name: entry for name, entry in prior.entries.items() if name not in names})
    likelihood = IntegratedNoise(whole.forward, whole.observations, whole.noise, None, integrals, units)
    return Integrated(rest, likelihood, posterior.experiments, whole=posterior)
