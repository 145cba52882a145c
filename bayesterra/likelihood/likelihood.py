"""Probability of the measurements given soil parameters and noise, errors in variables included.

What is conditioned on and what is an outcome the drive says (:mod:`bayesterra.study.drive`).

Errors in variables: sinkage and force both read with error, the true load of every row latent.
A row's load W has a flat prior on a stated range. The normal force reads W; sinkage, drawbar pull and moment
read what the model says at W, each with its own noise. The likelihood of a row is

    (1 / range) ∫ dW p(F_N | W) p(z | z(W)) p(F_DP | F_DP(W)) p(M_DR | M_DR(W)),

with nothing where the model carries no load W. It is computed over z, dW = dF_N/dz dz, as (14) gives forces
at a sinkage at once; the error of its logarithm is below 1e-3.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import ClassVar

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import BoolArray, FloatArray, IntArray, frozen, in_parts
from bayesterra.likelihood import load_integral as sums
from bayesterra.likelihood import load_integrand as lv
from bayesterra.likelihood.covariance import TableLaw
from bayesterra.likelihood.forward import Forward, Outcomes, Squares, offset_of, take
from bayesterra.likelihood.sites import Intervals
from bayesterra.models import kernels as at
from bayesterra.models.kernels import Codes, Lanes, Plan, called, compiled, inlined
from bayesterra.stats.tails import GAUSSIAN
from bayesterra.study.noise import Noise
from bayesterra.study.observations import Observations

DOUBLES = 1e6
"""Numbers that what is worked on at once may take."""


@dataclass(frozen=True)
class Likelihood:
    """Likelihood of every measured outcome, each with independent noise."""

    forward: Forward  # the model at the rows that are in the fit
    observations: Observations  # those rows
    noise: Sequence[Noise]  # noise of each measured outcome
    load_range: tuple[float, float] | None = None  # ends of the flat prior of every load, N; None where loads are known

    together: ClassVar[bool] = False
    """Whether the readings of a row have one law together, in which rounding is one more error."""
    rows_apart: ClassVar[bool] = True
    """Whether rows are independent given the parameters, so that the log likelihood sums its terms."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Measured outcomes, the order of :meth:`pointwise`'s last axis."""
        return tuple(noise.channel for noise in self.noise)

    @property
    def terms(self) -> tuple[str, ...]:
        """Terms that the log likelihood of a row is the sum of."""
        return ("readings",) if self.together else self.channels

    def status(self, soil: FloatArray) -> IntArray:
        """Status (n,) of soil arrays; 0 where every row has an answer."""
        return in_parts(self.forward.status, self.at_once, soil)

    def log_terms(self, soil: FloatArray, noise_values: FloatArray) -> FloatArray:
        """Log density (n, m, terms) of every row's readings; −inf where the model has no answer."""
        outcomes = self.forward(soil)
        terms = self.pointwise(outcomes, noise_values)
        return np.where((outcomes.status == 0)[:, None, None], terms, -np.inf)

    def log_likelihood(self, soil: FloatArray, noise_values: FloatArray) -> FloatArray:
        """Log likelihood (n,) of soil arrays (n, p); −inf where the model has no answer."""
        if len(soil) > (most := self.at_once):
            return in_parts(self.log_likelihood, most, soil, noise_values)
        nodes, squares = self.forward.nodes, self.squares
        if nodes is None or squares is None:
            return self.log_density(self.forward(soil), noise_values)
        outcomes, told = self.forward.at_nodes(nodes, soil)
        total = self.log_told(squares, outcomes, noise_values)
        if not told.all():
            total[~told] = self._finer.log_likelihood(soil[~told], noise_values[~told])
        return total

    @cached_property
    def _finer(self) -> "Likelihood":
        return replace(self, forward=self.forward.finer)

    @cached_property
    def squares(self) -> tuple[Squares, ...] | None:
        """Squared residuals of every channel of the readings where nodes tell the rows; else None.

        None also where there are no :attr:`stated_scales`.
        """
        nodes, scales = self.forward.nodes, self.stated_scales
        if nodes is None or scales is None:
            return None
        return tuple(Squares.of(*columns, nodes.spread) for columns in zip(self.measured.T, scales.T, strict=True))

    @cached_property
    def stated_scales(self) -> FloatArray | None:
        """Standard deviations (m, channels) of readings in units of what is estimated of them; else None.

        None where noise is not Gaussian, hangs on what is modelled, or is estimated for some rows only.
        """
        if self.intervals is not None or self.together:
            return None
        scales = np.ones(self.measured.shape)
        for i, noise in enumerate(self.noise):
            own = self._given_sd[noise.channel]
            if noise.tails != GAUSSIAN or noise.fraction is not None or (noise.parameter and not np.isnan(own).all()):
                return None
            if not noise.parameter:
                scales[:, i] = noise.scale(self.measured[None, :, i], None, own)[0]
        return scales

    def log_told(self, sums: Sequence[Squares], outcomes: Outcomes, noise_values: FloatArray) -> FloatArray:
        """Log likelihood (n,) of readings of which these are the squares, by ``outcomes`` of the nodes."""
        total, estimated = np.zeros(len(outcomes.values)), iter(noise_values.T)
        for noise, squares in zip(self.noise, sums, strict=True):
            size = noise.widened(next(estimated)) if noise.parameter else np.ones(1)
            total += squares.count * (noise.tails.log_peak - np.log(size)) - squares.logs
            total -= 0.5 * squares(outcomes[noise.channel]) / size**2
        return total

    def log_rows(self, soil: FloatArray, noise_values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log likelihood (n,), and log density (n, m) of every row's readings given those of all others.

        Rows are independent here, so the one is the sum of the other; correlated readings are not.
        """
        rows = in_parts(lambda *part: self.log_terms(*part).sum(axis=2), self.at_once, soil, noise_values)
        return np.asarray(rows.sum(axis=1)), np.asarray(rows)

    @property
    def at_once(self) -> int:
        """Parameter sets whose outcomes or matrices find room at once."""
        return max(1, int(DOUBLES / max(1, self.measured.size)))

    def joint_law(self, soil: FloatArray, noise_values: FloatArray) -> TableLaw | None:
        """Law of the whole table at soils with an answer in every row; None where rows are independent."""
        return None

    def law_where(
        self, read: BoolArray, soil: FloatArray, mean: FloatArray, noise: FloatArray, load: FloatArray | None
    ) -> TableLaw | None:
        """Law of readings where ``read`` (m, k) holds, made or yet to be made; None where these are apart.

        ``mean`` (n, m, k) is what the model says of them, ``load`` the effect of one standard deviation
        of latent loads.
        """
        return None

    def reading(self, law: TableLaw, readings: FloatArray) -> TableLaw:
        """A law of the table for other readings (m, k), of which others may be known by a limit only."""
        if self.intervals is None and not law.layout.heavy.any():
            return law
        side = np.zeros(readings.shape) if self.intervals is None else self.intervals.sides(readings)
        return law.told(side, readings)

    def scores(self, soil: FloatArray, noise_values: FloatArray) -> FloatArray:
        """Normal scores (n, m, k) of readings given all other rows; NaN where there is none."""
        if len(soil) > (most := self.at_once):
            return in_parts(self.scores, most, soil, noise_values)
        z = self.standardised(self.predicted(self.forward(soil)), noise_values)
        laws = [noise.tails.normal_score(z[:, :, i]) for i, noise in enumerate(self.noise)]
        return np.stack(laws, axis=2)

    def ahead(
        self, soil: FloatArray, noise_values: FloatArray, targets: BoolArray, rng: Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Places and standard deviations (n, t, k) of readings of rows ``targets`` (m,) that are not in use.

        Given the readings of the rows in use, and the normal forces of the others where loads are latent: a
        load is drawn then. NaN where there is no answer.
        """
        rows, kept = self.observations.take(targets), self.forward.drive.kept
        nothing = frozen(np.full(len(rows), np.nan))
        values = {name: column if name in kept else nothing for name, column in rows.values.items()}
        apart = replace(self, forward=self.forward.rows(targets), observations=replace(rows, values=values))
        centre = apart.predicted(apart.explained(soil, noise_values, rng))
        return centre, apart.scales(centre, noise_values)

    def doubts(self, soil: FloatArray, noise_values: FloatArray) -> str:
        """A sentence on rows for which an approximation is poor, at typical parameter sets; or nothing."""
        return ""

    def explained(self, soil: FloatArray, noise_values: FloatArray, rng: Generator) -> Outcomes:
        """Outcomes behind the readings, row by row; nothing is random where the load is known."""
        return self.forward(soil, every_row=True)

    def loads_near(self, readings: FloatArray) -> FloatArray | None:
        """Loads (m,), N, near those that readings (m, channels) tell; None where they tell none or loads are known."""
        return None

    def imagined(self, soil: FloatArray, noise_values: FloatArray, rng: Generator) -> Outcomes:
        """Outcomes row by row before any reading; as :meth:`explained` where the load is known."""
        return self.forward(soil, every_row=True)

    def beyond(
        self, soil: FloatArray, noise_values: FloatArray, wheel: str | None, slip: FloatArray, rng: Generator
    ) -> FloatArray | None:
        """Discrepancy (n, g, channels) of a wheel at slips (g,); None where the study has none."""
        return None

    def integrated_out(self, soil: FloatArray, rng: Generator) -> FloatArray:
        """Standard deviations (n, k) that were integrated out, SI, drawn given the soil (n, p): none here."""
        return np.empty((len(soil), 0))

    def fresh(self, forward: Forward, soil: FloatArray, noise_values: FloatArray, rng: Generator) -> FloatArray | None:
        """What new readings at the rows of ``forward`` have beside outcomes and noise; None for nothing."""
        return None

    @cached_property
    def measured(self) -> FloatArray:
        """Readings (m, channels), NaN where not measured."""
        return np.column_stack([self.observations.values[name] for name in self.channels])

    @cached_property
    def _given_sd(self) -> dict[str, FloatArray]:
        none = np.full(len(self.observations), np.nan)
        return {name: self.observations.given_sd.get(name, none) for name in self.channels}

    @cached_property
    def intervals(self) -> Intervals | None:
        """What readings stand for that are rounded or known by a limit; None where all are numbers.

        Rounding does not count where it is one more error of variance step²/12: see :meth:`Noise.scale`.
        """
        rows, readings = self.observations, self.measured
        return Intervals.of(rows, self.noise, readings, rounding=not self.together)

    @property
    def widened(self) -> bool:
        """Whether rounding is an error like noise, not an interval."""
        return self.together or self.intervals is None

    def predicted(self, outcomes: Outcomes) -> FloatArray:
        """Modelled values of the measured channels, (n, m, channels)."""
        return outcomes.of(self.channels)

    def scales(self, predicted: FloatArray, noise_values: FloatArray, *, rounded: bool = True) -> FloatArray:
        """Standard deviations (n, m, channels) of readings, or of what they were before being rounded.

        ``noise_values`` (n, k) are the estimated standard deviations, in the order of the channels that
        have one.
        """
        scale = np.empty(predicted.shape)
        estimated = iter(noise_values.T)
        for i, noise in enumerate(self.noise):
            value, of = next(estimated) if noise.parameter else None, self._given_sd[noise.channel]
            law = noise.scale if rounded else noise.before_rounding
            scale[:, :, i] = law(predicted[:, :, i], value, of)
        return scale

    def pointwise(self, outcomes: Outcomes, noise_values: FloatArray) -> FloatArray:
        """Log density of every reading, (n, m, channels); 0 where nothing was measured.

        That of a rounded reading is the log probability of what is rounded to it, less that of its step.
        """
        predicted = self.predicted(outcomes)
        scale = self.scales(predicted, noise_values, rounded=self.widened)
        return self.log_readings(self.measured, predicted, scale)

    def log_readings(self, readings: FloatArray, predicted: FloatArray, scale: FloatArray) -> FloatArray:
        """The same for any readings (m, channels); ``scale`` (n, m, channels) before those are rounded."""
        with np.errstate(over="ignore"):  # forces of 1e200 N have the log density −inf
            standard = (readings - predicted) / scale
            laws = [noise.tails.log_density(standard[:, :, i]) for i, noise in enumerate(self.noise)]
            density = np.stack(laws, axis=2) - np.log(scale)
            if self.intervals is not None:
                self.intervals.replace_densities(density, readings, predicted, scale)
        return np.where(np.isnan(readings), 0.0, density)

    def standardised(self, predicted: FloatArray, noise_values: FloatArray) -> FloatArray:
        """Residuals (n, m, channels) in units of their standard deviation, NaN where there is no reading.

        That of a reading known by a limit only: of the middle, by probability, of what is beyond the limit.
        """
        scale = self.scales(predicted, noise_values)
        standard = (self.measured - predicted) / scale
        return standard if self.intervals is None else self.intervals.at_middles(standard, predicted, scale)

    def log_density(self, outcomes: Outcomes, noise_values: FloatArray) -> FloatArray:
        """Log likelihood (n,), −inf where the model has no answer."""
        total = self.pointwise(outcomes, noise_values).sum(axis=(1, 2))
        return np.where(outcomes.status == 0, total, -np.inf)

    def draw(self, outcomes: Outcomes, noise_values: FloatArray, rng: Generator) -> FloatArray:
        """Draw readings (n, m, channels) with noise, for every row and measured channel."""
        predicted = self.predicted(outcomes)
        scale = self.scales(predicted, noise_values, rounded=False)
        return self._recording.recorded(self.with_noise(predicted, scale, rng))

    def with_noise(self, places: FloatArray, scale: FloatArray, rng: Generator) -> FloatArray:
        """Draw from the laws of the channels' noise about places (n, m, channels)."""
        standard = rng.standard_normal(places.shape)
        for i, noise in enumerate(self.noise):
            if noise.tails != GAUSSIAN:
                standard[:, :, i] = noise.tails.draw(places.shape[:2], rng)
        return places + scale * standard

    @cached_property
    def _recording(self) -> Intervals:
        none = np.full(len(self.observations), np.nan)
        values = [self.observations.values.get(name, none) for name in self.channels]
        return Intervals(self.noise, *Intervals.ends(self.observations, self.noise), np.column_stack(values))


@dataclass(frozen=True)
class LatentLoad(Likelihood):
    """Likelihood of rows whose load is known by its readings only; the loads of ``forward`` are not used."""

    load_range: tuple[float, float] = (0.0, np.inf)
    together: ClassVar[bool] = True

    def status(self, soil: FloatArray) -> IntArray:
        """Status (n,) of soil arrays; 0 where every row has an answer for the lowest load of the range."""
        return self.forward.at_load(self.load_range[0]).status(soil)

    def log_terms(self, soil: FloatArray, noise_values: FloatArray) -> FloatArray:
        """Log likelihood (n, m, 1) of every row's readings together; −inf where the model has no answer."""
        return self._rows(soil, noise_values, None)[:, :, :1]

    def log_likelihood(self, soil: FloatArray, noise_values: FloatArray) -> FloatArray:
        """Log likelihood (n,) of soil arrays (n, p)."""
        return np.asarray(self.log_terms(soil, noise_values).sum(axis=(1, 2)))

    def loads(self, soil: FloatArray, noise_values: FloatArray, rng: Generator) -> FloatArray:
        """Draw the load (n, m) of every row given soil, noise and its readings; NaN where there is none."""
        return self._rows(soil, noise_values, rng)[:, :, 1]

    def explained(self, soil: FloatArray, noise_values: FloatArray, rng: Generator) -> Outcomes:
        """Outcomes at loads drawn given soil, noise and the readings of each row."""
        return self.forward.at_load(self.loads(soil, noise_values, rng))(soil, every_row=True)

    def loads_near(self, readings: FloatArray) -> FloatArray | None:
        """The normal forces (m,), N, within the range; None where a row has none: each set's own takes an integral."""
        if "normal_force" not in self.channels:
            return None
        forces = readings[:, self.channels.index("normal_force")]
        return None if np.isnan(forces).any() else np.clip(forces, *self.load_range)

    def imagined(self, soil: FloatArray, noise_values: FloatArray, rng: Generator) -> Outcomes:
        """Outcomes at loads drawn from their flat prior."""
        loads = rng.uniform(*self.load_range, size=(len(soil), len(self.observations)))
        return self.forward.at_load(loads)(soil, every_row=True)

    def _rows(self, soil: FloatArray, noise_values: FloatArray, rng: Generator | None) -> FloatArray:
        """Log likelihood of every row, and a load drawn if there is a source of chance, (n, m, 2)."""
        if not self._compiled:
            return sums.log_rows(self.forward, soil, self.load_range, partial(self._levels, soil, noise_values), rng)
        shape = (len(soil), len(self.observations))
        out = np.empty((*shape, 2))
        out[:, :, 1] = -1.0 if rng is None else rng.random(shape)
        data = self._data(soil, noise_values)
        for rows, theta in self.forward.by_wheel(soil):
            part = np.ascontiguousarray(out[:, rows])
            codes = np.empty(part.shape[:2], dtype=np.int8)
            sets, rows_of, plan = self.forward.model.kernel_inputs(theta, take(self.forward.conditions, rows))
            likelihoods(sets, rows_of, _chosen(data, rows), plan, part, codes)
            out[:, rows] = part
        return out

    @cached_property
    def _compiled(self) -> bool:
        """Whether compiled code knows the model and all laws of noise: none is rounded and a fraction as well."""
        rounded = any(noise.fraction and noise.resolution for noise in self.noise)
        known = not rounded and not np.isnan([noise.tails.code for noise in self.noise]).any()
        return self.forward.model.compiled and known

    def _levels(self, soil: FloatArray, noise_values: FloatArray, values: FloatArray) -> FloatArray:
        """Log density (n, m) of every row's readings where the model says ``values`` (n, m, 4)."""
        outcomes = Outcomes(self.forward.outcomes, values, np.zeros(len(soil), dtype=np.int64))
        outcomes.add("sinkage", offset_of(soil))
        return np.asarray(self.pointwise(outcomes, noise_values).sum(axis=2))

    @cached_property
    def _fixed(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Readings, sides of limits and fractions (m, k), codes of the laws (k,) and what lies beyond."""
        outcomes = self.forward.outcomes
        shape = (len(self.observations), lv.CHANNELS)
        readings, fraction, dof = np.full(shape, np.nan), np.zeros(shape), np.full(lv.CHANNELS, np.inf)
        sides, beyond = np.zeros(shape), np.zeros((lv.CHANNELS, lv.STEPS))
        for column, noise in enumerate(self.noise):
            i, own = outcomes.index(noise.channel), self._given_sd[noise.channel]
            readings[:, i] = self.observations.values[noise.channel]
            fraction[:, i] = np.where(np.isnan(own), noise.fraction or 0.0, 0.0)
            dof[i], beyond[i] = noise.tails.code, noise.tails.log_cdf(lv.PLACES_BEYOND)
            if self.intervals is not None:
                sides[:, i] = self.intervals.sides(self.measured)[:, column]
        return readings, sides, fraction, dof, beyond

    def _data(self, soil: FloatArray, noise_values: FloatArray) -> "Data":
        """Readings and laws as the compiled loop takes them."""
        readings, sides, fraction, dof, beyond = self._fixed
        estimated = iter(noise_values.T)
        sets = len(soil) if noise_values.shape[1] else 1
        floor = np.ones((sets, *readings.shape, 2))
        for noise in self.noise:
            values = next(estimated)[:, None] if noise.parameter else noise.sd or noise.floor
            own, i = self._given_sd[noise.channel], self.forward.outcomes.index(noise.channel)
            floor[:, :, i, 0] = noise.widened(np.where(np.isnan(own), values, own))
            floor[:, :, i, 1] = noise.tails.log_peak - np.log(floor[:, :, i, 0])
        shift = np.ascontiguousarray(offset_of(soil)[:, 0])
        return readings, sides, floor, fraction, dof, beyond, shift, np.log(self.load_range)


def _chosen(data: "Data", rows: BoolArray) -> "Data":
    """The data of some rows."""
    if rows.all():
        return data
    readings, sides, floor, fraction, dof, beyond, shift, loads = data
    own = np.ascontiguousarray(floor[:, rows])
    return readings[rows], sides[rows], own, fraction[rows], dof, beyond, shift, loads


_SIGMAS = 7.0  # half-width of the first panel, in standard deviations of a reading
_UNSURE = 0.2  # of the guess at the log z that carries a load
_NARROWEST, _WIDEST = 0.02, 2.0

Data = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""Readings and their laws, channels in the order of the outcomes: readings (m, k), NaN where there is none;
sides (m, k) of what is known by a limit, −1 below and 1 above, else 0;
smallest scale of the noise, and log density there at its centre, (n, m, k, 2) or (1, m, k, 2); the scale as a
fraction (m, k) of the modelled value; codes of the laws (k,), and logs of their probabilities below
``PLACES_BEYOND``; zero error (n,) of the sinkage; log of the range (2,) of the load."""


@compiled
def likelihoods(theta: FloatArray, rows: FloatArray, data: Data, plan: Plan, out: FloatArray, status: Codes) -> None:
    """Fill `out` (n, m, 2): log likelihood of every row, and a drawn load in place of a uniform number."""
    at.screen(theta, rows, plan, status)
    workspace = np.zeros(lv.DESK_SIZE)
    loads = data[7]
    for channel in range(lv.CHANNELS):
        for k in range(lv.STEPS):
            workspace[lv.BEYOND + channel * lv.STEPS + k] = data[5][channel, k]
    width = loads[1] + np.log1p(-np.exp(loads[0] - loads[1]))
    for i in range(status.shape[0]):
        for j in range(status.shape[1]):
            draw = out[i, j, 1] >= 0.0
            if status[i, j] != 0:
                out[i, j, 0], out[i, j, 1] = -np.inf, np.nan
                continue
            at.lay(workspace, plan[0], theta[i], rows[j])
            _specify(workspace, data, i, j)
            workspace[lv.UNIFORM] = out[i, j, 1]
            falls = at.can_fall(workspace, 0, plan[0])
            left, right = _first_panel(workspace, loads)
            level = sums.log_integral(workspace, plan[0], falls, left, right) - width
            out[i, j, 0] = level if level < np.inf else -np.inf
            if draw:
                out[i, j, 1] = sums.drawn_load(workspace) if level > -np.inf else np.nan


@called
def _specify(workspace: Lanes, data: Data, i: int, j: int) -> None:
    """Put the readings of a row and their laws onto the desk."""
    readings, sides, floor, fraction, dof, _, shift, loads = data
    own = i if floor.shape[0] > 1 else 0
    for channel in range(lv.CHANNELS):
        first = lv.SPEC + channel * lv.COLUMNS
        workspace[first + lv.READING] = readings[j, channel]
        workspace[first + lv.SIDE] = sides[j, channel]
        workspace[first + lv.FLOOR] = floor[own, j, channel, 0]
        workspace[first + lv.PEAK] = floor[own, j, channel, 1]
        workspace[first + lv.FRACTION] = fraction[j, channel]
        workspace[first + lv.DOF] = dof[channel]
        workspace[first + lv.SHIFT] = shift[i] if channel == lv.SINKAGE else 0.0
    workspace[lv.LOAD_LOW], workspace[lv.LOAD_HIGH] = loads[0], loads[1]
    workspace[lv.TOP] = at.highest(workspace)


@called
def _first_panel(workspace: Lanes, loads: FloatArray) -> tuple[float, float]:
    """Guess the ends of the weight in log z from what sinkage and force say; the search corrects it."""
    force, around = _number(workspace, lv.NORMAL), _SIGMAS * _scale(workspace, lv.NORMAL)
    low, high = np.exp(loads[0]), np.exp(loads[1])
    least, most = max(low, force - around), min(high, force + around)
    if not least < most:  # not read, or far outside the range
        least, most = low, high
    middle, slope = at.guess(workspace, np.sqrt(least * most))
    half = 0.5 * np.log(most / least) / slope + _UNSURE
    left, right = middle - half, middle + half
    depth = _number(workspace, lv.SINKAGE) - lv.spec(workspace, lv.SINKAGE, lv.SHIFT)
    around = _SIGMAS * _scale(workspace, lv.SINKAGE)
    shallow = np.log(depth - around) if depth > around else left
    deep = np.log(depth + around) if depth > -around else right
    if max(left, shallow) < min(right, deep):
        left, right = max(left, shallow), min(right, deep)
    right = min(right, workspace[lv.TOP])
    return max(min(left, right - _NARROWEST), right - _WIDEST), right


@inlined
def _number(workspace: Lanes, channel: int) -> float:
    """Reading of a channel; NaN where there is none or a limit only."""
    side, reading = lv.spec(workspace, channel, lv.SIDE), lv.spec(workspace, channel, lv.READING)
    return reading if side == 0.0 else np.nan


@inlined
def _scale(workspace: Lanes, channel: int) -> float:
    """Scale of the noise of a reading, about."""
    size = abs(lv.spec(workspace, channel, lv.READING))
    return max(lv.spec(workspace, channel, lv.FRACTION) * size, lv.spec(workspace, channel, lv.FLOOR))
