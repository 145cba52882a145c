"""The one door to numba, so that compiled functions keep their Python types."""

from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np
from numba.core import caching
from numpy.typing import NDArray

P = ParamSpec("P")
R = TypeVar("R")
Number = TypeVar("Number", float, complex)
Lanes = NDArray[Any]  # float64, or complex128 for derivatives
Whole = NDArray[np.int64]

# Products and sums may be fused; nothing is reordered, and NaN and infinity keep their meaning.
FAST = {"contract", "arcp", "nsz"}
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": FAST}


@cache
def _fingerprint(folder: Path) -> str:
    """Digest of the compiled sources of the models and of another folder."""
    digest = sha256()
    for home in (Path(__file__).parent, folder):
        for source in sorted(home.glob("_*.py")):
            digest.update(source.read_bytes())
    return digest.hexdigest()


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` at its first call for each combination of argument types; cached on disk."""
    dispatcher: Any = numba.njit(**_OPTIONS)(function)
    dispatcher._cache = _cache(function)
    return cast(Callable[P, R], dispatcher)


def _cache(function: Callable[..., Any]) -> Any:
    """Return numba's cache on disk, which alone misses changes in the functions that a cached one calls."""
    new_cache: Any = caching.FunctionCache
    found: Any = new_cache(function)
    index_key = found._index_key
    sources = _fingerprint(Path(function.__code__.co_filename).parent)
    found._index_key = lambda sig, codegen: (*index_key(sig, codegen), sources)
    return found


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` into its callers, so that loops around it can be vectorised."""
    return cast(Callable[P, R], numba.njit(forceinline=True, **_OPTIONS)(function))
