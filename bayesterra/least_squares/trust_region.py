"""Least squares as ``lsqcurvefit`` of the paper's day did it: an emulation, to show what a fit owes to its start.

Ding et al. (2015, Section 5.1) name that function of Matlab. This is the published algorithm behind it in code of our
own: an interior trust region with reflection at the bounds (Coleman and Li 1996, SIAM J. Optim. 6, 418-445), its step
from a plane (Branch, Coleman and Li 1999, SIAM J. Sci. Comput. 21, 1-23). The settings are those that bring the
paper's K_s back: no scaling of the parameters, one preconditioned conjugate gradient, forward differences, and an end
after small changes, which on a valley floor is far from the minimum. ``minimise`` is the solver to identify with.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from bayesterra.arrays import FloatArray
from bayesterra.least_squares.solver import Box, Curve, Minimum
from bayesterra.parameters import PARAMETERS, SOIL_PARAMETERS

TOLERANCE = 1e-6
"""End of the search: ``TolFun`` and ``TolX``."""
RADIUS, LARGEST_RADIUS = 10.0, 100.0
"""First radius of the trust region, and the largest one in sizes of the start."""
STAY = 0.95
"""Least part of the way to a bound that a step goes."""
DIFFERENCE = float(np.sqrt(np.finfo(float).eps))
"""Forward difference of a parameter in sizes of it, or as such where the parameter is below 1."""
START = 1e-6
"""Distance of the start from a bound at least, in widths between the bounds."""
EDGE = 100 * float(np.finfo(float).eps)
"""Distance from a bound at which a point is moved inside."""
UNITS = np.array([PARAMETERS[name].scale if PARAMETERS[name].unit == "deg" else 1.0 for name in SOIL_PARAMETERS])
"""SI value of one unit of the search: that of Table 17, which is SI but for φ in degrees."""


@dataclass(frozen=True)
class Quadratic:
    """Half the sum of squares about a point in coordinates scaled by D: gradient D g (n,) and D JᵀJ D + G (n, n)."""

    gradient: FloatArray
    matrix: FloatArray

    def __call__(self, step: FloatArray) -> float:
        """Change of the value by a step (n,)."""
        return float(self.gradient @ step + 0.5 * step @ self.matrix @ step)

    def plane(self) -> FloatArray:
        """Basis (n, 1 or 2) of the plane of the step: one conjugate gradient, and the gradient."""
        first = self.gradient / np.maximum(np.linalg.norm(self.matrix, axis=0), np.finfo(float).eps)
        first = first / (np.linalg.norm(first) or 1.0)
        second = self.gradient - first * (first @ self.gradient)
        size = float(np.linalg.norm(second))
        near = size <= DIFFERENCE * float(np.linalg.norm(self.gradient))
        return first[:, None] if near else np.column_stack([first, second / size])

    def least(self, basis: FloatArray, radius: float) -> FloatArray:
        """The step (n,) within a basis (n, k) and a radius that lowers the value most."""
        values, vectors = np.linalg.eigh(basis.T @ self.matrix @ basis)
        slope = vectors.T @ (basis.T @ self.gradient)

        def step(shift: float) -> FloatArray:
            return -slope / np.maximum(values + shift, np.finfo(float).tiny)

        def beyond(shift: float) -> float:
            return 1 / radius - 1 / max(float(np.linalg.norm(step(shift))), np.finfo(float).tiny)

        shift = 0.0
        if np.linalg.norm(step(0.0)) > radius:
            shift = float(brentq(beyond, 0.0, float(np.linalg.norm(slope)) / radius, xtol=1e-300, rtol=1e-12))
        return basis @ (vectors @ step(shift))


@dataclass(frozen=True)
class Point:
    """A point x (n,) of the search with its residuals (k,) and their derivatives (k, n)."""

    x: FloatArray
    residual: FloatArray
    jacobian: FloatArray

    @property
    def value(self) -> float:
        """Sum of squares."""
        return float(self.residual @ self.residual)

    @property
    def gradient(self) -> FloatArray:
        """Gradient (n,) of half the sum of squares."""
        gradient: FloatArray = self.jacobian.T @ self.residual
        return gradient


@dataclass
class Search:
    """Search for the least sum of squares of a function, residuals (k,) at x (n,), within finite bounds (n,)."""

    function: Callable[[FloatArray], FloatArray]
    lower: FloatArray
    upper: FloatArray
    evaluations: int = 0

    def run(self, start: FloatArray, limit: int) -> tuple[FloatArray, float, bool]:
        """Parameters (n,) at the end, their sum of squares, and whether the end was met within ``limit``."""
        width = self.upper - self.lower
        at = self.point(np.clip(start, self.lower + START * width, self.upper - START * width))
        radius, largest = RADIUS, max(LARGEST_RADIUS * float(np.linalg.norm(start)), 1.0)
        before, size, ratio = np.inf, 1.0, 0.0
        while True:
            ahead = self.ahead(at)
            steepest = float(np.max(np.abs(ahead * at.gradient)))
            change, before = abs(before - at.value), at.value
            still = size < 0.9 * radius and ratio > 0.25 and change < TOLERANCE * (1 + at.value)
            if steepest < TOLERANCE or still or size < TOLERANCE:
                return at.x, at.value, True
            if self.evaluations > limit:
                return at.x, at.value, False
            step, scaled, gain = self.step(at, radius, max(STAY, 1 - steepest))
            size = float(np.linalg.norm(scaled))
            new = self.point(self.inside(at.x + step))
            if not np.isfinite(new.value):
                radius, ratio = min(size / 20, radius / 20), 0.0
                continue
            bend = 0.5 * float(scaled**2 @ np.abs(new.gradient))
            ratio = (0.5 * (new.value - at.value) + bend) / gain
            if ratio >= 0.75 and size >= 0.9 * radius:
                radius = min(largest, 2 * radius)
            elif ratio <= 0.25:
                radius = min(size / 4, radius / 4)
            at = new if new.value < at.value else at

    def inside(self, x: FloatArray) -> FloatArray:
        """A point moved off the bounds that it touches."""
        x = np.where(self.upper - x < EDGE, x - EDGE, x)
        return np.where(x - self.lower < EDGE, x + EDGE, x)

    def point(self, x: FloatArray) -> Point:
        """Residuals and their forward differences at x (n,)."""
        residual = self.function(x)
        steps = DIFFERENCE * np.maximum(np.abs(x), 1.0) * np.where(x < 0, -1.0, 1.0)
        columns = [(self.function(x + step) - residual) / step[i] for i, step in enumerate(np.diag(steps))]
        self.evaluations += 1 + len(x)
        return Point(x, residual, np.column_stack(columns))

    def ahead(self, at: Point) -> FloatArray:
        """Distance (n,) to the bound that the descent leads to, negative below an upper one."""
        return np.where(at.gradient < 0, at.x - self.upper, at.x - self.lower)

    def step(self, at: Point, radius: float, stay: float) -> tuple[FloatArray, FloatArray, float]:
        """The best of a step in the plane, its reflection and one down the gradient: (n,), scaled (n,), its gain."""
        scale = np.sqrt(np.abs(self.ahead(at)))
        inner = at.jacobian * scale
        model = Quadratic(scale * at.gradient, inner.T @ inner + np.diag(np.abs(at.gradient)))
        steepest = model.gradient[:, None] / (np.linalg.norm(model.gradient) or 1.0)
        whole, down = model.least(model.plane(), radius), model.least(steepest, radius)
        tried = [self.within(at.x, scale, step, stay) for step in (down, whole)]
        best = min([*tried, *self.reflected(at.x, scale, whole, radius, stay)], key=model)
        return scale * best, best, model(best)

    def reach(self, x: FloatArray, step: FloatArray) -> FloatArray:
        """How many times (n,) a step fits before it meets the bound of each parameter."""
        away = np.where(step > 0, self.upper - x, self.lower - x)
        return np.divide(away, step, out=np.full_like(step, np.inf), where=step != 0)

    def within(self, x: FloatArray, scale: FloatArray, step: FloatArray, stay: float) -> FloatArray:
        """As much of a scaled step (n,) as keeps inside."""
        return min(1.0, stay * float(np.min(self.reach(x, scale * step)))) * step

    def reflected(
        self, x: FloatArray, scale: FloatArray, step: FloatArray, radius: float, stay: float
    ) -> Iterator[FloatArray]:
        """A scaled step (n,) to its first bound and from there on turned back, where that is within the radius."""
        reach = self.reach(x, scale * step)
        first = int(np.argmin(reach))
        there = reach[first] * step
        if len(x) == 1 or not np.linalg.norm(there) < 0.9 * radius:
            return
        turned = step.copy()
        turned[first] = -turned[first]
        half, square = float(there @ turned), float(turned @ turned)
        farthest = (np.sqrt(half**2 - square * (there @ there - radius**2)) - half) / square
        yield there + self.within(x + scale * there, scale, min(1.0, float(farthest)) * turned, stay)


def emulate(residual: Curve, start: FloatArray, box: Box, *, evaluations: int) -> Minimum:
    """Minimise the sum of squares of ``residual`` as ``lsqcurvefit`` did; the arguments of ``minimise``."""
    columns = box.columns
    units = UNITS[columns]
    if not columns:
        return Minimum(start, 0.5 * float(np.sum(residual.values(start) ** 2)), converged=True)

    def parameters(x: FloatArray) -> FloatArray:
        theta = start.copy()
        theta[columns] = x * units
        return theta

    search = Search(lambda x: residual.values(parameters(x)), box.lower[columns] / units, box.upper[columns] / units)
    x, value, ended = search.run(start[columns] / units, evaluations)
    return Minimum(parameters(x), 0.5 * value, ended, search.evaluations)
