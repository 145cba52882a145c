"""What a sampler notes on its way, so that it can go on from there; where it is kept is not its business."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from types import NoneType
from typing import Any, Protocol, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from bayesterra.errors import ResultError
from bayesterra.reading import UNREADABLE

T = TypeVar("T")

Segment = Mapping[str, NDArray[Any]]
"""Arrays by name."""
SAME_DENSITY = 1e-9
"""Relative difference of log densities above which a run cannot go on from what was saved."""


class Journal(Protocol):
    """Segments by name, whose content depends on nothing but the run; used from several threads."""

    def holds(self, name: str) -> bool:
        """Whether a segment was ever saved, be it damaged by now."""

    def load(self, name: str) -> Segment | None:
        """What was saved under a name; None where there is nothing, or nothing sound."""

    def save(self, name: str, segment: Segment) -> None:
        """Keep a segment; once this returns it survives the process."""


class NoJournal:
    """For runs that nobody means to resume."""

    def holds(self, name: str) -> bool:
        """See :class:`Journal`."""
        return False

    def load(self, name: str) -> Segment | None:
        """See :class:`Journal`."""
        return None

    def save(self, name: str, segment: Segment) -> None:
        """See :class:`Journal`."""


def noted(journal: Journal, name: str, kind: type[T], make: Callable[[], T]) -> T:
    """What the journal has under a name, else what ``make`` gives, which is then saved.

    Either way it is returned as it reads back, so that a resumed run has no way to go on differently.
    """
    segment = journal.load(name)
    if segment is not None:
        try:
            return unpack(kind, segment)
        except UNREADABLE:
            pass  # it is whole and of this run, but not what we save: as good as none
    segment = pack(make())
    journal.save(name, segment)
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
        parts: dict[str, NDArray[Any]] = {f"{name}.length": np.array(len(value))}
        items = {str(i): item for i, item in enumerate(value)}
    elif is_dataclass(value):
        parts, items = {}, {field.name: getattr(value, field.name) for field in fields(value)}
    elif value is None:
        return {}
    else:
        array = np.array(value, order="C")
        if array.dtype.kind not in "biuf":
            raise TypeError(f"'{name}' cannot be saved (got {type(value).__name__})")
        return {name: array}
    for key, item in items.items():
        parts |= pack(item, f"{name}.{key}" if name else key)
    return parts


def unpack(kind: type[T], segment: Segment, name: str = "") -> T:
    """Build a value of a given type from the arrays of :func:`pack`."""
    value: T = _unpacked(kind, segment, name)
    return value


def _unpacked(kind: Any, segment: Segment, name: str) -> Any:
    optional = [one for one in get_args(kind) if one is not NoneType]
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
        parts = {field.name: field.name for field in fields(kind)}
        return kind(**{part: _unpacked(hints[part], segment, prefix + part) for part in parts})  # type: ignore[operator]
    return segment[name] if get_origin(kind) is np.ndarray else kind(segment[name])
