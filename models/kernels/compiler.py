"""The one door to numba, so that compiled functions keep their Python types."""

import gc
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np
from llvmlite.binding import parse_assembly
from numba.core import compiler, types
from numba.core.codegen import JITCodeLibrary
from numba.core.types import functions
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


def called(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` for what is compiled, by which alone it is called."""
    return _part(function, False)


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` into its callers, so that loops around it can be vectorised; else as `called`."""
    return _part(function, True)


def _part(function: Callable[P, R], inline: bool) -> Callable[P, R]:
    """Dispatcher of a function that Python does not call: it has no wrapper."""
    dispatcher: Any = numba.njit(pipeline_class=_Called, forceinline=inline, **_OPTIONS)(function)
    dispatcher.add_overload = lambda made: dispatcher.overloads.update({tuple(made.signature.args): made})
    return cast(Callable[P, R], _once_for_all_values(dispatcher))


class _Alone(compiler.Compiler):
    """A compiler of functions that do not share machine code with others.

    Where two functions call a third, numba keeps a copy of the third with each, optimised for it, and runs
    the copy that was compiled or loaded first for both. So the last digit of a sum hung on what else a
    process had done, and on whether it had compiled or read from disk. Here each runs its own copy.
    """

    def compile_extra(self, function: Any) -> Any:
        """Compile a function, into a library of its own."""
        new: Any = _Whole  # numba has no types
        library = new(self.state.targetctx.codegen(), function.__qualname__)
        library.enable_object_caching()
        self.state.library = library
        self.state.flags.no_cfunc_wrapper = True  # of use to C alone
        compile_with: Any = super().compile_extra
        with _operations_resolved_once(), _no_garbage_collected():
            return compile_with(function)


class _Called(compiler.Compiler):
    """A compiler of parts: of functions that have no machine code but in those that call them."""

    def compile_extra(self, function: Any) -> Any:
        """Compile a function down to code that can be linked with its callers'."""
        new: Any = _Part
        library, flags = new(self.state.targetctx.codegen(), function.__qualname__), self.state.flags
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        self.state.library = library
        compile_with: Any = super().compile_extra
        made = compile_with(function)
        as_key = partial(_refuse, function.__name__)
        self.state.targetctx.insert_user_function(as_key, made.fndesc, [library])
        return made._replace(entry_point=as_key)


def _refuse(name: str, *_arguments: object) -> None:
    raise TypeError(f"'{name}' can be called from compiled code only")


_HEADS = re.compile(r"^(define .*\)(?: (?:local_)?unnamed_addr)?)", re.MULTILINE)


class _Whole(JITCodeLibrary):
    """Machine code of a function and of its own copies of all that it calls."""

    def _optimize_final_module(self) -> None:
        """Optimise, then part: what callers may inline, and what runs.

        LLVM leaves half of the registers of 512 bits unused, as short loops gained nothing from them in old processors.
        """
        wide = r'\1 "prefer-vector-width"="512"'
        self._final_module = parse_assembly(_HEADS.sub(wide, str(self._final_module)))
        optimise: Any = super()._optimize_final_module
        optimise()
        runs = self._final_module
        self._shared_module = runs.clone()
        for code, old, new in ((self._shared_module, "external", "linkonce_odr"), (runs, "linkonce_odr", "internal")):
            for function in code.functions:
                if not function.is_declaration and function.linkage.name == old:
                    function.linkage = new


class _Part(JITCodeLibrary):
    """Code for callers to link with; machine code is made of theirs."""

    def _optimize_final_module(self) -> None:
        """Leave it to the callers, whose code is optimised with all parts in it: once is as fast, to the last bit."""

    def _finalize_final_module(self) -> None:
        note_globals: Any = self._finalize_dynamic_globals
        note_globals()
        self._finalized = True


_VALUES = (types.Number, types.Boolean, types.Array, types.BaseTuple, types.SliceType)
_resolved: dict[tuple[Any, tuple[Any, ...]], Any] = {}


@contextmanager
def _operations_resolved_once() -> Iterator[None]:
    """Let numba find once for all what an operation on values of some types is.

    For every product in a source, and again when it makes code of it, numba tries the dozens of meanings that a
    product can have, and always takes the same one: two fifths of all compiling.
    """
    kind: Any = functions.BaseFunction
    find = kind.get_call_type

    def found(operation: Any, context: Any, arguments: Any, named: Any) -> Any:
        if named or not all(isinstance(each, _VALUES) for each in arguments):
            return find(operation, context, arguments, named)
        key = (operation, tuple(arguments))
        if key not in _resolved:
            _resolved[key] = find(operation, context, arguments, named)
        return _resolved[key]

    kind.get_call_type = found
    try:
        yield
    finally:
        kind.get_call_type = find


@contextmanager
def _no_garbage_collected() -> Iterator[None]:
    """Let Python not look for garbage among the objects of a compilation: there is none, and they are millions."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


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
