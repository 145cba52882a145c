"""A study in, a calibration folder with its report out; resumable, task by task."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from math import isfinite
from pathlib import Path
from typing import Any, Self

from bayesterra import calibration, report
from bayesterra.calibration import Calibration, Fit, Outcome, Progress
from bayesterra.csvfiles import csv_text
from bayesterra.engines import Engine
from bayesterra.errors import ResultError
from bayesterra.folders import WORK, check_free, whole_folder, write_text
from bayesterra.messages import check_kind, check_number, check_seed
from bayesterra.reading import damage
from bayesterra.study import Study
from bayesterra.taskfolders import task_folder
from bayesterra.taskstore import STORE_FILE
from bayesterra.writing import write_study

MARK = "calibration.json"
"""File by which folders of this kind are known."""


class CalibrationResult(Calibration):
    """A calibration that can be saved as a folder with its report."""

    @classmethod
    def of(cls, found: Calibration) -> Self:
        """The same calibration, with a report to write."""
        return cls(**{field.name: getattr(found, field.name) for field in fields(Calibration)})

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write report, ranks, record and study into a new folder; returns the path of the report.

        Raises
        ------
        ResultError : the folder exists (and ``overwrite`` is not given) or cannot be written.
        """
        with whole_folder(Path(folder), overwrite=overwrite, mark=MARK) as part:
            self._write(part)
        return Path(folder) / "report.html"

    def _write(self, part: Path) -> None:
        write_text(part / "ranks.csv", csv_text(self.table, "%.6g"))
        write_text(part / MARK, json.dumps(_finite(self.findings()), indent=1, ensure_ascii=False) + "\n")
        write_text(part / "report.html", report.calibration_html(self))
        write_study(self.study, part)


def calibrate(
    study: Study,
    *,
    n: int,
    seed: int = 1,
    engine: Engine | None = None,
    fit: Fit | None = None,
    progress: Callable[[Progress], None] = lambda update: None,
) -> CalibrationResult:
    """Simulate a study ``n`` times over and check that its posterior is right.

    Parameters
    ----------
    n : replications, 20 at least; the result states which errors so many would have noticed.
    seed : same seed, same ranks, whatever the engine.
    engine : computes the replications: ``bt.local_pool()``, ``bt.dask_cluster("tcp://…")``; by default this
        process.
    fit : samples the posterior of a simulated study, see :data:`bayesterra.calibration.Fit`; by default the
        sampler of :func:`bayesterra.run`.
    progress : called as the replications end.

    Raises
    ------
    StudyError : too few replications, or nothing is free.
    SupportError : the prior leaves no parameter set that fits the conditions of the data.
    """
    check_kind("bt.calibrate", study, Study)
    check_seed(seed)
    check_number("n", n)
    found = calibration.calibrate(
        study, n=n, seed=seed, engine=engine, fit=fit, report=lambda outcomes, update: progress(update)
    )
    return CalibrationResult.of(found)


@dataclass(frozen=True)
class Job:
    """What to calibrate, and how; see :func:`calibrate`."""

    study: Study
    n: int
    seed: int = 1
    engine: Engine | None = None
    fit: Fit | None = None


def calibrate_study(
    job: Job,
    out: Path,
    *,
    resume: bool = False,
    overwrite: bool = False,
    quiet: bool = False,
    watch: Callable[[Progress], None] = lambda update: None,
) -> CalibrationResult:
    """Calibrate into a folder, with a progress bar on a terminal and a status file to poll.

    Every finished replication is saved at once in ``<out>.part``. ``resume`` goes on from there, also to a
    larger ``n``. ``watch`` is called as replications end.

    Raises
    ------
    ResultError : the folder exists (and ``overwrite`` is not given) or cannot be written; or there is an
        unfinished calibration, of something else or without ``resume``.
    """
    from bayesterra.console import calibration_bar

    check_free(out, overwrite=overwrite, mark=MARK)
    calibration.check(job.study, job.n)
    opened = task_folder(
        out, _made_with(job), mark=MARK, tasks="replications", resume=resume, overwrite=overwrite
    )
    with opened as (part, store, status):
        with calibration_bar(show=not quiet) as show:

            def update(outcomes: Sequence[Outcome], progress: Progress) -> None:
                store.add({outcome.task: asdict(outcome) for outcome in outcomes})
                status.note(_status(progress))
                show(progress)
                watch(progress)

            with damage(ResultError, part / WORK / STORE_FILE):
                finished = [Outcome.from_record(content) for content in store.tasks().values()]
            made = calibration.calibrate(
                job.study, n=job.n, seed=job.seed, engine=job.engine, fit=job.fit, finished=finished,
                report=update,
            )  # fmt: skip
        found = CalibrationResult.of(made)
        found._write(part)
    return found


def _made_with(job: Job) -> dict[str, Any]:
    """What must be the same for replications to belong together, by names fit for a message."""
    origin = calibration.origin(job.study, job.seed, job.fit)
    names = {"study": "study", "data": "table of measurements"}
    digests = {names[name]: digest for name, digest in origin.pop("fingerprints").items()}
    return {**origin.pop("versions"), **origin, **digests}


def _status(progress: Progress) -> dict[str, object]:
    """What a poller of ``status.json`` sees."""
    return {
        "stage": "calibrating",
        "done": progress.done / progress.of,
        "steps": progress.done,
        "replications": progress.done,
        "of": progress.of,
        "not_converged": progress.unsettled,
        "seconds_left": progress.seconds_left,
    }


def _finite(value: Any) -> Any:
    """A value that JSON can hold: NaN and infinities become null."""
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not isfinite(value) else value
