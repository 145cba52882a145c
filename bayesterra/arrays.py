"""Array types shared by all layers, and read-only copies at the border."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def frozen(values: ArrayLike, dtype: Any = np.float64) -> NDArray[Any]:
    """Copy ``values`` into a contiguous array that cannot be written to."""
    array = np.array(values, dtype=dtype, order="C")
    array.flags.writeable = False
    return array


def spaced(draws: FloatArray, most: int) -> FloatArray:
    """At most this number of draws (n, ...), evenly spaced."""
    return draws[:: max(1, -(-len(draws) // most))]
