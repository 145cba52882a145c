"""The command ``identify``: what these data determine, as a folder with its page."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Self

from bayesterra import report
from bayesterra.csvfiles import csv_text
from bayesterra.engines import Engine
from bayesterra.folders import check_free, whole_folder, write_text
from bayesterra.identified import Identified, foresee, identify_result, identify_study, tables
from bayesterra.messages import check_kind, check_seed
from bayesterra.results import Result
from bayesterra.study import Study

__all__ = ["IdentifyResult", "foresee", "identify", "identify_into"]

MARK = "identifiability.json"
"""File by which folders of this kind are known."""


class IdentifyResult(Identified):
    """An identifiability analysis that can be saved as a folder with its page."""

    @classmethod
    def of(cls, made: Identified) -> Self:
        """The same analysis, with a page to write."""
        return cls(**{field.name: getattr(made, field.name) for field in fields(Identified)})

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write page, tables and record into a new folder; returns the path of the page.

        Raises
        ------
        ResultError : the folder exists (and ``overwrite`` is not given) or cannot be written.
        """
        with whole_folder(Path(folder), overwrite=overwrite, mark=MARK) as part:
            for name, table in tables(self).items():
                write_text(part / f"{name}.csv", csv_text(table, "%.6g"))
            record = {"sentence": self.sentence, **self.record}
            text = json.dumps(record, indent=1, ensure_ascii=False, allow_nan=False)
            write_text(part / MARK, text + "\n")
            write_text(part / "report.html", report.identifiability_html(self))
        return Path(folder) / "report.html"


def identify(
    what: Study | Result,
    *,
    seed: int = 1,
    engine: Engine | None = None,
    progress: Callable[[str], None] = lambda part: None,
) -> IdentifyResult:
    """Find out what the data of a study determine, and what only repeats the prior.

    Parameters
    ----------
    what : a result, whose draws are used, or a study, which is sampled first.
    seed : same seed, same answer, whatever the engine.
    engine : traces the profiles: ``bt.local_pool()``, ``bt.dask_cluster("tcp://…")``; by default this
        process.
    progress : called with the name of each part as it begins.

    Raises
    ------
    StudyError : every parameter is fixed.
    SupportError : the prior leaves no parameter set that fits the conditions of the data.
    """
    check_seed(seed)
    if isinstance(what, Result):
        return IdentifyResult.of(identify_result(what, seed=seed, engine=engine, report=progress))
    check_kind("bt.identify", what, Study, Result)
    return IdentifyResult.of(identify_study(what, seed=seed, engine=engine, report=progress))


def identify_into(
    what: Study | Result,
    out: Path,
    *,
    seed: int = 1,
    engine: Engine | None = None,
    overwrite: bool = False,
    quiet: bool = False,
) -> IdentifyResult:
    """Analyse a result or a study into a new folder, with a word on each part on a terminal."""
    from bayesterra.console import stages

    check_free(out, overwrite=overwrite, mark=MARK)
    with stages(show=not quiet) as show:
        found = identify(what, seed=seed, engine=engine, progress=show)
    found.save(out, overwrite=overwrite)
    return found
