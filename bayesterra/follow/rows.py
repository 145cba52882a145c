"""Rows as they come in: one row read and checked, and all rows so far in arrays that grow geometrically."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from hashlib import sha256

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.errors import StudyError, did_you_mean
from bayesterra.parameters import CHANNELS
from bayesterra.study import assembly
from bayesterra.study.observations import LABELS, SD_SUFFIX, Observations, observations
from bayesterra.study.study import Study
from bayesterra.study.units import quantity

FIRST_CAPACITY = 64
SIDES = {"": 0.0, "<": -1.0, ">": 1.0}
"""Side of its limit on which a reading lies that is known by one only."""


def table_of(values: Mapping[str, object]) -> pd.DataFrame:
    """A table of one row from values by column: SI numbers or text with a unit.

    Names with a unit in them, as ``sinkage [mm]``, are columns of a table already and stay as they are.

    Raises
    ------
    StudyError : an unknown name, or a value that is no quantity of its kind.
    """
    cells: dict[str, object] = {}
    for name, value in values.items():
        if "[" in name or name in ("wheel", "use", *LABELS):
            cells[name] = value
        elif isinstance(value, str) and value.strip()[:1] in ("<", ">"):
            mark, limit = value.strip()[0], table_of({name: value.strip()[1:]})
            cells |= {header: f"{mark}{cell}" for header, cell in zip(limit.columns, limit.iloc[0], strict=True)}
        elif value is not None and not (isinstance(value, float) and np.isnan(value)):
            channel = CHANNELS.get(name.removesuffix(SD_SUFFIX))
            if channel is None:
                raise StudyError(f"unknown column '{name}'{did_you_mean(name, [*CHANNELS, 'wheel'])}")
            unit = f" [{channel.dimension}]" if channel.dimension else ""
            cells[name + unit] = quantity(value, channel.dimension, name, bare=True)
    return pd.DataFrame({name: [value] for name, value in cells.items()})


def read_row(study: Study, table: pd.DataFrame, number: int, references: Mapping[str, str]) -> Observations:
    """Check a table of one row and bring it to the form of the study's rows.

    Parameters
    ----------
    study : gives wheels, drive and noise.
    table : one row, columns as in the measurement files.
    number : of the row in the stream; messages name it.
    references : ``slip_reference`` and ``sinkage_reference``; see :class:`bayesterra.study.study.Study`.

    Raises
    ------
    StudyError : naming row, column, what must hold and the value got.
    """
    if len(table) != 1:
        raise StudyError(f"one row is added at a time (got {len(table)} rows)")
    try:
        row = observations(table, study.wheels, **references)
        row, _ = assembly.conditioned(row, study.drive)
        if not len(row) or not row.use[0]:
            raise StudyError("'use' must be 1 in a row that is added (got 0, row 1)")
        _check_noise(study, row)
        assembly.outcome_noise(row, study.noise, study.drive, expected=True)
    except StudyError as error:
        text = str(error).replace("row 1)", f"row {number})")
        raise StudyError(text if f"row {number}" in text else f"row {number}: {text}") from error
    return replace(assembly.awaited(row, study.noise, study.drive), rows=(number,))


def _check_noise(study: Study, row: Observations) -> None:
    for name, values in row.values.items():
        if name not in study.noise and name not in study.drive.idle and not np.isnan(values[0]):
            channels = ", ".join(study.noise)
            raise StudyError(f"[noise] has no entry for the measured channel '{name}' (it has {channels}; row 1)")


@dataclass
class Rows:
    """All rows of a stream. Memory: at most twice what the rows themselves need.

    Attributes
    ----------
    wheels : names of the study's wheels.
    channels : measured channels that are kept, besides slip and load.
    by : a column of labels that is kept, too, as it says which group a row belongs to; else empty.
    """

    wheels: tuple[str, ...]
    channels: tuple[str, ...]
    by: str = ""
    _cells: FloatArray = field(init=False)
    _wheel: IntArray = field(init=False)
    _label: list[str] = field(default_factory=list, init=False)
    _length: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._cells = np.empty((FIRST_CAPACITY, 2 + 3 * len(self.channels)))
        self._wheel = np.empty(FIRST_CAPACITY, dtype=np.int64)

    @classmethod
    def of(cls, study: Study) -> Rows:
        """An empty store for the rows of a study."""
        by = study.pooling.by if study.pooling else ""
        channels = (*(("sinkage",) if study.drive.by_sinkage else ()), *study.noise)
        return cls(tuple(study.wheels), channels, by if by in LABELS else "")

    def __len__(self) -> int:
        return self._length

    def append(self, rows: Observations) -> None:
        """Add one or more rows at the end."""
        end = self._length + len(rows)
        while end > len(self._cells):
            self._cells = np.concatenate([self._cells, np.empty_like(self._cells)])
            self._wheel = np.concatenate([self._wheel, np.empty_like(self._wheel)])
        none = np.full(len(rows), np.nan)
        values = [rows.values.get(name, none) for name in self.channels]
        sd = [rows.given_sd.get(name, none) for name in self.channels]
        sides = [[SIDES[mark] for mark in rows.marks(name)] for name in self.channels]
        self._cells[self._length : end] = np.column_stack([rows.slip, rows.load, *values, *sd, *sides])
        self._label[self._length :] = rows.label(self.by) if self.by else ()
        self._wheel[self._length : end] = [self.wheels.index(name) for name in rows.wheel]
        self._length = end

    @property
    def digest(self) -> str:
        """SHA-256 of all rows."""
        cells, wheel = self._cells[: self._length], self._wheel[: self._length]
        cells, sides = np.split(cells, [2 + 2 * len(self.channels)], axis=1)
        content = np.where(np.isnan(cells), np.nan, cells).tobytes() + wheel.tobytes()
        more = (sides.tobytes() if sides.any() else b"") + "\n".join(self._label[: self._length]).encode()
        return sha256(content + more).hexdigest()

    def cut(self, number: int) -> None:
        """Forget all rows after the first ``number``."""
        self._length = number

    def first(self, number: int | None = None) -> Observations:
        """The first ``number`` rows, by default all; views, not copies."""
        return self.between(0, self._length if number is None else number)

    def between(self, start: int, end: int) -> Observations:
        """Rows ``start`` to ``end``, counted from 0, the last one excluded; their numbers stay."""
        cells = self._cells[start:end].view()
        cells.flags.writeable = False
        k = len(self.channels)
        limits = {}
        for i, name in enumerate(self.channels):
            value, side = cells[:, 2 + i], cells[:, 2 + 2 * k + i]
            if side.any():
                ends = np.where(side < 0, value, -np.inf), np.where(side > 0, value, np.inf)
                limits[name] = np.column_stack(ends)
        return Observations(
            wheel=tuple(self.wheels[code] for code in self._wheel[start:end]), slip=cells[:, 0],
            load=cells[:, 1], values={name: cells[:, 2 + i] for i, name in enumerate(self.channels)},
            given_sd={name: cells[:, 2 + k + i] for i, name in enumerate(self.channels)},
            use=np.ones(end - start, dtype=np.bool_), rows=tuple(range(start + 1, end + 1)),
            labels={self.by: tuple(self._label[start:end])} if self.by else {}, limits=limits,
        )  # fmt: skip
