"""Finished tasks on disk, one row each in a crash-safe file, and the folders that are made of them."""

from __future__ import annotations

import json
import os
import sqlite3
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from zlib import crc32

import pandas as pd

from bayesterra.errors import ResultError, checked_path
from bayesterra.runtime.folders import part_of, whole_folder, write_text
from bayesterra.runtime.ownership import TASKS, WORK
from bayesterra.runtime.reading import parsed_json

STORE_FILE = TASKS
FORMAT = 1
"""Of the tables; another one is another version's file."""
NO_DAMAGE = {
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_CANTOPEN,
}
"""Errors of the disk or the rights, which no new beginning would mend."""
BUSY = 60.0
"""Seconds for which a commit waits for readers, and a reader for a commit."""
REMOTE = {
    "nfs",
    "nfs4",
    "cifs",
    "smb3",
    "lustre",
    "gpfs",
    "beegfs",
    "ceph",
    "glusterfs",
    "9p",
    "afs",
    "pvfs2",
}
"""File systems that several machines share: they have no memory in common, which a write-ahead log needs."""
MOST_BYTES = 16 * 2**20
"""Of the content of one task."""
_TABLES = {
    "origin": "CREATE TABLE origin (content TEXT NOT NULL, sum INTEGER NOT NULL)",
    "tasks": "CREATE TABLE tasks (task INTEGER PRIMARY KEY, content TEXT NOT NULL, sum INTEGER NOT NULL)",
}


class TaskStore:
    """Finished tasks and what they were made with; every task is committed as it comes.

    A killed program, or a machine without power, loses what it had not handed over, and nothing else. Others
    may read while it writes; see :func:`read_tasks`. Every row has a checksum. A file that is removed or
    replaced by someone else is noticed by the next task.

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
        except (sqlite3.Error, OSError) as error:
            raise _damaged(path, error) from error
        try:
            _verify(self._connection)
            mode = "TRUNCATE" if _shared_by_machines(path) else "WAL"
            self._connection.execute(f"PRAGMA journal_mode = {mode}")
            self._connection.execute("PRAGMA synchronous = FULL")
            with self._connection:
                self._connection.execute("BEGIN IMMEDIATE")  # tables and format: all or nothing
                for statement in _TABLES.values():
                    self._connection.execute(statement.replace("TABLE", "TABLE IF NOT EXISTS", 1))
                self._connection.execute(f"PRAGMA user_version = {FORMAT}")
            self._identity = _identity(path)
            self._check(json.loads(json.dumps(made_with)))
        except ResultError:
            self.close()
            raise
        except (sqlite3.Error, OSError, ValueError) as error:
            self.close()
            raise _damaged(path, error) from error

    def _check(self, made_with: dict[str, Any]) -> None:
        """Note what the tasks are made with, or compare."""
        before = _origin(self._connection)
        if before is None:
            content = json.dumps(made_with)
            with self._connection:
                self._connection.execute("INSERT INTO origin VALUES (?, ?)", (content, _sum(0, content)))
            return
        for name in {**before, **made_with}:
            if before.get(name) != made_with.get(name):
                place = self._path.parent
                place = place.parent if place.name == WORK else place
                raise ResultError(_difference(place, name, before.get(name), made_with.get(name)))

    def add(self, finished: Mapping[int, Mapping[str, Any]]) -> None:
        """Save finished tasks by number, all or none; they are on the disk when this returns.

        Raises
        ------
        ResultError : they cannot be saved, or the file has gone from under this program.
        """
        texts = {task: json.dumps(content) for task, content in finished.items()}
        rows = [(task, text, _sum(task, text)) for task, text in texts.items()]
        try:
            with self._connection:
                self._connection.executemany("INSERT OR REPLACE INTO tasks VALUES (?, ?, ?)", rows)
        except sqlite3.Error as error:
            raise ResultError(f"'{self._path}' cannot be written: {error}") from error
        self._still_there()

    def _still_there(self) -> None:
        """An open file without its name takes everything, and keeps nothing."""
        try:
            same = _identity(self._path) == self._identity
        except OSError:
            same = False
        if not same:
            raise ResultError(f"'{self._path}' was removed or replaced while tasks were being saved in it")

    def tasks(self) -> dict[int, dict[str, Any]]:
        """All finished tasks by number; one whose checksum is wrong has not been done."""
        try:
            return _tasks(self._connection)
        except (sqlite3.Error, ValueError) as error:
            raise _damaged(self._path, error) from error

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def read_tasks(path: str | Path) -> pd.DataFrame:
    """Read the tasks that an unfinished calibration or design has finished, also while it runs.

    Parameters
    ----------
    path : the folder ``<out>.part`` that it works in, the folder ``<out>`` that it will be, or the file
        ``tasks.sqlite`` itself.

    Returns
    -------
    pandas.DataFrame
        One row per task, by number; mappings, such as ranks, as columns of their own. ``attrs["made_with"]``
        says with what.

    Raises
    ------
    ResultError : there is no such file, or it is damaged.
    """
    file = _store_at(checked_path("bt.read_tasks", path, "a folder of tasks"))
    try:
        with closing(_reader(file)) as connection:
            _verify(connection)
            tasks, origin = _tasks(connection), _origin(connection)
    except (sqlite3.Error, OSError, ValueError) as error:
        raise _damaged(file, error) from error
    rows = [{"task": task, **_flat(content)} for task, content in tasks.items()]
    table = pd.DataFrame(rows, columns=None if rows else ["task"])
    table.attrs["made_with"] = origin or {}
    return table


def finished_tasks(path: Path) -> int:
    """Number of tasks in a file; 0 where there is none that can be read."""
    if not path.is_file():
        return 0
    try:
        with closing(_reader(path)) as connection:
            _check_tables(connection)
            return int(connection.execute("SELECT count(*) FROM tasks").fetchone()[0])
    except (sqlite3.Error, OSError, ValueError):
        return 0


def _store_at(path: Path) -> Path:
    places = (path, path / WORK / STORE_FILE, part_of(path) / WORK / STORE_FILE)
    for place in places:
        if place.is_file():
            return place
    raise ResultError(f"'{path}' holds no finished tasks: there is no {STORE_FILE}, or all are in the result")


def _reader(path: Path) -> sqlite3.Connection:
    return _connected(f"{path.resolve().as_uri()}?mode=ro", path)


def _verify(connection: sqlite3.Connection) -> None:
    """Make sure that the file is ours, whole and of this format; what is not yet made is whole."""
    _check_tables(connection)
    (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if verdict != "ok":
        raise ValueError(str(verdict).splitlines()[-1].strip("* "))
    (number,) = connection.execute("PRAGMA user_version").fetchone()
    (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    if tables and number != FORMAT:
        raise ValueError(f"its format is {number}, not {FORMAT}")


def _origin(connection: sqlite3.Connection) -> dict[str, Any] | None:
    row = connection.execute("SELECT content, sum FROM origin").fetchone()
    if row is None:
        return None
    if _sum(0, row[0]) != row[1]:
        raise ValueError("what it was made with has a wrong checksum")
    return _table(row[0])


def _table(content: str) -> dict[str, Any]:
    table = parsed_json(str(content))
    if not isinstance(table, dict):
        raise ValueError("it holds what is no table")
    return table


def _tasks(connection: sqlite3.Connection) -> dict[int, dict[str, Any]]:
    rows: Iterable[tuple[int, str, int]] = connection.execute(
        "SELECT task, content, sum FROM tasks ORDER BY task"
    )
    return {task: _table(content) for task, content, checksum in rows if _sum(task, content) == checksum}


def _sum(task: int, content: str) -> int:
    return crc32(f"{task} {content}".encode())


def _identity(path: Path) -> tuple[int, int]:
    """Identity of a file for as long as a name means the same one; OSError where there is none."""
    status = path.stat()
    return status.st_dev, status.st_ino


def _flat(content: Mapping[str, Any]) -> dict[str, Any]:
    """A row of a table: mappings become columns."""
    inner = {
        name: value for part in content.values() if isinstance(part, dict) for name, value in part.items()
    }
    return {name: value for name, value in content.items() if not isinstance(value, dict)} | inner


def _shared_by_machines(path: Path) -> bool:
    """True where a file lies on a network file system, as far as this system says so."""
    try:
        mounts = Path("/proc/self/mounts").read_text(encoding="utf-8").splitlines()
    except OSError:
        return False
    kinds = {words[1]: words[2] for words in map(str.split, mounts) if len(words) > 2}
    place = next((str(part) for part in path.resolve().parents if str(part) in kinds), "")
    return kinds.get(place, "").removeprefix("fuse.") in REMOTE | {"sshfs"}


def _damaged(path: Path, error: Exception) -> ResultError:
    if getattr(error, "sqlite_errorcode", 0) & 0xFF in NO_DAMAGE:
        return ResultError(f"'{path}' cannot be read or written: {error}")
    return ResultError(f"'{path}' is damaged ({error}): begin anew with --overwrite")


def _connected(where: str, path: Path) -> sqlite3.Connection:
    """A connection for which content is nothing but content; OSError where the file is a link or a device."""
    for name in (path, *(path.with_name(path.name + ending) for ending in ("-wal", "-shm", "-journal"))):
        if name.is_symlink() or (name.exists() and not name.is_file()):
            raise OSError(f"'{name.name}' is a link or no file")
    connection = sqlite3.connect(where, uri=where.startswith("file:"), timeout=BUSY)
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
    readable = not isinstance(before, dict) and not (isinstance(before, str) and len(before) == 64)
    what = f"{name} {before}, not {now}" if readable else f"another {name}"
    return f"'{part}' was made with {what}: give the same, or begin anew with --overwrite"


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
    made_with, mark : see :class:`TaskStore` and :func:`bayesterra.runtime.folders.check_free`.
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
    """Work that would be lost with ``part``, in words; a damaged store is no reason to remove it either."""
    store = part / WORK / STORE_FILE
    try:
        number = len(read_tasks(store)) if store.exists() else 0
    except ResultError:
        return f"{tasks} that cannot be read"
    return f"{number} finished {tasks}" if number else ""
