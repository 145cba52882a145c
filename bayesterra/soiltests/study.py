"""A soil-test file and its readings, read and checked: what is to be analysed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.errors import StudyError, checked_path, did_you_mean, errors_in
from bayesterra.models.soil_tests import SOIL_TESTS, SoilTestModel
from bayesterra.parameters import Channel
from bayesterra.runtime.folders import write_text
from bayesterra.runtime.reading import MOST_TOML, read_text
from bayesterra.runtime.tables import csv_text
from bayesterra.soiltests.schema import (
    COLUMNS,
    KINDS,
    NOISE,
    PATHS,
    QUANTITIES,
    REFERENCE,
    STRESSES,
    Content,
    DataTable,
    ReferenceTable,
    checked,
)
from bayesterra.stats.laws import Law
from bayesterra.study.canonical import assignments, law_entry, toml_table
from bayesterra.study.observations import Column, labels, named_columns, read_table, required, unit_scale, used_rows
from bayesterra.study.schema import SamplingOptions, read_toml
from bayesterra.study.units import text

DEFAULTS: dict[str, Law | float] = {
    "scatter": Law("halfnorm", {"scale": 0.5}, lower=0.005),
    "memory": Law("loguniform", lower=0.1, upper=30.0),
    "seating": Law("halfnorm", {"scale": 0.5e-3}, lower=1e-6),
    "sinkage_offset": Law("norm", {"loc": 0.0, "scale": 0.5e-3}),
}
"""Scatter of the tests, where a file does not say what is known of it."""
EXAMPLES = {
    "kc": '{ dist = "uniform", lower = "-500 kPa m", upper = "500 kPa m" }',
    "kphi": '{ dist = "uniform", lower = "-20000 kPa", upper = "20000 kPa" }',
    "n": '{ dist = "uniform", lower = 0.3, upper = 2.0 }',
    "c": '{ dist = "uniform", lower = "0 kPa", upper = "5 kPa" }',
    "phi": '{ dist = "uniform", lower = "0 deg", upper = "50 deg" }',
    "K": '{ dist = "uniform", lower = "2 mm", upper = "50 mm" }',
}


@dataclass(frozen=True)
class SoilTest:
    """Readings of one kind of test, and what is known beforehand.

    Attributes
    ----------
    readings : those that are used.
    entries : a law or a fixed value of every parameter, in the order of ``QUANTITIES``.
    reference : sinkage z (m) at which laws of the moduli are stated, as laws of k_c z^n and k_φ z^n; 1 m:
        of k_c and k_φ.
    independent : whether readings are taken as independent of each other, as usual practice does.
    published, truth : values known from elsewhere.
    content : the tables as they were given, checked; with ``table`` the study again.
    table : the table as it was given.
    notes : what was left out, and why.
    """

    readings: Readings
    entries: Mapping[str, Law | float]
    reference: float
    independent: bool
    published: ReferenceTable | None
    truth: ReferenceTable | None
    sampling: SamplingOptions
    content: Content
    table: pd.DataFrame = field(repr=False)
    notes: tuple[str, ...] = ()
    text: str = field(default="", repr=False)

    @property
    def kind(self) -> str:
        """``plate`` or ``shear``."""
        return self.content.test

    @property
    def soil(self) -> tuple[str, ...]:
        """Soil parameters of this kind of test."""
        return KINDS[self.kind]


def soil_test(table: pd.DataFrame, tables: Mapping[str, Any], *, bare: bool = True, text: str = "") -> SoilTest:
    """A soil test from a table of readings and the tables of its file.

    Parameters
    ----------
    table : readings, units in the headers.
    tables : as in a file; ``data.file`` names the table in the copy that a result keeps.
    bare : numbers are SI values.
    text : the file itself, where there is one.

    Raises
    ------
    StudyError : naming table, key or column, what must hold and the value got.
    """
    content = checked(tables, bare=bare)
    kind = content.test
    other = "displacement_range" if kind == "plate" else "pressure_range"
    if getattr(content.data, other) is not None:
        raise StudyError(f"[data] '{other}' does not go with {kind} tests")
    entries = _entries(content)
    selected, notes = readings(table, kind, content.data)
    return SoilTest(
        readings=selected, entries=entries, reference=_reference(content),
        independent=content.noise.independent, published=content.published, truth=content.truth,
        sampling=content.sampling, content=content, table=table, notes=notes, text=text,
    )  # fmt: skip


def _entries(content: Content) -> dict[str, Law | float]:
    kind, noise = content.test, content.noise
    soil = KINDS[kind]
    priors = {name: entry for name, entry in content.priors.items() if name != REFERENCE}
    for table, stated, names in (("priors", priors, soil), ("noise", noise.values, NOISE[kind])):
        for name in stated:
            if name not in names:
                raise StudyError(f"[{table}] '{name}' is no parameter of {kind} tests (known: {', '.join(names)})")
    for name in soil:
        if name not in priors:
            raise StudyError(f"[priors] needs '{name}', e.g. {name} = {EXAMPLES[name]}")
    scatter: dict[str, Law | float] = {**{name: DEFAULTS[name] for name in NOISE[kind]}, **noise.values}
    if noise.independent:
        scatter = {"scatter": scatter["scatter"]}
    both = {**priors, **scatter}
    for table, name in (("noise", "scatter"), ("noise", "memory"), ("priors", "K"), ("noise", "seating")):
        if name in both and (name, both[name]) != ("seating", 0.0):  # no seating is known
            _check_within(table, name, both[name])
    return {name: both[name] for name in QUANTITIES if name in both}


def _reference(content: Content) -> float:
    """The sinkage at which laws of the moduli are stated, m."""
    sinkage = content.priors.get(REFERENCE)
    if not isinstance(sinkage, int | float):
        return 1.0
    if content.test == "shear" or any(not isinstance(content.priors.get(name), Law) for name in KINDS["plate"]):
        raise StudyError(f"[priors] '{REFERENCE}' goes with plate tests whose kc, kphi and n all have laws")
    if sinkage <= 0:
        raise StudyError(f"[priors] '{REFERENCE}' must be above 0 (got {sinkage:g} m)")
    return float(sinkage)


def _check_within(table: str, name: str, entry: Law | float) -> None:
    if (low := (entry.range[0] if isinstance(entry, Law) else entry)) <= 0:
        raise StudyError(f"[{table}] '{name}' must be above 0 (got {low:g}): give its law a 'lower'")


def load_soil_test(path: str | Path) -> SoilTest:
    """Read a soil-test file, or a folder that holds ``soiltest.toml``, and its table.

    Raises
    ------
    StudyError : naming file, table, key or column, what must hold and the value got.
    """
    path = checked_path("bt.load_soil_test", path, "a soil-test file")
    path = path / "soiltest.toml" if path.is_dir() else path
    with errors_in(path):
        tables = read_toml(path)
        content = checked(tables, bare=False)
    file = path.parent / content.data.file
    with errors_in(file):
        table = read_table(file)
    with errors_in(path):
        try:
            return soil_test(table, tables, bare=False, text=read_text(path, MOST_TOML))
        except StudyError as error:
            if str(error).startswith("["):
                raise
            raise StudyError(f"in {content.data.file}: {error}") from error


def write_soil_test(test: SoilTest, folder: Path) -> None:
    """Write a soil test as ``soiltest.toml`` and ``readings.csv``, such that reading them gives it back."""
    write_text(folder / "soiltest.toml", "\n".join(_lines(test)) + "\n")
    write_text(folder / "readings.csv", csv_text(test.table))


def _lines(test: SoilTest) -> Iterator[str]:
    """The file again, complete: defaults written out, the table beside it."""
    content, data = test.content, test.content.data
    yield from assignments({"title": content.title, "soil": content.soil, "test": content.test})
    rows: dict[str, object] = {"file": "readings.csv", "kind": data.kind, "source": data.source}
    for name, unit in (("pressure_range", "Pa"), ("displacement_range", "m")):
        ends = getattr(data, name)
        if ends is not None:
            rows[name] = [text(end, unit) for end in ends]
    yield from toml_table("data", {**rows, "spacing": data.spacing})
    entries = {name: _entry(name, entry) for name, entry in test.entries.items()}
    noise = {name: entry for name, entry in entries.items() if name not in test.soil}
    yield from toml_table("noise", {"independent": True, **noise} if test.independent else noise)
    stated = {REFERENCE: text(test.reference, "m")} if test.reference != 1.0 else {}
    yield from toml_table("priors", {**stated, **{name: entries[name] for name in test.soil}})
    for name, reference in (("published", test.published), ("truth", test.truth)):
        if reference is not None:
            yield from toml_table(name, _stated(reference))
    yield from toml_table("sampling", asdict(test.sampling))


def _entry(name: str, entry: Law | float) -> object:
    dimension = QUANTITIES[name].dimension
    return law_entry(entry, dimension) if isinstance(entry, Law) else text(entry, dimension)


def _stated(reference: ReferenceTable) -> dict[str, object]:
    values = {name: text(value, QUANTITIES[name].dimension) for name, value in reference.values.items()}
    return {"source": reference.source, **values}


WANTED = {
    "plate": ("test", "plate_diameter", "sinkage", "force", "pressure", "use"),
    "shear": ("test", "normal_stress", "displacement", "shear_stress", "use"),
}
"""Columns that a table may have, by kind of test."""
GIVEN = {"plate": "plate_diameter", "shear": "normal_stress"}
"""Column that is the same in all rows of a test."""
LIMITS = {"plate_diameter": (1e-6, 1e3, "from 0.001 mm to 1 km"), "normal_stress": (1e-6, 1e15, "from 1e-6 to 1e15 Pa")}


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
    def model(self) -> SoilTestModel:
        """The law of the mean stress."""
        return SOIL_TESTS[self.kind]

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
    """Check a table of readings, units in the headers, convert it to SI and leave out what the options say.

    Beside them, a sentence on every kind of reading that was left out; StudyError names column and row.
    """
    columns = _columns(table, kind)
    tests = labels(columns["test"])
    path, given = required(columns, PATHS[kind].name), _within(columns, GIVEN[kind])
    level = 0.5 * given if kind == "plate" else given
    if "force" in columns:
        stress = required(columns, "force") / (np.pi * level**2)
    else:
        stress = required(columns, STRESSES[kind].name)
    kept, notes = _kept(kind, path, stress, used_rows(columns, len(table)), options)
    if not kept.any():
        raise StudyError(f"must hold at least one reading that is used (got none; {'; '.join(notes)})")
    numbers = {name: i for i, name in enumerate(dict.fromkeys(np.array(tests, dtype=object)[kept]))}
    test = np.array([numbers.get(name, -1) for name in tests])
    order = np.lexsort((path, test))
    order = order[kept[order]]
    _check_levels(test[order], given[order], tuple(numbers), COLUMNS[GIVEN[kind]])
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
    def scale(header: str, name: str, unit: str | None) -> float:
        if name not in WANTED[kind]:
            raise StudyError(f"unknown column '{header}' of {kind} tests{did_you_mean(name, WANTED[kind])}")
        return unit_scale(header, name, unit, COLUMNS[name]) if name in COLUMNS else 1.0

    columns = named_columns(table, scale, WANTED[kind])
    needed = ("test", "plate_diameter", "sinkage") if kind == "plate" else WANTED["shear"][:-1]
    for name in needed:
        if name not in columns:
            header = COLUMNS[name].header if name in COLUMNS else name
            raise StudyError(f"column '{header}' is missing")
    if kind == "plate" and ("force" in columns) == ("pressure" in columns):
        raise StudyError("plate tests need one column of 'force [N]' and 'pressure [kPa]', not both")
    return columns


def _within(columns: dict[str, Column], name: str) -> FloatArray:
    """A column within its limits; StudyError says them."""
    values, (least, most, said) = required(columns, name), LIMITS[name]
    if (wrong := (values < least) | (values > most)).any():
        row = int(np.argmax(wrong))
        raise StudyError(f"'{name}' must be {said} (got {columns[name].cells[row]}, row {row + 1})")
    return values


def _kept(
    kind: str, path: FloatArray, stress: FloatArray, used: BoolArray, options: DataTable
) -> tuple[BoolArray, list[str]]:
    """Mask (m,) of the readings that stay, and notes on why others do not."""
    notes = [] if used.all() else [f"{int((~used).sum())} readings left out, as their 'use' is 0"]
    positive = (path > 0) & (stress > 0)
    if (used & ~positive).any():
        count, names = int((used & ~positive).sum()), (PATHS[kind].name, STRESSES[kind].name)
        notes.append(f"{count} readings left out, as {' or '.join(names)} is not above 0".replace("_", " "))
    kept, bounds = used & positive, options.pressure_range or options.displacement_range
    if bounds is not None:
        ranged = stress if kind == "plate" else path
        inside = (ranged >= bounds[0]) & (ranged <= bounds[1])
        notes.append(f"{int((kept & ~inside).sum())} readings outside the range that the file gives are left out")
        kept &= inside
    return np.asarray(kept), notes


def _check_levels(test: IntArray, given: FloatArray, names: tuple[str, ...], column: Channel) -> None:
    for before, after in pairwise(range(len(test))):
        if test[before] == test[after] and given[before] != given[after]:
            raise StudyError(
                f"'{column.name}' must be the same in all rows of a test (got"
                f" {given[before] / column.scale:g} {column.unit} and another in test"
                f" '{names[int(test[before])]}')"
            )


def _spaced(test: IntArray, along: FloatArray, spacing: float) -> IntArray:
    """Readings that are at least ``spacing`` behind the last one kept of their test; equal paths never."""
    kept, last, current = [], -np.inf, -1
    for i, (number, here) in enumerate(zip(test, along, strict=True)):
        if number != current or (here - last >= spacing and here > last):
            kept.append(i)
            last, current = here, number
    return np.array(kept, dtype=np.intp)
