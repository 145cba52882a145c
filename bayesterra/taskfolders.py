"""Folders that are made of many tasks: what is finished is kept, and an interrupted making goes on."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

from bayesterra.errors import ResultError
from bayesterra.folders import WORK, whole_folder, write_text
from bayesterra.taskstore import STORE_FILE, TaskStore, read_tasks

STATUS_FILE = "status.json"
EVERY, BEAT = 0.5, 2.0
"""Seconds between two versions of the status file, at least and at most."""


class Status:
    """The file ``status.json``, for those who poll: always whole, and never older than some seconds.

    While it is open a thread of its own writes what was noted last again, with the time, so that a poller
    can tell long work from a process that is gone. Only what is noted says how far the work is.
    """

    def __init__(self, folder: Path) -> None:
        self._path, self._next = folder / STATUS_FILE, 0.0
        self._content: Mapping[str, Any] | None = None
        self._lock, self._closed = threading.Lock(), threading.Event()
        self._beating = threading.Thread(target=self._beat, name="status", daemon=True)

    def __enter__(self) -> Self:
        self._beating.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closed.set()
        self._beating.join()

    def note(self, content: Mapping[str, Any], *, now: bool = False) -> None:
        """Take note of how far the work is; written at most twice a second, or ``now``. From any thread."""
        with self._lock:
            self._content = content
            if now or time.monotonic() >= self._next:
                self._write()

    def write(self) -> None:
        """Write what was noted last."""
        with self._lock:
            self._write()

    def _write(self) -> None:
        if self._content is not None:
            stamp = {"time": datetime.now(UTC).isoformat(timespec="milliseconds"), "pid": os.getpid()}
            write_text(self._path, json.dumps({**self._content, **stamp}) + "\n")
            self._next = time.monotonic() + EVERY

    def _beat(self) -> None:
        while not self._closed.wait(BEAT):
            with suppress(OSError):  # a full disk ends the work where it needs the disk
                self.write()


@contextmanager
def task_folder(
    out: Path,
    made_with: Mapping[str, Any],
    *,
    mark: str,
    tasks: str = "tasks",
    resume: bool = False,
    overwrite: bool = False,
) -> Iterator[tuple[Path, TaskStore, Status]]:
    """Work in ``<out>.part``, with a store of finished tasks and a status file; in the end it is ``out``.

    Whatever ends the work early leaves ``<out>.part`` to be gone on with by ``resume``, also by Ctrl-C.

    Parameters
    ----------
    made_with, mark : see :class:`TaskStore` and :func:`bayesterra.folders.check_free`.
    tasks : what tasks are called in messages.

    Raises
    ------
    ResultError : ``out`` exists (and ``overwrite`` is not given) or cannot be written; another process works
        there; there are finished tasks, of something else or without ``resume``.
    """

    def unfinished(part: Path) -> str:
        return _finished(part, tasks)

    with whole_folder(out, mark=mark, resume=resume, overwrite=overwrite, unfinished=unfinished) as part:
        with Status(part) as status, TaskStore(part / WORK / STORE_FILE, made_with) as store:
            try:
                yield part, store, status
            finally:
                status.write()
        (part / STATUS_FILE).unlink(missing_ok=True)


def _finished(part: Path, tasks: str) -> str:
    """What would be lost with ``part``, in words; a damaged store is no reason to remove it either."""
    store = part / WORK / STORE_FILE
    try:
        number = len(read_tasks(store)) if store.exists() else 0
    except ResultError:
        return f"{tasks} that cannot be read"
    return f"{number} finished {tasks}" if number else ""
