"""A model carried on continuously to where it has no answer, so that a search can come back.

Least squares may try c1, c2 that put θm outside (θ2, θ1), or n0, n1 with N ≤ 0. There the offending row is
modelled with θm/θ1 (or N) at the nearest value inside; the excess is reported.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.likelihood import Forward
from bayesterra.models import Conditions
from bayesterra.parameters import SOIL_PARAMETERS

MARGIN = 1e-6
"""Distance of θm/θ1 from c3 and 1, and of N from 0, at which rows are clipped."""

_N0, _N1, _C1, _C2, _C3 = (SOIL_PARAMETERS.index(name) for name in ("n0", "n1", "c1", "c2", "c3"))


@dataclass(frozen=True)
class Clip:
    """What clipping does to every row.

    Attributes
    ----------
    theta : (m, 9 or 13) parameters with which each row is modelled.
    angle : (m,) how far θm/θ1 lies above (> 0) or below (< 0) its limits.
    exponent : (m,) how far N lies below its limit, ≤ 0.
    """

    theta: FloatArray
    angle: FloatArray
    exponent: FloatArray

    @property
    def any(self) -> bool:
        """Whether some row is modelled with other parameters than asked for."""
        return bool(np.any(self.angle) or np.any(self.exponent))


def clip(theta: FloatArray, slip: FloatArray, margin: float = MARGIN) -> Clip:
    """Parameters inside the model's range for every row; ``theta`` (9,), ``slip`` (m,)."""
    rows = np.repeat(theta[None, :], len(slip), axis=0)
    ratio, exponent = theta[_C1] + theta[_C2] * slip, theta[_N0] + theta[_N1] * slip
    inside = np.clip(ratio, theta[_C3] + margin, 1 - margin)
    positive = np.maximum(exponent, margin)
    rows[inside != ratio, _C1], rows[inside != ratio, _C2] = inside[inside != ratio], 0.0
    rows[positive != exponent, _N0], rows[positive != exponent, _N1] = margin, 0.0
    return Clip(rows, ratio - inside, exponent - positive)


def chain(derivatives: FloatArray, clipped: Clip) -> FloatArray:
    """Derivatives (m, ..., 9) by the parameters asked for, from those by the parameters of each row."""
    out = derivatives.copy()
    out[clipped.angle < 0, ..., _C3] += derivatives[clipped.angle < 0, ..., _C1]
    for column in (_C1, _C2):
        out[clipped.angle != 0, ..., column] = 0.0
    for column in (_N0, _N1):
        out[clipped.exponent != 0, ..., column] = 0.0
    return out


def excess_jacobian(clipped: Clip, slip: FloatArray) -> FloatArray:
    """Derivatives (2 m, 9 or 13) of the excesses: those of the angle, then those of the exponent."""
    width = clipped.theta.shape[1]
    out = np.zeros((2, len(slip), width))
    angle, exponent = (clipped.angle != 0).astype(float), (clipped.exponent != 0).astype(float)
    out[0, :, _C1], out[0, :, _C2], out[0, :, _C3] = angle, angle * slip, -(clipped.angle < 0).astype(float)
    out[1, :, _N0], out[1, :, _N1] = exponent, exponent * slip
    return out.reshape(-1, width)


@dataclass(frozen=True)
class ClippedModel:
    """A model held at its rows, with rows outside its range clipped.

    Parameters
    ----------
    forward : model, drive and conditions.
    """

    forward: Forward

    def values(self, theta: FloatArray) -> FloatArray:
        """Outcomes (m, 3) for parameters (9,); NaN where no sinkage carries the load."""

        def run(part: Forward, row: FloatArray) -> FloatArray:
            outcomes: FloatArray = part(row).values[0]
            return outcomes

        return self._by_group(clip(theta, self.forward.conditions.slip).theta, run, (3,))

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """Exact derivatives (m, 3, 9 or 13) of the outcomes."""

        def run(part: Forward, row: FloatArray) -> FloatArray:
            model = part.model
            step = model.response_jacobian_at if part.drive == "load" else model.jacobian_at
            derivatives: FloatArray = step(row, part.conditions, part.given)[0, :, :, : row.shape[1]]
            return derivatives

        clipped = clip(theta, self.forward.conditions.slip)
        return chain(self._by_group(clipped.theta, run, (3, len(theta))), clipped)

    def _by_group(
        self, rows: FloatArray, run: Callable[[Forward, FloatArray], FloatArray], shape: tuple[int, ...]
    ) -> FloatArray:
        """Run the rows that share parameters together."""
        if np.all(rows == rows[0]):
            return run(self.forward, rows[:1])
        out = np.empty((len(rows), *shape))
        sets, which = np.unique(rows, axis=0, return_inverse=True)
        for i in range(len(sets)):
            mask = which == i
            out[mask] = run(_part(self.forward, mask), sets[i : i + 1])
        return out


def take(conditions: Conditions, mask: BoolArray) -> Conditions:
    """The rows of ``conditions`` in ``mask``."""
    return Conditions(**{field.name: getattr(conditions, field.name)[mask] for field in fields(conditions)})


def _part(forward: Forward, mask: BoolArray) -> Forward:
    return replace(forward, conditions=take(forward.conditions, mask), given=forward.given[mask])
