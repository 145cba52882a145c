"""The log density of tests whose readings hang together, compiled."""

from __future__ import annotations

import numpy as np

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.models.kernels import compiled


@compiled
def log_densities(
    residuals: FloatArray,
    scatter: FloatArray,
    memory: FloatArray,
    shift: FloatArray,
    gaps: FloatArray,
    path: FloatArray,
    offset: FloatArray,
    ends: IntArray,
) -> FloatArray:
    """Log density (n, t) of every test; memory 0 means that readings are independent."""
    found = np.empty((len(residuals), len(ends) - 1))
    for k in range(len(residuals)):
        for test in range(len(ends) - 1):
            squares = both = size = logs = before = above = 0.0
            for i in range(ends[test], ends[test + 1]):
                kept = np.exp(-gaps[i] / memory[k]) if memory[k] > 0 else 0.0
                variance = 1.0 - kept * kept
                # innovations of the process, and of the column 1/z by which the seating enters
                column = 1.0 / (path[i] + offset[k])
                white, seat = residuals[k, i] - kept * before, column - kept * above
                before, above = residuals[k, i], column
                squares += white * white / variance
                both += white * seat / variance
                size += seat * seat / variance
                logs += 0.5 * np.log(variance)
            inverse, number = scatter[k] ** -2, ends[test + 1] - ends[test]
            logs += number * (np.log(scatter[k]) + 0.5 * np.log(2.0 * np.pi))
            seating = shift[k] ** 2  # one column more, by Woodbury's identity
            squares = inverse * (squares - seating * inverse * both**2 / (1.0 + seating * inverse * size))
            found[k, test] = -0.5 * (squares + np.log1p(seating * inverse * size)) - logs
    return found
