"""Sobol indices of any outputs, first-order and total, with Monte Carlo errors, for dependent inputs too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.random import Generator

from bayesterra.arrays import FloatArray
from sensitivity.problems import Problem, columns_of, draw_base, partners


@dataclass(frozen=True)
class Estimate:
    """An index of each output with the part of each draw in its error.

    Attributes
    ----------
    value : (q,), NaN for an output that does not vary.
    parts : (n, q), whose mean is zero and whose sd over √n is the standard error; zero for missing pairs.
    """

    value: FloatArray
    parts: FloatArray

    @property
    def error(self) -> FloatArray:
        """Standard errors (q,)."""
        return np.asarray(self.parts.std(axis=0) / np.sqrt(len(self.parts)))


def closed_index(values: FloatArray, others: FloatArray) -> Estimate:
    """Var(E[Y | shared])/Var(Y) from outputs (n, q) of pairs that share inputs, rows of NaN left out.

    Janon et al. 2014 (ESAIM: PS 18, 342), eq. (6): mean and variance from both of a pair.
    """
    first, second = _centred(values, others)
    return _ratio(first * second, 0.5 * (first**2 + second**2))


def total_index(values: FloatArray, others: FloatArray) -> Estimate:
    """E[Var(Y | shared)]/Var(Y) from outputs (n, q) of such pairs, Jansen 1999 (CPC 117, 35)."""
    first, second = _centred(values, others)
    return _ratio(0.5 * (first - second) ** 2, 0.5 * (first**2 + second**2))


def _centred(values: FloatArray, others: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Both of each pair without their common mean; zero where a pair is missing."""
    known = ~np.isnan(others)
    mean = 0.5 * (values.mean(axis=0, where=known) + others.mean(axis=0, where=known))
    return np.where(known, values - mean, 0.0), np.where(known, others - mean, 0.0)


def _ratio(part: FloatArray, variance: FloatArray) -> Estimate:
    """Ratio of two means and its linearised parts; missing pairs are zero in both."""
    spread = np.where(variance.any(axis=0), variance.mean(axis=0), np.nan)
    value = part.mean(axis=0) / spread
    return Estimate(value, (part - value * variance) / spread)


@dataclass(frozen=True)
class Sobol:
    """First-order and total Sobol indices.

    For inputs that the cut makes dependent, the first-order index counts what an input tells through the
    others too (the "full" index of Mara and Tarantola 2012), and the total one only what is left of it when
    all others are known ("independent"); a total index below the first-order one shows such a dependence.

    Attributes
    ----------
    inputs : names (k,).
    outputs : one row per output (q,).
    first, first_error : Var(E[Y | input])/Var(Y) and its standard error, (k, q).
    total, total_error : E[Var(Y | all others)]/Var(Y) and its standard error, (k, q).
    mean, sd : of each output (q,), in the output's unit.
    accepted : share of proposals inside the cut.
    unmatched : largest share of draws without a partner that any index leaves out.
    """

    inputs: tuple[str, ...]
    outputs: pd.DataFrame
    first: FloatArray
    first_error: FloatArray
    total: FloatArray
    total_error: FloatArray
    mean: FloatArray
    sd: FloatArray
    accepted: float
    unmatched: float

    @property
    def table(self) -> pd.DataFrame:
        """One row per output and input: the output's columns, input, both indices and their errors."""
        rows = self.outputs.loc[self.outputs.index.repeat(len(self.inputs))].reset_index(drop=True)
        figures = {name: getattr(self, name).T.ravel() for name in ("first", "first_error", "total", "total_error")}
        return rows.assign(input=list(self.inputs) * len(self.outputs), **figures)


def sobol(problem: Problem, n: int, rng: Generator) -> Sobol:
    """Sobol indices of every input and output from ``n`` base draws and 2n partners per input."""
    base = draw_base(problem, n, rng)
    first: list[Estimate] = []
    total: list[Estimate] = []
    missing = [0.0]
    for name in problem.inputs:
        own = columns_of(problem, (name,), base.x.shape[1])
        for shared, index, into in ((own, closed_index, first), (~own, total_index, total)):
            others = partners(problem, base, shared, rng)
            into.append(index(base.values, others))
            missing.append(float(np.isnan(others[:, 0]).mean()))
    return Sobol(
        tuple(problem.inputs), problem.outputs, *_stacked(first), *_stacked(total),
        base.values.mean(axis=0), base.values.std(axis=0), base.accepted, max(missing),
    )  # fmt: skip


def _stacked(estimates: list[Estimate]) -> tuple[FloatArray, FloatArray]:
    return np.array([each.value for each in estimates]), np.array([each.error for each in estimates])
