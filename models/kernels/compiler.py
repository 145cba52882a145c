"""The one door to numba, so that compiled functions keep their Python types."""

from collections.abc import Callable
from functools import partial
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np
from numba.core import compiler, types
from numpy.typing import NDArray

from bayesterra.models.kernels.cache import CompiledFiles

P = ParamSpec("P")
R = TypeVar("R")
Number = TypeVar("Number", float, complex)
Lanes = NDArray[Any]  # float64, or complex128 for derivatives
Whole = NDArray[np.int64]

# Products and sums may be fused; nothing is reordered, and NaN and infinity keep their meaning.
FAST = {"contract", "arcp", "nsz"}
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": FAST}


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` at its first call for each combination of argument types; kept on disk."""
    dispatcher: Any = numba.njit(pipeline_class=_Alone, **_OPTIONS)(function)
    dispatcher._cache = CompiledFiles(function)
    return cast(Callable[P, R], _once_for_all_values(dispatcher))


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` into its callers, so that loops around it can be vectorised."""
    return cast(Callable[P, R], _once_for_all_values(numba.njit(forceinline=True, **_OPTIONS)(function)))


class _Alone(compiler.Compiler):
    """A compiler of functions that do not share machine code with others.

    Where two functions call a third, numba keeps a copy of the third with each, optimised for it, and runs
    the copy that was compiled or loaded first for both. So the last digit of a sum hung on what else a
    process had done, and on whether it had compiled or read from disk. Here each runs its own copy.
    """

    def compile_extra(self, function: Any) -> Any:
        """Compile a function, into a library of its own."""
        library = self.state.targetctx.codegen().create_library(function.__qualname__)
        library.enable_object_caching()
        library._optimize_final_module = partial(_optimised, library, library._optimize_final_module)
        self.state.library = library
        compile_with: Any = super().compile_extra  # numba has no types
        return compile_with(function)


def _optimised(library: Any, optimise: Callable[[], None]) -> None:
    """Optimise a library's code, then part it: what callers may inline, and what runs with copies that are its own."""
    optimise()
    runs = library._final_module
    library._shared_module = runs.clone()
    for code, old, new in ((library._shared_module, "external", "linkonce_odr"), (runs, "linkonce_odr", "internal")):
        for function in code.functions:
            if not function.is_declaration and function.linkage.name == old:
                function.linkage = new


def _once_for_all_values(dispatcher: Any) -> Any:
    """Let callers in compiled code ask for whole numbers, where numba would compile anew for each constant.

    A call such as `f(x, 2)` has the argument types of any other whole number: the same code, which the
    optimiser still sees the constant of, and a seventh of all compiling is saved.
    """
    asked: Any = dispatcher.get_call_template
    plain: Any = types.unliteral

    def of_types(arguments: Any, named: Any) -> Any:
        return asked([plain(kind) for kind in arguments], {name: plain(kind) for name, kind in named.items()})

    dispatcher.get_call_template = of_types
    return dispatcher
