"""An existing Dask cluster as an engine. The only module that imports dask and distributed."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Future
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from typing import Any, TypeVar

from bayesterra.errors import EngineError
from bayesterra.runtime.engines import Engine

T = TypeVar("T")

TIMEOUT = 10.0
"""Seconds in which a scheduler must answer and have a worker."""
ABSENCE = 60.0
"""Seconds without any worker after which a cluster is given up: one that died may be started again."""
GLANCE = 1.0
"""Seconds for which the number of workers is taken as known."""
CLIENT_SIDE = ("client", "comm", "core", "batched", "utils", "utils_comm")
"""Loggers of distributed that speak where a cluster is asked."""
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

    def submit(self, function: Callable[..., T], /, *arguments: Any, **keywords: Any) -> Future[T]:
        """Hand a function to the scheduler."""
        with _reaching(self._address):
            future: Future[T] = self._executor.submit(function, *arguments, **keywords)
        return future

    def meaning(self, error: Exception) -> Exception:
        """What the error of a future means."""
        from distributed import KilledWorker

        if isinstance(error, KilledWorker):
            return BrokenExecutor(str(error))
        if isinstance(error, CancelledError):
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
