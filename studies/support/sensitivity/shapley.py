"""Shapley effects: shares of an output's variance that add up to one for dependent inputs too."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
import pandas as pd
from numpy.random import Generator

from bayesterra.arrays import FloatArray
from sensitivity.problems import Problem, columns_of, draw_base, partners
from sensitivity.sobol import closed_index

MOST_INPUTS = 10
"""Every subset of the inputs is looked at, 2^k − 2 of them."""


@dataclass(frozen=True)
class Shapley:
    """Shapley effects (Owen 2014; Song, Nelson and Staum 2016).

    Attributes
    ----------
    inputs : names (k,).
    outputs : one row per output (q,).
    effect, error : share of the variance and its standard error (k, q); effects add up to one.
    unmatched : largest share of draws without a partner that any subset leaves out.
    """

    inputs: tuple[str, ...]
    outputs: pd.DataFrame
    effect: FloatArray
    error: FloatArray
    unmatched: float

    @property
    def table(self) -> pd.DataFrame:
        """One row per output and input: the output's columns, input, effect and its error."""
        rows = self.outputs.loc[self.outputs.index.repeat(len(self.inputs))].reset_index(drop=True)
        return rows.assign(
            input=list(self.inputs) * len(self.outputs), effect=self.effect.T.ravel(), error=self.error.T.ravel()
        )


def shapley(problem: Problem, n: int, rng: Generator) -> Shapley:
    """Shapley effects of every input and output from ``n`` base draws and n partners per subset of inputs.

    Raises
    ------
    ValueError : there are more than ``MOST_INPUTS`` inputs.
    """
    names = tuple(problem.inputs)
    if len(names) > MOST_INPUTS:
        raise ValueError(f"'inputs' must be at most {MOST_INPUTS}; join some in groups (got {len(names)})")
    base = draw_base(problem, n, rng)
    effect = np.full((len(names), base.values.shape[1]), 1.0 / len(names))  # of the full set, whose index is 1
    parts, missing = np.zeros((len(names), *base.values.shape)), [0.0]
    for subset in _subsets(names):
        others = partners(problem, base, columns_of(problem, subset, base.x.shape[1]), rng)
        index, weights = closed_index(base.values, others), _weights(names, subset)
        effect += weights[:, None] * index.value
        parts += weights[:, None, None] * index.parts
        missing.append(float(np.isnan(others[:, 0]).mean()))
    return Shapley(names, problem.outputs, effect, parts.std(axis=1) / np.sqrt(n), max(missing))


def _subsets(names: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Every subset but the empty and the full one."""
    return [subset for size in range(1, len(names)) for subset in combinations(names, size)]


def _weights(names: tuple[str, ...], subset: tuple[str, ...]) -> FloatArray:
    """How much the index of a subset counts in the effect of each input (k,)."""
    k, size = len(names), len(subset)
    gain, loss = 1.0 / (k * comb(k - 1, size - 1)), 1.0 / (k * comb(k - 1, size))
    return np.array([gain if name in subset else -loss for name in names])
