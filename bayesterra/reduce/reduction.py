"""Reduction of logs: steady windows of drives become rows, loading branches of plate tests become readings."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, get_args

import numpy as np
import pandas as pd

from bayesterra.errors import ResultError, StudyError, errors_in, known
from bayesterra.parameters import OUTCOMES
from bayesterra.reduce.branch import Branch, branch_of
from bayesterra.reduce.log import LOGGED, Kind, Log, read_log
from bayesterra.reduce.windows import Settings, Window, windows_of
from bayesterra.runtime.folders import write_new_files
from bayesterra.runtime.tables import Record, csv_text
from bayesterra.study.result import AnalysisResult
from bayesterra.study.units import quantity


@dataclass(frozen=True)
class Reduction(AnalysisResult):
    """Rows of drives, or readings of plate tests, and how they came about.

    Attributes
    ----------
    logs : as read, offsets subtracted.
    windows : of drives, with rows or rejected.
    branches : of plate tests.
    """

    RECORD: ClassVar[type[Record] | None] = None
    VIEW: ClassVar[str] = "bayesterra.reduce.page:reduced"
    logs: tuple[Log, ...]
    windows: tuple[Window, ...] = ()
    branches: tuple[Branch, ...] = ()

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
    for path in paths:
        read = read_log(path, **form)
        with errors_in(path):
            log = read.without_offsets(record) if record else read
            logs.append(log)
            if lengths["plate"] or not {"travel_speed", "position", "rim_speed", "wheel_speed", "slip"} & set(
                log.values
            ):
                branches += [branch_of(test, lengths["plate"]) for test in log.tests()]
            else:
                windows += windows_of(log, settings)
    if windows and branches:
        raise StudyError("drives and plate tests give different tables: reduce them one after the other")
    return Reduction(tuple(logs), tuple(windows), tuple(branches))
