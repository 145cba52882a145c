"""Finished tasks on disk: one crash-safe file, one row per task. The only module that imports sqlite3."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from bayesterra.errors import BayesterraError, ResultError
from bayesterra.reading import parsed_json

STORE_FILE = "tasks.sqlite"
_TABLES = {
    "origin": "CREATE TABLE origin (content TEXT NOT NULL)",
    "tasks": "CREATE TABLE tasks (task INTEGER PRIMARY KEY, content TEXT NOT NULL)",
}
MOST_BYTES = 16 * 2**20
"""Of the content of one task."""


class TaskStore:
    """Finished tasks and what they were made with; every task is committed as it comes.

    A killed program loses what it had not handed over, and nothing else. Others may read while it writes.

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
        try:
            self._connection = _connected(str(path), path)
            self._connection.execute("PRAGMA journal_mode = WAL")
            self._connection.execute("PRAGMA synchronous = FULL")
            _check_tables(self._connection)
            with self._connection:
                for statement in _TABLES.values():
                    self._connection.execute(statement.replace("TABLE", "TABLE IF NOT EXISTS", 1))
            self._check(json.loads(json.dumps(made_with)))
        except (sqlite3.Error, OSError, ValueError) as error:
            if isinstance(error, BayesterraError):
                raise
            raise self._damaged(error) from error

    def _check(self, made_with: dict[str, Any]) -> None:
        """Note what the tasks are made with, or compare."""
        row = self._connection.execute("SELECT content FROM origin").fetchone()
        if row is None:
            with self._connection:
                self._connection.execute("INSERT INTO origin VALUES (?)", (json.dumps(made_with),))
            return
        before = parsed_json(str(row[0]))
        if not isinstance(before, dict):
            raise ValueError("its origin is no table")
        for name in {**before, **made_with}:
            if before.get(name) != made_with.get(name):
                raise ResultError(_difference(self._path.parent, name, before.get(name), made_with.get(name)))

    def add(self, task: int, content: Mapping[str, Any]) -> None:
        """Save one finished task; it is on the disk when this returns."""
        try:
            with self._connection:
                row = (task, json.dumps(content))
                self._connection.execute("INSERT OR REPLACE INTO tasks VALUES (?, ?)", row)
        except sqlite3.Error as error:
            raise ResultError(f"'{self._path}' cannot be written: {error}") from error

    def tasks(self) -> dict[int, dict[str, Any]]:
        """All finished tasks by number."""
        try:
            rows = self._connection.execute("SELECT task, content FROM tasks ORDER BY task").fetchall()
            return {task: parsed_json(str(content)) for task, content in rows}
        except (sqlite3.Error, ValueError) as error:
            raise self._damaged(error) from error

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


def finished_tasks(path: Path) -> int:
    """How many tasks a file holds; 0 where there is none that can be read."""
    if not path.is_file():
        return 0
    try:
        with closing(_connected(f"{path.resolve().as_uri()}?mode=ro", path)) as connection:
            _check_tables(connection)
            return int(connection.execute("SELECT count(*) FROM tasks").fetchone()[0])
    except (sqlite3.Error, OSError, ValueError):
        return 0


def _connected(where: str, path: Path) -> sqlite3.Connection:
    """A connection for which content is nothing but content; OSError where the file is a link or a device."""
    for name in (path, *(path.with_name(path.name + ending) for ending in ("-wal", "-shm", "-journal"))):
        if name.is_symlink() or (name.exists() and not name.is_file()):
            raise OSError(f"'{name.name}' is a link or no file")
    connection = sqlite3.connect(where, uri=where.startswith("file:"))
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_BYTES)
    connection.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
    connection.execute("PRAGMA trusted_schema = OFF")
    connection.execute("PRAGMA cell_size_check = ON")
    return connection


def _check_tables(connection: sqlite3.Connection) -> None:
    """ValueError where there are other tables than ours: a view or a trigger would be run by using it."""
    for kind, name, statement in connection.execute("SELECT type, name, sql FROM sqlite_master"):
        if kind != "table" or _TABLES.get(name) != statement:
            raise ValueError(f"it holds a {kind} that is not ours")


def _difference(part: Path, name: str, before: Any, now: Any) -> str:
    """One line on what does not match; digests and tables say nothing to people."""
    known = not isinstance(before, dict) and not (isinstance(before, str) and len(before) == 64)
    what = f"{name} {before}, not {now}" if known else f"another {name}"
    return f"'{part}' was made with {what}: give the same, or begin anew with --overwrite"
