"""Draws as netCDF: written by xarray, read after a look at what is declared; draws of a result folder.

An HDF5 file may name other files to read in its place, ask for a filter to be loaded, and declare more values
than any memory holds while it is a few bytes long. None of that is in files that the package writes.
"""

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import version
from math import prod
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import h5py
import xarray as xr

from bayesterra.arrays import FloatArray, frozen
from bayesterra.errors import ResultError, StudyError, in_short, printable
from bayesterra.runtime.folders import part_of, write_bytes
from bayesterra.runtime.reading import MEGABYTE, check_ordinary, check_sums, damage, read_bytes
from bayesterra.runtime.tables import Record

MOST_BYTES = 8192 * MEGABYTE
"""Of a file and, unpacked, of all that it declares."""
MOST_UNPACKED = 200
"""Bytes declared per byte of the file; measured: 1 to 3. A table that is nearly all NaN may reach 100."""
SLACK = 16 * MEGABYTE
MOST_OBJECTS = 20_000
DEEPEST = 20
FILTERS = (1, 2, 3)
"""Deflate, shuffle and checksum. Others may be looked for on the disk and loaded as programs."""


def read_tree(path: Path) -> xr.DataTree:
    """Read a netCDF file that :func:`write_tree` wrote, into memory.

    What h5py and xarray raise on damaged files is in :data:`bayesterra.runtime.reading.UNREADABLE`.
    """
    check_ordinary(os.stat(path), path, MOST_BYTES)
    with h5py.File(path, "r") as file:
        declared = _declared(file, [0], 0)
    if declared > min(MOST_BYTES, SLACK + MOST_UNPACKED * path.stat().st_size):
        raise ValueError(f"it declares {declared / MEGABYTE:.3g} MB of values, which its size cannot hold")
    with xr.open_datatree(path, engine="h5netcdf", decode_times=False, decode_timedelta=False) as tree:
        return tree.load()


def _declared(group: Any, seen: list[int], depth: int) -> int:
    """Bytes that the datasets of a group declare; ValueError where it has what no file of ours has."""
    if depth > DEEPEST:
        raise ValueError("its groups are nested too deeply")
    total = 0
    for name in group:
        seen[0] += 1
        if seen[0] > MOST_OBJECTS:
            raise ValueError("it has too many parts")
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            raise ValueError(f"'{name}' is a link to elsewhere")
        item = group[name]
        total += _declared(item, seen, depth + 1) if isinstance(item, h5py.Group) else _size(name, item)
    return total


def _size(name: str, item: Any) -> int:
    """Bytes that a dataset declares; ValueError where its values are elsewhere or are no numbers or texts."""
    if not isinstance(item, h5py.Dataset):
        raise ValueError(f"'{name}' is neither a group nor an array")
    if item.external or item.is_virtual:
        raise ValueError(f"'{name}' has its values in another file")
    made = item.id.get_create_plist()
    if any(made.get_filter(i)[0] not in FILTERS for i in range(made.get_nfilters())):
        raise ValueError(f"'{name}' asks for an unknown filter")
    kind = item.dtype.kind
    if kind not in "biufSU" and not (kind == "O" and h5py.check_string_dtype(item.dtype)):
        raise ValueError(f"'{name}' holds neither numbers nor texts")
    return int(item.dtype.itemsize) * max(int(item.size or 0), prod(item.chunks or (0,)))


def labelled_tree(groups: Mapping[str, xr.Dataset]) -> xr.DataTree:
    """Tree of groups by name, each of which says what made it, as ArviZ's schema asks."""
    made = {"inference_library": "bayesterra", "inference_library_version": version("bayesterra")}
    nodes = {f"/{name}": dataset.assign_attrs(made) for name, dataset in groups.items()}
    return xr.DataTree.from_dict({"/": xr.Dataset(attrs=made), **nodes})


def write_tree(tree: xr.DataTree, path: Path) -> None:
    """Write draws as netCDF; made in memory, because HDF5 loses its way on a full disk."""
    # each dataset is written on its own terms: draws compress well, coordinates need no chunks
    encoding = {
        node.path: {
            str(name): {"zlib": True, "complevel": 1}
            for name, values in node.data_vars.items()
            if values.dtype.kind in "fi" and values.ndim
        }
        for node in tree.subtree
        if node.data_vars
    }
    try:
        with ThreadPoolExecutor(1) as apart:  # Ctrl-C in the midst would leave objects that print as they go
            content = apart.submit(tree.to_netcdf, engine="h5netcdf", encoding=encoding).result()
    except TypeError:  # xarray before 2025.9 writes trees to files only
        with TemporaryDirectory() as folder:
            tree.to_netcdf(Path(folder, path.name), engine="h5netcdf", encoding=encoding)
            write_bytes(path, read_bytes(Path(folder, path.name), MOST_BYTES))
    else:
        write_bytes(path, content)


DRAWS, RECORD = "draws.nc", "run.json"


@dataclass(frozen=True)
class Drawn:
    """Draws of a finished result."""

    label: str  # where the draws come from, in words
    draws: Mapping[str, FloatArray]  # by variable, (chains, draws), SI
    units: Mapping[str, str]  # by variable, as the result states them; "" where it does not
    converged: bool  # whether the sampling passed its own checks

    @classmethod
    def of(cls, posterior: xr.Dataset, record: Mapping[str, Any], place: str) -> "Drawn":
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
    """True where a folder is meant as a result, be it whole or not."""
    return any((folder / name).exists() for name in (DRAWS, RECORD))


def read_drawn(folder: Path) -> Drawn:
    """Read the posterior draws of a result folder.

    StudyError where there is no such folder, its run has not ended, or it holds no posterior.
    """
    name = f"'{folder}'"
    if not os.path.isdir(folder):
        begun = part_of(folder).is_dir()
        why = "its run has not ended (run it with --resume)" if begun else "there is no such folder"
        raise StudyError(f"{name} is not a result folder: {why}")
    missing = [file for file in (DRAWS, RECORD) if not (folder / file).is_file()]
    if missing:
        raise StudyError(f"{name} is not a finished result folder: {' and '.join(missing)} missing")
    with damage(StudyError, folder):
        try:
            check_sums(folder, DRAWS, RECORD, "study.toml")
            record = Record.read(folder / RECORD)
        except ResultError as error:
            raise StudyError(str(error)) from error
        tree = read_tree(folder / DRAWS)
        if "posterior" in tree.children:
            return Drawn.of(tree["posterior"].to_dataset(), record, f"({folder.name})")
    raise StudyError(f"{name} holds a prior without readings (run --prior-only): there is no posterior")
