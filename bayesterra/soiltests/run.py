"""The command ``soiltest``: a soil-test file in, a result folder with its report out."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from bayesterra.errors import check_kind, check_seed
from bayesterra.runtime.folders import check_free
from bayesterra.runtime.status import job_folder
from bayesterra.sampling.sampler import Progress, progress_bar
from bayesterra.soiltests.analysis import SoilTestResult, analyse
from bayesterra.soiltests.study import SoilTest, load_soil_test
from bayesterra.soiltests.study import soil_test as from_tables


def soil_test(
    test: SoilTest | str | Path | None = None,
    *,
    data: pd.DataFrame | None = None,
    seed: int = 1,
    progress: Callable[[Progress], None] = lambda update: None,
    **tables: Any,
) -> SoilTestResult:
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
    return analyse(test, seed=seed, report=progress)


def _from_python(data: pd.DataFrame, tables: Mapping[str, Any]) -> SoilTest:
    content = dict(tables)
    options = ("source", "pressure_range", "displacement_range", "spacing")
    rows = {"file": "readings.csv", **{name: content.pop(name) for name in options if name in content}}
    return from_tables(data, {"test": content.pop("kind", None), "data": rows, **content})


def soil_test_into(
    file: Path, out: Path, *, seed: int = 1, overwrite: bool = False, quiet: bool = False
) -> SoilTestResult:
    """Analyse a soil-test file into a new folder, which appears whole or not at all.

    Raises
    ------
    StudyError : something in the file cannot be used as it stands.
    ResultError : the folder exists (and ``overwrite`` is not given) or cannot be written.
    """
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
        return result.write(part)
