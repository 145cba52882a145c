"""The mean curves of soil tests, as logarithms, and what the readings of a test may have in common.

Plates: Bekker's p = (k_c/b + k_φ) z^n, b the plate radius. Either modulus may be negative; only k_c/b + k_φ
> 0 under every plate is physical. Shear: Janosi and Hanamoto's τ = (c + σ tan φ) (1 − exp(−j/K)), the law
of eq. (9).
"""

from __future__ import annotations

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.soiltests.data import Readings


def log_curve(kind: str, x: FloatArray, path: FloatArray, level: FloatArray) -> FloatArray:
    """Log of the mean stress (n, m), Pa.

    Parameters
    ----------
    kind : ``plate`` or ``shear``.
    x : soil parameters (n, 3), SI: k_c, k_φ, n or c, φ, K, inside their physical range.
    path : sinkage or displacement (m,), m.
    level : plate radius, m, or normal stress, Pa, (m,).
    """
    first, second, third = (x[:, i : i + 1] for i in range(3))
    if kind == "plate":
        levels, which = np.unique(level, return_inverse=True)
        return np.asarray(np.log(first / levels + second)[:, which] + third * np.log(path))
    mobilised = -np.expm1(-path / third)
    return np.asarray(np.log(first + level * np.tan(second)) + np.log(mobilised))


def physical(kind: str, x: FloatArray, levels: FloatArray) -> BoolArray:
    """Whether soil parameters (n, 3) are physical under all plates or stresses ``levels`` (t,)."""
    first, second, third = x.T
    if kind == "plate":
        # K_s is linear in 1/b: positive under the smallest and the largest plate is positive under all
        with np.errstate(over="ignore", invalid="ignore"):  # far proposals overflow, and are turned away
            ends = first[:, None] / np.array([levels.min(), levels.max()]) + second[:, None]
        return np.asarray((ends > 0).all(axis=1))
    inside = (first >= 0) & (second >= 0) & (second < np.pi / 2) & (third > 0)
    return np.asarray(inside & (first + levels.min() * np.tan(np.where(inside, second, 0.0)) > 0))


def slopes(kind: str, x: FloatArray, path: FloatArray, level: FloatArray) -> FloatArray:
    """Derivatives (n, m, 3) of :func:`log_curve` by the soil parameters."""
    first, second, third = (x[:, i : i + 1] for i in range(3))
    if kind == "plate":
        modulus = first / level + second
        parts = (1.0 / (level * modulus), 1.0 / modulus, np.broadcast_to(np.log(path), modulus.shape))
    else:
        strength = first + level * np.tan(second)
        ratio = path / third
        parts = (1.0 / strength, level / np.cos(second) ** 2 / strength, -ratio / np.expm1(ratio) / third)
    shape = np.broadcast_shapes(*(part.shape for part in parts))
    return np.stack([np.broadcast_to(part, shape) for part in parts], axis=2)


def structural(readings: Readings, x: FloatArray, free: BoolArray) -> BoolArray:
    """Whether this design could determine each soil parameter (3,), from draws ``x`` (n, 3) of the cut prior.

    A parameter is lost where a direction that it takes part in changes no reading: k_c and k_φ under plates
    of one radius, c and φ under one normal stress. Only parameters that are ``free`` (3,) count.
    """
    lost = np.zeros((free.sum(), free.sum()))
    for matrix in slopes(readings.kind, x, readings.path, readings.level)[:, :, free]:
        norms = np.linalg.norm(matrix, axis=0)
        _, values, rows = np.linalg.svd(matrix / np.where(norms > 0, norms, 1.0))
        rank = int((values > 1e-9 * values[0]).sum())
        lost += rows[rank:].T @ rows[rank:]
    found = np.ones(3, dtype=np.bool_)
    found[free] = np.diagonal(lost) / len(x) < 1e-3
    return found
