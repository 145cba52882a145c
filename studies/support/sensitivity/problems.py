"""Outputs of random inputs on a cut domain, and pairs of draws that share some of the inputs.

A prior of independent laws cut to a region is, given some of its parameters, again the product of the other
laws cut to a region. Rejection therefore draws exactly from its conditional laws whatever the cut couples,
and no independent inputs need be constructed for indices that are defined by conditional expectations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.random import Generator

from bayesterra.arrays import BoolArray, FloatArray

ROUNDS = 200
"""Batches of proposals, each as large as the sample, after which a pair is given up."""
RAREST = 50_000
"""Proposals of which at least one must lie inside the cut."""


@dataclass(frozen=True)
class Problem:
    """What a sensitivity analysis needs to know.

    Attributes
    ----------
    inputs : name of each input and its columns of x; inputs are independent before the cut.
    outputs : one row per output (q,), in words.
    propose : draws (n, d) of x before the cut.
    answer : outputs (n, q) of x (n, d), and whether x lies inside the cut (n,).
    """

    inputs: Mapping[str, tuple[int, ...]]
    outputs: pd.DataFrame
    propose: Callable[[int, Generator], FloatArray]
    answer: Callable[[FloatArray], tuple[FloatArray, BoolArray]]


@dataclass(frozen=True)
class Base:
    """Draws that all pairs of an analysis start from.

    Attributes
    ----------
    x : inside the cut (n, d).
    values : their outputs (n, q).
    accepted : share of proposals inside the cut.
    """

    x: FloatArray
    values: FloatArray
    accepted: float


def draw_base(problem: Problem, n: int, rng: Generator) -> Base:
    """Draw ``n`` sets from the cut law.

    Raises
    ------
    ValueError : ``n`` is below 2, or fewer than one proposal in ``RAREST`` lies inside the cut.
    """
    if n < 2:
        raise ValueError(f"'n' must be at least 2 (got {n})")
    parts: list[tuple[FloatArray, FloatArray]] = []
    found = tried = 0
    while found < n:
        x = problem.propose(n, rng)
        values, inside = problem.answer(x)
        parts.append((x[inside], values[inside]))
        found, tried = found + int(inside.sum()), tried + n
        if tried >= RAREST and found < tried / RAREST:
            raise ValueError(f"the cut must leave more than one draw in {RAREST} (got {found} of {tried})")
    x, values = (np.concatenate(each)[:n] for each in zip(*parts, strict=True))
    return Base(x, values, found / tried)


def partners(problem: Problem, base: Base, shared: BoolArray, rng: Generator) -> FloatArray:
    """Outputs (n, q) of one partner for each base draw, with the columns ``shared`` (d,) in common.

    Partners follow the cut law given what is shared, by rejection. Where the room left is so narrow that
    ``ROUNDS`` batches find none, the row is NaN.
    """
    values = np.full(base.values.shape, np.nan)
    waiting = np.arange(len(base.x))
    for _ in range(ROUNDS):
        if not waiting.size:
            break
        rows = np.repeat(waiting, len(base.x) // len(waiting))  # the fewer are left, the more each tries
        x = problem.propose(len(rows), rng)
        x[:, shared] = base.x[rows][:, shared]
        answers, inside = problem.answer(x)
        found, first = np.unique(rows[inside], return_index=True)
        values[found] = answers[inside][first]
        waiting = np.setdiff1d(waiting, found, assume_unique=True)
    return values


def columns_of(problem: Problem, names: tuple[str, ...], width: int) -> BoolArray:
    """Which columns (width,) of x the inputs ``names`` consist of."""
    mask = np.zeros(width, dtype=np.bool_)
    mask[[column for name in names for column in problem.inputs[name]]] = True
    return mask
