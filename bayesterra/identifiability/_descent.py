"""Levenberg–Marquardt from many points at once, one parameter of each held, inside linear inequalities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.identifiability._quadratic import steps
from bayesterra.identifiability._target import Local, Target

MOST = 40
"""Steps after which a descent ends in any case."""
STIFF = 1e7
"""Damping at which a descent is stuck."""


@dataclass(frozen=True)
class Ends:
    """Where descents ended: scaled parameters (n, d) and values (n,), +inf where one could not begin."""

    y: FloatArray
    value: FloatArray


def begin(target: Target, y: FloatArray, fixed: IntArray, places: FloatArray) -> FloatArray:
    """Move points y (n, d) along their valleys, so that parameter ``fixed`` stands at ``places`` (n,).

    The others go where the quadratic model at y has its least value. Points outside the support stay out.
    """
    local = target.local(y)
    shift = places - y[np.arange(len(y)), fixed]
    moved = y + _damped(target, y, local, fixed, shift=shift, damping=np.zeros(len(y)))
    return np.where(np.arange(y.shape[1]) == fixed[:, None], places[:, None], np.clip(moved, 0.0, 1.0))


def descend(target: Target, y: FloatArray, fixed: IntArray) -> Ends:
    """Descend from points y (n, d), parameter ``fixed`` (n,) of each held, none where that is −1."""
    y, value = y.copy(), target.value(y)
    going = np.flatnonzero(np.isfinite(value) & (target.chart.slack(y) >= -1e-7).all(axis=1))
    value[np.setdiff1d(np.arange(len(y)), going)] = np.inf
    damping = np.full(len(y), 1e-3)
    local = target.local(y[going]) if going.size else None
    for _ in range(MOST):
        if local is None or not going.size:
            break
        move = _damped(
            target, y[going], local, fixed[going], shift=np.zeros(len(going)), damping=damping[going]
        )
        promised = _promise(local, move)
        new = np.clip(y[going] + move, 0.0, 1.0)
        level = target.value(new)
        with np.errstate(invalid="ignore"):
            ratio = np.where(np.isfinite(level), (value[going] - level) / np.maximum(promised, 1e-300), -1.0)
        better = (level < value[going]) & (promised > 0)
        y[going[better]], value[going[better]] = new[better], level[better]
        over = (promised < target.digits) & (damping[going] <= 1e-2) | (damping[going] > STIFF)
        damping[going] *= np.select([~better, ratio < 0.25, ratio > 0.75], [6.0, 2.0, 0.15], 1.0)
        local = _renewed(target, local, y[going], better, ~over)
        going = going[~over]
    return Ends(y, value)


def _damped(
    target: Target, y: FloatArray, local: Local, fixed: IntArray, *, shift: FloatArray, damping: FloatArray
) -> FloatArray:
    diagonal = np.einsum("nii->ni", local.curvature)
    extra = damping[:, None] * (diagonal + 1e-3)
    curvature = local.curvature + extra[:, :, None] * np.eye(y.shape[1])
    slack = np.maximum(target.chart.slack(y), 0.0)
    return steps(curvature, local.slope, rows=target.chart.rows, slack=slack, fixed=fixed, shift=shift)


def _promise(local: Local, move: FloatArray) -> FloatArray:
    """Decrease (n,) that the quadratic models see in the moves."""
    bent = np.einsum("ni,nij,nj->n", move, local.curvature, move)
    return np.asarray(-np.einsum("ni,ni->n", local.slope, move) - 0.5 * bent)


def _renewed(target: Target, local: Local, y: FloatArray, moved: BoolArray, kept: BoolArray) -> Local:
    """The models of the points kept, anew where they have moved."""
    value, slope, curvature = local.value.copy(), local.slope.copy(), local.curvature.copy()
    anew = np.flatnonzero(moved & kept)
    if anew.size:
        new = target.local(y[anew])
        value[anew], slope[anew], curvature[anew] = new.value, new.slope, new.curvature
    return Local(value[kept], slope[kept], curvature[kept])
