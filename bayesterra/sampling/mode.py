"""The posterior mode, found by optimisation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.posterior import Posterior
from bayesterra.likelihood.target import Target, chart
from bayesterra.parameters import SIZES
from bayesterra.stats.optimiser import descend

STARTS = 8
MOST = 400
"""Steps of a descent: bent valleys take many."""


@dataclass(frozen=True)
class Mode:
    """The most probable parameter set.

    Attributes
    ----------
    x : parameters (d,) in the posterior's order; estimated noise stands at its posterior median, because the
        joint mode of a spread and what spreads is no fair summary of either.
    log_density : log posterior density there.
    agreeing : how many of the optimiser's starts ended within 0.01 of it in log density.
    starts : how many starts there were.
    """

    x: FloatArray
    log_density: float
    agreeing: int
    starts: int


def find_mode(posterior: Posterior, draws: FloatArray, guesses: Sequence[Mapping[str, float]] = ()) -> Mode:
    """Maximise the posterior density of the soil parameters, noise held at its posterior median.

    Parameters
    ----------
    posterior : the density.
    draws : posterior draws (n, d); the densest of them are starting points.
    guesses : further starting points, soil parameters by name.
    """
    soil = np.array([not name.startswith(SIZES) for name in posterior.names])
    held = np.where(soil, draws, np.median(draws, axis=0))
    density = posterior.log_density(held)
    starts = held[np.argsort(-density, kind="stable")[_spaced(len(held))]]
    median = dict(zip(posterior.names, np.median(held, axis=0), strict=True))
    others = [[{**median, **guess}[name] for name in posterior.names] for guess in guesses]
    starts = np.vstack([starts, *others])
    starts = starts[posterior.log_density(starts) > -np.inf]
    target = Target(posterior, chart(posterior, np.vstack([held, starts])), with_prior=True, anchor=None)
    y = descend(target, target.chart.from_physical(starts), np.broadcast_to(~soil, starts.shape), MOST).y
    ends = np.where(soil, target.chart.to_physical(y), starts)
    levels = posterior.log_density(ends)
    best = int(levels.argmax())
    agreeing = int((levels > levels[best] - 0.01).sum())
    return Mode(ends[best], float(levels[best]), agreeing, len(starts))


def densest(posterior: Posterior, draws: FloatArray) -> Mode:
    """The densest of posterior draws (n, d), where no optimiser has an answer."""
    density = posterior.log_density(draws)
    best = int(density.argmax())
    return Mode(draws[best], float(density[best]), 0, 0)


def _spaced(n: int) -> list[int]:
    """Ranks of the starting points: the densest, then ever further down the list."""
    return sorted({min(n - 1, int(n * 0.5 * (i / (STARTS - 1)) ** 2)) for i in range(STARTS)})
