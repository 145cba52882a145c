"""Finished tasks on disk: one crash-safe file, one row per task. The only module that imports sqlite3."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from hashlib import sha256
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from bayesterra.errors import ResultError
from bayesterra.folders import WORK

STORE_FILE = "tasks.sqlite"
DIGITS = 64
"""Of a checksum, before the content of a task."""


class TaskStore:
    """Finished tasks and what they were made with; every task is committed as it comes.

    A killed program loses what it had not handed over, and nothing else. Others may read while it writes.
    Every task carries a checksum of itself and of what it was made with; one that fails it is as good as
    never saved.

    Parameters
    ----------
    path : the file, made where it does not exist.
    made_with : whatever must be the same for tasks to belong together, by names fit for a message.

    Raises
    ------
    ResultError : the file is damaged, or its tasks were made with something else.
    """

    def __init__(self, path: Path, made_with: Mapping[str, Any]) -> None:
        self._path = path
        self._origin = json.dumps(made_with, sort_keys=True)
        try:
            self._connection = sqlite3.connect(path)
            self._connection.execute("PRAGMA journal_mode = WAL")
            self._connection.execute("PRAGMA synchronous = FULL")
            with self._connection:
                self._connection.execute("CREATE TABLE IF NOT EXISTS origin (content TEXT NOT NULL)")
                self._connection.execute(
                    "CREATE TABLE IF NOT EXISTS tasks (task INTEGER PRIMARY KEY, content TEXT NOT NULL)"
                )
            self._check(json.loads(self._origin))
        except sqlite3.Error as error:
            raise self._damaged(error) from error

    def _check(self, made_with: dict[str, Any]) -> None:
        """Note what the tasks are made with, or compare."""
        row = self._connection.execute("SELECT content FROM origin").fetchone()
        if row is None:
            with self._connection:
                self._connection.execute("INSERT INTO origin VALUES (?)", (self._origin,))
            return
        try:
            before = dict(json.loads(row[0]))
        except (TypeError, ValueError) as error:
            raise self._damaged(error) from error
        for name in {**before, **made_with}:
            if before.get(name) != made_with.get(name):
                place = self._path.parent
                place = place.parent if place.name == WORK else place
                raise ResultError(_difference(place, name, before.get(name), made_with.get(name)))

    def add(self, task: int, content: Mapping[str, Any]) -> None:
        """Save one finished task; it is on the disk when this returns."""
        try:
            with self._connection:
                row = (task, self._signed(task, json.dumps(content)))
                self._connection.execute("INSERT OR REPLACE INTO tasks VALUES (?, ?)", row)
        except sqlite3.Error as error:
            raise ResultError(f"'{self._path}' cannot be written: {error}") from error

    def tasks(self) -> dict[int, dict[str, Any]]:
        """All finished tasks by number, but for damaged ones."""
        try:
            rows = self._connection.execute(
                "SELECT task, CAST(content AS BLOB) FROM tasks ORDER BY task"
            ).fetchall()
        except sqlite3.Error as error:
            raise self._damaged(error) from error
        read = ((task, (signed or b"").decode("utf-8", "replace")) for task, signed in rows)
        pairs = ((task, signed, signed[DIGITS:]) for task, signed in read)
        return {task: json.loads(text) for task, signed, text in pairs if signed == self._signed(task, text)}

    def _signed(self, task: int, text: str) -> str:
        return sha256(f"{self._origin} {task} {text}".encode()).hexdigest() + text

    def _damaged(self, error: Exception) -> ResultError:
        return ResultError(f"'{self._path}' is damaged ({error}): begin anew with --overwrite")

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def finished_tasks(path: Path) -> int | None:
    """How many tasks a file holds, 0 where there is no file; None where it cannot be read."""
    if not path.exists() or (path.is_file() and not path.stat().st_size):
        return 0
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as connection:
            return int(connection.execute("SELECT count(*) FROM tasks").fetchone()[0])
    except sqlite3.Error as error:
        return 0 if "no such table" in str(error) else None  # killed before there was one


def _difference(part: Path, name: str, before: Any, now: Any) -> str:
    """One line on what does not match; digests and tables say nothing to people."""
    known = not isinstance(before, dict) and not (isinstance(before, str) and len(before) == 64)
    what = f"{name} {before}, not {now}" if known else f"another {name}"
    return f"'{part}' was made with {what}: give the same, or begin anew with --overwrite"
