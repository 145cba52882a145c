"""Compiled polynomials of the straightening map: one pass over the points, no tables of features."""

from __future__ import annotations

import numpy as np

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.models.kernels import compiled


@compiled
def move(
    points: FloatArray, order: IntArray, coefficients: FloatArray, reach: float, sign: float, out: FloatArray
) -> None:
    """Fill ``out`` (n, d) with points (n, d), sign · g_j added to every coordinate j.

    The coordinates that g_j depends on are taken bent: from ``points`` where the map straightens (sign −1),
    from ``out``, where they have just been made, where it bends. Terms as in ``unbending._features``.
    """
    d = points.shape[1]
    near = np.empty(d)
    for row in range(points.shape[0]):
        first = 0
        for position in range(d):
            j = order[position]
            g = coefficients[first]
            products, cubes = first + 1 + position, first + 1 + position + position * (position + 1) // 2
            for i in range(position):
                g += near[i] * (coefficients[first + 1 + i] + coefficients[cubes + i] * near[i] * near[i])
                for k in range(i, position):
                    g += coefficients[products] * near[i] * near[k]
                    products += 1
            first = cubes + position
            out[row, j] = points[row, j] + sign * g
            bent = points[row, j] if sign < 0 else out[row, j]
            near[position] = min(max(bent, -reach), reach)
