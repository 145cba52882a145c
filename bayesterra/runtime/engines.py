"""Engines that compute independent tasks: this process, or a pool of processes on this machine.

A task is a function of a number that returns the same whatever computes it; so results do not depend on the
engine. :func:`bayesterra.runtime.parallel.completed` runs a task for many numbers on any :class:`Engine`.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, lru_cache
from hashlib import sha256
from multiprocessing import connection, get_context, parent_process
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
        """The task as it is best handed over many times; see :func:`packed`."""

    def submit(self, function: Callable[..., T], /, *arguments: Any) -> Future[T]:
        """Begin to compute ``function(*arguments)``."""

    def value(self, future: Future[T]) -> T:
        """The value of a future that has ended; raises what the function raised.

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
    task: Callable[[Any], Any] = pickle.loads(parcel.content)  # noqa: S301  (our own, from the main process)
    return task


@cache
def hold_to_one_thread() -> None:
    """Hold the linear algebra and numba of this process to one thread, loaded libraries and later ones."""
    from threadpoolctl import threadpool_limits

    os.environ.update(dict.fromkeys(THREADS, "1"))
    threadpool_limits(1)
    if "numba" in sys.modules:  # it is, where models are computed; importing it would take half a second
        sys.modules["numba"].set_num_threads(1)


def usable_processors() -> int:
    """Number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class InProcess(Closing):
    """Computes every function at once, here; see :class:`bayesterra.runtime.engines.Engine`."""

    workers = 1
    elsewhere = False
    starting = False

    def packed(self, task: Callable[[N], T]) -> Callable[[N], T]:
        """The task itself."""
        return task

    def submit(self, function: Callable[..., T], /, *arguments: Any) -> Future[T]:
        """Compute a function; its errors are raised here."""
        future: Future[T] = Future()
        future.set_result(function(*arguments))
        return future

    def value(self, future: Future[T]) -> T:
        """The result of a future."""
        return future.result()

    def check(self) -> None:
        """Somebody is always there."""


class LocalPool(Closing):
    """Processes of this machine, each an executor of its own: when one dies, the others work on.

    They start with the first function, one for each that is not waited for, and leave Ctrl-C to this process.
    """

    elsewhere = True

    def __init__(self, workers: int) -> None:
        self._executors: list[ProcessPoolExecutor | None] = [None] * workers
        self._open = [0] * workers
        self._homes: dict[Future[Any], tuple[int, ProcessPoolExecutor]] = {}
        self._dead: set[ProcessPoolExecutor] = set()

    @property
    def workers(self) -> int:
        """Number of processes."""
        return len(self._executors)

    @property
    def starting(self) -> bool:
        """True where no process was started yet."""
        return not any(self._executors)

    def packed(self, task: Callable[[N], T]) -> Callable[[N], T]:
        """Pickle the task once; see :func:`bayesterra.runtime.engines.packed`."""
        return packed(task)

    def submit(self, function: Callable[..., T], /, *arguments: Any) -> Future[T]:
        """Hand a function to the process that has least to do."""
        place = self._open.index(min(self._open))
        executor = self._executors[place] or self._begun(place)
        with _undisturbed():
            try:
                future = executor.submit(function, *arguments)
            except BrokenProcessPool:  # it died while it waited: nobody's fault
                executor = self._begun(place)
                future = executor.submit(function, *arguments)
        self._homes[future] = place, executor
        self._open[place] += 1
        return future

    def _begun(self, place: int) -> ProcessPoolExecutor:
        made = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_start)
        self._executors[place] = made
        return made

    def value(self, future: Future[T]) -> T:
        """The result of a future; the first in a dead process is the one that it was at."""
        place, executor = self._homes.pop(future)
        self._open[place] -= 1
        try:
            return future.result()
        except BrokenProcessPool:
            if self._executors[place] is executor:
                self._executors[place] = None
            at_work = executor not in self._dead
            self._dead.add(executor)
            raise WorkerDied(at_work=at_work) from None

    def check(self) -> None:
        """Processes are started as they are needed."""

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End all processes; with ``cancel_futures`` at once."""
        for executor in filter(None, self._executors):
            processes = list((executor._processes or {}).values())
            executor.shutdown(wait=wait and not cancel_futures, cancel_futures=cancel_futures)
            for process in processes if cancel_futures else ():
                process.terminate()  # from Python 3.14 on: executor.terminate_workers()
        self._executors = [None] * len(self._executors)


def in_process() -> Engine:
    """Compute in this process, one task after the other."""
    return InProcess()


def local_pool(workers: int | None = None) -> Engine:
    """Compute in several processes of this machine; a script needs its ``if __name__ == "__main__"``.

    Parameters
    ----------
    workers : processes; by default one per usable processor.

    Raises
    ------
    EngineError : no whole number, or fewer than one.
    """
    number = usable_processors() if workers is None else workers
    if isinstance(number, bool) or not isinstance(number, int) or number < 1:
        raise EngineError(f"'workers' must be at least 1 (got {number!r})")
    return LocalPool(number)


def _start() -> None:
    """In a new worker: leave Ctrl-C to the main process, end with it however it ends, and use one thread."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.environ.update(dict.fromkeys(THREADS, "1"))


def _end_with_parent() -> None:
    """Wait until the process that started this one is gone, then go too: a killed one cannot ask for it."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Keep Ctrl-C waiting: a process that starts now inherits that, and is silent until it can ignore it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
