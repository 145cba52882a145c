"""Steps that minimise many small quadratic models at once, inside linear inequalities."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray, IntArray

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
LEAST, MOST = 1e-60, 1e60
"""Bounds of slacks and multipliers on the way: those of problems without a solution go to 0 and infinity."""
ROUNDING = 1e-13
"""Added to unit diagonals: a matrix that rounding made singular is none."""
LOOSE = 1e-10
"""Slack granted to every inequality, so that a point on an edge is inside."""


def steps(
    curvature: FloatArray, slope: FloatArray, *, rows: FloatArray, slack: FloatArray,
    fixed: IntArray, shift: FloatArray,
) -> FloatArray:  # fmt: skip
    """Minimise ½ p·H p + g·p over p with ``rows @ p <= slack``, one entry of p given.

    Parameters
    ----------
    curvature, slope : H (n, d, d), positive definite, and g (n, d).
    rows, slack : inequalities (k, d) shared by all, and their limits (n, k).
    fixed, shift : which entry of p is given (n,), −1 for none, and its value (n,).

    Returns
    -------
    Steps p (n, d). Where nothing satisfies the inequalities the step violates them.
    """
    held = fixed[:, None] == np.arange(slope.shape[1])
    given = np.where(held, shift[:, None], 0.0)
    slope = np.where(held, 0.0, slope + np.einsum("nij,nj->ni", curvature, given))
    slack = slack - given @ rows.T + LOOSE
    matrix = _without(curvature, held)
    p = _solve(matrix, -slope)
    outside = np.flatnonzero((p @ rows.T > slack).any(axis=1))
    if outside.size:
        p[outside] = _interior_point(_Problems(matrix, slope, slack, held, rows).take(outside).scaled())
    return p + given


def _without(matrix: FloatArray, held: BoolArray) -> FloatArray:
    """The matrices with the rows and columns of held entries replaced by those of the identity."""
    either = held[:, :, None] | held[:, None, :]
    return np.where(either, held[:, :, None] * np.eye(held.shape[1]), matrix)


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve (n, d, d) systems with unit diagonals, for the sake of digits."""
    size = np.sqrt(np.einsum("nii->ni", matrix))
    scaled = matrix / size[:, :, None] / size[:, None, :] + ROUNDING * np.eye(matrix.shape[1])
    return np.asarray(np.linalg.solve(scaled, (right / size)[..., None])[..., 0] / size)


def _interior_point(problems: _Problems) -> FloatArray:
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

    def take(self, chosen: IntArray) -> _Problems:
        """Some of them."""
        return _Problems(
            self.matrix[chosen], self.slope[chosen], self.slack[chosen], self.held[chosen], self.rows
        )

    def scaled(self) -> _Problems:
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
        return p + forward * dp, np.maximum(s + forward * ds, LEAST), np.minimum(z + back * dz, MOST), solved


def _reach(value: FloatArray, change: FloatArray) -> FloatArray:
    """Largest share of the change, up to 1, that keeps all values of a row positive, (n, 1)."""
    with np.errstate(divide="ignore", over="ignore"):
        ratio = np.where(change < 0, -value / np.minimum(change, -1e-300), np.inf)
    return np.asarray(np.minimum(1.0, ratio.min(axis=1, keepdims=True)))
