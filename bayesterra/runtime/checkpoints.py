"""Finished work on disk, piece by piece: segments of arrays of a run, tasks of a job that is made of them.

A piece is one file: a line with the SHA-256 of all that follows, a line of JSON that says which piece of
which work it is, and NumPy arrays (npz), or a task as JSON. It is written under another name, flushed and
renamed, so a file with the name of a piece is complete, and others may read while work goes on. A damaged one
is as good as none: it is made again, and takes its place. Nothing that is read can run code.
"""

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from hashlib import sha256
from io import BytesIO
from math import prod
from pathlib import Path
from types import NoneType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints
from weakref import finalize
from zipfile import ZIP_STORED, BadZipFile, ZipFile

import numpy as np
import pandas as pd
from numpy.lib.format import read_array_header_1_0, read_array_header_2_0, read_magic
from numpy.typing import NDArray

from bayesterra.errors import ResultError, checked_path, counted
from bayesterra.runtime.folders import part_of, to_disk, write_bytes, write_text
from bayesterra.runtime.ownership import BEGUN, RUN, SEGMENT, TASK, TASKS, WORK, Lock, kind_of
from bayesterra.runtime.reading import MOST_SEGMENT, UNREADABLE, parsed_json, read_bytes, read_json

SHOWN = 40
"""Longest value, in characters, that a message shows."""

Identity = Mapping[str, Any]
"""All that work depends on: JSON values by what they are called, ``{}`` where the value stands in it."""
Segment = Mapping[str, NDArray[Any]]
"""Arrays by name."""
T = TypeVar("T")


class CheckpointStore:
    """Segments by name, whose content depends on nothing but the run; used from several threads.

    This one keeps nothing: it is for runs that nobody means to resume.
    """

    def holds(self, name: str) -> bool:
        """True where a segment was ever saved, be it damaged by now."""
        return False

    def load(self, name: str) -> Segment | None:
        """Segment that was saved under a name; None where there is nothing, or nothing sound."""
        return None

    def save(self, name: str, segment: Segment) -> None:
        """Keep a segment; once this returns it survives the process."""


@dataclass(frozen=True)
class Checkpoints(CheckpointStore):
    """Finished pieces of one work in a folder that no other process writes to."""

    folder: Path  # where they are
    run: str  # digest of all that the work depends on; pieces of another work are refused
    notes: tuple[str, ...] = ()  # what was found on opening; one sentence each
    _is_there: Callable[[], bool] = lambda: True

    @classmethod
    def opened(cls, folder: Path, identity: Identity, kind: str = RUN) -> "Checkpoints":
        """Begin work in an existing folder, or go on with the one that was begun there.

        Damaged pieces are removed, as if they had never been written. ``kind`` is that of the work: a run, or
        what its tasks are called.

        Raises
        ------
        ResultError : the work was begun with something else; the message says with what. Or something else
            than a file is in the place of one, or the folder cannot be written.
        """
        try:
            return cls._opened(folder, identity, kind)
        except OSError as error:
            place = error.filename or folder
            raise ResultError(f"'{place}' cannot be read or written: {error.strerror or error}") from error

    @classmethod
    def _opened(cls, folder: Path, identity: Identity, kind: str) -> "Checkpoints":
        for path in sorted((folder / BEGUN, *folder.glob("*" + SEGMENT))):
            if path.exists() and not path.is_file():  # it is not ours to remove
                raise ResultError(f"'{path}' is not a file: move it away")
        present = json.loads(json.dumps(identity))
        begun = identity_in(folder)
        if begun is not None and begun != present:
            raise _refusal(folder, difference(begun, present))
        damaged = cls(folder, digest(present))._without_damage()
        handle = os.open(folder, os.O_RDONLY)  # while it is open, no other folder gets its number
        saved = len(_names(folder))
        resumed = [f"going on from {counted(saved, 'saved segment')}"] if saved else []
        opened = cls(folder, digest(present), (*damaged, *resumed), Lock(handle, folder))
        finalize(opened, os.close, handle)
        if begun is None:
            record = {"run": digest(present), "kind": kind, "identity": present}
            write_text(folder / BEGUN, json.dumps(record, ensure_ascii=False, indent=1) + "\n")
        return opened

    def holds(self, name: str) -> bool:
        """True where a piece was saved."""
        return self._path(name).exists()

    def load(self, name: str) -> dict[str, NDArray[Any]] | None:
        """Read the arrays of a segment; None where it is missing or damaged.

        ResultError where it belongs to another work, or to someone who lets nobody read it.
        """
        loaded: dict[str, NDArray[Any]] | None = self._load(name, _arrays)
        return loaded

    def save(self, name: str, segment: Mapping[str, NDArray[Any]]) -> None:
        """Write a segment, whole or not at all; safe from several threads for segments of different names.

        ResultError where it cannot be written, or the folder has gone from under this program.
        """
        arrays = BytesIO()
        np.savez(arrays, **dict[str, Any](segment))
        self._write({name: arrays.getbuffer()})

    def tasks(self) -> dict[int, dict[str, Any]]:
        """All finished tasks by number; a damaged one has not been done."""
        numbers = {int(name.removeprefix(TASK)): name for name in _names(self.folder) if _is_task(name)}
        contents = {number: self._load(numbers[number], _table) for number in sorted(numbers)}
        return {number: content for number, content in contents.items() if content is not None}

    def add(self, finished: Mapping[int, Mapping[str, Any]]) -> None:
        """Save finished tasks by number, each whole or not at all, once this returns; see :meth:`save`."""
        self._write({f"{TASK}{number}": json.dumps(content).encode() for number, content in finished.items()})

    def _path(self, name: str) -> Path:
        return self.folder / (name + SEGMENT)

    def _load(self, name: str, read: Callable[[bytes], Any]) -> Any:
        """Content of a piece; None where it is missing or damaged."""
        try:
            about, content = _read(self._path(name))
            loaded = read(content)
        except PermissionError as error:  # whole or not, who may not read it may not make it again
            raise _unreadable(self._path(name), error) from error
        except (*UNREADABLE, BadZipFile):
            return None
        if about != {"run": self.run, "segment": name}:
            raise _refusal(self.folder, "was begun with another study, seed or version")
        return loaded

    def _write(self, contents: Mapping[str, bytes | memoryview]) -> None:
        self._check_there()
        try:
            for name, content in contents.items():
                about = json.dumps({"run": self.run, "segment": name}).encode()
                whole = b"\n".join([about, content])
                write_bytes(self._path(name), sha256(whole).hexdigest().encode() + b"\n" + whole)
            to_disk(self.folder)
        except OSError as error:
            self._check_there()
            raise ResultError(f"'{self.folder}' cannot be written: {error.strerror or error}") from error
        self._check_there()

    def _check_there(self) -> None:
        if not self._is_there():
            raise ResultError(f"'{self.folder}' was removed or replaced while work was being saved in it")

    def _without_damage(self) -> list[str]:
        """Remove damaged pieces; a sentence on each."""
        notes = []
        for name in _names(self.folder):
            if self._load(name, _table if _is_task(name) else _arrays) is None:
                self._path(name).unlink()
                notes.append(f"the saved segment '{name}{SEGMENT}' is damaged and is made again")
        return notes


def _names(folder: Path) -> list[str]:
    return sorted(path.name.removesuffix(SEGMENT) for path in folder.glob("*" + SEGMENT))


def _is_task(name: str) -> bool:
    return name.startswith(TASK) and name.removeprefix(TASK).isdecimal()


def _read(path: Path) -> tuple[Any, bytes]:
    """Record of a piece, and its content; ValueError where it is damaged."""
    checksum, _, whole = read_bytes(path, MOST_SEGMENT).partition(b"\n")
    if sha256(whole).hexdigest().encode() != checksum:
        raise ValueError("damaged")
    about, _, content = whole.partition(b"\n")
    return parsed_json(about.decode()), content


def _table(content: bytes) -> dict[str, Any]:
    """A task; ValueError where it is none."""
    table = parsed_json(content.decode())
    if not isinstance(table, dict):
        raise ValueError("damaged")
    return table


def _arrays(content: bytes) -> dict[str, NDArray[Any]]:
    """Arrays of a segment; ValueError where they are packed, or larger than they are: ours are neither."""
    headers = {(1, 0): read_array_header_1_0, (2, 0): read_array_header_2_0}
    with ZipFile(BytesIO(content)) as packed:
        for entry in packed.infolist():
            with packed.open(entry) as member:
                shape, _, kind = headers[read_magic(member)](member)
            if entry.compress_type != ZIP_STORED or prod(shape) * kind.itemsize > len(content):
                raise ValueError("damaged")
    with np.load(BytesIO(content), allow_pickle=False) as stored:
        return dict(stored)


def identity_in(folder: Path) -> Any:
    """Identity with which work was begun; None where that is missing or damaged, and its pieces must tell."""
    try:
        record = read_json(folder / BEGUN)
        return record["identity"] if record["run"] == digest(record["identity"]) else None
    except PermissionError as error:
        raise _unreadable(folder / BEGUN, error) from error
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _unreadable(path: Path, error: OSError) -> ResultError:
    return ResultError(f"'{path}' cannot be read ({error.strerror}): ask its owner for leave to read it")


def digest(identity: Identity) -> str:
    """SHA-256 of all that a run depends on."""
    return sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()


def _refusal(folder: Path, why: str) -> ResultError:
    return ResultError(f"'{folder.parent}' {why}; add --overwrite in place of --resume to begin anew")


def difference(before: Identity, now: Identity) -> str:
    """The first thing that a run was begun with and that is different now, in words."""
    for name in [*now, *before]:
        if name not in now:
            return f"was begun with {_filled(name, before[name])}, which is gone"
        if name not in before:
            return f"was begun without {_filled(name, now[name])}"
        if before[name] != now[name]:
            return f"was begun with {_changed(name, before[name], now[name])}"
    return "was begun in another order"


def _changed(name: str, before: Any, now: Any) -> str:
    shown = [_shown(before), _shown(now)]
    if max(map(len, shown)) > SHOWN:
        return f"another {name.replace('{} ', '', 1)}"
    return f"{_filled(name, before)}, not {shown[1]}"


def _filled(name: str, value: Any) -> str:
    shown = _shown(value)
    if len(shown) > SHOWN:
        return name.replace("{} ", "", 1)
    return name.replace("{}", shown, 1) if "{}" in name else f"{name} {shown}"


def _shown(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


SAME_DENSITY = 1e-9
"""Relative difference of log densities above which a run cannot go on from what was saved."""


def load_or_compute(checkpoint_store: CheckpointStore, name: str, kind: type[T], make: Callable[[], T]) -> T:
    """Value that the store has under a name, else the one that ``make`` gives, which is then saved.

    Either way it is returned as it reads back, so that a resumed run has no way to go on differently.
    """
    segment = checkpoint_store.load(name)
    if segment is not None:
        try:
            return unpack(kind, segment)
        except UNREADABLE:
            pass  # it is whole and of this run, but not what we save: as good as none
    segment = pack(make())
    checkpoint_store.save(name, segment)
    return unpack(kind, segment)


def check_drift(worst: float) -> None:
    """Make sure that saved walkers have the density here that they had where they were saved.

    ``worst`` is the largest relative difference of the two log densities.
    """
    if not worst <= SAME_DENSITY:
        raise ResultError(
            f"the saved draws cannot be used: their log density is off by {worst:.1g} of itself when computed"
            " anew; add --overwrite in place of --resume to begin anew"
        )


def pack(value: Any, name: str = "") -> dict[str, NDArray[Any]]:
    """Lay out a value as arrays by name: arrays, numbers, tuples, dataclasses and None within each other.

    TypeError where it holds something else.
    """
    if isinstance(value, tuple) and not all(isinstance(item, int | float) for item in value):
        arrays: dict[str, NDArray[Any]] = {f"{name}.length": np.array(len(value))}
        items = {str(i): item for i, item in enumerate(value)}
    elif is_dataclass(value):
        arrays, items = {}, {field.name: getattr(value, field.name) for field in fields(value)}
    elif value is None:
        return {}
    else:
        array = np.array(value, order="C")
        if array.dtype.kind not in "biuf":
            raise TypeError(f"'{name}' cannot be saved (got {type(value).__name__})")
        return {name: array}
    for key, item in items.items():
        arrays |= pack(item, f"{name}.{key}" if name else key)
    return arrays


def unpack(kind: type[T], segment: Segment, name: str = "") -> T:
    """Build a value of a given type from the arrays of :func:`pack`."""
    value: T = _unpacked(kind, segment, name)
    return value


def _unpacked(kind: Any, segment: Segment, name: str) -> Any:
    optional = [option for option in get_args(kind) if option is not NoneType]
    if NoneType in get_args(kind):
        there = any(key == name or key.startswith(name + ".") for key in segment)
        return _unpacked(optional[0], segment, name) if there else None
    if get_origin(kind) is tuple:
        item, *_ = get_args(kind)
        if name in segment:  # plain numbers, or none
            return tuple(item(number) for number in segment[name])
        length = int(segment[f"{name}.length"])
        return tuple(_unpacked(item, segment, f"{name}.{i}") for i in range(length))
    if is_dataclass(kind):
        hints, prefix = get_type_hints(kind), f"{name}." if name else ""
        parts = {part.name: _unpacked(hints[part.name], segment, prefix + part.name) for part in fields(kind)}
        return kind(**parts)  # type: ignore[operator]
    return kind(segment[name]) if isinstance(kind, type) else segment[name]  # numbers, or arrays


def read_tasks(path: str | Path) -> pd.DataFrame:
    """Read the tasks that an unfinished calibration or design has finished, also while it runs.

    Parameters
    ----------
    path : the folder ``<out>.part`` that it works in, the folder ``<out>`` that it will be, or the folder
        ``checkpoint`` itself.

    Returns
    -------
    pandas.DataFrame
        One row per task, by number; mappings, such as ranks, as columns of their own. ``attrs["made_with"]``
        says with what.

    Raises
    ------
    ResultError : there are no such tasks, or what they were made with is damaged.
    """
    work = _work_at(checked_path("bt.read_tasks", path, "a folder of tasks"))
    identity = identity_in(work)
    if identity is None:
        raise ResultError(f"'{work / BEGUN}' is damaged")
    tasks = Checkpoints(work, digest(identity)).tasks()
    rows = [{"task": task, **_flat(content)} for task, content in tasks.items()]
    table = pd.DataFrame(rows, columns=None if rows else ["task"])
    table.attrs["made_with"] = identity
    return table


def finished_tasks(work: Path) -> int:
    """Number of finished tasks in the folder ``checkpoint`` of a job; 0 where there are none."""
    return sum(1 for _ in work.glob(f"{TASK}*{SEGMENT}"))


def _work_at(path: Path) -> Path:
    for work in (path, path / WORK, part_of(path) / WORK):
        if (work / TASKS).is_file():
            raise ResultError(f"'{work / TASKS}' was written by an older version: read it with that version")
        if (work / BEGUN).is_file() and kind_of(work) != RUN:
            return work
    raise ResultError(f"'{path}' holds no finished tasks: none was saved there, or all are in the result")


def _flat(content: Mapping[str, Any]) -> dict[str, Any]:
    """A row of a table: mappings become columns."""
    inner = {name: value for part in content.values() if isinstance(part, dict) for name, value in part.items()}
    return {name: value for name, value in content.items() if not isinstance(value, dict)} | inner
