"""Integral of a row's likelihood over its latent load by NumPy, for models that are not compiled.

Over log sinkage between the ends of the loads' range the integrand is looked at on a grid, which is laid anew
where the weight is until it is well resolved; there it is summed over dW by Gauss's rule in panels. A peak much
narrower than a cell of the first grid counts where its neighbours show it.
"""

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.forward import Forward
from bayesterra.models.forces import NORMAL_FORCE, SINKAGE
from bayesterra.study.drive import Drive

PLACES, ZOOMS = 65, 6
"""Places of a grid, and grids at most."""
DEPTH = 16.0
"""Depth below the highest level, in logs, beyond which there is no weight."""
PANELS, GAUSS = 16, 6
"""Panels of the sum, and nodes of each."""
_X, _W = np.polynomial.legendre.leggauss(GAUSS)
_NODES = 0.5 * (1 + _X)
_WEIGHTS = np.tile(0.5 * _W, PANELS)
_POWERS = np.vander(_X, increasing=True)
_SLOPES = 2 * np.linalg.solve(_POWERS.T, np.column_stack([np.zeros(GAUSS), _POWERS[:, :-1] * np.arange(1, GAUSS)]).T).T
"""Matrix that takes values at the nodes of a panel to derivatives by its share."""
_DEEPEST = 1.0 - 1e-9  # share of the radius

Levels = Callable[[FloatArray], FloatArray]
"""Log density (n, m) of every row's readings at what the model says there, (n, m, 4)."""


def log_rows(
    forward: Forward, soil: FloatArray, ends: tuple[float, float], levels: Levels, rng: Generator | None
) -> FloatArray:
    """Log likelihood of every row, and a load drawn if there is a source of chance, (n, m, 2).

    Parameters
    ----------
    forward : the model at the rows, loads unknown.
    soil : soil arrays (n, p).
    ends : range (N) of the flat law of the load.
    levels : log density of the readings, given true outcomes.
    """
    held = Forward(forward.model, Drive.LOAD, forward.conditions, forward.given)
    shape = (len(soil), len(forward.given))
    depths = []
    for end in ends:
        depth = held.at_load(end)(soil, every_row=True)["sinkage"]
        depths.append(np.where(np.isnan(depth), _DEEPEST * forward.conditions.radius, depth))
    low, high = np.log(depths[0]), np.log(depths[1])
    answered = held.at_load(ends[0])(soil, every_row=True)["sinkage"] > 0
    for _ in range(ZOOMS):
        log_depth = low + np.linspace(0.0, 1.0, PLACES)[:, None, None] * (high - low)
        values, level = _at(forward, soil, log_depth, levels)
        bar = level.max(axis=0) - DEPTH
        weighty = level >= bar
        first, last = weighty.argmax(axis=0), PLACES - 1 - weighty[::-1].argmax(axis=0)
        if (last - first > PLACES // 2).all():
            break
        low = np.take_along_axis(log_depth, np.maximum(first - 1, 0)[None], 0)[0]
        high = np.take_along_axis(log_depth, np.minimum(last + 1, PLACES - 1)[None], 0)[0]
    panels = _panels(log_depth, values[..., NORMAL_FORCE], level)
    nodes = (panels[:-1, None] + _NODES[:, None, None] * np.diff(panels, axis=0)[:, None]).reshape(-1, *shape)
    values, level = _at(forward, soil, nodes, levels)
    growth = np.einsum("ij,kj...->ki...", _SLOPES, values[..., NORMAL_FORCE].reshape(PANELS, GAUSS, *shape))
    level = level + np.log(np.maximum(growth.reshape(level.shape), 1e-300) * _WEIGHTS[:, None, None])
    top = level.max(axis=0)
    with np.errstate(invalid="ignore"):
        pieces = np.nan_to_num(np.exp(level - np.where(np.isfinite(top), top, 0.0)))
    total = pieces.sum(axis=0)
    out = np.full((*shape, 2), np.nan)
    with np.errstate(divide="ignore"):
        out[..., 0] = np.where(answered & (total > 0), top + np.log(total) - np.log(ends[1] - ends[0]), -np.inf)
    if rng is not None:
        load = values[..., NORMAL_FORCE]
        edges = np.concatenate([load[:1], 0.5 * (load[1:] + load[:-1]), load[-1:]])
        drawn = _quantile(edges, pieces, rng.random(shape))
        out[..., 1] = np.where(np.isfinite(out[..., 0]), np.clip(drawn, *ends), np.nan)
    return out


def _at(forward: Forward, soil: FloatArray, log_depth: FloatArray, levels: Levels) -> tuple[FloatArray, FloatArray]:
    """Forces (places, n, m, 3) and levels (places, n, m) at log sinkages (places, n, m)."""
    values, level = np.empty((*log_depth.shape, 3)), np.empty(log_depth.shape)
    for k, depth in enumerate(np.exp(log_depth)):
        values[k] = Forward(forward.model, Drive.SINKAGE, forward.conditions, depth)(soil, every_row=True).values
        found = levels(np.insert(values[k], SINKAGE, depth, axis=2))
        level[k] = np.where(np.isnan(found), -np.inf, found)
    return values, level


def _panels(log_depth: FloatArray, load: FloatArray, level: FloatArray) -> FloatArray:
    """Ends (panels + 1, n, m) of panels that halve between even ones and ones of even weight."""
    top = level.max(axis=0)
    with np.errstate(invalid="ignore"):
        density = np.exp(level - np.where(np.isfinite(top), top, 0.0))
        masses = np.nan_to_num(0.5 * (density[1:] + density[:-1]) * np.maximum(np.diff(load, axis=0), 0.0))
        total = masses.sum(axis=0)
    masses = 1.0 / len(masses) + np.where(total > 0, masses / np.where(total > 0, total, 1.0), 0.0)
    shares = np.linspace(0.0, 1.0, PANELS + 1)
    ends = [_quantile(log_depth, masses, np.full(total.shape, share)) for share in shares[1:-1]]
    return np.stack([log_depth[0], *ends, log_depth[-1]])


def _quantile(edges: FloatArray, masses: FloatArray, shares: FloatArray) -> FloatArray:
    """Places (n, m) below which ``shares`` of the masses (k, n, m) lie, each spread evenly between its edges."""
    below = np.cumsum(masses, axis=0)
    below /= np.where(below[-1] > 0, below[-1], 1.0)
    k = np.minimum((below < shares).sum(axis=0), len(masses) - 1)[None]
    before = np.where(k > 0, np.take_along_axis(below, np.maximum(k - 1, 0), 0), 0.0)[0]
    share = (shares - before) / np.maximum(np.take_along_axis(below, k, 0)[0] - before, 1e-300)
    left, right = np.take_along_axis(edges, k, 0)[0], np.take_along_axis(edges, k + 1, 0)[0]
    return np.asarray(left + np.clip(share, 0.0, 1.0) * (right - left))
