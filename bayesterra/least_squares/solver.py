"""Bounded least squares over some soil parameters, with the model carried on where it has no answer.

Least squares may try c1, c2 that put θm outside (θ2, θ1), or n0, n1 with N ≤ 0. There the offending row is
modelled with θm/θ1 (or N) at the nearest value inside; the excess is reported.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.forward import Forward, take
from bayesterra.models.decoupled import MARGIN, leaving, ratio
from bayesterra.parameters import SOIL_PARAMETERS

TOLERANCE = 1e-14
MAX_EVALUATIONS = 1000
COMPLEX_STEP = 1e-60
_N0, _N1, _C1, _C2, _C3 = (SOIL_PARAMETERS.index(name) for name in ("n0", "n1", "c1", "c2", "c3"))


def of_the_paper(names: Sequence[str]) -> bool:
    """True for parameters that begin with those of Ding et al. 2015, as those of its models do."""
    return tuple(names[: len(SOIL_PARAMETERS)]) == SOIL_PARAMETERS


class Curve(Protocol):
    """Values (k,) that depend on soil parameters (p,), with exact derivatives (k, p)."""

    def values(self, theta: FloatArray) -> FloatArray:
        """Values (k,); non-finite where the model has no answer."""

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """Derivatives (k, p) of the values."""


@dataclass(frozen=True)
class Formula:
    """A curve from a formula that also takes complex parameters; its derivatives are complex steps."""

    formula: Callable[[NDArray[np.complex128]], NDArray[np.complex128]]

    def values(self, theta: FloatArray) -> FloatArray:
        """Values (k,)."""
        return np.real(self.formula(theta.astype(complex)))

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """Derivatives (k, p), exact to rounding: nothing is subtracted in a complex step."""
        steps = theta + 1j * COMPLEX_STEP * np.eye(len(theta))
        return np.column_stack([np.imag(self.formula(step)) / COMPLEX_STEP for step in steps])


@dataclass(frozen=True)
class Box:
    """Range of a search: bounds on coordinates x, with parameters (p,) = ``basis`` @ x."""

    lower: FloatArray  # bounds (p,) of the coordinates
    upper: FloatArray  # likewise
    columns: list[int]  # the coordinates that are free; the others stay as at the start
    basis: FloatArray | None = None  # (p, p), None where the coordinates are the parameters

    def coordinates(self, theta: FloatArray) -> FloatArray:
        """Coordinates (p,) of parameters (p,), the free ones moved inside the bounds."""
        x = theta.copy() if self.basis is None else np.linalg.inv(self.basis) @ theta
        x[self.columns] = np.clip(x, self.lower, self.upper)[self.columns]
        return x

    def parameters(self, x: FloatArray) -> FloatArray:
        """Parameters (p,) of coordinates (p,)."""
        return x if self.basis is None else self.basis @ x

    def slopes(self, derivatives: FloatArray) -> FloatArray:
        """Derivatives (k, free) by the free coordinates, from those by the parameters (k, p)."""
        return (derivatives if self.basis is None else derivatives @ self.basis)[:, self.columns]


@dataclass(frozen=True)
class Minimum:
    """Parameters (p,) at the end, half the sum of squares there, whether a stopping rule was met, and evaluations."""

    theta: FloatArray
    cost: float
    converged: bool
    evaluations: int = 0


def minimise(
    residual: Curve, start: FloatArray, box: Box, *, tolerance: float = TOLERANCE, evaluations: int = MAX_EVALUATIONS
) -> Minimum:
    """Minimise the sum of squares of ``residual`` over the free coordinates of ``box``, from ``start`` (p,).

    Trust-region reflective, variables scaled by the width of their bounds. A trial step to where the
    residual is not finite is refused and the trust region shrinks; only the start must have an answer.
    """
    origin, columns = box.coordinates(start), box.columns
    if not columns:
        return Minimum(start, 0.5 * float(np.sum(residual.values(start) ** 2)), converged=True)

    def parameters(free: FloatArray) -> FloatArray:
        x = origin.copy()
        x[columns] = free
        return box.parameters(x)

    def values(free: FloatArray) -> FloatArray:
        return residual.values(parameters(free))

    def jacobian(free: FloatArray) -> FloatArray:
        return box.slopes(residual.jacobian(parameters(free)))

    lower, upper = box.lower[columns], box.upper[columns]
    first, width = origin[columns], upper - lower
    # the size of a value, or 1, where its bounds are open
    width = np.where(np.isfinite(width) & (width > 0), width, np.where(first == 0, 1.0, np.abs(first)))
    result = least_squares(
        values, first, jac=jacobian, bounds=(lower, upper), x_scale=width, ftol=tolerance, xtol=tolerance,
        gtol=tolerance, max_nfev=evaluations,
    )  # fmt: skip
    # values go on the bound that they have converged to; the search itself stays strictly inside
    near = 1e-10 * np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    x = np.where(result.x < lower + near, lower, np.where(result.x > upper - near, upper, result.x))
    return Minimum(parameters(x), float(result.cost), bool(result.status > 0), int(result.nfev))


@dataclass(frozen=True)
class Clip:
    """Effect of clipping on every row."""

    theta: FloatArray  # (m, k) parameters with which each row is modelled
    angle: FloatArray  # (m,) how far θm/θ1 lies above (> 0) or below (< 0) its limits
    exponent: FloatArray  # (m,) how far N lies below its limit, ≤ 0

    @property
    def any(self) -> bool:
        """True where some row is modelled with other parameters than asked for."""
        return bool(np.any(self.angle) or np.any(self.exponent))


def clip(
    theta: FloatArray, slip: FloatArray, margin: float = MARGIN, *, names: Sequence[str] = SOIL_PARAMETERS
) -> Clip:
    """Parameters (p,) inside the range of a model of Ding et al. 2015 for every row (m,); as they are for others."""
    rows = np.repeat(theta[None, :], len(slip), axis=0)
    if not of_the_paper(names):
        return Clip(rows, np.zeros_like(slip), np.zeros_like(slip))
    middle, exponent = ratio(theta, slip), theta[_N0] + theta[_N1] * slip
    inside = np.clip(middle, leaving(theta, slip) + margin, 1 - margin)
    positive = np.maximum(exponent, margin)
    rows[inside != middle, _C1], rows[inside != middle, _C2] = inside[inside != middle], 0.0
    rows[positive != exponent, _N0], rows[positive != exponent, _N1] = margin, 0.0
    return Clip(rows, middle - inside, exponent - positive)


def chain(derivatives: FloatArray, clipped: Clip) -> FloatArray:
    """Derivatives (m, ..., p) by the parameters asked for, from those by the parameters of each row."""
    if not clipped.any:
        return derivatives
    out = derivatives.copy()
    out[clipped.angle < 0, ..., _C3] += derivatives[clipped.angle < 0, ..., _C1]
    for column in (_C1, _C2):
        out[clipped.angle != 0, ..., column] = 0.0
    for column in (_N0, _N1):
        out[clipped.exponent != 0, ..., column] = 0.0
    return out


def excess_jacobian(clipped: Clip, slip: FloatArray) -> FloatArray:
    """Derivatives (2 m, k) of the excesses: those of the angle, then those of the exponent."""
    width = clipped.theta.shape[1]
    out = np.zeros((2, len(slip), width))
    if not clipped.any:
        return out.reshape(-1, width)
    angle, exponent = (clipped.angle != 0).astype(float), (clipped.exponent != 0).astype(float)
    out[0, :, _C1], out[0, :, _C2], out[0, :, _C3] = angle, angle * slip, -(clipped.angle < 0).astype(float)
    out[1, :, _N0], out[1, :, _N1] = exponent, exponent * slip
    return out.reshape(-1, width)


_Run = Callable[[Forward, FloatArray], FloatArray]


@dataclass(frozen=True)
class ClippedModel:
    """A model held at its rows, with rows outside its range clipped.

    Parameters
    ----------
    forward : model, drive and conditions.
    """

    forward: Forward

    def values(self, theta: FloatArray) -> FloatArray:
        """Outcomes (m, 3) for parameters (p,); NaN where no sinkage carries the load."""

        def run(part: Forward, row: FloatArray) -> FloatArray:
            return np.asarray(part.answers(row, part.conditions, part.given)[0][0])

        return self._by_group(theta, self._clipped(theta).theta, run, (self.forward.width,))

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """Exact derivatives (m, 3, k) of the outcomes."""

        def run(part: Forward, row: FloatArray) -> FloatArray:
            return part.slopes(row, part.conditions, part.given)[1][0, :, :, : row.shape[1]]

        clipped = self._clipped(theta)
        return chain(self._by_group(theta, clipped.theta, run, (self.forward.width, len(theta))), clipped)

    def _clipped(self, theta: FloatArray) -> Clip:
        return clip(theta, self.forward.conditions.slip, names=self.forward.model.parameters)

    def _by_group(self, theta: FloatArray, rows: FloatArray, run: _Run, shape: tuple[int, ...]) -> FloatArray:
        """Run the rows that share parameters together: those that are not clipped have ``theta``."""
        if np.all(rows == rows[0]):
            return run(self.forward, rows[:1])
        out = np.empty((len(rows), *shape))
        clipped = np.flatnonzero((rows != theta).any(axis=1))
        clips, kind = np.unique(rows[clipped], axis=0, return_inverse=True)
        sets, which = np.vstack([theta, clips]), np.zeros(len(rows), dtype=np.int64)
        which[clipped] = 1 + kind.ravel()
        for i in np.unique(which):
            mask = which == i
            conditions = take(self.forward.conditions, mask)
            part = replace(self.forward, conditions=conditions, given=self.forward.given[mask])
            out[mask] = run(part, sets[i : i + 1])
        return out
