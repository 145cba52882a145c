"""Readings of every draw and how probable each is under every other draw; what a gain is computed from."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from numpy.random import Generator
from scipy.special import ndtri
from scipy.stats import rankdata

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.design.readings import Reading, standard_noise

BLOCK = 500
BANDWIDTH = 2.0
"""Width of the kernel in units of n^(−1/(s + 4)); wide, as a regression takes out what varies inside it."""


@dataclass(frozen=True)
class Interest:
    """Draws of all parameters, and which of them are asked about.

    Attributes
    ----------
    draws : (n, d).
    columns : those of the s parameters of interest.
    """

    draws: FloatArray
    columns: tuple[int, ...]

    def __getstate__(self) -> dict[str, Any]:
        """Without what can be computed again, which is large."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def whole(self) -> bool:
        """Whether all parameters are of interest."""
        return len(self.columns) == int(self.draws.shape[1])

    @property
    def values(self) -> FloatArray:
        """Draws (n, s) of the parameters of interest."""
        return self.draws[:, self.columns]

    @cached_property
    def scores(self) -> FloatArray:
        """Normal scores (n, d) of all parameters."""
        return np.asarray(ndtri((rankdata(self.draws, axis=0) - 0.5) / len(self.draws)))

    @cached_property
    def log_kernel(self) -> FloatArray:
        """Log weights (n, n) of draws by their distance in the scores of interest, own weight one."""
        z = self.scores[:, self.columns]
        factor = np.linalg.cholesky(np.atleast_2d(np.cov(z.T)) + 1e-12 * np.eye(z.shape[1]))
        z = np.linalg.solve(factor, z.T).T / (BANDWIDTH * len(z) ** (-1 / (z.shape[1] + 4)))
        size = (z**2).sum(axis=1)
        return np.asarray(np.minimum(z @ z.T - 0.5 * (size[:, None] + size[None, :]), 0.0))

    @cached_property
    def terms(self) -> FloatArray:
        """Terms (n, q) of a quadratic in the scores of interest."""
        z = self.scores[:, self.columns]
        products = [z[:, a] * z[:, b] for a, b in combinations_with_replacement(range(z.shape[1]), 2)]
        return np.column_stack([np.ones(len(z)), z, *products])


@dataclass(frozen=True)
class Pairs:
    """What readings say, pair by pair.

    Attributes
    ----------
    log : (n, n) log density of the readings that draw i makes, under draw j.
    given : the same under draw j moved to the parameters of interest of draw i; None where these are all.
    answered : draws (n,) for which the model has an answer; the others have no part.
    readings : those readings (n, k).
    """

    log: FloatArray
    given: FloatArray | None
    answered: BoolArray
    readings: FloatArray

    def __add__(self, other: Pairs) -> Pairs:
        """Readings of both, which are independent given the parameters."""
        given = None if self.given is None or other.given is None else self.given + other.given
        both = np.column_stack([self.readings, other.readings])
        return Pairs(self.log + other.log, given, self.answered & other.answered, both)


def pairs(readings: tuple[Reading, ...], interest: Interest, rng: Generator) -> Pairs:
    """Draw the readings of every draw, row by row, and compute their densities under all draws."""
    first, *others = (_row(one, interest, rng) for one in readings)
    return sum(others, first)


def _row(reading: Reading, interest: Interest, rng: Generator) -> Pairs:
    drawn = reading.draw(standard_noise(reading, rng))
    log = _densities(reading, drawn)
    if interest.whole:
        return Pairs(log, None, reading.answered, drawn)
    middle = _regressed(reading, interest.terms)
    rest = Reading(reading.mean - middle, reading.whitening, reading.noise)
    return Pairs(log, _densities(rest, drawn - middle), reading.answered, drawn)


def _regressed(reading: Reading, terms: FloatArray) -> FloatArray:
    """Means (n, k) as a quadratic in the parameters of interest explains them."""
    known = reading.answered
    if known.sum() <= terms.shape[1]:
        return np.zeros(reading.mean.shape)
    weights = np.linalg.lstsq(terms[known], reading.mean[known], rcond=None)[0]
    return np.asarray(terms @ weights)


def _densities(reading: Reading, drawn: FloatArray) -> FloatArray:
    """Log densities (n, n) of readings (n, k), a block of them at a time."""
    blocks = range(0, len(drawn), BLOCK)
    return np.concatenate([reading.log_density(drawn[start : start + BLOCK]) for start in blocks])
