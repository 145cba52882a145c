"""Compiled squared distances from the components of a mixture: side by side in the vector lanes."""

from __future__ import annotations

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.models.kernels import compiled


@compiled
def squared(points: FloatArray, inverse: FloatArray, offsets: FloatArray, out: FloatArray) -> None:
    """Fill ``out`` (n, k) with squared lengths of L⁻¹ u − offset for points (n, d).

    ``inverse`` (d, d, k) holds the lower triangles L⁻¹ of all components, ``offsets`` is (d, k).
    """
    d, k = offsets.shape
    white = np.empty(k)
    for row in range(points.shape[0]):
        out[row, :] = 0.0
        for a in range(d):
            for c in range(k):
                white[c] = -offsets[a, c]
            for b in range(a + 1):
                value = points[row, b]
                for c in range(k):
                    white[c] += inverse[a, b, c] * value
            for c in range(k):
                out[row, c] += white[c] * white[c]
