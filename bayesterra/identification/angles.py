"""Coordinates in which the limits of the contact angle are bounds, so that a search can slide along them.

θm/θ1 = c1 + c2 s must stay inside (c3, 1) at every slip, which is a slanted edge in c1 and c2. In the
ratios at the lowest and the highest slip it is a plain bound; the ranges of c1 and c2 are then slanted.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.identification.settings import Settings
from bayesterra.identification.solver import Box
from bayesterra.identification.support import MARGIN
from bayesterra.parameters import SOIL_PARAMETERS

_C1, _C2, _C3 = (SOIL_PARAMETERS.index(name) for name in ("c1", "c2", "c3"))


def boxes(settings: Settings, columns: list[int], slip: FloatArray) -> list[Box]:
    """Boxes to search ``columns`` in, first the one whose bounds are the limits of θm/θ1.

    The others bound c1 or c2 themselves, alone or beside one limit: for minima at such a corner.
    """
    if not {_C1, _C2}.issubset(columns) or np.ptp(slip) == 0:
        return [_narrowed(settings, columns, slip)]
    low, high = settings.lower[_C3] + MARGIN, 1 - MARGIN
    choices = {  # row of the coordinate in terms of (c1, c2), and its bounds
        "lowest": ((1.0, float(slip.min())), (low, high)),
        "highest": ((1.0, float(slip.max())), (low, high)),
        "c1": ((1.0, 0.0), (settings.lower[_C1], settings.upper[_C1])),
        "c2": ((0.0, 1.0), (settings.lower[_C2], settings.upper[_C2])),
    }
    pairs = (np.array([first, second]) for first, second in combinations(choices.values(), 2))
    return [_box(settings, columns, pair) for pair in pairs if abs(np.linalg.det(pair[:, 0])) > 1e-6]


def _box(settings: Settings, columns: list[int], pair: FloatArray) -> Box:
    """Box in which c1 and c2 are replaced by two combinations; ``pair`` holds rows and bounds, (2, 2, 2)."""
    lower, upper, basis = settings.lower.copy(), settings.upper.copy(), np.eye(len(SOIL_PARAMETERS))
    angles = [_C1, _C2]
    lower[angles], upper[angles] = pair[:, 1].T
    basis[np.ix_(angles, angles)] = np.linalg.inv(pair[:, 0])
    return Box(lower, upper, columns, basis)


def _narrowed(settings: Settings, columns: list[int], slip: FloatArray) -> Box:
    """Box of the parameters themselves; c1 free alone is bounded by the limits at the held c2 as well."""
    lower, upper = settings.lower.copy(), settings.upper.copy()
    if _C1 in columns and _C2 not in columns:
        growth = settings.start[_C2] * slip
        lower[_C1] = max(lower[_C1], settings.lower[_C3] + MARGIN - growth.min())
        upper[_C1] = min(upper[_C1], 1 - MARGIN - growth.max())
    if not lower[_C1] < upper[_C1]:
        return Box(settings.lower, settings.upper, columns)
    return Box(lower, upper, columns)
