"""Errors in variables: sinkage and force both read with error, the true load of every row latent.

A row's load W has a flat prior on a stated range. The normal force reads W; sinkage, drawbar pull and moment
read what the model says at W, each with its own noise. The likelihood of a row is

    (1 / range) ∫ dW p(F_N | W) p(z | z(W)) p(F_DP | F_DP(W)) p(M_DR | M_DR(W)),

with nothing where the model carries no load W. It is computed over z, dW = dF_N/dz dz, as (14) gives forces
at a sinkage at once; the error of its logarithm is below 1e-3.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.likelihood import load_integral as sums
from bayesterra.likelihood import load_integrand as lv
from bayesterra.likelihood import load_integrand as pn
from bayesterra.likelihood.forward import Outcomes, offset_of, take
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.models import kernels as at
from bayesterra.models.kernels import Codes, Lanes, Plan, compiled, inlined


@dataclass(frozen=True)
class LatentLoad(Likelihood):
    """Likelihood of rows whose load is known by its readings only.

    Parameters
    ----------
    forward : the model at the rows, drive ``both``; its loads are not used.
    load_range : lower and upper end of the flat prior of every load, N.
    """

    load_range: tuple[float, float] = (0.0, np.inf)

    @property
    def terms(self) -> tuple[str, ...]:
        """One term: all readings of a row together."""
        return ("readings",)

    def status(self, soil: FloatArray) -> IntArray:
        """Status (n,) of soil arrays; 0 where every row has an answer for the lowest load of the range."""
        lowest = np.full(len(self.observations), self.load_range[0])
        return replace(self.forward, given=lowest)(soil).status

    def log_terms(self, soil: FloatArray, noise_values: FloatArray) -> FloatArray:
        """Log likelihood (n, m, 1) of every row's readings together; −inf where the model has no answer."""
        return self._rows(soil, noise_values, None)[:, :, :1]

    def log_likelihood(self, soil: FloatArray, noise_values: FloatArray) -> FloatArray:
        """Log likelihood (n,) of soil arrays (n, 16)."""
        return np.asarray(self.log_terms(soil, noise_values).sum(axis=(1, 2)))

    def loads(self, soil: FloatArray, noise_values: FloatArray, rng: Generator) -> FloatArray:
        """Draw the load (n, m) of every row given soil, noise and its readings; NaN where there is none."""
        return self._rows(soil, noise_values, rng)[:, :, 1]

    def explained(self, soil: FloatArray, noise_values: FloatArray, rng: Generator) -> Outcomes:
        """Outcomes at loads drawn given soil, noise and the readings of each row."""
        return replace(self.forward, given=self.loads(soil, noise_values, rng))(soil, every_row=True)

    def imagined(self, soil: FloatArray, noise_values: FloatArray, rng: Generator) -> Outcomes:
        """Outcomes at loads drawn from their flat prior."""
        loads = rng.uniform(*self.load_range, size=(len(soil), len(self.observations)))
        return replace(self.forward, given=loads)(soil, every_row=True)

    def _rows(self, soil: FloatArray, noise_values: FloatArray, rng: Generator | None) -> FloatArray:
        """Log likelihood of every row, and a load drawn if there is a source of chance, (n, m, 2)."""
        pass  # numba is heavy: only where it is needed

        shape = (len(soil), len(self.observations))
        out = np.empty((*shape, 2))
        out[:, :, 1] = -1.0 if rng is None else rng.random(shape)
        data = self._data(soil, noise_values)
        for rows, theta in self.forward.by_wheel(soil):
            part = np.ascontiguousarray(out[:, rows])
            codes = np.empty(part.shape[:2], dtype=np.int8)
            model, conditions = self.forward.model, take(self.forward.conditions, rows)
            sets, rows_of = model.kernel_inputs(theta, conditions)
            plan = model.plan(every_row=True)
            likelihoods(sets, rows_of, _chosen(data, rows), plan, part, codes)
            out[:, rows] = part
        return out

    @cached_property
    def _fixed(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Readings (m, 4), fractions (m, 4) and degrees of freedom (4,); channels as the outcomes stand."""
        m, outcomes = len(self.observations), self.forward.outcomes
        readings, fraction, dof = np.full((m, 4), np.nan), np.zeros((m, 4)), np.full(4, np.inf)
        for noise in self.noise:
            i, own = outcomes.index(noise.channel), self._given_sd[noise.channel]
            readings[:, i] = self.observations.values[noise.channel]
            fraction[:, i] = np.where(np.isnan(own), noise.fraction or 0.0, 0.0)
            dof[i] = noise.dof
        return readings, fraction, dof

    def _data(self, soil: FloatArray, noise_values: FloatArray) -> Data:
        """Readings and laws as the compiled loop takes them."""
        readings, fraction, dof = self._fixed
        estimated = iter(noise_values.T)
        sets = len(soil) if noise_values.shape[1] else 1
        floor = np.ones((sets, *readings.shape, 2))
        for noise in self.noise:
            values = next(estimated)[:, None] if noise.parameter else noise.sd or noise.floor
            own, i = self._given_sd[noise.channel], self.forward.outcomes.index(noise.channel)
            floor[:, :, i, 0] = np.where(np.isnan(own), values, own)
            floor[:, :, i, 1] = noise.log_peak - np.log(floor[:, :, i, 0])
        shift = np.ascontiguousarray(offset_of(soil)[:, 0])
        return readings, floor, fraction, dof, shift, np.log(self.load_range)


def _chosen(data: Data, rows: BoolArray) -> Data:
    """The data of some rows."""
    if rows.all():
        return data
    readings, floor, fraction, dof, shift, loads = data
    return readings[rows], np.ascontiguousarray(floor[:, rows]), fraction[rows], dof, shift, loads


_SIGMAS = 7.0  # half-width of the first panel, in standard deviations of a reading
_UNSURE = 0.2  # of the guess at the log z that carries a load
_NARROWEST, _WIDEST = 0.02, 2.0

Data = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""Readings and their laws, channels in the order of the outcomes: readings (m, 4), NaN where there is none;
smallest scale of the noise, and log density there at its centre, (n, m, 4, 2) or (1, m, 4, 2); the scale as a
fraction (m, 4) of the modelled value; degrees of freedom (4,); zero error (n,) of the sinkage; log of the
range (2,) of the load."""


@compiled
def likelihoods(
    theta: FloatArray, rows: FloatArray, data: Data, plan: Plan, out: FloatArray, status: Codes
) -> None:
    """Fill `out` (n, m, 2): log likelihood of every row, and a drawn load in place of a uniform number."""
    at.screen(theta, rows, plan, status)
    workspace = np.zeros(lv.DESK_SIZE)
    loads = data[5]
    width = loads[1] + np.log1p(-np.exp(loads[0] - loads[1]))
    for i in range(status.shape[0]):
        for j in range(status.shape[1]):
            draw = out[i, j, 1] >= 0.0
            if status[i, j] != 0:
                out[i, j, 0], out[i, j, 1] = -np.inf, np.nan
                continue
            at.lay(workspace, theta[i], rows[j])
            _specify(workspace, data, i, j)
            workspace[pn.UNIFORM] = out[i, j, 1]
            falls = at.can_fall(workspace, 0, plan[0])
            left, right = _first_panel(workspace, loads)
            level = sums.log_integral(workspace, plan[0], falls, left, right) - width
            out[i, j, 0] = level if level < np.inf else -np.inf
            if draw:
                out[i, j, 1] = sums.drawn_load(workspace) if level > -np.inf else np.nan


@compiled
def _specify(workspace: Lanes, data: Data, i: int, j: int) -> None:
    """Put the readings of a row and their laws onto the desk."""
    readings, floor, fraction, dof, shift, loads = data
    own = i if floor.shape[0] > 1 else 0
    for channel in range(lv.CHANNELS):
        first = lv.SPEC + channel * lv.COLUMNS
        workspace[first + lv.READING] = readings[j, channel]
        workspace[first + lv.FLOOR], workspace[first + lv.PEAK] = (
            floor[own, j, channel, 0],
            floor[own, j, channel, 1],
        )
        workspace[first + lv.FRACTION] = fraction[j, channel]
        workspace[first + lv.DOF] = dof[channel]
        workspace[first + lv.SHIFT] = shift[i] if channel == lv.SINKAGE else 0.0
    workspace[pn.LOAD_LOW], workspace[pn.LOAD_HIGH] = loads[0], loads[1]
    workspace[pn.TOP] = at.highest(workspace)


@compiled
def _first_panel(workspace: Lanes, loads: FloatArray) -> tuple[float, float]:
    """Guess the ends of the weight in log z from what sinkage and force say; the search corrects it."""
    force, around = lv.spec(workspace, lv.NORMAL, lv.READING), _SIGMAS * _scale(workspace, lv.NORMAL)
    low, high = np.exp(loads[0]), np.exp(loads[1])
    least, most = max(low, force - around), min(high, force + around)
    if not least < most:  # not read, or far outside the range
        least, most = low, high
    middle, slope = at.guess(workspace, np.sqrt(least * most))
    half = 0.5 * np.log(most / least) / slope + _UNSURE
    left, right = middle - half, middle + half
    depth = lv.spec(workspace, lv.SINKAGE, lv.READING) - lv.spec(workspace, lv.SINKAGE, lv.SHIFT)
    around = _SIGMAS * _scale(workspace, lv.SINKAGE)
    shallow = np.log(depth - around) if depth > around else left
    deep = np.log(depth + around) if depth > -around else right
    if max(left, shallow) < min(right, deep):
        left, right = max(left, shallow), min(right, deep)
    right = min(right, workspace[pn.TOP])
    return max(min(left, right - _NARROWEST), right - _WIDEST), right


@inlined
def _scale(workspace: Lanes, channel: int) -> float:
    """Scale of the noise of a reading, about."""
    size = abs(lv.spec(workspace, channel, lv.READING))
    return max(lv.spec(workspace, channel, lv.FRACTION) * size, lv.spec(workspace, channel, lv.FLOOR))
