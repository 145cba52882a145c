"""A soil-test file read and checked: what is to be analysed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from bayesterra.errors import StudyError, checked_path, errors_in
from bayesterra.runtime.folders import write_text
from bayesterra.runtime.reading import MOST_TOML, read_text
from bayesterra.runtime.tables import csv_text
from bayesterra.soiltests.observations import Readings, readings
from bayesterra.soiltests.schema import KINDS, NOISE, QUANTITIES, REFERENCE, Content, ReferenceTable, checked
from bayesterra.stats.laws import Law
from bayesterra.study.canonical import assignments, law_entry, toml_table
from bayesterra.study.observations import read_table
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


def soil_test(
    table: pd.DataFrame, tables: Mapping[str, Any], *, bare: bool = True, text: str = ""
) -> SoilTest:
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
        readings=selected,
        entries=entries,
        reference=_reference(content),
        independent=content.noise.independent,
        published=content.published,
        truth=content.truth,
        sampling=content.sampling,
        content=content,
        table=table,
        notes=notes,
        text=text,
    )


def _entries(content: Content) -> dict[str, Law | float]:
    kind, noise = content.test, content.noise
    soil = KINDS[kind]
    priors = {name: entry for name, entry in content.priors.items() if name != REFERENCE}
    for table, stated, names in (("priors", priors, soil), ("noise", noise.values, NOISE[kind])):
        for name in stated:
            if name not in names:
                raise StudyError(
                    f"[{table}] '{name}' is no parameter of {kind} tests (known: {', '.join(names)})"
                )
    for name in soil:
        if name not in priors:
            raise StudyError(f"[priors] needs '{name}', e.g. {name} = {EXAMPLES[name]}")
    scatter: dict[str, Law | float] = {**{name: DEFAULTS[name] for name in NOISE[kind]}, **noise.values}
    if noise.independent:
        scatter = {"scatter": scatter["scatter"]}
    both = {**priors, **scatter}
    _check_positive("noise", {name: both[name] for name in ("scatter", "memory") if name in both})
    _check_positive("priors", {"K": both["K"]} if "K" in both else {})
    if "seating" in both and both["seating"] != 0.0:
        _check_positive("noise", {"seating": both["seating"]})
    return {name: both[name] for name in QUANTITIES if name in both}


def _reference(content: Content) -> float:
    """The sinkage at which laws of the moduli are stated, m."""
    sinkage = content.priors.get(REFERENCE)
    if not isinstance(sinkage, int | float):
        return 1.0
    if content.test == "shear" or any(
        not isinstance(content.priors.get(name), Law) for name in KINDS["plate"]
    ):
        raise StudyError(f"[priors] '{REFERENCE}' goes with plate tests whose kc, kphi and n all have laws")
    if sinkage <= 0:
        raise StudyError(f"[priors] '{REFERENCE}' must be above 0 (got {sinkage:g} m)")
    return float(sinkage)


def _check_positive(table: str, entries: Mapping[str, Law | float]) -> None:
    for name, entry in entries.items():
        if (low := _lowest(entry)) <= 0:
            raise StudyError(f"[{table}] '{name}' must be above 0 (got {low:g}): give its law a 'lower'")


def _lowest(entry: Law | float) -> float:
    return entry.range[0] if isinstance(entry, Law) else entry


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
    sampling = test.sampling
    yield from toml_table(
        "sampling", {name: getattr(sampling, name) for name in sampling.__dataclass_fields__}
    )


def _entry(name: str, entry: Law | float) -> object:
    dimension = QUANTITIES[name].dimension
    return law_entry(entry, dimension) if isinstance(entry, Law) else text(entry, dimension)


def _stated(reference: ReferenceTable) -> dict[str, object]:
    values = {name: text(value, QUANTITIES[name].dimension) for name, value in reference.values.items()}
    return {"source": reference.source, **values}
