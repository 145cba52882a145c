"""Populations: normal laws cut to a range, one mean and spread for each value."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from scipy.special import ndtr, ndtri, ndtri_exp

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.stats.tails import GAUSSIAN

Range = tuple[float, float]
FAINTEST = -690.0
"""Log probability below which a score goes no further out, as in :meth:`bayesterra.stats.laws.Law.score`."""


def log_mass(mean: FloatArray, spread: FloatArray, limits: Range) -> FloatArray:
    """Log probability (any shape) of normal laws inside a range."""
    return GAUSSIAN.log_mass((limits[0] - mean) / spread, (limits[1] - mean) / spread)


def log_population(values: FloatArray, mean: FloatArray, spread: FloatArray, limits: Range) -> FloatArray:
    """Log density of values (any shape) of wheels given mean and spread of their population.

    Normal(mean, spread²) cut to ``limits``, the constant of the cut included; −inf outside them.
    """
    inside = (values >= limits[0]) & (values <= limits[1]) & (spread > 0)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        density = -0.5 * ((values - mean) / spread) ** 2 - np.log(spread) - 0.5 * np.log(2 * np.pi)
        log_density = density - log_mass(mean, spread, limits)
    return np.where(inside & np.isfinite(log_density), log_density, -np.inf)


def draw_population(mean: FloatArray, spread: FloatArray, limits: Range, rng: Generator) -> FloatArray:
    """One value of every population, the shape of ``mean``."""
    return _within(rng.random(np.shape(mean)), _ends(mean, spread, limits), mean, spread, limits)


def population_value(score: FloatArray, mean: FloatArray, spread: FloatArray, limits: Range) -> FloatArray:
    """Values at normal scores (any shape) of the laws of populations, the inverse of their score."""
    ends = _ends(mean, spread, limits)
    return _within(ndtr(np.where(ends[2], -score, score)), ends, mean, spread, limits)


def population_score(values: FloatArray, mean: FloatArray, spread: FloatArray, limits: Range) -> FloatArray:
    """Normal scores (any shape) of values inside the limits under the laws of their populations."""
    with np.errstate(over="ignore", invalid="ignore"):  # spreads of next to nothing, ranges without mass
        low, at, high = ((edge - mean) / spread for edge in (limits[0], values, limits[1]))
        whole = GAUSSIAN.log_mass(low, high)
        below, above = (
            np.clip(np.nan_to_num(part - whole, nan=-np.inf), FAINTEST, 0.0)
            for part in (GAUSSIAN.log_mass(low, at), GAUSSIAN.log_mass(at, high))
        )
    return np.asarray(np.where(below < above, ndtri_exp(below), -ndtri_exp(above)))


def _ends(mean: FloatArray, spread: FloatArray, limits: Range) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Standardised limits, and whether digits are kept in the upper tail."""
    with np.errstate(invalid="ignore"):  # limits at both infinities
        low, high = (limits[0] - mean) / spread, (limits[1] - mean) / spread
        return low, high, np.asarray(low + high > 0)


def _within(
    q: FloatArray,
    ends: tuple[FloatArray, FloatArray, BoolArray],
    mean: FloatArray,
    spread: FloatArray,
    limits: Range,
) -> FloatArray:
    """Values between which and the end of the range with the digits a share ``q`` of a population lies."""
    low, high, flipped = ends
    below, above = np.where(flipped, -high, low), np.where(flipped, -low, high)
    score = ndtri(ndtr(below) + q * (ndtr(above) - ndtr(below)))
    return np.asarray(np.clip(mean + spread * np.where(flipped, -score, score), *limits))
