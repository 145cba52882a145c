"""A study in, a calibration folder with its report out; resumable, task by task."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, fields
from math import isfinite
from pathlib import Path
from typing import Any, Self

from bayesterra import calibration, report
from bayesterra.calibration import Calibration, Fit, Outcome, Progress
from bayesterra.folders import WORK, clear_up, part_of, whole_folder, write_text
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
        write_text(part / "ranks.csv", self.table.to_csv(index=False, float_format="%.6g"))
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

    calibration.check(job.study, job.n, job.workers)
    if resume and not overwrite and (ended := _ended(job, out)):
        return ended
    how: dict[str, Any] = {"overwrite": overwrite, "resume": resume}
    with whole_folder(out, mark=MARK, unfinished=_unfinished, **how) as part:
        with calibration_bar(show=not quiet and sys.stderr.isatty()) as show:
            found = CalibrationResult.of(_filled(job, part, (show, watch)))
        found._write(part)
        (part / "status.json").unlink(missing_ok=True)
    return found


def _filled(job: Job, part: Path, watchers: Iterable[Callable[[Progress], None]]) -> Calibration:
    """Run what is missing, and save every outcome as it comes."""
    with TaskStore(part / WORK / STORE_FILE, _made_with(job)) as store:

        def update(outcome: Outcome | None, progress: Progress) -> None:
            if outcome is not None:
                store.add(outcome.task, asdict(outcome))
            write_text(part / "status.json", json.dumps(_status(progress)) + "\n")
            for watch in watchers:
                watch(progress)

        finished = [Outcome(**content) for content in store.tasks().values()]
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


def _unfinished(part: Path) -> str:
    """What would be lost with ``<folder>.part``, in words."""
    store = part / WORK / STORE_FILE
    finished = finished_tasks(store)
    if finished:
        return f"an unfinished calibration of {finished} replications"
    return "saved replications that cannot be read" if finished is None else ""


def _ended(job: Job, out: Path) -> CalibrationResult | None:
    """The calibration that a run left which was killed after its folder had become whole, else None."""
    store = out / WORK / STORE_FILE
    if not finished_tasks(store) or _unfinished(part_of(out)):
        return None
    with TaskStore(store, _made_with(job)) as tasks:
        finished = [Outcome(**content) for content in tasks.tasks().values()]
    if {outcome.task for outcome in finished} != set(range(1, job.n + 1)):
        return None
    found = calibration.calibrate(job.study, n=job.n, seed=job.seed, fit=job.fit, finished=finished)
    clear_up(out)
    return CalibrationResult.of(found)


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
