"""Errors in sinkage and in force: the true load of a row is latent.

A row's load W has a flat prior on a stated range. The normal force reads W, sinkage, drawbar pull and moment
read what the model says at W, each with its own noise. The likelihood of a row is

    (1 / range) ∫ dW p(F_N | W) p(z | z(W)) p(F_DP | F_DP(W)) p(M_DR | M_DR(W)).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.likelihood import Likelihood
from bayesterra.likelihood import Outcomes

NODES = 200


@dataclass(frozen=True)
class LatentLoad(Likelihood):
    """Likelihood of rows whose load is known by its readings only.

    Parameters
    ----------
    load_range : lower and upper end of the flat prior of every load, N.
    """

    load_range: tuple[float, float] = (0.0, np.inf)

    @property
    def terms(self) -> tuple[str, ...]:
        """One term: all readings of a row together."""
        return ("row",)

    def _grid(self, soil: FloatArray, noise_values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        edges = np.linspace(*self.load_range, NODES + 1)
        loads = 0.5 * (edges[1:] + edges[:-1])
        logs = np.empty((len(soil), len(self.observations), NODES))
        known = np.empty(logs.shape, bool)
        for k, load in enumerate(loads):
            forward = replace(self.forward, given=np.full(len(self.observations), load))
            outcomes = forward.one_by_one(soil)
            known[:, :, k] = np.isfinite(outcomes.values).all(axis=2)
            logs[:, :, k] = self.pointwise(outcomes, noise_values).sum(axis=2)
        return loads, np.where(known, logs, -np.inf), known

    def status(self, soil: FloatArray) -> IntArray:
        """Status."""
        return replace(self.forward, given=np.full(len(self.observations), self.load_range[0]))(soil).status

    def log_terms(self, soil: FloatArray, noise_values: FloatArray) -> FloatArray:
        """Log likelihood (n, m, 1) of every row."""
        _, logs, _ = self._grid(soil, noise_values)
        with np.errstate(divide="ignore"):
            return np.logaddexp.reduce(logs, axis=2)[:, :, None] - np.log(NODES)

    def log_likelihood(self, soil: FloatArray, noise_values: FloatArray) -> FloatArray:
        """Log likelihood (n,)."""
        return self.log_terms(soil, noise_values).sum(axis=(1, 2))

    def explained(self, soil: FloatArray, noise_values: FloatArray, rng: Generator) -> Outcomes:
        """Outcomes at loads drawn given soil and readings."""
        loads, logs, _ = self._grid(soil, noise_values)
        gumbel = logs + rng.gumbel(size=logs.shape)
        return replace(self.forward, given=loads[gumbel.argmax(axis=2)]).one_by_one(soil)
