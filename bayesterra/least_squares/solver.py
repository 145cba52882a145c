"""Bounded least squares over some soil parameters, with the model carried on where it has no answer.

Least squares may try c1, c2 that put θm outside (θ2, θ1), or n0, n1 with N ≤ 0. There the offending row is
modelled with θm/θ1 (or N) at the nearest value inside; the excess is reported.

``emulate`` is least squares as ``lsqcurvefit`` of the paper's day did it, to show what a fit owes to its start.
Ding et al. (2015, Section 5.1) name that function of Matlab. This is the published algorithm behind it in code of our
own: an interior trust region with reflection at the bounds (Coleman and Li 1996, SIAM J. Optim. 6, 418-445), its step
from a plane (Branch, Coleman and Li 1999, SIAM J. Sci. Comput. 21, 1-23). The settings are those that bring the
paper's K_s back: no scaling of the parameters, one preconditioned conjugate gradient, forward differences, and an end
after small changes, which on a valley floor is far from the minimum. ``minimise`` is the solver to identify with.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, least_squares

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.forward import Forward, take
from bayesterra.models.decoupled import MARGIN, leaving, ratio
from bayesterra.parameters import PARAMETERS, SOIL_PARAMETERS

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
    """A model held at its rows, with rows outside its range clipped."""

    forward: Forward  # model, drive and conditions

    def values(self, theta: FloatArray) -> FloatArray:
        """Outcomes (m, 3) for parameters (p,); NaN where no sinkage carries the load."""
        return self._by_group(self._clipped(theta).theta, (self.forward.width,),
            lambda part, row: np.asarray(part.answers(row, part.conditions, part.given)[0][0]))  # fmt: skip

    def jacobian(self, theta: FloatArray, only: Sequence[int] | None = None) -> FloatArray:
        """Exact derivatives (m, 3, k) of the outcomes; those by others than ``only`` may be 0."""
        clipped = self._clipped(theta)
        return chain(self._by_group(
            clipped.theta, (self.forward.width, len(theta)),
            lambda part, row: part.slopes(row, part.conditions, part.given, only)[1][0, :, :, : row.shape[1]],
        ), clipped)  # fmt: skip

    def _clipped(self, theta: FloatArray) -> Clip:
        return clip(theta, self.forward.conditions.slip, names=self.forward.model.parameters)

    def _by_group(self, rows: FloatArray, shape: tuple[int, ...], run: _Run) -> FloatArray:
        """Run the rows that share parameters together."""
        if np.all(rows == rows[0]):
            return run(self.forward, rows[:1])
        out, todo = np.empty((len(rows), *shape)), np.ones(len(rows), dtype=np.bool_)
        while todo.any():  # six sets at most: θm/θ1 inside or at either limit, N inside or not
            first = int(np.argmax(todo))
            mask = (rows == rows[first]).all(axis=1)
            mask[first] = True  # also where it is not a number
            part = replace(self.forward, conditions=take(self.forward.conditions, mask), given=self.forward.given[mask])
            out[mask] = run(part, rows[first][None])
            todo &= ~mask
        return out


SMALL_CHANGE = 1e-6
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
            still = size < 0.9 * radius and ratio > 0.25 and change < SMALL_CHANGE * (1 + at.value)
            if steepest < SMALL_CHANGE or still or size < SMALL_CHANGE:
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
