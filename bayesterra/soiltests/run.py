"""The command ``soiltest``: a soil-test file in, a result folder with its report out."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from math import isfinite
from pathlib import Path
from typing import Any, Self

import pandas as pd

from bayesterra.errors import check_kind, check_seed
from bayesterra.report.failures import with_failures
from bayesterra.runtime.folders import check_free, whole_folder, write_text
from bayesterra.runtime.netcdf import write_tree
from bayesterra.runtime.status import job_folder
from bayesterra.runtime.tables import csv_text
from bayesterra.sampling.sampler import Progress
from bayesterra.soiltests.analysis import SoilTestResult, analyse
from bayesterra.soiltests.schema import QUANTITIES, REFERENCE, ReferenceTable
from bayesterra.soiltests.study import SoilTest, load_soil_test
from bayesterra.soiltests.study import soil_test as from_tables
from bayesterra.stats.laws import Law
from bayesterra.study.canonical import assignments, law_entry, toml_table
from bayesterra.study.units import text

TABLES = ("summary", "least_squares", "identifiability", "left_out", "bands")


class SavedSoilTest(SoilTestResult):
    """The result of a soil test that can be saved as a folder with its report."""

    @classmethod
    def of(cls, result: SoilTestResult) -> Self:
        """The same result, with a report to write."""
        return cls(**{field.name: getattr(result, field.name) for field in fields(SoilTestResult)})

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write everything into a new folder, whole or not at all; returns the path of the report.

        Raises
        ------
        ResultError : the folder exists (and ``overwrite`` is not given) or cannot be written.
        """
        with whole_folder(Path(folder), overwrite=overwrite) as part:
            self._write(part)
        return Path(folder) / "report.html"

    def _write(self, part: Path) -> Self:
        """Write all files; returns the result with what could not be made of its report in the record."""
        from bayesterra.soiltests.page import soil_test_and_failures

        page, failures = soil_test_and_failures(self)
        whole = replace(self, record=with_failures(self.record, failures))
        write_tree(self.draws, part / "draws.nc")
        for name in TABLES:
            write_text(part / f"{name}.csv", csv_text(getattr(self, name), "%.6g"))
        write_text(part / "run.json", json.dumps(_plain(whole.record), indent=1, ensure_ascii=False) + "\n")
        write_text(part / "report.html", page)
        write_text(part / "soiltest.toml", "\n".join(_lines(self.test)) + "\n")
        write_text(part / "readings.csv", csv_text(self.test.table))
        return whole


def soil_test(
    test: SoilTest | str | Path | None = None,
    *,
    data: pd.DataFrame | None = None,
    seed: int = 1,
    progress: Callable[[Progress], None] = lambda update: None,
    **tables: Any,
) -> SavedSoilTest:
    """Sample what plate or shear tests tell of their soil, and set it beside least squares.

    Parameters
    ----------
    test : a soil-test file, the folder of one, or a loaded test.
    data : in place of a file: readings with units in the headers; further keywords are then the tables of the
        file (``kind="plate"``, ``priors``, ``noise``, ...), with numbers in SI, and options of [data] by
        name.
    seed : same seed, same draws on one machine.
    progress : called as the sampling goes on.

    Raises
    ------
    StudyError : something in the file or the tables cannot be used as it stands.
    SupportError : the prior leaves no physical parameter set.
    """
    if data is not None:
        check_kind("bt.soil_test", data, pd.DataFrame)
        test = _from_python(data, tables)
    elif isinstance(test, str | Path):
        test = load_soil_test(test)
    if test is None or (tables and data is None):
        raise TypeError("soil_test() takes a file, a loaded test, or data with its tables")
    check_kind("bt.soil_test", test, SoilTest)
    check_seed(seed)
    return SavedSoilTest.of(analyse(test, seed=seed, report=progress))


def _from_python(data: pd.DataFrame, tables: Mapping[str, Any]) -> SoilTest:
    content = dict(tables)
    options = ("source", "pressure_range", "displacement_range", "spacing")
    rows = {"file": "readings.csv", **{name: content.pop(name) for name in options if name in content}}
    return from_tables(data, {"test": content.pop("kind", None), "data": rows, **content})


def soil_test_into(
    file: Path, out: Path, *, seed: int = 1, overwrite: bool = False, quiet: bool = False
) -> SavedSoilTest:
    """Analyse a soil-test file into a new folder, which appears whole or not at all.

    Raises
    ------
    StudyError : something in the file cannot be used as it stands.
    ResultError : the folder exists (and ``overwrite`` is not given) or cannot be written.
    """
    from bayesterra.sampling.progress import progress_bar

    test = load_soil_test(file)
    check_free(out, overwrite=overwrite)
    with job_folder(out, overwrite=overwrite) as (part, status):
        with progress_bar(show=not quiet and sys.stderr.isatty()) as show:

            def update(progress: Progress) -> None:
                progress.note_in(status)
                show(progress)

            update(Progress("reading", 0.0))
            result = soil_test(test, seed=seed, progress=update)
            update(Progress("writing the report", 1.0))
        return result._write(part)


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
            yield from toml_table(name, _reference(reference))
    sampling = test.sampling
    yield from toml_table(
        "sampling", {name: getattr(sampling, name) for name in sampling.__dataclass_fields__}
    )


def _entry(name: str, entry: Law | float) -> object:
    dimension = QUANTITIES[name].dimension
    return law_entry(entry, dimension) if isinstance(entry, Law) else text(entry, dimension)


def _reference(reference: ReferenceTable) -> dict[str, object]:
    values = {name: text(value, QUANTITIES[name].dimension) for name, value in reference.values.items()}
    return {"source": reference.source, **values}


def _plain(value: Any) -> Any:
    """A value that JSON can hold: NaN and infinities become null, NumPy numbers Python ones."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not isfinite(value) else value
