"""Array types shared by all layers, and read-only copies at the border."""

from collections.abc import Callable, Sequence
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


def in_parts(of: Callable[..., NDArray[Any]], most: int, *columns: FloatArray) -> NDArray[Any]:
    """Values of a function of so many rows of some arrays at once at most, one after another."""
    parts = [slice(first, first + most) for first in range(0, max(1, len(columns[0])), most)]
    return np.concatenate([of(*(column[part] for column in columns)) for part in parts])


def answered_quantiles(values: FloatArray, levels: Sequence[float]) -> FloatArray:
    """Quantiles (k, ...) over those draws (n, ...) that are finite, place by place; NaN where none is."""
    quantiles = np.full((len(levels), *values.shape[1:]), np.nan)
    for place in np.ndindex(values.shape[1:]):
        drawn = values[(slice(None), *place)]
        answered = drawn[np.isfinite(drawn)]
        if answered.size:
            quantiles[(slice(None), *place)] = np.quantile(answered, levels)
    return quantiles
