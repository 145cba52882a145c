"""Readings behind printed errors: six unknown readings per channel, told by 21 errors (16) of Tables 5 to 8.

A printed error of a group is max|F_m − F_p|/max|F_m| over six slips; the predictions F_p are known (M1, Wh31), so each
error says how far the readings F_m lie from one more curve. Misfits of the errors are taken as Laplace with an unknown
scale b, at least half a printed digit: most errors are met to the digit, a few (deep groups) are not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from sensitivity.groups import GROUPS, SECTION_4, Setting, soil_array
from sensitivity.responses import respond

from bayesterra.models import M1, SOIL_FIELDS

FloatArray = NDArray[np.float64]
NAMES = tuple(name for name in GROUPS if name != "G17")
"""All groups but G17, whose printed c1 cannot be right."""
PRINTED: FloatArray = 100 * np.array([GROUPS[name].printed_errors for name in NAMES])
"""Errors (21, 3), percent."""
DIGIT = 0.005
"""Half of the last printed digit, percentage points."""
SCALES = (DIGIT, 5.0)
"""Range of the scale b of the misfits, flat in its logarithm."""
UNITS = np.array([1e3, 1.0, 1.0])
"""mm, N, N m."""
WIDE = 0.3
"""Half width of the flat prior of a reading under every setting: this share of G1's value and of its largest."""


def slips_on_r() -> FloatArray:
    """The slips of Section 3.1 if they are on the radius r, amended to r_s by (3)."""
    wheel = SECTION_4.wheel
    shearing = wheel.radius + 0.75 * wheel.lug_height
    return 1 - wheel.radius / shearing * (1 - SECTION_4.slips)


def predictions(slips: FloatArray | None = None, load: float = 80.0, K: float = 0.012) -> FloatArray:
    """Predicted readings (21, 6, 3) of the groups, mm, N and N m; ``K`` is that of G1."""
    soils = soil_array(GROUPS[name] for name in NAMES)
    column = SOIL_FIELDS.index("K")
    soils[soils[:, column] == soils[0, column], column] = K
    setting = Setting(SECTION_4.wheel, load, SECTION_4.slips if slips is None else slips)
    return respond(M1(), soils, setting).values * UNITS


def errors(readings: FloatArray, predicted: FloatArray) -> FloatArray:
    """Error figure (16), percent, of predictions (g, 6) against readings (n, 6): (n, g)."""
    away = np.abs(readings[:, None, :] - predicted[None]).max(axis=-1)
    return np.asarray(100 * away / np.abs(readings).max(axis=-1, keepdims=True))


@dataclass(frozen=True)
class Recovered:
    """Posterior of six readings.

    Attributes
    ----------
    readings : (n, 6) draws.
    scale : (n,) draws of b, percentage points.
    misfit : (n,) mean absolute misfit of the errors, percentage points.
    log_z : log evidence.
    """

    readings: FloatArray
    scale: FloatArray
    misfit: FloatArray
    log_z: float

    @property
    def best(self) -> FloatArray:
        """The readings (6,) with the smallest misfit."""
        return np.asarray(self.readings[np.argmin(self.misfit)])


def recover(
    predicted: FloatArray, printed: FloatArray, middle: FloatArray, rng: Generator, *, particles: int, sweeps: int = 12
) -> Recovered:
    """Readings of one channel from predictions (g, 6) and errors (g,), by tempering particles from the prior.

    ``middle`` (6,) is the middle of the flat prior of the readings.

    Between temperatures, which are a third of the effective number apart, particles take steps along differences of
    others (differential evolution), so that separate solutions keep their shares.
    """
    reach = WIDE * (np.abs(middle) + np.abs(middle).max())
    low = np.append(middle - reach, np.log(SCALES[0]))
    high = np.append(middle + reach, np.log(SCALES[1]))

    def misfits(x: FloatArray) -> FloatArray:
        return np.asarray(np.abs(errors(x[:, :-1], predicted) - printed).sum(axis=1))

    def log_likelihood(x: FloatArray, total: FloatArray) -> FloatArray:
        return np.asarray(-len(printed) * (x[:, -1] + np.log(2)) - total * np.exp(-x[:, -1]))

    x = rng.uniform(low, high, (particles, len(low)))
    total = misfits(x)
    level, log_z = 0.0, 0.0
    while level < 1:
        value = log_likelihood(x, total)
        step = _next(value, 1 - level)
        weight = step * (value - value.max())
        log_z += float(step * value.max() + np.log(np.mean(np.exp(weight))))
        level += step
        kept = rng.choice(particles, particles, p=np.exp(weight) / np.exp(weight).sum())
        x, total = x[kept], total[kept]
        for sweep in range(sweeps if level < 1 else 15 * sweeps):
            one, other = (rng.permutation(particles) for _ in range(2))
            gain = 1.0 if sweep % 6 == 5 else rng.uniform(0.1, 0.9)
            moved = x + gain * (x[one] - x[other]) + 1e-4 * (high - low) * rng.standard_normal(x.shape)
            inside = ((moved > low) & (moved < high)).all(axis=1)
            moved = np.where(inside[:, None], moved, x)
            after = misfits(moved)
            ahead = level * (log_likelihood(moved, after) - log_likelihood(x, total))
            taken = inside & (np.log(rng.random(particles)) < ahead)
            x, total = np.where(taken[:, None], moved, x), np.where(taken, after, total)
    return Recovered(x[:, :-1], np.exp(x[:, -1]), total / len(printed), log_z)


def _next(value: FloatArray, most: float) -> float:
    """The rise of temperature that leaves half of the effective number."""
    low, high = 0.0, most
    for _ in range(60):
        middle = 0.5 * (low + high)
        weight = np.exp(middle * (value - value.max()))
        few = weight.sum() ** 2 / (weight**2).sum() < 0.5 * len(value)
        low, high = (low, middle) if few else (middle, high)
    return most if high == most else low
