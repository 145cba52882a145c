"""Storage of results: folders read and written, and what must be sound in them.

Files are damaged, edited by hand, or sent by somebody. Whatever the commands and the report rely on is
looked at here, once, as a folder is read, so that a wrong one is called wrong by name.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayesterra.analysis.prior_only import PriorResult
from bayesterra.checking.validation import Validation
from bayesterra.errors import ResultError
from bayesterra.parameters import CHANNELS, DERIVED, PARAMETERS
from bayesterra.pooling.run import PooledResult
from bayesterra.runtime.folders import write_text
from bayesterra.runtime.netcdf import DRAWS, RECORD, read_tree, write_tree
from bayesterra.runtime.reading import check_sums, damage, read_json
from bayesterra.runtime.tables import csv_text, read_csv
from bayesterra.study.canonical import write_study
from bayesterra.study.result import Result
from bayesterra.study.study import Study, load_study


class Either:
    """One of several shapes."""

    def __init__(self, *shapes: object) -> None:
        self.shapes = shapes


class OneOf:
    """A text that is one of those known."""

    def __init__(self, choices: Sequence[str]) -> None:
        self.choices = frozenset(choices)


class Each:
    """A table with any keys, or with known ones, whose entries have one shape."""

    def __init__(self, shape: object, keys: Sequence[str] | None = None) -> None:
        self.shape, self.keys = shape, None if keys is None else frozenset(keys)


class Whole:
    """A whole number, from 0 to one that no study reaches."""


class Maybe:
    """An entry that may be missing."""

    def __init__(self, shape: object) -> None:
        self.shape = shape


NUMBER = float
SOME = Either(float, None)  # what is not finite stands as null
TEXT = str
_NAME, _CHANNEL = OneOf(tuple(PARAMETERS)), OneOf(tuple(CHANNELS))
_BY_NAME = tuple(PARAMETERS)
_CHECK = {"name": TEXT, "value": SOME, "threshold": NUMBER, "passed": bool, "advice": TEXT}
_FIT = {
    "converged": bool,
    "passes": Whole(),
    "errors_percent": Each(SOME, tuple(CHANNELS)),
    "held": [_NAME],
    "at_bound": [_NAME],
    "missing": [_NAME],
    "notes": [TEXT],
}
_STANDING = {
    "credible_level": SOME,
    "log_density": SOME,
    "word": TEXT,
    "at_bound": [_NAME],
    "filled": [_NAME],
    "values": Each(SOME, _BY_NAME),
}
_ORIGIN = {
    "title": TEXT,
    "kind": OneOf(("measured", "simulated", "digitised")),
    "source": TEXT,
    "made": TEXT,
    "versions": Each(TEXT),
    "machine": TEXT,
    "seed": Whole(),
    "model": TEXT,
    "drive": TEXT,
    "fingerprints": {"study": TEXT, "data": TEXT, "run": Maybe(TEXT)},
    "notes": [TEXT],
    "settings": {"target_ess": Whole(), "ensembles": Whole(), "walkers": Whole(), "max_steps": Whole()},
    "seconds": Each(NUMBER),
    "verdict": {"converged": bool, "ess": NUMBER, "r_hat": SOME, "checks": [_CHECK]},
    "failures": Maybe(Each({"error": TEXT, "message": TEXT, "trace": [TEXT]})),
}
FAILING = {
    "evidence": ("evidence",),
    "directions": ("directions", "identifiability"),
    "predictive_checks": ("predictive_checks",),
    "prior_checks": ("prior_checks", "prior_predictive"),
    "loo": ("loo",),
}
"""Entries of a record that may be missing where its ``failures`` name one of these."""

RECORD_SHAPE: Mapping[str, object] = {
    **_ORIGIN,
    "sampling": {
        "acceptance": NUMBER,
        "steps": Whole(),
        "kept_one_step_in": Whole(),
        "tau": Each(SOME, _BY_NAME),
        "temperatures": [Whole()],
        "proposal_efficiency": [SOME],
        "log_evidence": [SOME],
    },
    "evidence": {
        "log_z": NUMBER,
        "error": NUMBER,
        "k_hat": SOME,
        "limit": NUMBER,
        "draws": Whole(),
        "reliable": bool,
        "spread": Maybe(NUMBER),
        "log_share": NUMBER,
        "log_share_error": NUMBER,
    },
    "prior_support": {"tried": Whole(), "shares": Each(NUMBER)},
    "mode": {"log_density": NUMBER, "agreeing_starts": Whole()},
    "fits": Each(_FIT, ("IM1", "IM2", "IM3", "joint")),
    "refused_fits": [TEXT],
    "standings": Each(_STANDING, ("mode", "IM1", "IM2", "IM3", "joint", "published", "truth")),
    "directions": {
        "determined": Whole(),
        "of": Whole(),
        "contractions": [NUMBER],
        "groups": [
            {
                "scope": TEXT,
                "view": TEXT,
                "directions": Whole(),
                "determined": Whole(),
                "effective": SOME,
                "cut_effective": SOME,
            }
        ],
        "unseen": [TEXT],
    },
    "predictive_checks": {
        "checks": [{"channel": _CHANNEL, "statistic": TEXT, "p": NUMBER, "calibrated": NUMBER}],
        "overall": NUMBER,
        "replicates": Whole(),
        "effective": [NUMBER],
    },
    "prior_checks": {
        "checks": [
            {
                "channel": _CHANNEL, "statistic": TEXT, "value": NUMBER, "low": NUMBER, "high": NUMBER,
                "p": NUMBER,
            }
        ],
        "overall": NUMBER,
    },
    "loo": {
        "rows": [{"row": Whole(), "elpd": NUMBER, "error": NUMBER, "k": SOME, "refitted": bool}],
        "full": [NUMBER],
        "pit": Each([SOME], tuple(CHANNELS)),
    },
}  # fmt: skip
"""The content of ``run.json``."""

POOLED_RECORD: Mapping[str, object] = {
    **_ORIGIN,
    "pooling": {
        "by": TEXT,
        "preferred": TEXT,
        "sentence": TEXT,
        "degrees": [{"pooling": TEXT, "log_evidence": NUMBER, "elpd_rows": NUMBER, "elpd_groups": NUMBER}],
    },
}
_MOST = 10**15

COLUMNS: Mapping[str, Mapping[str, object]] = {
    "summary": {
        "parameter": OneOf((*PARAMETERS, *DERIVED)), "unit": TEXT, "mode": NUMBER, "mean": NUMBER,
        "median": NUMBER, "sd": NUMBER, "hdi90_lo": NUMBER, "hdi90_hi": NUMBER, "ess_bulk": NUMBER,
        "ess_tail": NUMBER, "r_hat": NUMBER, "prior_mean": NUMBER, "prior_sd": NUMBER,
    },
    "least_squares": {"method": TEXT, "parameter": TEXT, "unit": TEXT, "value": NUMBER},
    "identifiability": {
        "parameter": _NAME, "verdict": TEXT, "contraction": NUMBER, "correlation": NUMBER, "bound": TEXT,
        "prior_sd": NUMBER, "posterior_sd": NUMBER,
    },
    "predictive": {
        "row": NUMBER, "slip": NUMBER, "channel": _CHANNEL, "unit": TEXT, "observed": NUMBER, "mean": NUMBER,
        "q05": NUMBER, "q50": NUMBER, "q95": NUMBER, "no_answer": NUMBER,
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


def check_record(record: Any, shape: Mapping[str, object] = RECORD_SHAPE) -> None:
    """ValueError where something in a record is missing, or of another kind than the report relies on."""
    _check(record, {"failures": _ORIGIN["failures"]}, "run.json")
    failed = set(record.get("failures", ()))
    missing = {name for name, causes in FAILING.items() if name not in record and failed & set(causes)}
    _check(record, {name: kind for name, kind in shape.items() if name not in missing}, "run.json")
    loo = record.get("loo")
    if loo is not None and len(loo["rows"]) != len(loo["full"]):
        raise ValueError("run.json: 'loo' must have as many rows as densities")


def _check(value: Any, shape: object, place: str) -> None:
    if isinstance(shape, Either):
        if any(_fits(value, alternative) for alternative in shape.shapes):
            return
        raise ValueError(f"{place} is of the wrong kind (got {value!r:.40})")
    if isinstance(shape, Mapping):
        _check_table(value, shape, place)
    elif isinstance(shape, Each):
        keys = shape.keys
        for key, item in _table(value, place).items():
            if keys is not None and key not in keys:
                raise ValueError(f"{place} has an unknown entry {key!r:.40}")
            _check(item, shape.shape, f"{place}: {key!s:.40}")
    elif isinstance(shape, list):
        if not isinstance(value, list):
            raise ValueError(f"{place} must be a list (got {value!r:.40})")
        for item in value:
            _check(item, shape[0], place)
    elif not _fits(value, shape):
        raise ValueError(f"{place} is of the wrong kind (got {value!r:.40})")


def _check_table(value: Any, shape: Mapping[str, object], place: str) -> None:
    content = _table(value, place)
    for key, item in shape.items():
        inner = item.shape if isinstance(item, Maybe) else item
        if key in content:
            _check(content[key], inner, f"{place}: {key}")
        elif not isinstance(item, Maybe):
            raise ValueError(f"{place} lacks '{key}'")


def _table(value: Any, place: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{place} must be a table (got {value!r:.40})")
    return value


def _fits(value: Any, shape: object) -> bool:
    """True where a single value is of a kind."""
    if shape is None:
        return value is None
    if isinstance(shape, OneOf):
        return isinstance(value, str) and value in shape.choices
    if isinstance(shape, Whole):
        return type(value) is int and 0 <= value < _MOST
    if shape is float:
        return type(value) in (int, float) and abs(value) < 1e300  # NaN and infinities are written as null
    return type(value) is shape


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


def _check_column(table: pd.DataFrame, column: str, kind: object, place: str) -> None:
    if column not in table:
        raise ValueError(f"{place} lacks the column '{column}'")
    if list(table.columns).count(column) > 1:
        raise ValueError(f"{place} has the column '{column}' twice")
    values = table[column]
    if kind is NUMBER:
        if not pd.api.types.is_numeric_dtype(values) or pd.api.types.is_complex_dtype(values):
            raise ValueError(f"{place}: '{column}' must hold numbers")
    elif not all(_fits(value, kind) for value in values):
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
    """True where a folder was written by a run of a study with groups."""
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
    """True where the record of a folder has an entry that says what kind of result it is."""
    try:
        return bool(read_json(folder / RECORD).get(key))
    except (OSError, ValueError, AttributeError):
        return False


_FILES = ("draws.nc", "run.json", "study.toml", "measurements.csv", *(f"{name}.csv" for name in TABLES))
