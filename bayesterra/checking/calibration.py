"""Simulation-based calibration of a study: its replications, and the resumable job that makes a folder.

True values are drawn from the cut prior, readings are simulated from them, the posterior of each simulated
table is sampled, and the true values are ranked among its draws (Talts et al. 2018). Functions of readings
and parameters are ranked too, as parameters alone miss whole classes of error (Modrák et al. 2023).
"""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator, SeedSequence, default_rng

from bayesterra.arrays import FloatArray
from bayesterra.checking.ranks import CONVERGED, DRAWS, FAILED, UNCONVERGED, Calibration, normalised_rank
from bayesterra.checking.short_runs import FAILURES, Fit, settings_of, short_runs
from bayesterra.errors import ResultError, StudyError, SupportError, check_kind, check_number, check_seed
from bayesterra.likelihood.forward import bearing_pressure, shear_strength, soil_at
from bayesterra.likelihood.joint import Whole, draw_joint_prior, joint_posterior, name_in_group, whole_posterior
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior, posterior
from bayesterra.models import ForwardModel
from bayesterra.runtime.checkpoints import Checkpoints
from bayesterra.runtime.engines import Engine, ended, in_process
from bayesterra.runtime.folders import check_free
from bayesterra.runtime.ownership import WORK
from bayesterra.runtime.reading import damage
from bayesterra.runtime.status import job_folder
from bayesterra.study.canonical import FORM
from bayesterra.study.drive import Drive
from bayesterra.study.result import versions
from bayesterra.study.study import Study

LOG_LIKELIHOOD, LOG_PRIOR = "log_likelihood", "log_prior"
AT_SLIP = "_at_largest_slip"
"""Ending of quantities that the model says of the row with the largest slip."""


def predictive_names(drive: Drive, model: ForwardModel) -> tuple[str, ...]:
    """The two predictive quantities of a drive.

    With a latent load no modelled force is defined for every soil, so they are those of the soil, as far as the
    model has its parameters.
    """
    if drive.latent_load:
        named = {"bearing_pressure": {"Ks", "n0"}, "shear_strength": {"c", "phi"}}
        return tuple(name for name, needed in named.items() if needed <= {*model.parameters})
    first, second, *_ = drive.outcomes
    return first + AT_SLIP, second + AT_SLIP


def quantity_names(study: Study) -> tuple[str, ...]:
    """All test quantities: free parameters, log likelihood, log prior, two predictive ones of each group."""
    target = whole_posterior(study)
    named = predictive_names(study.drive, study.model) if study.wheels else ()
    predictive = (name_in_group(name, group) for group in target.groups for name in named)
    return (*target.names, LOG_LIKELIHOOD, LOG_PRIOR, *predictive)


def quantities(target: Whole, x: FloatArray) -> dict[str, FloatArray]:
    """Every test quantity (n,) of parameter sets (n, d) inside the support, for the posterior's readings."""
    prior, likelihood = target.log_prior_and_likelihood(x)
    values = {name: x[:, i] for i, name in enumerate(target.names)}
    values |= {LOG_LIKELIHOOD: likelihood, LOG_PRIOR: prior}
    for (group, alone), own in zip(target.groups.items(), target.values_of_groups(x), strict=True):
        values |= {name_in_group(name, group): column for name, column in _predicted(alone, own).items()}
    return values


def _predicted(posterior: Posterior, x: FloatArray) -> dict[str, FloatArray]:
    forward, soil = posterior.likelihood.forward, posterior.prior.soil_values(x)
    if not posterior.driven:
        return {}
    names = predictive_names(forward.drive, forward.model)
    if forward.drive.latent_load:
        plain = soil_at(soil, float(forward.conditions.width[0]))
        derived = {"bearing_pressure": bearing_pressure, "shear_strength": shear_strength}
        return {name: derived[name](plain) for name in names}
    outcomes, row = forward(soil), int(np.argmax(forward.conditions.slip))
    return {name: outcomes[name.removesuffix(AT_SLIP)][:, row] for name in names}


_BATCH, _ATTEMPTS = 128, 2000


@dataclass(frozen=True)
class Outcome:
    """Outcome of one replication."""

    task: int  # its number, from 1
    status: str  # ``converged``, ``not converged`` or ``failed``; a failed one has no ranks
    ess: float  # of its sampling
    r_hat: float  # likewise
    seconds: float  # processor time
    note: str = ""  # why it failed
    ranks: Mapping[str, float] = field(default_factory=dict)  # normalised, of every test quantity; NaN where constant

    @classmethod
    def from_record(cls, content: Mapping[str, Any]) -> "Outcome":
        """Read back what ``dataclasses.asdict`` wrote; TypeError or ValueError where it is no outcome."""
        outcome = cls(**content)
        ranks = {str(name): float(rank) for name, rank in outcome.ranks.items()}
        if outcome.status not in (CONVERGED, UNCONVERGED, FAILED) or type(outcome.task) is not int or outcome.task < 1:
            raise ValueError(f"no outcome of a replication: {outcome!r:.60}")
        if any(rank < 0 or rank > 1 for rank in ranks.values()):
            raise ValueError(f"no ranks: {ranks!r:.60}")
        ess, r_hat, seconds = float(outcome.ess), float(outcome.r_hat), float(outcome.seconds)
        return cls(outcome.task, outcome.status, ess, r_hat, seconds, str(outcome.note), ranks)


@dataclass(frozen=True)
class Replication:
    """The task of a calibration: a number in, an outcome out, the same wherever and whenever it is run."""

    study: Study
    seed: int
    fit: Fit

    def __call__(self, task: int) -> Outcome:
        """Run replication number ``task``."""
        started = time.process_time()
        making, fitting, ranking = SeedSequence(self.seed, spawn_key=(task,)).spawn(3)
        truth, simulated = replicated(self.study, default_rng(making))
        try:
            fitted = self.fit(simulated, fitting)
            rng = default_rng(ranking)
            values = quantities(whole_posterior(simulated), np.concatenate([truth, spaced(fitted.draws, rng)]))
            ranks = {name: normalised_rank(column[0], column[1:], rng) for name, column in values.items()}
        except FAILURES as error:
            names = quantity_names(self.study)
            note, nothing = f"{type(error).__name__}: {error}", float("nan")
            seconds = time.process_time() - started
            return Outcome(task, FAILED, 0.0, nothing, seconds, note, dict.fromkeys(names, nothing))
        seconds = time.process_time() - started
        return Outcome(task, fitted.status, fitted.ess, fitted.r_hat, seconds, ranks=ranks)


def replicated(study: Study, rng: Generator) -> tuple[FloatArray, Study]:
    """Draw true values (1, d) from the cut prior, and the study with readings that they make.

    With groups truth and readings are those of the joint posterior. Readings are made where the study has
    some, at its slips, wheels and loads; with the drive ``sinkage`` at its sinkage. With ``both`` every load
    is drawn from its flat prior, and the soil anew where it does not carry one of them.

    Raises
    ------
    SupportError : hardly any soil of the prior carries the loads.
    """
    target, true_values = whole_posterior(study), _truths(study)
    groups = target.groups.values()
    for _ in range(_ATTEMPTS):
        truth = true_values(rng)
        own = target.values_of_groups(truth)
        outcomes = [
            alone.likelihood.imagined(alone.prior.soil_values(values), alone.noise_values(values), rng)
            for alone, values in zip(groups, own, strict=True)
            if alone.driven
        ]
        if not any(made.status[0] for made in outcomes):
            break
    else:
        raise SupportError(f"none of {_ATTEMPTS} soils of the prior carries loads of the whole load range")
    readings = {name: study.observations.values[name].copy() for name in study.noise}
    stresses = {
        each.test.name: each.draw(values, rng)[0]
        for alone, values in zip(groups, own, strict=True)
        for each in alone.experiments
    }
    study = study.with_stresses(stresses) if stresses else study
    if not outcomes:
        return truth, study
    for alone, values, made in zip(groups, own, outcomes, strict=True):
        likelihood = alone.likelihood
        drawn = likelihood.draw(made, alone.noise_values(values), rng)[0]
        drawn[np.isnan(likelihood.measured)] = np.nan
        rows = np.isin(study.observations.rows, likelihood.observations.rows)
        for name, column in zip(likelihood.channels, drawn.T, strict=True):
            readings[name][rows] = column
    return truth, study.with_data(readings)


def _truths(study: Study) -> Callable[[Generator], FloatArray]:
    """Source of true values (1, d): one draw of the cut prior at a time."""
    if study.pooling is None:
        alone = posterior(study)
        return lambda rng: draw_cut_prior(alone, 1, rng, batch=_BATCH).x
    joint = joint_posterior(study)
    return lambda rng: draw_joint_prior(joint, 1, rng, batch=_BATCH, most=None)


def spaced(draws: FloatArray, rng: Generator) -> FloatArray:
    """``DRAWS`` of the draws (n, d), one from each of as many equal stretches."""
    places = (np.arange(DRAWS) + rng.random(DRAWS)) * len(draws) / DRAWS
    return draws[places.astype(np.int64)]


FEWEST = 20
"""Fewer replications than this notice nothing but the grossest errors."""


@dataclass(frozen=True)
class Progress:
    """Progress of a calibration."""

    done: int  # replications
    of: int  # as many in all
    unsettled: int  # those that failed or did not converge
    seconds_left: float | None  # at the pace so far; None before the first


def check(study: Study, n: int) -> None:
    """Make sure that a calibration is possible before work is spent on it.

    StudyError for too few replications, or where nothing is free; SupportError where the prior leaves no parameter
    set that fits the conditions of the data.
    """
    if n < FEWEST:
        raise StudyError(f"'n' must be at least {FEWEST} replications, better 200 or more (got {n})")
    if not study.prior.names:
        raise StudyError("every parameter is fixed: there is nothing to calibrate")
    _truths(study)(default_rng(0))


def _calibrated(
    job: "CalibrationRequest", finished: Iterable[Outcome], report: Callable[[Sequence[Outcome], Progress], None]
) -> Calibration:
    """Do what is left beside ``finished``; ``report`` is told of new outcomes, at the start of none."""
    study, n = job.study, job.n
    check(study, n)
    outcomes = {outcome.task: outcome for outcome in finished if outcome.task <= n}
    open_tasks = [task for task in range(1, n + 1) if task not in outcomes]
    replication = Replication(study, job.seed, job.fit or short_runs(study))
    started, before = time.perf_counter(), len(outcomes)
    report((), _progress(outcomes, n, None))
    for batch in ended(replication, open_tasks, job.engine or in_process()):
        outcomes |= batch
        pace = (time.perf_counter() - started) / (len(outcomes) - before)
        report([outcome for _, outcome in batch], _progress(outcomes, n, pace * (n - len(outcomes))))
    return Calibration(
        study, table([outcomes[task] for task in sorted(outcomes)], study), origin_of(study, job.seed, job.fit)
    )


def _progress(outcomes: dict[int, Outcome], n: int, seconds_left: float | None) -> Progress:
    unsettled = sum(outcome.status != CONVERGED for outcome in outcomes.values())
    return Progress(len(outcomes), n, unsettled, seconds_left)


def table(outcomes: Iterable[Outcome], study: Study) -> pd.DataFrame:
    """One row per outcome; see :attr:`Calibration.table`."""
    rows = [asdict(outcome) for outcome in outcomes]
    ranks = [row.pop("ranks") for row in rows]
    names = quantity_names(study)
    return pd.DataFrame(rows).join(pd.DataFrame(ranks, columns=list(names)))


def origin_of(study: Study, seed: int, fit: Fit | None = None) -> dict[str, Any]:
    """Origin of outcomes: all that they depend on, which must be the same for a calibration to go on."""
    return {
        "seed": seed,
        "model": study.model.name if study.wheels else "",
        "drive": study.drive if study.wheels else "",
        "fingerprints": study.fingerprint,
        "settings": {"ranked_among": DRAWS, **settings_of(fit or short_runs(study))},
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
    fit : samples the posterior of a simulated study, see :data:`bayesterra.checking.short_runs.Fit`; by
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
