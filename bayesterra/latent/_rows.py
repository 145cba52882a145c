"""Compiled loops over parameter sets and rows."""

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.latent import _levels as lv
from bayesterra.latent import _panels as pn
from bayesterra.latent import _sums as sums
from bayesterra.models import kernels as at
from bayesterra.models.kernels import Codes, Lanes, Plan, compiled, inlined

_SIGMAS = 7.0  # half-width of the first panel, in standard deviations of a reading
_UNSURE = 0.2  # of the guess at the log z that carries a load
_NARROWEST, _WIDEST = 0.02, 2.0


Data = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""Readings and their laws, channels in the order of the outcomes: readings (m, 4), NaN where there is none;
smallest scale of the noise, and log density there at its centre, (n, m, 4, 2) or (1, m, 4, 2); the scale as a
fraction (m, 4) of the modelled value; degrees of freedom (4,); zero error (n,) of the sinkage; log of the
range (2,) of the load."""


@compiled
def likelihoods(
    theta: FloatArray, rows: FloatArray, data: Data, plan: Plan, out: FloatArray, status: Codes
) -> None:
    """Fill `out` (n, m, 2): log likelihood of every row, and a drawn load in place of a uniform number."""
    at.screen(theta, rows, plan, status)
    desk = np.zeros(lv.DESK_SIZE)
    loads = data[5]
    width = loads[1] + np.log1p(-np.exp(loads[0] - loads[1]))
    for i in range(status.shape[0]):
        for j in range(status.shape[1]):
            draw = out[i, j, 1] >= 0.0
            if status[i, j] != 0:
                out[i, j, 0], out[i, j, 1] = -np.inf, np.nan
                continue
            at.lay(desk, theta[i], rows[j])
            _specify(desk, data, i, j)
            desk[pn.UNIFORM] = out[i, j, 1]
            falls = at.can_fall(desk, 0, plan[0])
            left, right = _first_panel(desk, loads)
            level = sums.log_integral(desk, plan[0], falls, left, right) - width
            out[i, j, 0] = level if level < np.inf else -np.inf
            if draw:
                out[i, j, 1] = sums.drawn_load(desk) if level > -np.inf else np.nan


@compiled
def _specify(desk: Lanes, data: Data, i: int, j: int) -> None:
    """Put the readings of a row and their laws onto the desk."""
    readings, floor, fraction, dof, shift, loads = data
    own = i if floor.shape[0] > 1 else 0
    for channel in range(lv.CHANNELS):
        first = lv.SPEC + channel * lv.COLUMNS
        desk[first + lv.READING] = readings[j, channel]
        desk[first + lv.FLOOR], desk[first + lv.PEAK] = floor[own, j, channel, 0], floor[own, j, channel, 1]
        desk[first + lv.FRACTION] = fraction[j, channel]
        desk[first + lv.DOF] = dof[channel]
        desk[first + lv.SHIFT] = shift[i] if channel == lv.SINKAGE else 0.0
    desk[pn.LOAD_LOW], desk[pn.LOAD_HIGH] = loads[0], loads[1]
    desk[pn.TOP] = at.highest(desk)


@compiled
def _first_panel(desk: Lanes, loads: FloatArray) -> tuple[float, float]:
    """Guess the ends of the weight in log z from what sinkage and force say; the search corrects it."""
    force, around = lv.spec(desk, lv.NORMAL, lv.READING), _SIGMAS * _scale(desk, lv.NORMAL)
    low, high = np.exp(loads[0]), np.exp(loads[1])
    least, most = max(low, force - around), min(high, force + around)
    if not least < most:  # not read, or far outside the range
        least, most = low, high
    middle, slope = at.guess(desk, np.sqrt(least * most))
    half = 0.5 * np.log(most / least) / slope + _UNSURE
    left, right = middle - half, middle + half
    depth = lv.spec(desk, lv.SINKAGE, lv.READING) - lv.spec(desk, lv.SINKAGE, lv.SHIFT)
    around = _SIGMAS * _scale(desk, lv.SINKAGE)
    shallow = np.log(depth - around) if depth > around else left
    deep = np.log(depth + around) if depth > -around else right
    if max(left, shallow) < min(right, deep):
        left, right = max(left, shallow), min(right, deep)
    right = min(right, desk[pn.TOP])
    return max(min(left, right - _NARROWEST), right - _WIDEST), right


@inlined
def _scale(desk: Lanes, channel: int) -> float:
    """Scale of the noise of a reading, about."""
    size = abs(lv.spec(desk, channel, lv.READING))
    return max(lv.spec(desk, channel, lv.FRACTION) * size, lv.spec(desk, channel, lv.FLOOR))
