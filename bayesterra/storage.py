"""Result folders: with :mod:`bayesterra.drawn` the only module that knows their file formats."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pandas as pd
import xarray as xr

from bayesterra.checksums import check_sums
from bayesterra.drawn import DRAWS
from bayesterra.errors import ResultError, StudyError
from bayesterra.folders import write_bytes, write_text
from bayesterra.pooled import PooledResult
from bayesterra.prior_only import PriorResult
from bayesterra.results import Result
from bayesterra.study import load_study
from bayesterra.writing import write_study

TABLES = ("summary", "least_squares", "identifiability", "predictive")
POOLED_TABLES = ("summary", "pooling", "sharing", "left_out")


def write_result(result: Result | PriorResult | PooledResult, folder: Path) -> None:
    """Write draws, tables, record and a copy of the study into an existing folder."""
    write_draws(result.draws, folder / DRAWS)
    for name in (name for name in dict.fromkeys((*TABLES, *POOLED_TABLES)) if hasattr(result, name)):
        write_text(folder / f"{name}.csv", getattr(result, name).to_csv(index=False))
    write_text(folder / "run.json", json.dumps(_plain(result.record), indent=1, ensure_ascii=False) + "\n")
    write_study(result.study, folder)


def write_draws(draws: xr.DataTree, path: Path) -> None:
    """Write draws as netCDF; made in memory, because HDF5 loses its way on a full disk."""
    # each dataset is written on its own terms: draws compress well, coordinates need no chunks
    encoding = {
        node.path: {str(name): {"zlib": True, "complevel": 1} for name in _numeric(node)}
        for node in draws.subtree
        if node.data_vars
    }
    content = draws.to_netcdf(engine="h5netcdf", encoding=encoding)
    write_bytes(path, bytes(content))


def _numeric(node: xr.DataTree) -> list[str]:
    return [str(name) for name, values in node.data_vars.items() if values.dtype.kind in "fi" and values.ndim]


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
    try:
        tables = {name: pd.read_csv(folder / f"{name}.csv") for name in TABLES}
        record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        draws = xr.open_datatree(folder / DRAWS, engine="h5netcdf").load()
        draws.close()
        return Result(study=load_study(folder), draws=draws, record=record, **tables)
    except StudyError:
        raise
    except (OSError, ValueError, KeyError) as error:
        raise ResultError(f"'{folder}' is damaged: {str(error).splitlines()[0]}") from error


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
    try:
        tables = {name: pd.read_csv(folder / f"{name}.csv") for name in POOLED_TABLES}
        record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        draws = xr.open_datatree(folder / "draws.nc", engine="h5netcdf").load()
        draws.close()
        return PooledResult(study=load_study(folder), draws=draws, record=record, **tables)
    except StudyError:
        raise
    except (OSError, ValueError, KeyError) as error:
        raise ResultError(f"'{folder}' is damaged: {str(error).splitlines()[0]}") from error


def _marked(folder: Path, key: str) -> bool:
    """Whether the record of a folder has an entry that says what kind of result it is."""
    try:
        return bool(json.loads((folder / "run.json").read_text(encoding="utf-8")).get(key))
    except (OSError, ValueError, AttributeError):
        return False


_FILES = ("draws.nc", "run.json", "study.toml", "measurements.csv", *(f"{name}.csv" for name in TABLES))
