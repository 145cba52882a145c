"""Batched Levenberg–Marquardt inside linear limits."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray, IntArray

MOST = 40
"""Steps after which a descent ends in any case, unless told otherwise."""
STIFF = 1e7
"""Damping at which a descent is stuck."""


@dataclass(frozen=True)
class Local:
    """Quadratic models at points y: slopes (n, d) and curvatures (n, d, d)."""

    slope: FloatArray
    curvature: FloatArray


class Problem(Protocol):
    """A function of points y in the unit box, to be minimised where ``rows @ y`` leaves no negative slack."""

    @property
    def rows(self) -> FloatArray:
        """The inequalities (k, d), those of the box among them."""

    @property
    def digits(self) -> float:
        """Change of the value that is worth a step."""

    def slack(self, y: FloatArray) -> FloatArray:
        """Slack of points (n, d) inside each inequality, (n, k)."""

    def value(self, y: FloatArray) -> FloatArray:
        """Values (n,) at points (n, d), +inf where there is none."""

    def local(self, y: FloatArray) -> Local:
        """Quadratic models at points (n, d) that have a value; their curvatures are positive definite."""


@dataclass(frozen=True)
class Ends:
    """Ends of descents: scaled parameters (n, d) and values (n,), +inf where one could not begin."""

    y: FloatArray
    value: FloatArray


def begin(problem: Problem, y: FloatArray, fixed: IntArray, places: FloatArray) -> FloatArray:
    """Move points y (n, d) along their valleys, so that parameter ``fixed`` stands at ``places`` (n,).

    The others go where the quadratic model at y has its least value. Points outside the support stay out.
    """
    held = np.arange(y.shape[1]) == fixed[:, None]
    shift = np.where(held, places[:, None] - y, 0.0)
    moved = y + _damped(problem, y, problem.local(y), held, shift=shift, damping=np.zeros(len(y)))
    return np.where(held, places[:, None], np.clip(moved, 0.0, 1.0))


def descend(problem: Problem, y: FloatArray, held: BoolArray, most: int = MOST) -> Ends:
    """Descend from points y (n, d), parameters where ``held`` (n, d) held, in at most so many steps."""
    y, value = y.copy(), problem.value(y)
    going = np.flatnonzero(np.isfinite(value) & (problem.slack(y) >= -1e-7).all(axis=1))
    value[np.setdiff1d(np.arange(len(y)), going)] = np.inf
    damping = np.full(len(y), 1e-3)
    local = problem.local(y[going]) if going.size else None
    for _ in range(most):
        if local is None or not going.size:
            break
        at, stay = y[going], held[going]
        move = _damped(problem, at, local, stay, shift=np.zeros_like(at), damping=damping[going])
        new = np.clip(at + move, 0.0, 1.0)
        bent = np.einsum("ni,nij,nj->n", new - at, local.curvature, new - at)
        promised = -np.einsum("ni,ni->n", local.slope, new - at) - 0.5 * bent  # as the quadratic models see it
        level = problem.value(new)
        with np.errstate(invalid="ignore"):
            ratio = np.where(np.isfinite(level), (value[going] - level) / np.maximum(promised, 1e-300), -1.0)
        better = (level < value[going]) & (promised > 0)
        y[going[better]], value[going[better]] = new[better], level[better]
        over = (promised < problem.digits) & (damping[going] <= 1e-2) | (damping[going] > STIFF)
        damping[going] *= np.select([~better, ratio < 0.25, ratio > 0.75], [6.0, 2.0, 0.15], 1.0)
        local, going = Local(local.slope[~over], local.curvature[~over]), going[~over]
        anew = np.flatnonzero(better[~over])
        if anew.size:  # models are made anew where points have moved
            renewed = problem.local(y[going[anew]])
            local.slope[anew], local.curvature[anew] = renewed.slope, renewed.curvature
    return Ends(y, value)


def _damped(
    problem: Problem, y: FloatArray, local: Local, held: BoolArray, *, shift: FloatArray, damping: FloatArray
) -> FloatArray:
    diagonal = np.einsum("nii->ni", local.curvature)
    extra = damping[:, None] * (diagonal + 1e-3)
    curvature = local.curvature + extra[:, :, None] * np.eye(y.shape[1])
    slack = np.maximum(problem.slack(y), 0.0)
    return steps(curvature, local.slope, rows=problem.rows, slack=slack, held=held, shift=shift)


ROUNDS = 25
"""Most Newton steps of the interior-point method; it stops once every problem is solved."""
SOLVED = 1e-9
"""Complementarity, in units of the slope, at which a problem counts as solved."""
HOPELESS = 1e20
"""Multiplier, in units of the slope, from which nothing satisfies the inequalities; it would only grow."""
STEEPEST = 1e16
"""Curvature of the barrier beyond which digits are lost."""
FIRST = 0.1
"""Least slack to begin with, in units of the range."""
LEAST, GREATEST = 1e-60, 1e60
"""Bounds of slacks and multipliers on the way: those of problems without a solution go to 0 and infinity."""

ROUNDING = 1e-13
"""Added to unit diagonals: a matrix that rounding made singular is none."""
LOOSE = 1e-10
"""Slack granted to every inequality, so that a point on an edge is inside."""


def steps(
    curvature: FloatArray, slope: FloatArray, *, rows: FloatArray, slack: FloatArray,
    held: BoolArray, shift: FloatArray,
) -> FloatArray:  # fmt: skip
    """Minimise ½ p·H p + g·p over p with ``rows @ p <= slack``, some entries of p given.

    Parameters
    ----------
    curvature, slope : H (n, d, d), positive definite, and g (n, d).
    rows, slack : inequalities (k, d) shared by all, and their limits (n, k).
    held, shift : which entries of p are given (n, d), and their values (n, d), 0 elsewhere.

    Returns
    -------
    Steps p (n, d). Where nothing satisfies the inequalities the step violates them.
    """
    slope = np.where(held, 0.0, slope + np.einsum("nij,nj->ni", curvature, shift))
    slack = slack - shift @ rows.T + LOOSE
    matrix = _without(curvature, held)
    p = _solve(matrix, -slope)
    outside = np.flatnonzero((p @ rows.T > slack).any(axis=1))
    if outside.size:
        p[outside] = _interior_point(_Problems(matrix, slope, slack, held, rows).take(outside).scaled())
    return p + shift


def _without(matrix: FloatArray, held: BoolArray) -> FloatArray:
    """The matrices with the rows and columns of held entries replaced by those of the identity."""
    either = held[:, :, None] | held[:, None, :]
    return np.where(either, held[:, :, None] * np.eye(held.shape[1]), matrix)


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve (n, d, d) systems with unit diagonals, for the sake of digits."""
    size = np.sqrt(np.einsum("nii->ni", matrix))
    scaled = matrix / size[:, :, None] / size[:, None, :] + ROUNDING * np.eye(matrix.shape[1])
    return np.asarray(np.linalg.solve(scaled, (right / size)[..., None])[..., 0] / size)


def _interior_point(problems: "_Problems") -> FloatArray:
    """Mehrotra's predictor–corrector method (Nocedal and Wright 2006, algorithm 16.4), from p = 0."""
    p, s = np.zeros_like(problems.slope), np.maximum(problems.slack, FIRST)
    z, left = np.ones_like(s), np.arange(len(p))
    for _ in range(ROUNDS):
        p[left], s[left], z[left], solved = problems.take(left).improved(p[left], s[left], z[left])
        left = left[~solved]
        if not left.size:
            break
    return p


@dataclass(frozen=True)
class _Problems:
    """Quadratic programmes that share their inequalities."""

    matrix: FloatArray
    slope: FloatArray
    slack: FloatArray
    held: BoolArray
    rows: FloatArray

    def take(self, chosen: IntArray) -> "_Problems":
        """Some of them."""
        return _Problems(self.matrix[chosen], self.slope[chosen], self.slack[chosen], self.held[chosen], self.rows)

    def scaled(self) -> "_Problems":
        """The same problems with slopes of order one; their solutions are the same."""
        size = np.maximum(np.abs(self.slope).max(axis=1), 1e-12)
        return replace(self, matrix=self.matrix / size[:, None, None], slope=self.slope / size[:, None])

    def improved(
        self, p: FloatArray, s: FloatArray, z: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """Steps, slacks and multipliers after one more iteration, and which were solved already."""
        dual = np.einsum("nij,nj->ni", self.matrix, p) + self.slope + z @ self.rows
        primal = p @ self.rows.T + s - self.slack
        gap = (s * z).mean(axis=1, keepdims=True)
        solved = (gap[:, 0] < SOLVED) & (np.abs(primal).max(axis=1) < SOLVED)
        solved |= z.max(axis=1) > HOPELESS
        outer = (self.rows[:, :, None] * self.rows[:, None, :]).reshape(len(self.rows), -1)
        barrier = (np.minimum(z / s, STEEPEST) @ outer).reshape(self.matrix.shape)
        system = _without(self.matrix + barrier, self.held)

        def newton(target: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
            right = -dual - ((z * primal - target) / s) @ self.rows
            dp = _solve(system, np.where(self.held, 0.0, right))
            ds = -primal - dp @ self.rows.T
            return dp, ds, (-target - z * ds) / s

        _, ds, dz = newton(s * z)
        ahead = ((s + _reach(s, ds) * ds) * (z + _reach(z, dz) * dz)).mean(axis=1, keepdims=True)
        dp, ds, dz = newton(s * z + ds * dz - (ahead / gap) ** 3 * gap)
        forward, back = 0.995 * _reach(s, ds), 0.995 * _reach(z, dz)
        s, z = np.maximum(s + forward * ds, LEAST), np.minimum(z + back * dz, GREATEST)
        return p + forward * dp, s, z, solved


def _reach(value: FloatArray, change: FloatArray) -> FloatArray:
    """Largest share of the change, up to 1, that keeps all values of a row positive, (n, 1)."""
    with np.errstate(divide="ignore", over="ignore"):
        ratio = np.where(change < 0, -value / np.minimum(change, -1e-300), np.inf)
    return np.asarray(np.minimum(1.0, ratio.min(axis=1, keepdims=True)))
