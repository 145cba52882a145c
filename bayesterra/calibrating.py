"""A study in, a calibration folder with its report out; resumable, task by task."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from math import isfinite
from pathlib import Path
from typing import Any, Self

from bayesterra import calibration, report
from bayesterra.calibration import Calibration, Fit, Outcome, Progress
from bayesterra.csvfiles import csv_text
from bayesterra.errors import ResultError
from bayesterra.folders import (
    WORK,
    check_free,
    check_no_links,
    part_of,
    settle,
    tidy,
    whole_folder,
    write_text,
)
from bayesterra.locking import locked
from bayesterra.reading import damage
from bayesterra.study import Study
from bayesterra.taskstore import STORE_FILE, TaskStore, finished_tasks
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
    workers: int = 1,
    fit: Fit | None = None,
    progress: Callable[[Progress], None] = lambda update: None,
) -> CalibrationResult:
    """Simulate a study ``n`` times over and check that its posterior is right.

    Parameters
    ----------
    n : replications, 20 at least; the result states which errors so many would have noticed.
    seed : same seed, same ranks, whatever the number of workers.
    workers : processes; with more than one a script needs its ``if __name__ == "__main__"``.
    fit : samples the posterior of a simulated study, see :data:`bayesterra.calibration.Fit`; by default the
        sampler of :func:`bayesterra.run`.
    progress : called as the replications end.

    Raises
    ------
    StudyError : too few replications, or nothing is free.
    SupportError : the prior leaves no parameter set that fits the conditions of the data.
    """
    found = calibration.calibrate(
        study, n=n, seed=seed, workers=workers, fit=fit, report=lambda outcome, update: progress(update)
    )
    return CalibrationResult.of(found)


@dataclass(frozen=True)
class Job:
    """What to calibrate, and how; see :func:`calibrate`."""

    study: Study
    n: int
    seed: int = 1
    workers: int = 1
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
    calibration.check(job.study, job.n, job.workers)
    with _part_of(out, resume=resume, overwrite=overwrite) as part:
        with calibration_bar(show=not quiet and sys.stderr.isatty()) as show:
            found = CalibrationResult.of(_filled(job, part, (show, watch)))
        found._write(part)
        for path in (*part.glob(f"{STORE_FILE}*"), part / "status.json"):
            path.unlink(missing_ok=True)
        settle(part, out)
        tidy(out)
    return found


def _filled(job: Job, part: Path, watchers: Iterable[Callable[[Progress], None]]) -> Calibration:
    """Run what is missing, and save every outcome as it comes."""
    with TaskStore(part / STORE_FILE, _made_with(job)) as store:

        def update(outcome: Outcome | None, progress: Progress) -> None:
            if outcome is not None:
                store.add(outcome.task, asdict(outcome))
            write_text(part / "status.json", json.dumps(_status(progress)) + "\n")
            for watch in watchers:
                watch(progress)

        with damage(ResultError, part / STORE_FILE):
            finished = [Outcome.from_record(content) for content in store.tasks().values()]
        return calibration.calibrate(
            job.study, n=job.n, seed=job.seed, workers=job.workers, fit=job.fit, finished=finished,
            report=update,
        )  # fmt: skip


def _made_with(job: Job) -> dict[str, Any]:
    """What must be the same for replications to belong together, by names fit for a message."""
    origin = calibration.origin(job.study, job.seed, job.fit)
    names = {"study": "study", "data": "table of measurements"}
    digests = {names[name]: digest for name, digest in origin.pop("fingerprints").items()}
    return {**origin.pop("versions"), **origin, **digests}


@contextmanager
def _part_of(folder: Path, *, resume: bool, overwrite: bool) -> Iterator[Path]:
    """The folder to work in; what earlier work left in it stays with ``resume`` only."""
    part = part_of(folder)
    check_no_links(part)
    with locked(part / WORK / "lock", f"'{part}'"):
        finished = finished_tasks(part / STORE_FILE)
        if finished and not (resume or overwrite):
            raise ResultError(
                f"'{part}' holds {finished} finished replications: add --resume to go on, or --overwrite to"
                " begin anew"
            )
        try:
            for path in part.iterdir() if not resume else ():
                if path.name != WORK:
                    shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
            yield part
        except OSError as error:
            raise ResultError(f"'{part}' cannot be written: {error.strerror or error}") from error


def _status(progress: Progress) -> dict[str, object]:
    """What a poller of ``status.json`` sees."""
    return {
        "stage": "calibrating",
        "done": progress.done / progress.of,
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
