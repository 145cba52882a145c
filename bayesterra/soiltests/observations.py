"""Readings of soil tests: a table in, checked arrays in SI out."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.errors import StudyError, checked_name, did_you_mean
from bayesterra.soiltests.schema import COLUMNS, DataTable
from bayesterra.study.observations import Column
from bayesterra.study.units import column_header, factor

WANTED = {
    "plate": ("test", "plate_diameter", "sinkage", "force", "pressure", "use"),
    "shear": ("test", "normal_stress", "displacement", "shear_stress", "use"),
}
"""Columns that a table may have, by kind of test."""


@dataclass(frozen=True)
class Readings:
    """Readings of several tests, SI; those of one test stand together, sorted by path.

    Attributes
    ----------
    kind : ``plate`` or ``shear``.
    tests : name of every test (t,).
    test : which test a reading is of, (m,).
    path : sinkage or shear displacement (m,), above 0.
    level : plate radius, m, or normal stress, Pa, of every reading (m,).
    stress : pressure or shear stress (m,), above 0.
    """

    kind: str
    tests: tuple[str, ...]
    test: IntArray
    path: FloatArray
    level: FloatArray
    stress: FloatArray

    def __len__(self) -> int:
        return len(self.test)

    @property
    def levels(self) -> FloatArray:
        """Plate radius or normal stress of every test (t,)."""
        return self.level[self.starts]

    @property
    def starts(self) -> IntArray:
        """First reading of every test (t,)."""
        return np.searchsorted(self.test, np.arange(len(self.tests)))

    def only(self, chosen: BoolArray) -> Readings:
        """Only the tests where ``chosen`` (t,) holds."""
        kept = chosen[self.test]
        number = np.cumsum(chosen) - 1
        return Readings(
            self.kind,
            tuple(name for name, keep in zip(self.tests, chosen, strict=True) if keep),
            number[self.test[kept]],
            *(getattr(self, name)[kept] for name in ("path", "level", "stress")),
        )


def readings(table: pd.DataFrame, kind: str, options: DataTable) -> tuple[Readings, tuple[str, ...]]:
    """Check a table of readings, convert it to SI and leave out what the options leave out.

    Parameters
    ----------
    table : columns as in the file, units in the headers.
    kind : ``plate`` or ``shear``.
    options : ranges and spacing.

    Returns
    -------
    Readings, and a sentence on every kind of reading that was left out.

    Raises
    ------
    StudyError : naming column, row, what must hold and the value got.
    """
    columns = _columns(table, kind)
    tests = _tests(columns)
    path, level, stress = _plate(columns) if kind == "plate" else _shear(columns)
    used = _use(columns)
    kept, notes = _kept(kind, (path, stress), used, options)
    if not kept.any():
        raise StudyError(f"must hold at least one reading that is used (got none; {'; '.join(notes)})")
    numbers = {name: i for i, name in enumerate(dict.fromkeys(np.array(tests, dtype=object)[kept]))}
    test = np.array([numbers.get(name, -1) for name in tests])
    order = np.lexsort((path, test))
    order = order[kept[order]]
    _check_levels(
        test[order], level[order], tuple(numbers), "plate_diameter" if kind == "plate" else "normal_stress"
    )
    wide = _spaced(test[order], np.log(path[order]), options.spacing)
    if wide.size < order.size:
        notes.append(
            f"of {order.size} readings in range {wide.size} are used: of those of one test that are closer"
            f" than {100 * options.spacing:g} % only the first"
        )
    chosen = order[wide]
    selected = Readings(kind, tuple(numbers), test[chosen], path[chosen], level[chosen], stress[chosen])
    return selected, tuple(notes)


def _columns(table: pd.DataFrame, kind: str) -> dict[str, Column]:
    wanted, columns = WANTED[kind], {}
    for position, header in enumerate(table.columns):
        name, unit = column_header(str(header))
        if name not in wanted:
            raise StudyError(f"unknown column '{header}' of {kind} tests{did_you_mean(name, wanted)}")
        if name in columns:
            raise StudyError(f"column '{name}' must appear once (it appears twice)")
        columns[name] = Column(name, list(table.iloc[:, position]), _scale(str(header), name, unit))
    needed = ("test", "plate_diameter", "sinkage") if kind == "plate" else WANTED["shear"][:-1]
    for name in needed:
        if name not in columns:
            raise StudyError(f"column '{_example(name)}' is missing")
    if kind == "plate" and ("force" in columns) == ("pressure" in columns):
        raise StudyError("plate tests need one column of 'force [N]' and 'pressure [kPa]', not both")
    return columns


def _example(name: str) -> str:
    return f"{name} [{COLUMNS[name].unit}]" if name in COLUMNS else name


def _scale(header: str, name: str, unit: str | None) -> float:
    if name not in COLUMNS:
        return 1.0
    if not unit:
        raise StudyError(f"column '{name}' needs a unit, e.g. '{_example(name)}' (got '{header}')")
    try:
        return factor(unit, COLUMNS[name].dimension)
    except StudyError as error:
        raise StudyError(f"column '{header}': {error}") from error


def _tests(columns: dict[str, Column]) -> list[str]:
    names = ["" if cell is None else str(cell).strip() for cell in columns["test"].cells]
    if "" in names:
        raise StudyError(f"'test' must name the test of every reading (empty in row {names.index('') + 1})")
    for row, name in enumerate(names, start=1):
        checked_name(name, f"'test' in row {row}")
    return names


def _complete(columns: dict[str, Column], name: str) -> FloatArray:
    values = columns[name].si()
    if np.isnan(values).any():
        row = int(np.argmax(np.isnan(values))) + 1
        raise StudyError(f"'{name}' must be given in every row (empty in row {row})")
    return values


def _positive(columns: dict[str, Column], name: str) -> FloatArray:
    values = _complete(columns, name)
    if (values <= 0).any():
        row = int(np.argmax(values <= 0))
        raise StudyError(f"'{name}' must be above 0 (got {columns[name].cells[row]}, row {row + 1})")
    return values


def _plate(columns: dict[str, Column]) -> tuple[FloatArray, FloatArray, FloatArray]:
    radius = 0.5 * _positive(columns, "plate_diameter")
    if "pressure" in columns:
        return _complete(columns, "sinkage"), radius, _complete(columns, "pressure")
    return _complete(columns, "sinkage"), radius, _complete(columns, "force") / (np.pi * radius**2)


def _shear(columns: dict[str, Column]) -> tuple[FloatArray, FloatArray, FloatArray]:
    stress = _positive(columns, "normal_stress")
    return _complete(columns, "displacement"), stress, _complete(columns, "shear_stress")


def _use(columns: dict[str, Column]) -> BoolArray:
    if "use" not in columns:
        return np.ones(len(columns["test"].cells), dtype=np.bool_)
    values = columns["use"].si()
    wrong = ~np.isin(values, (0.0, 1.0))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise StudyError(f"'use' must be 0 or 1 (got {columns['use'].cells[row]!r}, row {row + 1})")
    return np.asarray(values == 1.0)


def _kept(
    kind: str, values: tuple[FloatArray, FloatArray], used: BoolArray, options: DataTable
) -> tuple[BoolArray, list[str]]:
    """Mask (m,) of the readings that stay, and notes on why others do not."""
    path, stress = values
    names = ("sinkage", "pressure") if kind == "plate" else ("displacement", "shear stress")
    notes = [] if used.all() else [f"{int((~used).sum())} readings left out, as their 'use' is 0"]
    positive = (path > 0) & (stress > 0)
    if (used & ~positive).any():
        count = int((used & ~positive).sum())
        notes.append(f"{count} readings left out, as {names[0]} or {names[1]} is not above 0")
    ranged, bounds = (
        (stress, options.pressure_range) if kind == "plate" else (path, options.displacement_range)
    )
    kept = used & positive
    if bounds is not None:
        inside = (ranged >= bounds[0]) & (ranged <= bounds[1])
        notes.append(
            f"{int((kept & ~inside).sum())} readings outside the range that the file gives are left out"
        )
        kept &= inside
    return np.asarray(kept), notes


def _check_levels(test: IntArray, level: FloatArray, names: tuple[str, ...], column: str) -> None:
    for before, after in pairwise(range(len(test))):
        if test[before] == test[after] and level[before] != level[after]:
            unit = COLUMNS[column]
            got = (
                f"{2 * level[before] / unit.scale:g}"
                if column == "plate_diameter"
                else f"{level[before] / unit.scale:g}"
            )
            raise StudyError(
                f"'{column}' must be the same in all rows of a test (got {got} {unit.unit} and another in"
                f" test '{names[int(test[before])]}')"
            )


def _spaced(test: IntArray, along: FloatArray, spacing: float) -> IntArray:
    """Readings that are at least ``spacing`` behind the last one kept of their test; equal paths never."""
    kept, last, current = [], -np.inf, -1
    for i, (number, here) in enumerate(zip(test, along, strict=True)):
        if number != current or (here - last >= spacing and here > last):
            kept.append(i)
            last, current = here, number
    return np.array(kept, dtype=np.intp)
