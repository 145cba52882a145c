"""Folders that are made of many tasks: what is finished is kept, and an interrupted making goes on."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from bayesterra.errors import ResultError
from bayesterra.folders import WORK, whole_folder, write_text
from bayesterra.taskstore import STORE_FILE, TaskStore, read_tasks

STATUS_FILE = "status.json"
EVERY = 0.5
"""Seconds between two versions of the status file."""


class Status:
    """The file ``status.json``, for those who poll: replaced whole, at most twice a second and at the end."""

    def __init__(self, folder: Path) -> None:
        self._path, self._next = folder / STATUS_FILE, 0.0
        self._waiting: Mapping[str, Any] | None = None

    def note(self, content: Mapping[str, Any]) -> None:
        """Take note of how far the work is."""
        self._waiting = content
        if time.monotonic() >= self._next:
            self.write()

    def write(self) -> None:
        """Write what was noted last, where it was not."""
        if self._waiting is not None:
            write_text(self._path, json.dumps({**self._waiting, "process": os.getpid()}) + "\n")
            self._waiting, self._next = None, time.monotonic() + EVERY


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
        status = Status(part)
        with TaskStore(part / WORK / STORE_FILE, made_with) as store:
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
