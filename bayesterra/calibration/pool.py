"""Independent tasks over worker processes: the same outcomes whatever the number of workers."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from multiprocessing import get_context
from typing import TypeVar

from threadpoolctl import threadpool_limits

from bayesterra.errors import ResultError

T = TypeVar("T")


def outcomes(task: Callable[[int], T], numbers: Iterable[int], workers: int) -> Iterator[T]:
    """Run a task for every number, and hand over what it returns as soon as it is there.

    With one worker in this process, with several in new ones (then ``task`` is pickled, and a script needs
    its ``if __name__ == "__main__"``), each held to one thread of BLAS and numba.

    Raises
    ------
    ResultError : a worker died.
    """
    if workers == 1:
        yield from map(task, numbers)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_start) as pool:
        try:
            yield from _completed(pool, task, iter(numbers), 2 * workers)
        except BrokenProcessPool as error:
            raise ResultError("a worker process died (was memory short?); finished tasks are kept") from error
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _completed(
    pool: ProcessPoolExecutor, task: Callable[[int], T], numbers: Iterator[int], ahead: int
) -> Iterator[T]:
    """Keep a few tasks ahead of the workers, so that an interrupted run has little to wait for."""
    waiting: set[Future[T]] = set()
    while True:
        waiting |= {pool.submit(task, number) for number in islice(numbers, ahead - len(waiting))}
        if not waiting:
            return
        done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
        yield from (future.result() for future in done)


def _start() -> None:
    """In a new worker: leave Ctrl-C to the main process, and use one thread."""
    import numba

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threadpool_limits(1)
    numba.set_num_threads(1)
