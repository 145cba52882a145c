"""One row taken in: weights, and where they would degenerate, steps on the way with moves in between."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from scipy.optimize import brentq

from bayesterra.arrays import FloatArray
from bayesterra.errors import SupportError
from bayesterra.streaming.cloud import Cloud, effective_number
from bayesterra.streaming.moves import Levels, Rejuvenation, rejuvenate

KEEP = 0.5
"""Effective share of the particles below which they are resampled and moved."""
FLOOR = 0.2
"""Share that a row may leave at once; where it would leave less, it is taken in by steps."""
STEP_KEEP = 0.4
"""Share of the effective particles that such a step leaves."""


@dataclass(frozen=True)
class Learned:
    """A cloud after one more row.

    Attributes
    ----------
    cloud : particles of the posterior of all rows.
    log_predictive : log density of the row's readings given the earlier rows; all constants included.
    variance : Monte Carlo variance of the log evidence that the resamplings of this row settled.
    rejuvenations : one for every resampling.
    """

    cloud: Cloud
    log_predictive: float
    variance: float
    rejuvenations: tuple[Rejuvenation, ...]


def learn(
    cloud: Cloud, levels: Callable[[], Levels], newest: FloatArray, before: FloatArray, rng: Generator
) -> Learned:
    """Take a row into a cloud (iterated batch importance sampling, Chopin 2002, with tempering).

    Parameters
    ----------
    cloud : of the earlier rows.
    levels : makes the densities of all rows, which are needed only where particles have to move.
    newest : log likelihood (n,) of the row for the particles of the cloud.
    before : draws of the prior (k, d).

    Raises
    ------
    SupportError : the row has no density for any particle.
    """
    n, done, total, variance = len(cloud), 0.0, 0.0, 0.0
    events: list[Rejuvenation] = []
    if not (newest > -np.inf).any():
        raise SupportError("the model has no answer in this row for any soil that the earlier rows leave")
    while True:
        step = _step(cloud.log_weights, newest, 1.0 - done)
        done = 1.0 if step >= 1.0 - done else done + step
        cloud, gained = cloud.weighed(step * newest)
        total += gained
        if done == 1.0 and cloud.effective >= KEEP * n:
            break
        variance += settled(cloud)
        cloud, newest, event = rejuvenate(cloud, levels(), done, before, rng)
        events.append(event)
        if done == 1.0:
            break
    cloud = replace(cloud, log_likelihood=cloud.log_likelihood + newest)
    return Learned(cloud, total, variance, tuple(events))


def settled(cloud: Cloud) -> float:
    """Monte Carlo variance of the log mean of the weights that particles have come to hold."""
    return 1.0 / cloud.effective - 1.0 / len(cloud)


def _step(log_weights: FloatArray, newest: FloatArray, rest: float) -> float:
    """Power of the row's likelihood to take in next: the rest of it, if enough particles are left."""
    if effective_number(log_weights + rest * newest) >= FLOOR * len(log_weights):
        return rest
    alive = newest > -np.inf
    log_weights, newest = log_weights[alive], newest[alive]
    wanted = STEP_KEEP * effective_number(log_weights)

    def excess(step: float) -> float:
        return effective_number(log_weights + step * newest) - wanted

    if excess(rest) >= 0:
        return rest
    return float(brentq(excess, 0.0, rest, xtol=1e-300, rtol=1e-6, maxiter=1000))
