"""The command ``holdout``: how well rows are predicted that the fit has not seen, as a folder."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields
from math import isfinite
from pathlib import Path
from typing import Any, Self

from bayesterra import holdout, report
from bayesterra.calibration import Fit
from bayesterra.csvfiles import csv_text
from bayesterra.engines import Engine
from bayesterra.figures.holdout import bands_png, left_out_png
from bayesterra.folders import check_free, whole_folder, write_bytes, write_text
from bayesterra.holdout import Holdout
from bayesterra.holdout.levels import TOLERANCE, By
from bayesterra.messages import check_kind, check_seed
from bayesterra.results import Result
from bayesterra.study import Study, load_study
from bayesterra.writing import write_study

__all__ = ["HoldoutResult", "leave_out", "leave_out_into"]

MARK = "holdout.json"
"""File by which folders of this kind are known."""


class HoldoutResult(Holdout):
    """Left-out levels with their predictions, which can be saved as a folder with its page."""

    @classmethod
    def of(cls, found: Holdout) -> Self:
        """The same, with a page to write."""
        return cls(**{field.name: getattr(found, field.name) for field in fields(Holdout)})

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write page, plots, tables, record and study into a new folder; returns the path of the page.

        Raises
        ------
        ResultError : the folder exists (and ``overwrite`` is not given) or cannot be written.
        """
        tables = {"scores": self.table, "summary": self.summary, "skills": self.skills, "refits": self.refits}
        with whole_folder(Path(folder), overwrite=overwrite, mark=MARK) as part:
            for name, table in tables.items():
                write_text(part / f"{name}.csv", csv_text(table, "%.6g"))
            write_bytes(part / "holdout.png", left_out_png(self.table))
            write_bytes(part / "bands.png", bands_png(self))
            text = json.dumps(_finite({**self.record, "converged": self.converged}), indent=1)
            write_text(part / MARK, text + "\n")
            write_text(part / "report.html", report.holdout_html(self))
            write_study(self.study, part)
        return Path(folder) / "report.html"


def _finite(value: Any) -> Any:
    """A value that JSON can hold: NaN and infinities become null."""
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not isfinite(value) else value


def leave_out(
    what: Study | Result,
    by: By = "slip",
    *,
    tolerance: float = TOLERANCE,
    seed: int = 1,
    engine: Engine | None = None,
    fit: Fit | None = None,
    progress: Callable[[str], None] = lambda part: None,
) -> HoldoutResult:
    """Leave groups of rows out, one group at a time; fit the others; predict the group and score that.

    Of a left-out row its slip, wheel and load stay known, with the drive ``both`` its normal force as it was
    read, with ``sinkage`` its sinkage; all else that was read is predicted, noise included. Regressions that
    know no terramechanics predict the same rows from the same training rows.

    Parameters
    ----------
    what : a study, or a result, of which only the study is used.
    by : ``slip`` (slips nearer than ``tolerance`` are one level), ``wheel`` or ``row``; or groups of row
        numbers, or one label for every row of the table.
    tolerance : for ``slip``.
    seed : same seed, same scores, whatever the engine.
    engine : computes the refits: ``bt.local_pool()``, ``bt.dask_cluster("tcp://…")``; by default this
        process.
    fit : samples a posterior, see :data:`bayesterra.calibration.Fit`; by default the sampler of
        :func:`bayesterra.run`, until there are 1000 effective draws.
    progress : told what is at work.

    Raises
    ------
    StudyError : an unknown grouping, fewer than two groups, or nothing is free.
    """
    check_kind("bt.leave_out", what, Study, Result)
    check_seed(seed)
    study = what.study if isinstance(what, Result) else what
    found = holdout.leave_out(
        study, by=by, tolerance=tolerance, seed=seed, engine=engine, fit=fit, report=progress
    )
    return HoldoutResult.of(found)


def leave_out_into(
    path: Path, out: Path, *, overwrite: bool = False, quiet: bool = False, **asked: Any
) -> HoldoutResult:
    """Leave levels of the study at a path, or of the one in a result folder, out into a new folder.

    ``asked``: keywords of :func:`leave_out`.

    Raises
    ------
    ResultError : ``out`` exists (and ``overwrite`` is not given) or cannot be written.
    StudyError : as :func:`leave_out`.
    """
    from bayesterra.console import stages

    study = load_study(path)
    check_free(out, overwrite=overwrite, mark=MARK)
    with stages(show=not quiet) as show:
        found = leave_out(study, progress=show, **asked)
    found.save(out, overwrite=overwrite)
    return found
