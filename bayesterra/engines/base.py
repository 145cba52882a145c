"""What an engine is, and how tasks reach it."""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import cache, lru_cache
from hashlib import sha256
from types import TracebackType
from typing import Any, Protocol, Self, TypeVar

from bayesterra.errors import EngineError

N = TypeVar("N")
T = TypeVar("T")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""Environment variables that hold libraries to some threads."""


class WorkerDied(Exception):  # noqa: N818  (it says what happened; whether it is an error is decided later)
    """A worker ended before its task did.

    Attributes
    ----------
    at_work : whether the worker was at this very task; others only waited for it.
    final : whether the engine has tried often enough itself.
    """

    def __init__(self, *, at_work: bool, final: bool = False) -> None:
        super().__init__("a worker died")
        self.at_work, self.final = at_work, final


class Engine(Protocol):
    """Computes functions, much as a ``concurrent.futures.Executor`` does; a context that ends its workers.

    Attributes
    ----------
    workers : how many functions it computes at a time, at the moment.
    elsewhere : whether other processes compute; functions and their results are then pickled.
    starting : whether its workers have still to be started, which takes some seconds.
    """

    @property
    def workers(self) -> int: ...  # noqa: D102

    @property
    def elsewhere(self) -> bool: ...  # noqa: D102

    @property
    def starting(self) -> bool: ...  # noqa: D102

    def packed(self, task: Callable[[N], T]) -> Callable[[N], T]:
        """Return the task as it is best handed over many times; see :func:`packed`."""

    def submit(self, function: Callable[..., T], /, *arguments: Any) -> Future[T]:
        """Begin to compute ``function(*arguments)``."""

    def value(self, future: Future[T]) -> T:
        """Return what a future that has ended holds, or raise what the function raised.

        Futures are asked in the order in which they were submitted.

        Raises
        ------
        WorkerDied : it holds nothing, and may be submitted again.
        EngineError : it holds nothing, and there is nobody to submit it to.
        """

    def check(self) -> None:
        """Make sure that somebody is there to compute; called when nothing has ended for a while.

        Raises
        ------
        EngineError : nobody is.
        """

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the workers that were started here; with ``cancel_futures`` at once, whatever they are at."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Closing:
    """An engine's end as a context: in order, or at once after an error or Ctrl-C."""

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """See :class:`Engine`."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.shutdown(wait=kind is None, cancel_futures=kind is not None)


@dataclass(frozen=True)
class Packed:
    """A pickled task that a worker unpacks once, however many numbers it is called with.

    Attributes
    ----------
    key : by which a worker knows it again.
    content : the pickle.
    """

    key: str
    content: bytes = field(compare=False, repr=False)

    def __call__(self, number: Any) -> Any:
        """Run the task in a worker, on one thread."""
        task = _unpacked(self)
        hold_to_one_thread()
        return task(number)


def packed(task: Callable[[N], T], dumps: Callable[[Any], bytes] = pickle.dumps) -> Callable[[N], T]:
    """Pickle a task once.

    Raises
    ------
    EngineError : it cannot be pickled.
    """
    try:
        content = dumps(task)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise EngineError(
            f"the task cannot be handed to other processes ({error}): functions must stand in a module,"
            " not inside another function"
        ) from error
    return Packed(sha256(content).hexdigest(), content)


@lru_cache(maxsize=2)
def _unpacked(parcel: Packed) -> Callable[[Any], Any]:
    found: Callable[[Any], Any] = pickle.loads(parcel.content)  # noqa: S301  (our own, from the main process)
    return found


@cache
def hold_to_one_thread() -> None:
    """Hold the linear algebra and numba of this process to one thread, loaded libraries and later ones."""
    from threadpoolctl import threadpool_limits

    os.environ.update(dict.fromkeys(THREADS, "1"))
    threadpool_limits(1)
    if "numba" in sys.modules:  # it is, where models are computed; importing it would take half a second
        sys.modules["numba"].set_num_threads(1)
