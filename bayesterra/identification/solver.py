"""Bounded least squares over some of the nine soil parameters, with exact derivatives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from bayesterra.arrays import FloatArray

TOLERANCE = 1e-14
MAX_EVALUATIONS = 1000
COMPLEX_STEP = 1e-60


class Curve(Protocol):
    """Values (k,) that depend on soil parameters (9,), with exact derivatives (k, 9)."""

    def values(self, theta: FloatArray) -> FloatArray:
        """Values (k,); non-finite where the model has no answer."""

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """Derivatives (k, 9) of the values."""


@dataclass(frozen=True)
class Formula:
    """A curve from a formula that also takes complex parameters; its derivatives are complex steps."""

    formula: Callable[[NDArray[np.complex128]], NDArray[np.complex128]]

    def values(self, theta: FloatArray) -> FloatArray:
        """Values (k,)."""
        return np.real(self.formula(theta.astype(complex)))

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """Derivatives (k, 9), exact to rounding: nothing is subtracted in a complex step."""
        steps = theta + 1j * COMPLEX_STEP * np.eye(len(theta))
        return np.column_stack([np.imag(self.formula(step)) / COMPLEX_STEP for step in steps])


@dataclass(frozen=True)
class Box:
    """Where a search may go: bounds on coordinates x, with parameters (9,) = ``basis`` @ x.

    Attributes
    ----------
    lower, upper : (9,) bounds of the coordinates.
    columns : the coordinates that are free; the others stay as at the start.
    basis : (9, 9), None where the coordinates are the parameters.
    """

    lower: FloatArray
    upper: FloatArray
    columns: list[int]
    basis: FloatArray | None = None

    def coordinates(self, theta: FloatArray) -> FloatArray:
        """Coordinates (9,) of parameters (9,), the free ones moved inside the bounds."""
        x = theta.copy() if self.basis is None else np.linalg.inv(self.basis) @ theta
        x[self.columns] = np.clip(x, self.lower, self.upper)[self.columns]
        return x

    def parameters(self, x: FloatArray) -> FloatArray:
        """Parameters (9,) of coordinates (9,)."""
        return x if self.basis is None else self.basis @ x

    def slopes(self, derivatives: FloatArray) -> FloatArray:
        """Derivatives (k, free) by the free coordinates, from those by the parameters (k, 9)."""
        return (derivatives if self.basis is None else derivatives @ self.basis)[:, self.columns]


@dataclass(frozen=True)
class Minimum:
    """Parameters (9,) at the end, half the sum of squares there, and whether a stopping rule was met."""

    theta: FloatArray
    cost: float
    converged: bool


def minimise(
    residual: Curve,
    start: FloatArray,
    box: Box,
    *,
    tolerance: float = TOLERANCE,
    evaluations: int = MAX_EVALUATIONS,
) -> Minimum:
    """Minimise the sum of squares of ``residual`` over the free coordinates of ``box``, from ``start`` (9,).

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
    result = least_squares(
        values,
        origin[columns],
        jac=jacobian,
        bounds=(lower, upper),
        x_scale=_widths(origin, box.lower, box.upper)[columns],
        ftol=tolerance,
        xtol=tolerance,
        gtol=tolerance,
        max_nfev=evaluations,
    )
    theta = parameters(_on_bounds(result.x, lower, upper))
    return Minimum(theta, float(result.cost), bool(result.status > 0))


def _on_bounds(x: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Put values on the bound that they have converged to; the search itself stays strictly inside."""
    near = 1e-10 * np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    return np.where(x < lower + near, lower, np.where(x > upper - near, upper, x))


def _widths(x: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Width of the bounds; the size of the value (or 1) where they are open."""
    width = upper - lower
    return np.where(np.isfinite(width) & (width > 0), width, np.where(x == 0, 1.0, np.abs(x)))
