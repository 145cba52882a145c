"""Errors in sinkage and in force: the true load of every row is latent.

A row's load W has a flat prior on a stated range. The normal force reads W; sinkage, drawbar pull and moment
read what the model says at W, each with its own noise. The likelihood of a row is

    (1 / range) ∫ dW p(F_N | W) p(z | z(W)) p(F_DP | F_DP(W)) p(M_DR | M_DR(W)),

with nothing where the model carries no load W. It is computed over z, dW = dF_N/dz dz, as (14) gives forces
at a sinkage at once; the error of its logarithm is below 1e-3.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.forward import by_wheel, offset_of, take
from bayesterra.likelihood import Likelihood, Outcomes

if TYPE_CHECKING:
    from bayesterra.latent._rows import Data


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
        """Log likelihood (n,) of soil arrays (n, 9 or 12)."""
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
        from bayesterra.latent import _rows as kernel  # numba is heavy: only where it is needed

        shape = (len(soil), len(self.observations))
        out = np.empty((*shape, 2))
        out[:, :, 1] = -1.0 if rng is None else rng.random(shape)
        data = self._data(soil, noise_values)
        for rows, theta in by_wheel(soil, self.forward.conditions):
            part = np.ascontiguousarray(out[:, rows])
            codes = np.empty(part.shape[:2], dtype=np.int8)
            model, conditions = self.forward.model, take(self.forward.conditions, rows)
            sets, rows_of = model.kernel_inputs(theta, conditions)
            plan = model.plan(every_row=True)
            kernel.likelihoods(sets, rows_of, _chosen(data, rows), plan, part, codes)
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
