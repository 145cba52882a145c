"""Checkpoints of a run: closed segments of arrays on disk, and the store that a sampler goes on from.

A segment is one file: a line with the SHA-256 of all that follows, a line of JSON that says which segment of
which run it is, and NumPy arrays (npz). It is written under another name, flushed and renamed, so a file with
the name of a segment is complete. Nothing that is read can run code.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from hashlib import sha256
from io import BytesIO
from math import prod
from pathlib import Path
from types import NoneType
from typing import Any, Protocol, TypeVar, get_args, get_origin, get_type_hints
from zipfile import ZIP_STORED, BadZipFile, ZipFile

import numpy as np
from numpy.lib.format import read_array_header_1_0, read_array_header_2_0, read_magic
from numpy.typing import NDArray

from bayesterra.errors import ResultError
from bayesterra.runtime.folders import to_disk, write_bytes, write_text
from bayesterra.runtime.ownership import SEGMENT
from bayesterra.runtime.reading import MOST_SEGMENT, UNREADABLE, parsed_json, read_bytes, read_json

BEGUN = "begun.json"
SHOWN = 40
"""Longest value, in characters, that a message shows."""

Identity = Mapping[str, Any]
"""All that a run depends on: JSON values by what they are called, ``{}`` where the value stands in it."""


@dataclass(frozen=True)
class Checkpoints:
    """Segments of one run in a folder that no other process writes to.

    Attributes
    ----------
    folder : where they are.
    run : digest of all that the run depends on; segments of another run are refused.
    notes : what was found on opening; one sentence each.
    """

    folder: Path
    run: str
    notes: tuple[str, ...] = ()

    @classmethod
    def opened(cls, folder: Path, identity: Identity) -> Checkpoints:
        """Begin a run in an existing folder, or go on with the one that was begun there.

        Damaged segments are removed, as if they had never been written.

        Raises
        ------
        ResultError : the run was begun with something else; the message says with what. Or something else
            than a file is in the place of one.
        """
        _refuse_what_is_no_file(folder)
        present = json.loads(json.dumps(identity))
        begun = _begun(folder)
        if begun is not None and begun != present:
            raise _refusal(folder, difference(begun, present))
        checkpoints = cls(folder, _digest(present))
        damaged = checkpoints._without_damage()
        if begun is None:
            record = {"run": _digest(present), "identity": present}
            write_text(folder / BEGUN, json.dumps(record, ensure_ascii=False, indent=1) + "\n")
        saved = len(list(folder.glob("*" + SEGMENT)))
        resumed = (f"going on from {saved} saved segment{'s' * (saved > 1)}",) if saved else ()
        return cls(folder, checkpoints.run, (*damaged, *resumed))

    def holds(self, name: str) -> bool:
        """True where a segment was saved."""
        return self._path(name).exists()

    def load(self, name: str) -> dict[str, NDArray[Any]] | None:
        """Read the arrays of a segment; None where it is missing or damaged.

        Raises
        ------
        ResultError : it belongs to another run.
        """
        if not self.holds(name):
            return None
        try:
            about, arrays = _read(self._path(name))
        except (*UNREADABLE, BadZipFile):
            return None
        if about != {"run": self.run, "segment": name}:
            raise _refusal(self.folder, "was begun with another study, seed or version")
        return arrays

    def save(self, name: str, segment: Mapping[str, NDArray[Any]]) -> None:
        """Write a segment, whole or not at all; safe from several threads for segments of different names."""
        arrays = BytesIO()
        np.savez(arrays, **dict[str, Any](segment))
        about = json.dumps({"run": self.run, "segment": name}).encode()
        content = b"\n".join([about, arrays.getbuffer()])
        write_bytes(self._path(name), sha256(content).hexdigest().encode() + b"\n" + content)
        to_disk(self.folder)

    def _path(self, name: str) -> Path:
        return self.folder / (name + SEGMENT)

    def _without_damage(self) -> list[str]:
        """Remove damaged segments; a sentence on each."""
        notes = []
        for path in sorted(self.folder.glob("*" + SEGMENT)):
            if self.load(path.name.removesuffix(SEGMENT)) is None:
                path.unlink()
                notes.append(f"the saved segment '{path.name}' is damaged and is made again")
        return notes


def _refuse_what_is_no_file(folder: Path) -> None:
    """Refuse a folder in the place of a file: it is not ours to remove."""
    for path in sorted((folder / BEGUN, *folder.glob("*" + SEGMENT))):
        if path.exists() and not path.is_file():
            raise ResultError(f"'{path}' is not a file: move it away")


def _read(path: Path) -> tuple[Any, dict[str, NDArray[Any]]]:
    """Record of a segment, and its arrays; ValueError where it is damaged."""
    checksum, _, content = read_bytes(path, MOST_SEGMENT).partition(b"\n")
    if sha256(content).hexdigest().encode() != checksum:
        raise ValueError("damaged")
    about, _, arrays = content.partition(b"\n")
    _check_sizes(arrays)
    with np.load(BytesIO(arrays), allow_pickle=False) as stored:
        return parsed_json(about.decode()), dict(stored)


def _check_sizes(arrays: bytes) -> None:
    """ValueError where arrays are packed, or declared larger than they are: ours are neither."""
    headers = {(1, 0): read_array_header_1_0, (2, 0): read_array_header_2_0}
    with ZipFile(BytesIO(arrays)) as packed:
        for entry in packed.infolist():
            with packed.open(entry) as member:
                shape, _, kind = headers[read_magic(member)](member)
            if entry.compress_type != ZIP_STORED or prod(shape) * kind.itemsize > len(arrays):
                raise ValueError("damaged")


def _begun(folder: Path) -> Any:
    """Identity with which a run was begun; None where that cannot be read, and its segments must tell."""
    try:
        record = read_json(folder / BEGUN)
        return record["identity"] if record["run"] == _digest(record["identity"]) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _digest(identity: Any) -> str:
    return sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()


def digest(identity: Identity) -> str:
    """SHA-256 of all that a run depends on."""
    return _digest(json.loads(json.dumps(identity)))


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


T = TypeVar("T")

Segment = Mapping[str, NDArray[Any]]
"""Arrays by name."""
SAME_DENSITY = 1e-9
"""Relative difference of log densities above which a run cannot go on from what was saved."""


class CheckpointStore(Protocol):
    """Segments by name, whose content depends on nothing but the run; used from several threads."""

    def holds(self, name: str) -> bool:
        """True where a segment was ever saved, be it damaged by now."""

    def load(self, name: str) -> Segment | None:
        """Segment that was saved under a name; None where there is nothing, or nothing sound."""

    def save(self, name: str, segment: Segment) -> None:
        """Keep a segment; once this returns it survives the process."""


class NoCheckpointStore:
    """For runs that nobody means to resume."""

    def holds(self, name: str) -> bool:
        """See :class:`CheckpointStore`."""
        return False

    def load(self, name: str) -> Segment | None:
        """See :class:`CheckpointStore`."""
        return None

    def save(self, name: str, segment: Segment) -> None:
        """See :class:`CheckpointStore`."""


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

    Parameters
    ----------
    worst : largest relative difference of the two log densities.
    """
    if not worst <= SAME_DENSITY:
        raise ResultError(
            f"the saved draws cannot be used: their log density is off by {worst:.1g} of itself when computed"
            " anew; add --overwrite in place of --resume to begin anew"
        )


def pack(value: Any, name: str = "") -> dict[str, NDArray[Any]]:
    """Lay out a value as arrays by name: arrays, numbers, tuples, dataclasses and None within each other.

    Raises
    ------
    TypeError : it holds something else.
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
        hints = get_type_hints(kind)
        prefix = f"{name}." if name else ""
        names = {field.name: field.name for field in fields(kind)}
        return kind(**{part: _unpacked(hints[part], segment, prefix + part) for part in names})  # type: ignore[operator]
    return segment[name] if get_origin(kind) is np.ndarray else kind(segment[name])
