"""The likelihood of a row with a latent load the slow way: load drive at many loads, adaptive quadrature."""

from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
from scipy.special import logsumexp

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.forward import Forward
from bayesterra.likelihood.likelihood import LatentLoad, Likelihood
from bayesterra.models import Conditions
from bayesterra.study.drive import Drive

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


class AtLoads(Likelihood):
    """Rows whose loads are tried; rounding widens their noise, as it does that of rows with latent loads."""

    together: ClassVar[bool] = True


def log_integrand(whole: LatentLoad, soil: FloatArray, noise: FloatArray, row: int, loads: FloatArray) -> FloatArray:
    """Log density of a row's readings at loads (k,) for one soil; −inf where the model has no answer."""
    forward, k = whole.forward.row(row), len(loads)
    names = ("slip", "radius", "width", "lug_height", "shearing_radius")
    many = Conditions(*(np.repeat(getattr(forward.conditions, name), k) for name in names))
    held = Forward(forward.model, Drive.BOTH, many, loads, as_read=True)
    outcomes = held(soil, every_row=True)
    rows = whole.observations.take(np.arange(len(whole.observations)) == row)
    rows = replace(
        rows,
        values={name: np.repeat(column, k) for name, column in rows.values.items()},
        given_sd={name: np.repeat(column, k) for name, column in rows.given_sd.items()},
        limits={name: np.repeat(ends, k, axis=0) for name, ends in rows.limits.items()},
    )
    density = AtLoads(held, rows, whole.noise).pointwise(outcomes, noise)
    return np.where(np.isfinite(outcomes["sinkage"][0]), density[0].sum(axis=1), -np.inf)


def row_log_likelihood(whole: LatentLoad, soil: FloatArray, noise: FloatArray, row: int) -> float:
    """Log likelihood of a row, to about 1e-6: intervals of the load are halved until that changes nothing."""
    low, high = whole.load_range
    carried = _highest_carried(whole, soil, noise, row)
    if not carried > low:
        return -np.inf
    edges = np.linspace(low, carried, 65)
    todo, done = np.column_stack([edges[:-1], edges[1:]]), [-np.inf]
    for _ in range(60):
        coarse, fine = _interval(whole, soil, noise, row, todo)
        total = logsumexp([*done, *fine])
        with np.errstate(invalid="ignore", over="ignore"):
            settled = np.abs(np.exp(coarse - total) - np.exp(fine - total)) < 1e-8
        settled |= todo[:, 1] - todo[:, 0] < 1e-10 * high  # the load drive solves for the sinkage to that
        done.extend(fine[settled].tolist())
        rest = todo[~settled]
        if not len(rest):
            break
        middle = rest.mean(axis=1)
        todo = np.vstack([np.column_stack([rest[:, 0], middle]), np.column_stack([middle, rest[:, 1]])])
    return float(logsumexp(done) - np.log(high - low))


def _highest_carried(whole: LatentLoad, soil: FloatArray, noise: FloatArray, row: int) -> float:
    """Highest load of the range that the model carries, by cutting it into many parts again and again."""
    low, high = whole.load_range
    ends = log_integrand(whole, soil, noise, row, np.array([low, high]))
    if np.isfinite(ends[1]) or np.isneginf(ends[0]):
        return high if np.isfinite(ends[1]) else low
    while high - low > 1e-15 * high:
        loads = np.linspace(low, high, 34)
        answered = np.isfinite(log_integrand(whole, soil, noise, row, loads[1:-1]))
        last = len(answered) if answered.all() else int(np.argmin(answered))
        if (loads[last], loads[last + 1]) == (low, high):
            break
        low, high = float(loads[last]), float(loads[last + 1])
    return low


def _interval(
    whole: LatentLoad, soil: FloatArray, noise: FloatArray, row: int, todo: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Log integrals over intervals (k, 2), by 12 nodes and by 24."""
    halves = []
    middle = todo.mean(axis=1)
    for low, high in ((todo[:, 0], todo[:, 1]), (todo[:, 0], middle), (middle, todo[:, 1])):
        half = 0.5 * (high - low)[:, None]
        loads = 0.5 * (high + low)[:, None] + half * _NODES
        level = log_integrand(whole, soil, noise, row, loads.ravel()).reshape(loads.shape)
        halves.append(logsumexp(level, b=half * _WEIGHTS, axis=1))
    return halves[0], np.logaddexp(halves[1], halves[2])


RowLevel = Callable[[LatentLoad, FloatArray, FloatArray, int], float]
Integrand = Callable[[LatentLoad, FloatArray, FloatArray, int, FloatArray], FloatArray]


@pytest.fixture(scope="session")
def brute_force() -> RowLevel:
    """Log likelihood of a row the slow way."""
    return row_log_likelihood


@pytest.fixture(scope="session")
def integrand() -> Integrand:
    """Log density of a row's readings at given loads."""
    return log_integrand
