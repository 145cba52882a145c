"""Range checks whose messages name the quantity, the rule, the value and its row."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def as_floats(name: str, value: ArrayLike) -> FloatArray:
    """`value` as a float array; ValueError where it is not numbers or not finite."""
    try:
        if np.asarray(value).dtype == np.bool_:  # True is no length of 1 m
            raise TypeError
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"'{name}' must be a number or an array of numbers (got {value!r})") from None
    require(np.isfinite(array), name, "must be finite", array)
    return array


def require(holds: BoolArray | np.bool_ | bool, name: str, rule: str, value: ArrayLike) -> None:
    """Raise ValueError for the first element of `value` for which `holds` is false."""
    good = np.asarray(holds)
    if good.all():
        return
    good, values = np.broadcast_arrays(good, np.asarray(value))
    index = tuple(int(i) for i in np.argwhere(~good)[0])
    raise ValueError(f"'{name}' {rule} (got {values[index]:.6g}{row_suffix(index)})")


def row_suffix(index: tuple[int, ...]) -> str:
    """Text ', row 7' for an element of an array and nothing for a single number."""
    return f", row {index[0] if len(index) == 1 else index}" if index else ""


def plain(array: FloatArray) -> FloatArray | float:
    """A float for a 0-d array and the array itself otherwise."""
    return float(array) if array.ndim == 0 else array
