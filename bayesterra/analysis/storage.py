"""Storage of results: folders read and written, and what must be sound in them.

Files are damaged, edited by hand, or sent by somebody. Whatever the commands and the report rely on is
looked at here, once, as a folder is read, so that a wrong one is called wrong by name.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayesterra.analysis.result import RunResult
from bayesterra.checking.validation import Validation
from bayesterra.errors import ResultError
from bayesterra.parameters import CHANNELS, DERIVED, PARAMETERS
from bayesterra.pooling.run import PooledResult
from bayesterra.runtime.netcdf import DRAWS, RECORD, read_tree
from bayesterra.runtime.reading import check_sums, damage, read_json
from bayesterra.runtime.tables import read_csv
from bayesterra.study.result import Result
from bayesterra.study.study import Study, load_study

NUMBER, TEXT = "number", "text"
COLUMNS: Mapping[str, Mapping[str, str | Collection[str]]] = {
    "summary": {
        "parameter": {*PARAMETERS, *DERIVED}, "unit": TEXT, "mode": NUMBER, "mean": NUMBER,
        "median": NUMBER, "sd": NUMBER, "hdi90_lo": NUMBER, "hdi90_hi": NUMBER, "ess_bulk": NUMBER,
        "ess_tail": NUMBER, "r_hat": NUMBER, "prior_mean": NUMBER, "prior_sd": NUMBER,
    },
    "least_squares": {"method": TEXT, "parameter": TEXT, "unit": TEXT, "value": NUMBER},
    "identifiability": {
        "parameter": {*PARAMETERS}, "verdict": TEXT, "contraction": NUMBER, "correlation": NUMBER,
        "bound": TEXT, "prior_sd": NUMBER, "posterior_sd": NUMBER,
    },
    "predictive": {
        "row": NUMBER, "slip": NUMBER, "channel": {*CHANNELS}, "unit": TEXT, "observed": NUMBER,
        "mean": NUMBER, "q05": NUMBER, "q50": NUMBER, "q95": NUMBER, "no_answer": NUMBER,
    },
}  # fmt: skip
"""Columns that tables must have."""
GROUPS: Mapping[str, tuple[str, ...]] = {
    "posterior": ("chain", "draw"),
    "sample_stats": ("chain", "draw"),
    "log_prior": ("chain", "draw"),
    "prior": ("chain", "draw"),
    "prior_predictive": ("chain", "draw", "row"),
    "posterior_predictive": ("chain", "draw", "row"),
    "observed_data": ("row",),
    "log_likelihood": ("chain", "draw", "row"),
}
"""Groups of ``draws.nc``, and the dimensions of all that is in them.

Older files have all rows of the table under ``row``, and the log likelihood of those in the fit under
``used_row``.
"""


def check_tables(tables: Mapping[str, pd.DataFrame], names: Sequence[str]) -> None:
    """ValueError where a table lacks a column, or a column holds something else.

    Parameters
    ----------
    tables : of a result, by name.
    names : free parameters of its study; every table of parameters begins with them.
    """
    for name, columns in COLUMNS.items():
        for column, kind in columns.items():
            _check_column(tables[name], column, kind, f"{name}.csv")
    for name in ("summary", "identifiability"):
        if tables[name]["parameter"].tolist()[: len(names)] != list(names):
            raise ValueError(f"{name}.csv is about other parameters than the study")
        if tables[name]["parameter"].duplicated().any():
            raise ValueError(f"{name}.csv has a parameter twice")
    partners = tables["identifiability"].get("partner", pd.Series(dtype=object)).dropna()
    if not set(partners) <= set(names):
        raise ValueError("identifiability.csv names other parameters than the study")


def _check_column(table: pd.DataFrame, column: str, kind: str | Collection[str], place: str) -> None:
    if column not in table:
        raise ValueError(f"{place} lacks the column '{column}'")
    if list(table.columns).count(column) > 1:
        raise ValueError(f"{place} has the column '{column}' twice")
    values = table[column]
    if kind == NUMBER:
        if not pd.api.types.is_numeric_dtype(values) or pd.api.types.is_complex_dtype(values):
            raise ValueError(f"{place}: '{column}' must hold numbers")
    elif not all(isinstance(value, str) and (kind == TEXT or value in kind) for value in values):
        raise ValueError(f"{place}: '{column}' holds what does not belong there")


def check_draws(tree: xr.DataTree, study: Study) -> None:
    """ValueError where groups, dimensions or parameters are not those of a result of this study."""
    older = "log_likelihood" in tree.children and "used_row" in tree["log_likelihood"].dims
    of_fit = {"log_likelihood": ("chain", "draw", "used_row")} if older else {}
    for group, dims in {**GROUPS, **of_fit}.items():
        if group not in tree.children:
            raise ValueError(f"draws.nc lacks the group '{group}'")
        for name, values in tree[group].data_vars.items():
            if set(values.dims) != set(dims) or values.dtype.kind not in "iuf" or not values.size:
                raise ValueError(f"draws.nc: '{group}' holds '{name}', which is of another form")
    names = set(study.prior.names)
    for group in ("posterior", "prior"):
        held = {str(name): values for name, values in tree[group].data_vars.items()}
        if set(held) != names:
            raise ValueError(f"draws.nc: '{group}' is about other parameters than the study")
        for name, values in held.items():
            if values.dims != ("chain", "draw") or not np.isfinite(values.to_numpy()).all():
                raise ValueError(f"draws.nc: '{group}' holds draws of '{name}' that are no numbers")
    if "lp" not in tree["sample_stats"].data_vars:
        raise ValueError("draws.nc lacks the log densities of its draws")
    used = int(study.observations.use.sum())
    rows = len(study.observations) if older else used
    sizes = dict.fromkeys(("observed_data", "posterior_predictive", "prior_predictive"), rows)
    for group, size in {**sizes, "log_likelihood": used}.items():
        if tree[group].sizes[{**GROUPS, **of_fit}[group][-1]] != size:
            raise ValueError(f"draws.nc: '{group}' has other rows than the study")


def read_result(folder: Path) -> RunResult:
    """Read the result folder of a run on one soil.

    Raises
    ------
    ResultError : the folder is missing, incomplete or damaged, of another kind, or of another format.
    """
    if not folder.is_dir():
        raise ResultError(f"'{folder}' is not a result folder: there is no such folder")
    if missing := _missing(folder, RunResult):
        if is_pooled(folder):
            raise ResultError(
                f"'{folder}' holds a joint posterior of several groups ([pooling]): give one without groups"
            )
        if is_prior(folder):
            raise ResultError(
                f"'{folder}' holds a prior without readings (run --prior-only): there is no posterior"
            )
        raise ResultError(f"'{folder}' is not a complete result folder: {', '.join(missing)} missing")
    with damage(ResultError, folder):
        content = _content(folder, RunResult)
        Validation.from_record(content["record"])
        study = content["study"]
        check_tables(content, study.prior.names)
        check_draws(content["draws"], study)
        return RunResult(**content)


def read_pooled(folder: Path) -> PooledResult:
    """Read the result folder of a study with groups.

    Raises
    ------
    ResultError : it is incomplete or damaged, or of another format.
    """
    if missing := _missing(folder, PooledResult):
        raise ResultError(f"'{folder}' is not a complete result folder: {', '.join(missing)} missing")
    with damage(ResultError, folder):
        return PooledResult(**_content(folder, PooledResult))


def _files(kind: type[Result]) -> tuple[str, ...]:
    return (DRAWS, RECORD, "study.toml", "measurements.csv", *(f"{name}.csv" for name in kind.TABLES))


def _missing(folder: Path, kind: type[Result]) -> list[str]:
    return [name for name in _files(kind) if not (folder / name).is_file()]


def _content(folder: Path, kind: type[RunResult | PooledResult]) -> dict[str, Any]:
    """Fields of a result by name, read from the files of a folder."""
    check_sums(folder, *_files(kind))
    tables = {name: read_csv(folder / f"{name}.csv") for name in kind.TABLES}
    record = kind.RECORD.read(folder / RECORD)
    return {**tables, "record": record, "draws": read_tree(folder / DRAWS), "study": load_study(folder)}


def is_pooled(folder: Path) -> bool:
    """True where a folder was written by a run of a study with groups."""
    return _marked(folder, "pooling")


def is_prior(folder: Path) -> bool:
    """True where a folder holds a prior without readings."""
    return _marked(folder, "prior_only")


def _marked(folder: Path, key: str) -> bool:
    """True where the record of a folder has an entry that says what kind of result it is."""
    try:
        return bool(read_json(folder / RECORD).get(key))
    except (OSError, ValueError, AttributeError):
        return False
