"""The file ``status.json`` of a job at work, and the folder that a job becomes."""

import json
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from typing import Any, Self

from bayesterra.runtime.folders import whole_folder, write_text

STATUS_FILE = "status.json"
EVERY, BEAT = 0.5, 2.0
"""Seconds between two versions of the status file, at least and at most."""


class Status:
    """The file ``status.json``, for those who poll: always whole, and never older than some seconds.

    It has the same keys in every command: ``stage``, ``done`` (share, 0 to 1), ``seconds_left`` (null where
    nobody knows), ``time``, ``pid``; and where they are known ``steps`` and ``rate`` (steps per second since
    the stage began), ``ess`` and ``r_hat``. While it is open a thread of its own writes what was noted last
    again, with the time, so that a poller can tell long work from a process that is gone. Only what is noted
    says how far the work is.
    """

    def __init__(self, folder: Path) -> None:
        self._path, self._next = folder / STATUS_FILE, 0.0
        self._content: dict[str, Any] = {}
        self._zero = ("", 0, 0.0)
        self._lock, self._closed = threading.Lock(), threading.Event()
        self._beating = threading.Thread(target=self._beat, name="status", daemon=True)

    def __enter__(self) -> Self:
        self._beating.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closed.set()
        self._beating.join()
        with suppress(OSError):
            self._write()

    def note(
        self,
        stage: str,
        done: float,
        seconds_left: float | None = None,
        *,
        steps: int | None = None,
        now: bool = False,
        **figures: float,
    ) -> None:
        """Take note of how far the work is; from any thread.

        Parameters
        ----------
        steps : steps, or tasks, that have been made.
        now : write it at once; else at most twice a second.
        figures : ``ess`` and ``r_hat``.
        """
        numbers = {"done": done, "seconds_left": seconds_left, **figures}
        finite = {name: None if x is None or not isfinite(x) else x for name, x in numbers.items()}
        with self._lock:
            self._content = {"stage": stage, **finite, **self._pace(stage, steps)}
            if now or time.monotonic() >= self._next:
                self._write()

    def _pace(self, stage: str, steps: int | None) -> dict[str, float]:
        """Steps, and how many there are in a second since the stage began."""
        if steps is None:
            return {}
        clock = time.monotonic()
        if stage != self._zero[0]:
            self._zero = stage, steps, clock
        _, before, since = self._zero
        rate = {"rate": (steps - before) / (clock - since)} if steps > before and clock > since else {}
        return {"steps": steps, **rate}

    def _write(self) -> None:
        if self._content:
            stamp = {"time": datetime.now(UTC).isoformat(timespec="milliseconds"), "pid": os.getpid()}
            write_text(self._path, json.dumps({**self._content, **stamp}) + "\n")
            self._next = time.monotonic() + EVERY

    def _beat(self) -> None:
        while not self._closed.wait(BEAT):
            with self._lock, suppress(OSError):  # a full disk ends the work where it needs the disk
                self._write()


@contextmanager
def job_folder(out: Path, **how: Any) -> Iterator[tuple[Path, Status]]:
    """Work in ``<out>.part``, with a status file; in the end it is ``out``.

    Whatever ends the work early leaves what :class:`bayesterra.runtime.checkpoints.Checkpoints` has saved in
    ``<out>.part``, to be gone on with by ``resume``, also by Ctrl-C. ``how`` and errors: see
    :func:`bayesterra.runtime.folders.whole_folder`.
    """
    with whole_folder(out, **how) as part:
        with Status(part) as status:
            yield part, status
        (part / STATUS_FILE).unlink(missing_ok=True)
