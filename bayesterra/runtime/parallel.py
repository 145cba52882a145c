"""One task for many numbers, on any engine: as they end, whatever dies on the way."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from itertools import islice
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from bayesterra.errors import EngineError
from bayesterra.runtime.dask import dask_cluster
from bayesterra.runtime.engines import (
    Engine,
    InProcess,
    in_process,
    local_pool,
    packed,
    run_packed,
    usable_processors,
)

N = TypeVar("N", bound=Hashable)
T = TypeVar("T")

AHEAD = 2
"""Tasks handed over per worker, the one at work included: an interrupted run has little to wait for."""
PATIENCE = 4.0
"""Seconds for which short tasks are computed here, before workers are started for the rest: about what
starting them costs."""
GLANCE = 1.0
"""Seconds without an outcome after which the engine is asked again how many workers there are."""


def chosen(workers: int | None, scheduler: str | None) -> Engine:
    """The engine that a command's options ask for; by default a pool on all usable processors.

    Raises
    ------
    EngineError : both are given, there are no workers, or no scheduler answers.
    """
    if scheduler is not None:
        if workers is not None:
            raise EngineError("'--workers' are those of this machine: leave it out with '--scheduler'")
        return dask_cluster(scheduler)
    number = usable_processors() if workers is None else workers
    return in_process() if number == 1 else local_pool(number)


def completed(
    task: Callable[[N], T], numbers: Iterable[N], engine: Engine, *, short: bool = False
) -> Iterator[tuple[N, T]]:
    """Run a task for every number; yields (number, outcome) as they end, in any order; see :func:`ended`."""
    for batch in ended(task, numbers, engine, short=short):
        yield from batch


def ended(
    task: Callable[[N], T], numbers: Iterable[N], engine: Engine, *, short: bool = False
) -> Iterator[list[tuple[N, T]]]:
    """Run a task for every number; yields all (number, outcome) that have ended since the last time.

    Linear algebra is held to one thread everywhere, so outcomes are the same on all engines. Tasks whose
    worker died are run again. What waits is cancelled when the iteration ends early.

    Parameters
    ----------
    task : picklable for engines with other processes; what it raises is raised here.
    numbers : of the tasks, or whatever tells them apart and is quick to hand over.
    short : tasks may all be over before workers have started. The first are then computed here, and
        workers are started only if some are left after ``PATIENCE`` seconds.

    Raises
    ------
    EngineError : every worker that took a task died, or nobody is left to compute.
    """
    todo = iter(numbers)
    if isinstance(engine, InProcess):
        yield from _here(task, todo)
        return
    content = packed(task, engine)  # before anything is computed here that the task may keep
    if short and engine.starting:
        yield from _here(task, todo, PATIENCE)
    yield from _elsewhere(content, todo, engine)


def _here(
    task: Callable[[N], T], todo: Iterator[N], seconds: float = math.inf
) -> Iterator[list[tuple[N, T]]]:
    """Run tasks in this process, begin none after some seconds."""
    end = time.monotonic() + seconds
    with threadpool_limits(1):
        for number in todo:
            yield [(number, task(number))]
            if time.monotonic() > end:
                return


def _elsewhere(content: bytes, todo: Iterator[N], engine: Engine) -> Iterator[list[tuple[N, Any]]]:
    """Keep the workers busy, and hand over what they send; after an error also what they are still at."""
    waiting: dict[Future[Any], N] = {}
    failure: Exception | None = None
    try:
        while True:
            wanted = 0 if failure else AHEAD * engine.workers - len(waiting)
            for number in islice(todo, max(wanted, 0)):
                waiting[engine.submit(run_packed, content, number)] = number
            if not waiting:
                break
            outcomes: list[tuple[N, Any]] = []
            for future in wait(waiting, timeout=GLANCE, return_when=FIRST_COMPLETED).done:
                number = waiting.pop(future)
                try:
                    outcomes.append((number, future.result()))
                except Exception as error:
                    failure = failure or _meaning(error, number, engine)
            if outcomes:
                yield outcomes
            for future in list(waiting) if failure else ():
                if future.cancel():
                    del waiting[future]
    finally:
        for future in waiting:
            future.cancel()
    if failure:
        raise failure


def _meaning(error: Exception, number: object, engine: Engine) -> Exception:
    meaning = engine.meaning(error)
    if not isinstance(meaning, BrokenExecutor):
        return meaning
    return EngineError(
        f"task {number}: every worker that took it died (was memory short? does a script lack its"
        ' if __name__ == "__main__"?); finished tasks are kept'
    )
