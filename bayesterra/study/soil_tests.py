"""Soil tests of a study, plates and shear rings: checked readings, and the parameters that they read."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.errors import StudyError, did_you_mean, errors_after, errors_in, known
from bayesterra.models.soil_tests import SOIL_TESTS, SoilTestModel
from bayesterra.parameters import OFFSET, PARAMETERS, Channel, of_soil_tests, quantities
from bayesterra.stats.laws import Law
from bayesterra.study.entries import SCATTER, law_entry
from bayesterra.study.observations import Column, labels, named_columns, required, unit_scale, used_rows
from bayesterra.study.schema import SoilTestTable
from bayesterra.study.units import text

COLUMNS = quantities("soil_tests", Channel)
"""Columns that a table of readings may have, beside ``test`` and ``use``."""
PATHS = {"plate": COLUMNS["sinkage"], "shear": COLUMNS["displacement"]}
LEVELS = {"plate": COLUMNS.pop("plate_radius"), "shear": COLUMNS["normal_stress"]}
STRESSES = {"plate": COLUMNS["pressure"], "shear": COLUMNS["shear_stress"]}
"""Axis of a curve, what sets tests apart, and the answer of the soil, by kind of test."""

DEFAULTS: dict[str, Law | float] = {
    "scatter": Law("halfnorm", {"scale": 0.5}, lower=0.005),
    "memory": Law("loguniform", lower=0.1, upper=30.0),
    "seating": Law("halfnorm", {"scale": 0.5e-3}, lower=1e-6),
    OFFSET: Law("norm", {"loc": 0.0, "scale": 0.5e-3}),
}
"""Scatter of the tests, where a study does not say what is known of it."""
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
    """A series of plate or shear tests of a study.

    Attributes
    ----------
    name : of the series, with which the names of its own parameters end.
    readings : those that are used.
    names : parameter of the study by what the test calls it; shared where the study's other parts read it too.
    scatter : a law or a fixed value of every parameter of the scatter, by the study's name of it.
    stated : the table of the study that it stands in.
    table : the readings as they were given.
    notes : what was left out, and why.
    """

    name: str
    readings: "Readings"
    names: Mapping[str, str]
    scatter: Mapping[str, Law | float]
    stated: SoilTestTable
    table: pd.DataFrame = field(repr=False)
    notes: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """``plate`` or ``shear``."""
        return self.stated.test

    @property
    def independent(self) -> bool:
        """Whether readings are taken as independent of each other, as usual practice does."""
        return "memory" not in self.names

    @property
    def soil(self) -> tuple[str, ...]:
        """Soil parameters of the study that it reads, in the order of its law."""
        return tuple(self.names[name] for name in self.readings.model.parameters)

    def with_stress(self, stress: FloatArray) -> "SoilTest":
        """The same tests with other answers (m,) of the soil: simulated ones, say."""
        made = replace(self.readings, stress=stress)
        columns = {"test": np.array(made.tests)[made.test]}
        columns[f"{GIVEN[self.kind]}"] = made.level * (2.0 if self.kind == "plate" else 1.0)
        columns |= {PATHS[self.kind].name: made.path, STRESSES[self.kind].name: stress}
        units = {name: f"{name} [{COLUMNS[name].dimension}]" for name in columns if name in COLUMNS}
        stated = replace(
            self.stated, kind="simulated", source="", pressure_range=None, displacement_range=None, spacing=0.0
        )
        return replace(self, readings=made, stated=stated, table=pd.DataFrame(columns).rename(columns=units), notes=())

    def canonical(self) -> dict[str, object]:
        """Keys and values of its table of a study file, complete, with units."""
        stated = self.stated
        ranges = {name: getattr(stated, name) for name in ("pressure_range", "displacement_range")}
        ends = {n: [text(e, u) for e in ranges[n]] for n, u in zip(ranges, ("Pa", "m"), strict=True) if ranges[n]}
        tie = {own: to for own, to in stated.tie.items() if own != to}
        noise = {own: _entry(own, self.scatter[to]) for own, to in self.names.items() if to in self.scatter}
        noise |= {"independent": True} if self.independent else {}
        rest = {"spacing": stated.spacing, **({"tie": tie} if tie else {}), "noise": noise}
        origin = {"kind": stated.kind, **({"source": stated.source} if stated.source else {})}
        return {"test": self.kind, "file": self.file, **origin, **ends, **rest}

    @property
    def file(self) -> str:
        """Name of the file of its readings in a folder that a study is written into."""
        return f"soil-test-{self.name}.csv"


def _entry(name: str, entry: Law | float) -> object:
    dimension = PARAMETERS[name].dimension
    return law_entry(entry, dimension) if isinstance(entry, Law) else text(entry, dimension)


def soil_test(name: str, stated: SoilTestTable) -> SoilTest:
    """Check a series of tests and its readings.

    Raises
    ------
    StudyError : naming table, key or column, what must hold and the value got.
    """
    kind, soil = stated.test, SOIL_TESTS[stated.test].parameters
    with errors_after(f"[soil_tests.{name}] "):
        other = "displacement_range" if kind == "plate" else "pressure_range"
        if getattr(stated, other) is not None:
            raise StudyError(f"'{other}' does not go with {kind} tests")
        if stated.table is None:
            raise StudyError("needs 'file', its table of readings")
        names = {own: _tied(own, stated.tie.get(own, own)) for own in soil}
        for own in stated.tie:
            known("parameter", own, soil, "tie: ")
        entries = {n: entry for n, entry in stated.noise.items() if n != "independent"}
        for own in entries:
            known("parameter", own, SCATTER[kind], "noise: ")
        scatter = {**{own: DEFAULTS[own] for own in SCATTER[kind]}, **entries}
        if stated.noise.get("independent", False):
            scatter = {"scatter": scatter["scatter"]}
        for own in scatter:
            if own != OFFSET and (own, scatter[own]) != ("seating", 0.0):  # no seating is known
                check_above(f"noise: '{own}'", scatter[own])
    with errors_in(stated.file or f"[soil_tests.{name}]"):
        selected, notes = readings(stated.table, kind, stated)
    names |= {own: f"{own}.{name}" for own in scatter}
    laws = {names[own]: entry for own, entry in scatter.items()}
    return SoilTest(name, selected, names, laws, stated, stated.table, notes)


SHARED = ("n0", *dict.fromkeys(name for law in SOIL_TESTS.values() for name in law.parameters))
"""Parameters of a study that a test may share, beside names of its own such as ``K.ring``."""


def _tied(own: str, to: str) -> str:
    alike = PARAMETERS[to].dimension == PARAMETERS[own].dimension if to in SHARED or of_soil_tests(to) else False
    if not alike:
        raise StudyError(f"tie: '{own}' must be tied to a parameter of the soil such as n0 or {own}.ring (got '{to}')")
    return to


def check_above(what: str, entry: object) -> None:
    """StudyError where a law or a value is not above 0."""
    low = entry.range[0] if isinstance(entry, Law) else entry
    if isinstance(low, int | float) and low <= 0:
        raise StudyError(f"{what} must be above 0 (got {low:g}): give its law a 'lower'")


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
    """Readings of several tests, SI; those of one test stand together, sorted by path."""

    kind: str  # ``plate`` or ``shear``
    tests: tuple[str, ...]  # name of every test (t,)
    test: IntArray  # which test a reading is of, (m,)
    path: FloatArray  # sinkage or shear displacement (m,), above 0
    level: FloatArray  # plate radius, m, or normal stress, Pa, of every reading (m,)
    stress: FloatArray  # pressure or shear stress (m,), above 0

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

    def only(self, chosen: BoolArray) -> "Readings":
        """Only the tests where ``chosen`` (t,) holds."""
        kept = chosen[self.test]
        number = np.cumsum(chosen) - 1
        return Readings(
            self.kind,
            tuple(name for name, keep in zip(self.tests, chosen, strict=True) if keep),
            number[self.test[kept]],
            *(getattr(self, name)[kept] for name in ("path", "level", "stress")),
        )


HIGHEST_STRESS = 1e12
"""Stress, Pa, that no soil reaches: a slip of the pen."""


def readings(table: pd.DataFrame, kind: str, options: SoilTestTable) -> tuple[Readings, tuple[str, ...]]:
    """Check a table of readings, units in the headers, convert it to SI and leave out what the options say.

    Beside them, a sentence on every kind of reading that was left out; StudyError names column and row.
    """
    columns = _columns(table, kind)
    tests = labels(columns["test"])
    path, given = required(columns, PATHS[kind].name), _within(columns, GIVEN[kind])
    level = 0.5 * given if kind == "plate" else given
    read = "force" if "force" in columns else STRESSES[kind].name
    with np.errstate(over="ignore"):
        stress = required(columns, read) / (np.pi * level**2 if read == "force" else 1.0)
    if (wrong := np.abs(stress) > HIGHEST_STRESS).any():
        row = int(np.argmax(wrong))
        raise StudyError(f"'{read}' must be a stress below 1 TPa (got {columns[read].cells[row]}, row {row + 1})")
    kept, notes = _kept(kind, path, stress, used_rows(columns, len(table)), options)
    if not kept.any():
        raise StudyError(f"must hold at least one reading that is used (got none; {'; '.join(notes)})")
    numbers = {name: i for i, name in enumerate(dict.fromkeys(np.array(tests, dtype=object)[kept]))}
    test = np.array([numbers.get(name, -1) for name in tests])
    order = np.lexsort((path, test))
    order = order[kept[order]]
    column, number, each = COLUMNS[GIVEN[kind]], test[order], given[order]
    if (changes := (number[1:] == number[:-1]) & (each[1:] != each[:-1])).any():
        row = int(np.argmax(changes))
        raise StudyError(
            f"'{column.name}' must be the same in all rows of a test (got {each[row] / column.scale:g}"
            f" {column.unit} and another in test '{tuple(numbers)[number[row]]}')"
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
    kind: str, path: FloatArray, stress: FloatArray, used: BoolArray, options: SoilTestTable
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


def _spaced(test: IntArray, along: FloatArray, spacing: float) -> IntArray:
    """Readings that are at least ``spacing`` behind the last one kept of their test; equal paths never."""
    kept, last, current = [], -np.inf, -1
    for i, (number, here) in enumerate(zip(test, along, strict=True)):
        if number != current or (here - last >= spacing and here > last):
            kept.append(i)
            last, current = here, number
    return np.array(kept, dtype=np.intp)
