"""The one door to numba, so that compiled functions keep their Python types."""

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np
from numba.core.caching import FunctionCache
from numpy.typing import NDArray

P = ParamSpec("P")
R = TypeVar("R")
Number = TypeVar("Number", float, complex)
Lanes = NDArray[Any]  # float64, or complex128 for derivatives
Whole = NDArray[np.int64]

# Products and sums may be fused; nothing is reordered, and NaN and infinity keep their meaning.
FAST = {"contract", "arcp", "nsz"}
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": FAST}


def _fingerprint() -> str:
    digest = sha256()
    for source in sorted(Path(__file__).parent.glob("_*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()


_FINGERPRINT = _fingerprint()


class _Cache(FunctionCache):  # type: ignore[misc]  # numba has no types
    """numba's cache on disk, which by itself misses changes in the functions that a cached one calls."""

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return (*super()._index_key(sig, codegen), _FINGERPRINT)


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` at its first call for each combination of argument types; cached on disk."""
    dispatcher = numba.njit(**_OPTIONS)(function)
    dispatcher._cache = _Cache(function)
    return cast(Callable[P, R], dispatcher)


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` into its callers, so that loops around it can be vectorised."""
    return cast(Callable[P, R], numba.njit(forceinline=True, **_OPTIONS)(function))
