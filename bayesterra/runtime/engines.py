"""Engines that compute independent tasks: executors in this process, in a pool of processes here, or on a Dask cluster.

A task is a function of a number that returns the same whatever computes it; so results do not depend on the
engine. :func:`completed` runs a task for many numbers on any :class:`Engine`. The only module that imports dask.
"""

import logging
import math
import os
import pickle
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent import futures
from contextlib import contextmanager
from functools import cache, lru_cache
from importlib.metadata import PackageNotFoundError, version
from itertools import islice
from multiprocessing import connection, get_context, parent_process, resource_tracker
from types import TracebackType
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from bayesterra.errors import EngineError

T = TypeVar("T")
N = TypeVar("N", bound=Hashable)
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""Environment variables that hold libraries to some threads."""
ATTEMPTS = 3
"""Workers that may die at one task before it is given up."""


class Engine(futures.Executor):
    """An executor of ``concurrent.futures`` that says how many functions it computes at a time.

    As a context it ends its workers: in order, or at once after an error or Ctrl-C.
    """

    @property
    def starting(self) -> bool:
        """True where its workers have still to be started, which takes some seconds."""
        return False

    @property
    def workers(self) -> int:
        """How many functions it computes at a time, at the moment; EngineError where nobody is left."""
        return 1

    def dumps(self, task: object) -> bytes:
        """A task as it is handed to workers."""
        return pickle.dumps(task)

    def meaning(self, error: Exception) -> Exception | None:
        """The error of a future as the package says it; BrokenExecutor: every worker died; None: an answer was lost."""
        return error

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.shutdown(wait=kind is None, cancel_futures=kind is not None)


def packed(task: object, engine: Engine) -> bytes:
    """A task to be handed over many times, pickled once; EngineError where it cannot be pickled."""
    try:
        return engine.dumps(task)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise EngineError(
            f"the task cannot be handed to other processes ({error}): functions must stand in a module,"
            " not inside another function"
        ) from error


def run_packed(content: bytes, number: Any) -> Any:
    """Run a packed task in a worker, on one thread."""
    task = _unpacked(content)
    hold_to_one_thread()
    return task(number)


@lru_cache(maxsize=2)
def _unpacked(content: bytes) -> Callable[[Any], Any]:
    task: Callable[[Any], Any] = pickle.loads(content)  # noqa: S301  (our own, from the main process)
    return task


@cache
def hold_to_one_thread() -> None:
    """Hold the linear algebra and numba of this process to one thread, loaded libraries and later ones."""
    os.environ.update(dict.fromkeys(THREADS, "1"))
    threadpool_limits(1)
    if "numba" in sys.modules:  # it is, where models are computed; importing it would take half a second
        sys.modules["numba"].set_num_threads(1)


def usable_processors() -> int:
    """Number of processors that this process may use: one where it is held to one thread."""
    if hold_to_one_thread.cache_info().currsize:
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class InProcess(Engine):
    """Computes every function at once, here."""

    def submit(self, function: Callable[..., T], /, *arguments: Any, **keywords: Any) -> futures.Future[T]:
        """Compute a function; its errors are raised here."""
        future: futures.Future[T] = futures.Future()
        future.set_result(function(*arguments, **keywords))
        return future


class LocalPool(Engine):
    """Processes of this machine, each an executor of its own: when one dies, the others work on.

    A thread waits for each; it begins another process where its own has died, and repeats what that held.
    They start with the first function, one for each that is not waited for, and leave Ctrl-C to this process.
    """

    def __init__(self, workers: int) -> None:
        self._workers, self._ended = workers, False
        self._lanes = futures.ThreadPoolExecutor(workers, "worker", initializer=_keep_from_interrupts)
        self._own, self._lock = threading.local(), threading.Lock()
        self._begun = list[futures.ProcessPoolExecutor]()

    @property
    def workers(self) -> int:
        """Number of processes."""
        return self._workers

    @property
    def starting(self) -> bool:
        """True where no process was started yet."""
        return not self._begun

    def submit(self, function: Callable[..., T], /, *arguments: Any, **keywords: Any) -> futures.Future[T]:
        """Hand a function to the next process that has nothing to do.

        The future raises BrokenExecutor where ``ATTEMPTS`` processes died at it.
        """
        return self._lanes.submit(self._computed, function, arguments, keywords)

    def _computed(self, function: Callable[..., T], arguments: tuple[Any, ...], keywords: Any) -> T:
        attempts = 0
        while True:
            try:
                future = self._submitted(function, arguments, keywords)
            except futures.BrokenExecutor:  # it died while it waited: nobody's fault
                self._own.process = None
                continue
            try:
                return future.result()
            except futures.BrokenExecutor:
                self._own.process, attempts = None, attempts + 1
                if attempts == ATTEMPTS:
                    raise

    def _submitted(self, function: Callable[..., T], arguments: tuple[Any, ...], keywords: Any) -> futures.Future[T]:
        """Hand a function to this thread's process, which starts with the first."""
        with self._lock:
            if self._ended:
                raise RuntimeError("the pool has ended")
            process: futures.ProcessPoolExecutor | None = getattr(self._own, "process", None)
            if process is None:
                process = self._own.process = futures.ProcessPoolExecutor(1, get_context("spawn"), initializer=_start)
                self._begun.append(process)
            return process.submit(function, *arguments, **keywords)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End all processes; with ``cancel_futures`` at once, whatever they are at."""
        self._lanes.shutdown(wait and not cancel_futures, cancel_futures=cancel_futures)
        with self._lock:
            self._ended = cancel_futures or wait
        for executor in self._begun if self._ended else ():
            for process in list((executor._processes or {}).values()) if cancel_futures else ():
                process.terminate()  # from Python 3.14 on: executor.terminate_workers()
            executor.shutdown(cancel_futures=cancel_futures)  # its thread must not race with the interpreter's end


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


def _keep_from_interrupts() -> None:
    """Leave Ctrl-C to the main thread; a process that starts here inherits that until it can ignore it."""
    if hasattr(signal, "pthread_sigmask"):
        resource_tracker.ensure_running()  # which lets interrupts through as it starts
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


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


AHEAD = 2
"""Tasks handed over per worker, the one at work included: an interrupted run has little to wait for."""
PATIENCE = 4.0
"""Seconds for which short tasks are computed here before workers are started, about what starting them costs."""
GLANCE = 1.0
"""Seconds after which the number of workers is asked for again, without an outcome or of a cluster."""


def chosen(workers: int | None, scheduler: str | None) -> Engine:
    """The engine that a command's options ask for; by default a pool on all usable processors.

    EngineError where both are given, there are no workers, or no scheduler answers.
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


def _here(task: Callable[[N], T], todo: Iterator[N], seconds: float = math.inf) -> Iterator[list[tuple[N, T]]]:
    """Run tasks in this process, begin none after some seconds."""
    end = time.monotonic() + seconds
    with threadpool_limits(1):
        for number in todo:
            yield [(number, task(number))]
            if time.monotonic() > end:
                return


def _elsewhere(content: bytes, todo: Iterator[N], engine: Engine) -> Iterator[list[tuple[N, Any]]]:
    """Keep the workers busy, and hand over what they send; after an error also what they are still at."""
    waiting: dict[futures.Future[Any], N] = {}
    failure: Exception | None = None
    try:
        while True:
            wanted = 0 if failure else AHEAD * engine.workers - len(waiting)
            for number in islice(todo, max(wanted, 0)):
                waiting[engine.submit(run_packed, content, number)] = number
            if not waiting:
                break
            outcomes: list[tuple[N, Any]] = []
            for future in futures.wait(waiting, timeout=GLANCE, return_when=futures.FIRST_COMPLETED).done:
                number = waiting.pop(future)
                try:
                    outcomes.append((number, future.result()))
                except Exception as error:
                    if (meaning := _meaning(error, number, engine)) or failure:
                        failure = failure or meaning
                    else:
                        waiting[engine.submit(run_packed, content, number)] = number
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


def _meaning(error: Exception, number: object, engine: Engine) -> Exception | None:
    meaning = engine.meaning(error)
    if not isinstance(meaning, futures.BrokenExecutor):
        return meaning
    return EngineError(
        f"task {number}: every worker that took it died (was memory short? does a script lack its"
        ' if __name__ == "__main__"?); finished tasks are kept'
    )


TIMEOUT = 10.0
"""Seconds in which a scheduler must answer and have a worker."""
ABSENCE = 60.0
"""Seconds without any worker after which a cluster is given up: one that died may be started again."""
CLIENT_SIDE = ("client", "comm", "core", "batched", "utils", "utils_comm")
"""Loggers of distributed that speak where a cluster is asked."""
EXECUTOR = "distributed.cfexecutor"
"""Module of the client's executor."""
ALIKE = ("bayesterra", "numpy", "scipy", "numba", "emcee")
"""Packages that must have one version everywhere, or results may differ."""


class DaskCluster(Engine):
    """Workers of a Dask scheduler: the executor of its client.

    The scheduler runs a task again elsewhere when its worker dies, up to its ``allowed-failures``. It and its
    workers are not ended with this engine.
    """

    def __init__(self, address: str, timeout: float) -> None:
        self._address, self._client = address, _connected(address, timeout)
        self._asked, self._threads, self._seen = 0.0, 0, time.monotonic()
        try:
            self._wait_for_worker(timeout)
            with _reaching(address):
                _compare(self._client.get_versions(packages=list(ALIKE)))
        except BaseException:
            self.shutdown()
            raise
        self._executor = self._client.get_executor(pure=False)

    def _wait_for_worker(self, timeout: float) -> None:
        end = time.monotonic() + timeout
        while not self._present():
            if time.monotonic() > end:
                raise EngineError(
                    f"the Dask scheduler at '{self._address}' has no workers: start some with"
                    f" 'dask worker {self._address} --nworkers 4 --nthreads 1'"
                )
            time.sleep(0.1)

    @property
    def workers(self) -> int:
        """Threads of all workers at the moment; one where there are none, who may come within ``ABSENCE``.

        EngineError where the scheduler is gone, or none have come.
        """
        if self._client.status != "running":
            raise _gone(self._address)
        now = time.monotonic()
        if threads := self._present():
            self._seen = now
        elif now > self._seen + ABSENCE:
            raise EngineError(
                f"the Dask scheduler at '{self._address}' has had no worker for {ABSENCE:.0f} s; finished"
                " tasks are kept"
            )
        return max(threads, 1)

    def _present(self) -> int:
        now = time.monotonic()
        if now > self._asked + GLANCE or not self._threads:
            with _reaching(self._address):
                self._threads = sum(self._client.nthreads().values())
            self._asked = now
        return self._threads

    def dumps(self, task: object) -> bytes:
        """A pickle of the task, functions of a script by what they do."""
        from cloudpickle import dumps

        content: bytes = dumps(task)
        return content

    def submit(self, function: Callable[..., T], /, *arguments: Any, **keywords: Any) -> futures.Future[T]:
        """Hand a function to the scheduler."""
        with _reaching(self._address):
            future: futures.Future[T] = self._executor.submit(function, *arguments, **keywords)
        return future

    def meaning(self, error: Exception) -> Exception | None:
        """What the error of a future means."""
        from distributed import KilledWorker

        raised = [frame for frame, _ in traceback.walk_tb(error.__traceback__)][-1:]
        if any(f.f_globals["__name__"] == EXECUTOR and f.f_locals.get("typ") is not type(error) for f in raised):
            return None  # a worker died with an answer that had just been reported, and the executor stumbles
        if isinstance(error, KilledWorker):
            return futures.BrokenExecutor(str(error))
        if isinstance(error, futures.CancelledError):
            return _gone(self._address)
        if isinstance(error, ModuleNotFoundError):
            return EngineError(f"a worker of '{self._address}' lacks what the task needs: {error}")
        return error

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster; what it was asked for and has not begun is cancelled."""
        self._client.close(timeout=2)


def dask_cluster(address: str, *, timeout: float = TIMEOUT) -> Engine:
    """Compute on the workers of a Dask scheduler that runs already.

    Parameters
    ----------
    address : of the scheduler, such as ``tcp://10.0.0.5:8786``.
    timeout : seconds in which it must answer and have a worker.

    Raises
    ------
    EngineError : there is no address, the extra ``dask`` is not installed, nobody answers, there are no
        workers, or they have other versions of bayesterra or of what it computes with.
    """
    if not isinstance(address, str) or not address:  # Dask would start a cluster of its own
        raise EngineError(f"bt.dask_cluster needs an address such as tcp://10.0.0.5:8786 (got {address!r})")
    return DaskCluster(address, timeout)


def _connected(address: str, timeout: float) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        raise EngineError("a Dask cluster needs an extra: pip install 'bayesterra[dask]'") from error
    for name in CLIENT_SIDE:  # what they tell on standard error, we say in one line
        logging.getLogger(f"distributed.{name}").setLevel(logging.CRITICAL)
    try:
        connect: Any = Client  # it has no types
        return connect(address, timeout=timeout, set_as_default=False, name="bayesterra")
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        raise EngineError(
            f"no Dask scheduler answers at '{address}' within {timeout:.0f} s: start one with"
            " 'dask scheduler', and give the address that it prints (tcp://…)"
        ) from error


def _compare(versions: Any) -> None:
    """Versions here against those of the scheduler and of every worker."""
    here = {name: _version(name) for name in ALIKE}
    workers = {f"the Dask worker at '{where}'": host for where, host in versions["workers"].items()}
    for where, host in {"the Dask scheduler": versions["scheduler"], **workers}.items():
        for name in ALIKE:
            there = host["packages"].get(name)
            if there != here[name]:
                what = f"{name} {there}" if there else f"no {name}"
                raise EngineError(
                    f"{where} has {what}, here is {here[name]}: install the same everywhere, or results may differ"
                )


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _gone(address: str) -> EngineError:
    return EngineError(f"the Dask scheduler at '{address}' is gone; finished tasks are kept")


@contextmanager
def _reaching(address: str) -> Iterator[None]:
    """Turn a lost connection into one line: the scheduler does not answer."""
    try:
        yield
    except (OSError, TimeoutError) as error:  # what distributed raises for lost connections is an OSError
        raise _gone(address) from error
