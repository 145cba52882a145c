"""Result folders: with :mod:`bayesterra.drawn` the only module that knows their file formats."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from bayesterra.checksums import check_sums
from bayesterra.csvfiles import csv_text, read_csv
from bayesterra.drawn import DRAWS, RECORD
from bayesterra.errors import ResultError
from bayesterra.folders import write_text
from bayesterra.netcdf import read_tree, write_tree
from bayesterra.pooled import PooledResult
from bayesterra.prior_only import PriorResult
from bayesterra.reading import damage, read_json
from bayesterra.results import Result
from bayesterra.soundness import POOLED_RECORD, check_draws, check_record, check_tables
from bayesterra.study import load_study
from bayesterra.validation import Validation
from bayesterra.writing import write_study

TABLES = ("summary", "least_squares", "identifiability", "predictive")
POOLED_TABLES = ("summary", "pooling", "sharing", "left_out")


def write_result(result: Result | PriorResult | PooledResult, folder: Path) -> None:
    """Write draws, tables, record and a copy of the study into an existing folder."""
    write_tree(result.draws, folder / DRAWS)
    for name in (name for name in dict.fromkeys((*TABLES, *POOLED_TABLES)) if hasattr(result, name)):
        write_text(folder / f"{name}.csv", csv_text(getattr(result, name)))
    write_text(folder / "run.json", json.dumps(_plain(result.record), indent=1, ensure_ascii=False) + "\n")
    write_study(result.study, folder)


def _plain(value: Any) -> Any:
    """A value that JSON can hold: NaN and infinities become null, NumPy numbers Python ones."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not math.isfinite(value) else value


def read_result(folder: Path) -> Result:
    """Read a result folder.

    Raises
    ------
    ResultError : the folder is missing, incomplete or damaged.
    """
    if not folder.is_dir():
        raise ResultError(f"'{folder}' is not a result folder: there is no such folder")
    missing = [name for name in _FILES if not (folder / name).is_file()]
    if missing and _marked(folder, "pooling"):
        raise ResultError(
            f"'{folder}' holds a joint posterior of several groups ([pooling]): give one without groups"
        )
    if missing and _marked(folder, "prior_only"):
        raise ResultError(
            f"'{folder}' holds a prior without readings (run --prior-only): there is no posterior"
        )
    if missing:
        raise ResultError(f"'{folder}' is not a complete result folder: {', '.join(missing)} missing")
    check_sums(folder, *_FILES)
    with damage(ResultError, folder):
        tables = {name: read_csv(folder / f"{name}.csv") for name in TABLES}
        record = read_json(folder / RECORD)
        draws, study = read_tree(folder / DRAWS), load_study(folder)
        check_record(record)
        Validation.from_record(record)
        check_tables(tables, study.prior.names)
        check_draws(draws, study)
        return Result(study=study, draws=draws, record=record, **tables)


def is_pooled(folder: Path) -> bool:
    """Whether a folder was written by a run of a study with groups."""
    return _marked(folder, "pooling")


def read_pooled(folder: Path) -> PooledResult:
    """Read the result folder of a study with groups.

    Raises
    ------
    ResultError : it is incomplete or damaged.
    """
    needed = ("draws.nc", "run.json", "study.toml", "measurements.csv", *(f"{n}.csv" for n in POOLED_TABLES))
    missing = [name for name in needed if not (folder / name).is_file()]
    if missing:
        raise ResultError(f"'{folder}' is not a complete result folder: {', '.join(missing)} missing")
    check_sums(folder, *needed)
    with damage(ResultError, folder):
        tables = {name: read_csv(folder / f"{name}.csv") for name in POOLED_TABLES}
        record = read_json(folder / RECORD)
        draws = read_tree(folder / DRAWS)
        check_record(record, POOLED_RECORD)
        return PooledResult(study=load_study(folder), draws=draws, record=record, **tables)


def _marked(folder: Path, key: str) -> bool:
    """Whether the record of a folder has an entry that says what kind of result it is."""
    try:
        return bool(read_json(folder / RECORD).get(key))
    except (OSError, ValueError, AttributeError):
        return False


_FILES = ("draws.nc", "run.json", "study.toml", "measurements.csv", *(f"{name}.csv" for name in TABLES))
