"""Compiled straightening map: one pass over the points, no tables of features."""

from __future__ import annotations

import math

import numpy as np

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.models.kernels import compiled


@compiled
def move(
    points: FloatArray,
    order: IntArray,
    coefficients: FloatArray,
    spreads: FloatArray,
    limits: tuple[float, float],
    straighten: bool,
    out: FloatArray,
    log_jacobian: FloatArray,
) -> None:
    """Fill ``out`` (n, d) with points (n, d) moved by the map, and ``log_jacobian`` (n,) with log |dz/dv|.

    Bent z_j = g_j + exp(h_j) v_j, with polynomials g_j and linear h_j of the bent coordinates before j: these
    are in ``points`` where the map straightens, in ``out``, where they have just been made, where it bends.
    Terms as in ``unbending._features``; ``limits``: reach of the coordinates, and of the slopes of h_j.
    """
    d = points.shape[1]
    reach, most = limits
    near = np.empty(d)
    for row in range(points.shape[0]):
        first = linear = 0
        total = 0.0
        for position in range(d):
            j = order[position]
            g, h = coefficients[first], 0.0
            products, cubes = first + 1 + position, first + 1 + position + position * (position + 1) // 2
            for i in range(position):
                g += near[i] * (coefficients[first + 1 + i] + coefficients[cubes + i] * near[i] * near[i])
                h += spreads[linear + 1 + i] * near[i]
                for k in range(i, position):
                    g += coefficients[products] * near[i] * near[k]
                    products += 1
            h = spreads[linear] + min(max(h, -most), most)
            first, linear = cubes + position, linear + 1 + position
            if straighten:
                bent = points[row, j]
                out[row, j] = (bent - g) * math.exp(-h)
            else:
                bent = g + math.exp(h) * points[row, j]
                out[row, j] = bent
            total += h
            near[position] = min(max(bent, -reach), reach)
        log_jacobian[row] = total
