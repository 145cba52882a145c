"""Engines on this machine: the process itself, and a pool of processes."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import connection, get_context, parent_process
from typing import Any, TypeVar

from bayesterra.engines.base import THREADS, Closing, Engine, WorkerDied, packed
from bayesterra.errors import EngineError

N = TypeVar("N")
T = TypeVar("T")


def usable_processors() -> int:
    """How many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class InProcess(Closing):
    """Computes every function at once, here; see :class:`bayesterra.engines.Engine`."""

    workers = 1
    elsewhere = False
    starting = False

    def packed(self, task: Callable[[N], T]) -> Callable[[N], T]:
        """Return the task itself."""
        return task

    def submit(self, function: Callable[..., T], /, *arguments: Any) -> Future[T]:
        """Compute a function; its errors are raised here."""
        future: Future[T] = Future()
        future.set_result(function(*arguments))
        return future

    def value(self, future: Future[T]) -> T:
        """Return the result of a future."""
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
        """Whether no process was started yet."""
        return not any(self._executors)

    def packed(self, task: Callable[[N], T]) -> Callable[[N], T]:
        """Pickle the task once; see :func:`bayesterra.engines.base.packed`."""
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
        """Return the result of a future; the first in a dead process is the one that it was at."""
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
