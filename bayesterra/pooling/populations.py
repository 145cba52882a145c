"""The law of a hierarchical parameter: normal about a population mean, cut to the parameter's range."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from scipy.special import log_ndtr, ndtr, ndtri

from bayesterra.arrays import FloatArray

Range = tuple[float, float]


def log_mass(mean: FloatArray, spread: FloatArray, limits: Range) -> FloatArray:
    """Log probability (any shape) of normal laws inside a range."""
    low, high = (limits[0] - mean) / spread, (limits[1] - mean) / spread
    flipped = low + high > 0  # the tail with the digits
    low, high = np.where(flipped, -high, low), np.where(flipped, -low, high)
    with np.errstate(invalid="ignore", divide="ignore"):
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
    low, high = (limits[0] - mean) / spread, (limits[1] - mean) / spread
    flipped = low + high > 0
    below, above = np.where(flipped, -high, low), np.where(flipped, -low, high)
    score = ndtri(ndtr(below) + rng.random(np.shape(mean)) * (ndtr(above) - ndtr(below)))
    return np.asarray(np.clip(mean + spread * np.where(flipped, -score, score), *limits))
