"""The law of a hierarchical parameter: normal about a population mean, cut to the parameter's range."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from scipy.special import log_ndtr, ndtr, ndtri, ndtri_exp

from bayesterra.arrays import BoolArray, FloatArray

Range = tuple[float, float]
FAINTEST = -690.0
"""Log probability below which a score goes no further out; as :meth:`bayesterra.laws.Law.score` has it."""


def log_mass(mean: FloatArray, spread: FloatArray, limits: Range) -> FloatArray:
    """Log probability (any shape) of normal laws inside a range."""
    return _log_between((limits[0] - mean) / spread, (limits[1] - mean) / spread)


def _log_between(low: FloatArray, high: FloatArray) -> FloatArray:
    """Log probability (any shape) of the standard normal law between two points."""
    with np.errstate(invalid="ignore", divide="ignore"):
        flipped = low + high > 0  # the tail with the digits
        low, high = np.where(flipped, -high, low), np.where(flipped, -low, high)
        below, above = log_ndtr(low), log_ndtr(high)
        return np.asarray(above + np.log(-np.expm1(np.minimum(below - above, 0.0))))


def log_population(values: FloatArray, mean: FloatArray, spread: FloatArray, limits: Range) -> FloatArray:
    """Log density of values (any shape) of wheels given mean and spread of their population.

    Normal(mean, spread²) cut to ``limits``, the constant of the cut included; −inf outside them.
    """
    inside = (values >= limits[0]) & (values <= limits[1]) & (spread > 0)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        density = -0.5 * ((values - mean) / spread) ** 2 - np.log(spread) - 0.5 * np.log(2 * np.pi)
        found = density - log_mass(mean, spread, limits)
    return np.where(inside & np.isfinite(found), found, -np.inf)


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
        whole = _log_between(low, high)
        below, above = (
            np.clip(np.nan_to_num(part - whole, nan=-np.inf), FAINTEST, 0.0)
            for part in (_log_between(low, at), _log_between(at, high))
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
