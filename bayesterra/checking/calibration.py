"""Simulation-based calibration of a study, as a resumable job and a folder with its page.

True values are drawn from the cut prior, readings are simulated from them, the posterior of each simulated
table is sampled, and the true values are ranked among its draws (Talts et al. 2018). Functions of readings
and parameters are ranked too, as parameters alone miss whole classes of error (Modrák et al. 2023).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from numpy.random import default_rng

from bayesterra.checking.ranks import CONVERGED, DRAWS, Calibration
from bayesterra.checking.replications import Fit, Outcome, Replication, ShortRuns, quantity_names
from bayesterra.errors import ResultError, StudyError, check_kind, check_number, check_seed
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.runtime.checkpoints import Checkpoints
from bayesterra.runtime.engines import Engine, ended, in_process
from bayesterra.runtime.folders import check_free
from bayesterra.runtime.ownership import WORK
from bayesterra.runtime.reading import damage
from bayesterra.runtime.status import job_folder
from bayesterra.study.canonical import FORM
from bayesterra.study.result import versions
from bayesterra.study.study import Study

FEWEST = 20
"""Fewer replications than this notice nothing but the grossest errors."""


@dataclass(frozen=True)
class Progress:
    """Progress of a calibration.

    Attributes
    ----------
    done, of : replications.
    unsettled : those that failed or did not converge.
    seconds_left : at the pace so far; None before the first.
    """

    done: int
    of: int
    unsettled: int
    seconds_left: float | None


def check(study: Study, n: int) -> None:
    """Make sure that a calibration is possible before work is spent on it.

    Raises
    ------
    StudyError : too few replications, or nothing is free.
    SupportError : the prior leaves no parameter set that fits the conditions of the data.
    """
    if n < FEWEST:
        raise StudyError(f"'n' must be at least {FEWEST} replications, better 200 or more (got {n})")
    if not study.prior.names:
        raise StudyError("every parameter is fixed: there is nothing to calibrate")
    draw_cut_prior(posterior(study), 1, default_rng(0))


def _calibrated(
    job: CalibrationRequest,
    finished: Iterable[Outcome],
    report: Callable[[Sequence[Outcome], Progress], None],
) -> Calibration:
    """Do what is left beside ``finished``; ``report`` is told of new outcomes, at the start of none."""
    study, n = job.study, job.n
    check(study, n)
    outcomes = {outcome.task: outcome for outcome in finished if outcome.task <= n}
    open_tasks = [task for task in range(1, n + 1) if task not in outcomes]
    replication = Replication(study, job.seed, job.fit or ShortRuns())
    started, before = time.perf_counter(), len(outcomes)
    report((), _progress(outcomes, n, None))
    for batch in ended(replication, open_tasks, job.engine or in_process()):
        outcomes |= batch
        pace = (time.perf_counter() - started) / (len(outcomes) - before)
        report([outcome for _, outcome in batch], _progress(outcomes, n, pace * (n - len(outcomes))))
    return Calibration(
        study,
        table([outcomes[task] for task in sorted(outcomes)], study),
        origin_of(study, job.seed, job.fit),
    )


def _progress(outcomes: dict[int, Outcome], n: int, seconds_left: float | None) -> Progress:
    unsettled = sum(outcome.status != CONVERGED for outcome in outcomes.values())
    return Progress(len(outcomes), n, unsettled, seconds_left)


def table(outcomes: Iterable[Outcome], study: Study) -> pd.DataFrame:
    """One row per outcome; see :attr:`Calibration.table`."""
    rows = [asdict(outcome) for outcome in outcomes]
    ranks = [row.pop("ranks") for row in rows]
    names = quantity_names(study.prior.names, study.drive)
    return pd.DataFrame(rows).join(pd.DataFrame(ranks, columns=list(names)))


def origin_of(study: Study, seed: int, fit: Fit | None = None) -> dict[str, Any]:
    """Origin of outcomes: all that they depend on, which must be the same for a calibration to go on."""
    chosen = fit or ShortRuns()
    named = {"fit": getattr(chosen, "__qualname__", type(chosen).__name__)}
    settings = chosen.record() if isinstance(chosen, ShortRuns) else named
    return {
        "seed": seed,
        "model": study.model.name,
        "drive": study.drive,
        "fingerprints": study.fingerprint,
        "settings": {"ranked_among": DRAWS, **settings},
        "versions": versions(),
    }


TASKS = "replications"


def calibrate(
    study: Study,
    *,
    n: int,
    seed: int = 1,
    engine: Engine | None = None,
    fit: Fit | None = None,
    progress: Callable[[Progress], None] = lambda update: None,
) -> Calibration:
    """Simulate a study ``n`` times over and check that its posterior is right.

    Parameters
    ----------
    n : replications, 20 at least; the result states which errors so many would have noticed.
    seed : same seed, same ranks, whatever the engine.
    engine : computes the replications: ``bt.local_pool()``, ``bt.dask_cluster("tcp://…")``; by default this
        process.
    fit : samples the posterior of a simulated study, see :data:`bayesterra.checking.replications.Fit`; by
        default the sampler of :func:`bayesterra.run`.
    progress : called as the replications end.

    Raises
    ------
    StudyError : too few replications, or nothing is free.
    SupportError : the prior leaves no parameter set that fits the conditions of the data.
    """
    check_kind("bt.calibrate", study, Study)
    check_seed(seed)
    check_number("n", n)
    job = CalibrationRequest(study, n, seed, engine, fit)
    return _calibrated(job, (), lambda outcomes, update: progress(update))


@dataclass(frozen=True)
class CalibrationRequest:
    """Request for a calibration; see :func:`calibrate`."""

    study: Study
    n: int
    seed: int = 1
    engine: Engine | None = None
    fit: Fit | None = None


def calibrate_study(
    job: CalibrationRequest,
    out: Path,
    *,
    resume: bool = False,
    overwrite: bool = False,
    quiet: bool = False,
    watch: Callable[[Progress], None] = lambda update: None,
) -> Calibration:
    """Calibrate into a folder, with a progress bar on a terminal and a status file to poll.

    Every finished replication is saved at once in ``<out>.part``. ``resume`` goes on from there, also to a
    larger ``n``. ``watch`` is called as replications end.

    Raises
    ------
    ResultError : the folder exists (and ``overwrite`` is not given) or cannot be written; or there is an
        unfinished calibration, of something else or without ``resume``.
    """
    from bayesterra.report.terminal import task_bar

    check_free(out, overwrite=overwrite, mark=Calibration.MARK)
    check(job.study, job.n)
    folder = job_folder(out, mark=Calibration.MARK, kind=TASKS, resume=resume, overwrite=overwrite)
    with folder as (part, status):
        store = Checkpoints.opened(part / WORK, _made_with(job), TASKS)
        with task_bar("calibrating", "replications", show=not quiet) as show:

            def update(outcomes: Sequence[Outcome], progress: Progress) -> None:
                store.add({outcome.task: asdict(outcome) for outcome in outcomes})
                done = progress.done / progress.of
                status.note("calibrating", done, progress.seconds_left, steps=progress.done)
                remark = f", {progress.unsettled} not converged" if progress.unsettled else ""
                show("calibrating", progress.done, progress.of, progress.seconds_left, remark)
                watch(progress)

            with damage(ResultError, part / WORK):
                finished = [Outcome.from_record(content) for content in store.tasks().values()]
            made = _calibrated(job, finished, update)
        return made.write(part)


def _made_with(job: CalibrationRequest) -> dict[str, Any]:
    """Settings that replications must share to belong together, by names fit for a message."""
    origin = origin_of(job.study, job.seed, job.fit)
    names = {"study": "study", "data": "table of measurements"}
    digests = {names[name]: digest for name, digest in origin.pop("fingerprints").items()}
    return {"plain form {} of studies": FORM, **origin.pop("versions"), **origin, **digests}
