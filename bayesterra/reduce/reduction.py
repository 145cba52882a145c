"""Reduction of logs: steady windows of drives become rows, loading branches of plate tests become readings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, get_args

import numpy as np
import pandas as pd

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.errors import ResultError, StudyError, counted, errors_in, known
from bayesterra.parameters import OUTCOMES
from bayesterra.reduce.log import LOGGED, Kind, Log, read_log
from bayesterra.reduce.windows import Settings, Window, windows_of
from bayesterra.runtime.folders import write_new_files
from bayesterra.runtime.tables import Record, csv_text
from bayesterra.study.result import AnalysisResult
from bayesterra.study.units import quantity


@dataclass(frozen=True)
class Reduction(AnalysisResult):
    """Rows of drives, or readings of plate tests, and how they came about."""

    RECORD: ClassVar[type[Record] | None] = None
    VIEW: ClassVar[str] = "bayesterra.reduce.page:reduced"
    logs: tuple[Log, ...]  # as read, offsets subtracted
    windows: tuple[Window, ...] = ()  # of drives, with rows or rejected
    branches: tuple["Branch", ...] = ()  # of plate tests

    @property
    def kept(self) -> tuple[Window, ...]:
        """Windows that give a row."""
        return tuple(window for window in self.windows if not window.rejected)

    def tables(self) -> dict[str, pd.DataFrame]:
        """``measurements`` of drives as a study reads them, or ``readings`` of plates as a soil test does."""
        return {"readings": self._readings()} if self.branches else {"measurements": self._measurements()}

    def _measurements(self) -> pd.DataFrame:
        kinds = {log.name: log.kind for log in self.logs}
        columns: dict[str, list[Any]] = {"slip": [round(window.mean["slip"], 6) for window in self.kept]}
        for name in ("load", *OUTCOMES):
            channel = LOGGED[name]
            if any(name in window.mean for window in self.kept):
                for header, of in ((name, "mean"), (f"{name}_sd", "sd")):
                    values = [getattr(window, of).get(name, np.nan) / channel.scale for window in self.kept]
                    columns[f"{header} [{channel.unit}]"] = [float(f"{value:.6g}") for value in values]
        columns["use"] = [int(0 <= window.mean["slip"] < 1) for window in self.kept]
        columns["# slip_sd"] = [float(f"{window.sd['slip']:.3g}") for window in self.kept]
        columns["# log"] = [window.log for window in self.kept]
        columns["# from [s]"] = [round(window.start, 3) for window in self.kept]
        columns["# to [s]"] = [round(window.end, 3) for window in self.kept]
        columns["# kind"] = [kinds[window.log] for window in self.kept]
        return pd.DataFrame(columns)

    def _readings(self) -> pd.DataFrame:
        tables = []
        for branch in self.branches:
            channel = LOGGED[branch.stress]
            tables.append(pd.DataFrame({
                "test": branch.test,
                "plate_diameter [mm]": float(f"{branch.diameter * 1e3:.6g}"),
                "sinkage [mm]": [float(f"{z * 1e3:.6g}") for z in branch.readings[:, 0]],
                f"{branch.stress} [{channel.unit}]": [float(f"{p / channel.scale:.6g}") for p in branch.readings[:, 1]],
                "# kind": branch.log.kind,
            }))  # fmt: skip
        return pd.concat(tables, ignore_index=True)

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write the table, and beside it the page of the same name; both or none, and nothing is replaced.

        ResultError where no row was found, a file is there already, or cannot be written.
        """
        file = Path(folder)
        if overwrite:
            raise ResultError(f"'{file}' is a table, which may be a person's: it is never replaced")
        ((_, table),) = self.tables().items()
        if table.empty:
            reasons = dict.fromkeys(window.rejected for window in self.windows)
            raise ResultError(f"no steady window was found: {'; '.join(reasons)} (--steady allows more drift)")
        write_new_files({file.with_suffix(".html"): self.page().html(), file: csv_text(table)})
        return file

    def place(self, folder: Path) -> str:
        """Line on where it was saved."""
        return f"Written: {folder}   Page: {folder.with_suffix('.html')}"


def reduce_logs(
    paths: Sequence[Path],
    *,
    zero: Path | None = None,
    radius: str | None = None,
    plate: str | None = None,
    lugs: int = 0,
    steady: float = 0.02,
    **form: Any,
) -> Reduction:
    """Reduce logs of drives, or of plate tests.

    Parameters
    ----------
    paths : CSV, Excel, Parquet or MATLAB files, or ROS bags.
    zero : record of the unloaded sensors, whose means are subtracted.
    radius : of the wheel, e.g. ``"58 mm"``: behind the rim speed; with ``lugs`` it gives the ripple's period.
    plate : diameter of the plate; logs with it, or with a column of it, are plate tests.
    steady : see :class:`bayesterra.reduce.windows.Settings`.
    **form : ``kind``, ``sheet`` and ``decimal`` of :func:`bayesterra.reduce.log.read_log`.

    Raises
    ------
    StudyError : one line that names the file, what is wrong and the mend.
    """
    lengths = {name: None if text is None else quantity(text, "m", name) for name, text in
               (("radius", radius), ("plate", plate))}  # fmt: skip
    for name, length in lengths.items():
        if length is not None and length <= 0:
            raise StudyError(f"'{name}' must be above 0 (got {length:g} m)")
    known("kind", str(form.get("kind", "measured")), get_args(Kind))
    if not 0 <= steady < 1:
        raise StudyError(f"'steady' must lie in [0, 1) (got {steady:g})")
    settings = Settings(lengths["radius"], lugs, steady)
    record = read_log(zero, **form) if zero else None
    logs: list[Log] = []
    windows: list[Window] = []
    branches: list[Branch] = []
    names = [path.name for path in paths]
    for path in paths:
        if [each.resolve() for each in paths].count(path.resolve()) > 1:
            raise StudyError(f"'{path}' is given twice: name it once")
        read = read_log(path, **form)
        with errors_in(path):
            log = read.without_offsets(record) if record else read
            log = log if names.count(path.name) == 1 else replace(log, name=str(path))
            logs.append(log)
            if lengths["plate"] or not {"travel_speed", "position", "rim_speed", "wheel_speed", "slip"} & set(
                log.values
            ):
                found = [branch_of(test, lengths["plate"]) for test in log.tests()]
                taken = {branch.test for branch in branches}
                branches += [replace(b, test=f"{log.name} {b.test}") if b.test in taken else b for b in found]
            else:
                windows += windows_of(log, settings)
    if windows and branches:
        raise StudyError("drives and plate tests give different tables: reduce them one after the other")
    return Reduction(tuple(logs), tuple(windows), tuple(branches))


FEWEST = 20
"""Samples in air, at least, that tell the zero of a plate's force."""


@dataclass(frozen=True)
class Branch:
    """Loading branch of a plate test."""

    test: str  # its name
    log: Log  # the samples of the test, offsets subtracted
    stress: str  # ``force`` or ``pressure``, what was measured
    diameter: float  # of the plate, m
    zero: float  # reading of the sinkage at which the plate meets the soil, m
    air: float  # force or pressure in air before it, SI, subtracted from the readings
    loading: BoolArray  # samples (m,) of the branch
    readings: FloatArray  # sinkage, m, and force or pressure, SI, (k, 2): means of neighbours that hang together
    notes: tuple[str, ...]  # what was left out, and why


def branch_of(log: Log, plate: float | None) -> Branch:
    """The loading branch of one plate test; StudyError where a channel or the plate's diameter (m) is missing."""
    values = log.values
    stress = next((name for name in ("force", "pressure", "normal_force", "load") if name in values), "")
    if not stress or "sinkage" not in values:
        raise StudyError("a plate test needs 'sinkage [mm]' and 'force [N]' or 'pressure [kPa]'")
    stated = values.get("plate_diameter", np.empty(0))
    told = np.unique(stated[~np.isnan(stated)])
    if len(told) > 1 or (told <= 0).any():
        got = " to ".join(f"{1e3 * end:g}" for end in dict.fromkeys(told[[0, -1]]))
        mend = ": name tests in a column 'test'" if len(told) > 1 else ""
        raise StudyError(f"'plate_diameter' must be one length above 0 in a test (got {got} mm, {log.name}){mend}")
    diameter = float(told[0]) if told.size else plate
    if diameter is None:
        raise StudyError("the plate's diameter is missing: --plate \"100 mm\", or a column 'plate_diameter [mm]'")
    there = ~(np.isnan(values["sinkage"]) | np.isnan(values[stress]))
    sinkage, force = values["sinkage"][there], values[stress][there]
    contact, air, noise = _contact(force)
    smooth = _running_mean(force - air)
    top = int(np.argmax(smooth))
    branch = (np.arange(len(force)) >= contact) & (np.arange(len(force)) <= top)
    # a loop lies between a greatest load so far and its return, where it falls by a tenth and by noise meanwhile
    most = np.maximum.accumulate(smooth)
    stretch = np.cumsum(smooth >= most)
    deep = np.unique(stretch[smooth < 0.9 * most - 4 * noise])
    loop = branch & np.isin(stretch, deep) & (smooth < most)
    loading = branch & ~loop
    zero = float(np.median(sinkage[contact - 2 : contact + 3])) if contact else 0.0
    readings = _independent(sinkage[loading] - zero, force[loading] - air)
    channel, after = LOGGED[stress], len(force) - 1 - top
    begins = f"contact at a reading of {zero * 1e3:.2f} mm; in air {air / channel.scale:.4g} {channel.unit}, subtracted"
    notes = (
        begins if contact else "it begins in contact: zeros are those of the log",
        *([f"{counted(int(loop.sum()), 'sample')} of unloading and reloading left out"] if loop.any() else []),
        *([f"{counted(after, 'sample')} after the greatest load left out"] if after else []),
        f"{counted(int(loading.sum()), 'sample')} thinned to {counted(len(readings), 'reading')}",
    )
    kept = np.zeros(len(there), dtype=np.bool_)
    kept[there] = loading
    named = "pressure" if stress == "pressure" else "force"
    return Branch(log.name, log, named, diameter, zero, air, kept, readings, notes)


def _contact(force: FloatArray) -> tuple[int, float, float]:
    """Sample of contact, mean force in air before it (0, 0 where the test begins in contact), noise of the force."""
    noise = float(1.4826 * np.median(np.abs(np.diff(force[: max(len(force) // 5, FEWEST)])))) / np.sqrt(2)
    smooth, start = _running_mean(force), float(np.median(force[:10]))
    loaded = int(np.argmax(smooth > start + 0.05 * (smooth.max() - start)))
    low = np.flatnonzero(smooth[:loaded] <= start + 4 * noise)
    contact = int(low[-1]) + 1 if low.size else 0
    if contact < FEWEST:
        return 0, 0.0, noise
    parts = np.array([part.mean() for part in np.array_split(force[: int(0.95 * contact)], 10)])
    level = np.ptp(parts) < 0.005 * (smooth.max() - start)
    return (contact, float(parts.mean()), noise) if level else (0, 0.0, noise)


def _running_mean(values: FloatArray, width: int = 5) -> FloatArray:
    padded = np.concatenate([np.full(width // 2, values[0]), values, np.full(width // 2, values[-1])])
    return np.convolve(padded, np.full(width, 1 / width), mode="valid")


def _independent(sinkage: FloatArray, stress: FloatArray, apart: float = 1.05) -> FloatArray:
    """Means (k, 2) of neighbours along the branch: as many as hang together, and 5 % of sinkage at least."""
    order = np.argsort(sinkage, kind="stable")
    order = order[sinkage[order] > 0]
    z, p = sinkage[order], stress[order]
    trend = _running_mean(p, 2 * max(len(p) // 40, 2) + 1)
    scatter = p - trend
    power = float(scatter @ scatter)
    correlation = float(np.clip(scatter[1:] @ scatter[:-1] / power, 0, 0.95)) if power > 0 else 0.0
    least = int(np.ceil((1 + correlation) / (1 - correlation)))
    readings, first = [], 0
    for end in range(1, len(z) + 1):
        if end == len(z) or (end - first >= least and z[end] >= apart * z[first]):
            readings.append((z[first:end].mean(), p[first:end].mean()))
            first = end
    return np.array(readings).reshape(-1, 2)
