"""Coordinates in which the limits of the contact angle are bounds, so that a search can slide along them.

θm/θ1 = c1 + c2 s must stay inside (c3, 1) at every slip, which is a slanted edge in c1 and c2. In the
ratios at the lowest and the highest slip it is a plain bound.
"""

from __future__ import annotations

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.identification.settings import Settings
from bayesterra.identification.solver import Box
from bayesterra.identification.support import MARGIN
from bayesterra.parameters import SOIL_PARAMETERS

_C1, _C2, _C3 = (SOIL_PARAMETERS.index(name) for name in ("c1", "c2", "c3"))


def ratio_box(settings: Settings, columns: list[int], slip: FloatArray) -> Box:
    """Box in which θm/θ1 at the lowest and at the highest slip stand for c1 and c2, where both are free."""
    if not {_C1, _C2}.issubset(columns) or np.ptp(slip) < 1e-6:
        return _narrowed(settings, columns, slip)
    angles = [_C1, _C2]
    lower, upper, basis = settings.lower.copy(), settings.upper.copy(), np.eye(len(settings.lower))
    lower[angles], upper[angles] = settings.lower[_C3] + MARGIN, 1 - MARGIN
    basis[np.ix_(angles, angles)] = np.linalg.inv([[1.0, slip.min()], [1.0, slip.max()]])
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
