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
class Minimum:
    """Parameters (9,) at the end, half the sum of squares there, and whether a stopping rule was met."""

    theta: FloatArray
    cost: float
    converged: bool


def minimise(
    residual: Curve, start: FloatArray, columns: list[int], lower: FloatArray, upper: FloatArray
) -> Minimum:
    """Minimise the sum of squares of ``residual`` over ``columns`` of the parameters (9,).

    Trust-region reflective, variables scaled by the width of their bounds. A trial step to where the
    residual is not finite is refused and the trust region shrinks; only the start must have an answer.
    """

    def complete(x: FloatArray) -> FloatArray:
        theta = start.copy()
        theta[columns] = x
        return theta

    result = least_squares(
        lambda x: residual.values(complete(x)),
        start[columns],
        jac=lambda x: residual.jacobian(complete(x))[:, columns],
        bounds=(lower[columns], upper[columns]),
        x_scale=_widths(start, lower, upper)[columns],
        ftol=TOLERANCE,
        xtol=TOLERANCE,
        gtol=TOLERANCE,
        max_nfev=MAX_EVALUATIONS,
    )
    return Minimum(complete(result.x), float(result.cost), bool(result.status > 0))


def _widths(start: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Width of the bounds; the size of the start value (or 1) where they are open."""
    width = upper - lower
    return np.where(np.isfinite(width) & (width > 0), width, np.where(start == 0, 1.0, np.abs(start)))
