"""Soil-test files: one series of plate or shear tests without wheels, as a study of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pandas as pd

from bayesterra.errors import StudyError, check_keys, checked_path, errors_in
from bayesterra.study import entries, schema
from bayesterra.study.observations import read_table
from bayesterra.study.study import Study

SOIL_TEST_FILE = "soiltest.toml"
KEYS = ("test", "title", "soil", "data", "noise", "priors", "published", "truth", "sampling")
"""Keys and tables of such a file."""
EFFECTIVE = {"target_ess": 2000}
"""Sampling options of such a file, where it has none."""


def load_soil_test(path: str | Path) -> Study:
    """Read a soil-test file, or a folder that holds ``soiltest.toml``, and its table.

    Raises
    ------
    StudyError : naming file, table, key or column, what must hold and the value got.
    """
    path = checked_path("bt.load_soil_test", path, "a soil-test file")
    path = path / SOIL_TEST_FILE if path.is_dir() else path
    with errors_in(path):
        return soil_test_study(schema.read_toml(path), folder=path.parent)


def soil_test_study(tables: Mapping[str, Any], *, table: pd.DataFrame | None = None, folder: Path = Path()) -> Study:
    """A study of one series of tests from the tables of a soil-test file.

    Parameters
    ----------
    table : readings, units in the headers; numbers in ``tables`` are then SI values. Else the file that [data]
        names in ``folder`` is read.

    Raises
    ------
    StudyError : naming table, key or column, what must hold and the value got.
    """
    check_keys(tables, KEYS)
    kind = str(tables.get("test"))
    data = entries.table(tables.get("data", {}), "data")
    series = {**data, "test": tables.get("test"), "noise": tables.get("noise", {})}
    rest = {key: value for key, value in tables.items() if key not in ("test", "data", "noise")}
    sampling = tables.get("sampling", {})
    whole = {**rest, "sampling": {**EFFECTIVE, **sampling} if isinstance(sampling, Mapping) else sampling}
    try:
        if kind not in entries.SCATTER:
            raise StudyError(f"'test' must be 'plate' or 'shear' (got {tables.get('test')!r})")
        content = schema.checked({**whole, "soil_tests": {kind: series}}, bare=table is not None)
        stated = content.soil_tests[kind]
        if table is None and stated.file:
            with errors_in(folder / stated.file):
                table = read_table(folder / stated.file)
        parts = {field.name: getattr(content, field.name) for field in fields(content)}
        del parts["data"], parts["wheels"]
        return Study(**{**parts, "soil_tests": {kind: replace(stated, table=table)}})
    except StudyError as error:  # in the words of the file
        said = str(error).replace(f"[soil_tests.{kind}] noise: ", "[noise] ").replace(f"[soil_tests.{kind}", "[data")
        raise type(error)(said) from error
