"""Posterior draws in a result folder: how the file is named and read, whatever test the result is of."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import xarray as xr

from bayesterra.arrays import FloatArray, frozen
from bayesterra.checksums import check_sums
from bayesterra.errors import ResultError, StudyError, in_short, printable
from bayesterra.folders import part_of
from bayesterra.netcdf import read_tree
from bayesterra.reading import damage, read_json

DRAWS, RECORD = "draws.nc", "run.json"


@dataclass(frozen=True)
class Drawn:
    """What a finished result says, as far as draws do.

    Attributes
    ----------
    label : where the draws come from, in words.
    draws : by variable, (chains, draws), SI.
    units : by variable, as the result states them; "" where it does not.
    converged : whether the sampling passed its own checks.
    """

    label: str
    draws: Mapping[str, FloatArray]
    units: Mapping[str, str]
    converged: bool

    @classmethod
    def of(cls, posterior: xr.Dataset, record: Mapping[str, Any], place: str) -> Drawn:
        """Label the draws of a group ``posterior`` of dimensions chain and draw."""
        columns = {str(name): values for name, values in posterior.data_vars.items()}
        plain = {name: v for name, v in columns.items() if set(v.dims) == {"chain", "draw"}}
        title = in_short(printable(str(record.get("title") or "")), 200)
        return cls(
            label=" ".join(part for part in (f"'{title}'" if title else "", place) if part) or "a result",
            draws={name: frozen(v.transpose("chain", "draw").to_numpy()) for name, v in plain.items()},
            units={name: str(v.attrs.get("units", "")) for name, v in plain.items()},
            converged=bool(record.get("verdict", {}).get("converged", True)),
        )


def is_result(folder: Path) -> bool:
    """Whether a folder is meant as a result, be it whole or not."""
    return any((folder / name).exists() for name in (DRAWS, RECORD))


def read_drawn(folder: Path) -> Drawn:
    """Read the posterior draws of a result folder.

    Raises
    ------
    StudyError : there is no such folder, its run has not ended, or it holds no posterior.
    """
    name = f"'{folder}'"
    if not os.path.isdir(folder):
        begun = part_of(folder).is_dir()
        why = "its run has not ended (run it with --resume)" if begun else "there is no such folder"
        raise StudyError(f"{name} is not a result folder: {why}")
    missing = [file for file in (DRAWS, RECORD) if not (folder / file).is_file()]
    if missing:
        raise StudyError(f"{name} is not a finished result folder: {' and '.join(missing)} missing")
    try:
        check_sums(folder, DRAWS, RECORD, "study.toml")
    except ResultError as error:
        raise StudyError(str(error)) from error
    with damage(StudyError, folder):
        record, tree = read_json(folder / RECORD), read_tree(folder / DRAWS)
        if "posterior" in tree.children:
            return Drawn.of(tree["posterior"].to_dataset(), record, f"({folder.name})")
    raise StudyError(f"{name} holds a prior without readings (run --prior-only): there is no posterior")
