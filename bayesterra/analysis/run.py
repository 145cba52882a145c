"""The job ``run``: a study in, a result folder with its report out; a path opened; groups checked."""

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator, SeedSequence, default_rng
from threadpoolctl import threadpool_limits

from bayesterra.analysis import inference
from bayesterra.analysis.inference import run_prior
from bayesterra.analysis.result import PriorResult, is_pooled, is_prior, read_pooled, read_result
from bayesterra.arrays import FloatArray
from bayesterra.checking.folds import Fold
from bayesterra.checking.levels import parts_of, places, predicted, untested, ways
from bayesterra.checking.loo import without_levels
from bayesterra.checking.predictive_checks import uncalibrated_checks
from bayesterra.checking.validation import fit_verdict, prediction_verdict
from bayesterra.errors import ResultError, check_kind, check_seed, checked_path, enumerated
from bayesterra.likelihood.joint import JointPosterior, joint_posterior
from bayesterra.pooling.run import PooledResult, run_pooled
from bayesterra.report.numbers import probability
from bayesterra.report.verdicts import Failures, Verdict, unknown_verdict, with_failures
from bayesterra.runtime.checkpoints import Checkpoints, digest
from bayesterra.runtime.folders import check_free, clear_up, part_of, whole_folder
from bayesterra.runtime.netcdf import is_result
from bayesterra.runtime.ownership import WORK, unfinished
from bayesterra.runtime.reading import check_sums, damage
from bayesterra.runtime.status import job_folder
from bayesterra.sampling.sampler import Progress, progress_bar
from bayesterra.study.canonical import identity
from bayesterra.study.own import allowing_code
from bayesterra.study.result import Result
from bayesterra.study.study import STUDY_FILE, Study, load_soil_test, load_study, soil_test_study


def run(
    study: Study, *, seed: int = 1, progress: Callable[[Progress], None] = lambda update: None, crosscheck: bool = False
) -> Result:
    """Sample the posterior of a study and compare it with least squares.

    The work is done by :func:`bayesterra.analysis.inference.run`.

    Of a study with a [pooling] table the result is a :class:`bayesterra.pooling.run.PooledResult`.

    Raises
    ------
    StudyError : no study is given.
    """
    check_kind("bt.run", study, Study)
    check_seed(seed)
    return _sampled(study, seed=seed, report=progress, crosscheck=crosscheck)


def _sampled(study: Study, **how: Any) -> Result:
    return inference.run(study, **how) if study.pooling is None else judged(run_pooled(study, **how), how["seed"])


def load_result(folder: str | Path, *, allow_code: bool = False) -> Result:
    """Read a saved result folder; ``allow_code``: run the code that its study names as its model.

    Raises
    ------
    ResultError : the folder is missing, incomplete or damaged.
    StudyError : no path is given.
    """
    path = checked_path("bt.load_result", folder, "a result folder")
    with allowing_code(allow_code):
        return read_pooled(path) if is_pooled(path) else read_result(path)


def run_study(
    study: Study,
    *,
    out: Path,
    seed: int = 1,
    overwrite: bool = False,
    resume: bool = False,
    quiet: bool = False,
    crosscheck: bool = False,
) -> Result:
    """Run a study into a folder, with a progress bar on a terminal and a status file to poll.

    Every finished adaptation and round of sampling is saved in ``<out>.part``. With ``resume`` a run that
    ended before its time goes on from there, to the same draws as if it had not; where it had ended in time,
    its result is read.

    Raises
    ------
    ResultError : the folder exists (and ``overwrite`` is not given) or cannot be written; an unfinished run
        is in the way, or was begun with another study, seed or version.
    SupportError : the prior leaves no parameter set that fits the conditions of the data.
    """
    from bayesterra.report.terminal import note

    if resume and not overwrite and (done := _finished(study, out, seed)):
        return done
    check_free(out, overwrite=overwrite)
    with job_folder(out, overwrite=overwrite, resume=resume) as (part, status):
        checkpoints = Checkpoints.opened(part / WORK, identity(study, seed))
        resumed = bool(unfinished(part)[1])
        for sentence in checkpoints.notes if not quiet else ():
            note(sentence)
        with progress_bar(status, quiet=quiet) as update:
            update(Progress("drawing from the prior", 0.0))
            how: dict[str, Any] = {"seed": seed, "report": update, "checkpoint_store": checkpoints}
            with damage(ResultError, part, STUCK) if resumed else nullcontext():
                result = _sampled(study, crosscheck=crosscheck, **how)
            update(Progress("writing the report", 1.0))
            result = result.write(part)
    return result


STUCK = "'{}' holds segments that this run cannot go on from ({}): add --overwrite in place of --resume to begin anew"
"""Error for saved segments that are whole and of this run, and yet no run can go on from them."""


def _finished(study: Study, out: Path, seed: int) -> Result | None:
    """The result that a run left which ended after all; None where there is none, or another one."""
    if not (out / "run.json").is_file() or unfinished(part_of(out))[1]:
        return None
    try:
        result = load_result(out)
    except ResultError:
        return None
    if result.record["fingerprints"].get("run") != digest(identity(study, seed)):
        return None
    clear_up(out)
    return result


def soil_test(
    test: Study | str | Path | None = None,
    *,
    data: pd.DataFrame | None = None,
    seed: int = 1,
    progress: Callable[[Progress], None] = lambda update: None,
    **tables: Any,
) -> Result:
    """Sample what a series of plate or shear tests tells of its soil, and set it beside least squares.

    Parameters
    ----------
    test : a soil-test file, the folder of one, or a loaded test.
    data : in place of a file: readings with units in the headers; further keywords are then the tables of the
        file (``kind="plate"``, ``priors``, ``noise``, ...), with numbers in SI, and options of [data] by
        name.
    seed : same seed, same draws on one machine.
    progress : called as the sampling goes on.

    Raises
    ------
    StudyError : something in the file or the tables cannot be used as it stands.
    SupportError : the prior leaves no physical parameter set.
    """
    if data is not None:
        check_kind("bt.soil_test", data, pd.DataFrame)
        content = dict(tables)
        options = ("source", "pressure_range", "displacement_range", "spacing")
        rows = {name: content.pop(name) for name in options if name in content}
        test = soil_test_study({"test": content.pop("kind", None), "data": rows, **content}, table=data)
    elif isinstance(test, str | Path):
        test = load_soil_test(test)
    if test is None or (tables and data is None):
        raise TypeError("soil_test() takes a file, a loaded test, or data with its tables")
    check_kind("bt.soil_test", test, Study)
    return run(test, seed=seed, progress=progress)


def run_prior_study(study: Study, *, out: Path, seed: int = 1, overwrite: bool = False) -> PriorResult:
    """Report on a study's prior alone into a folder; see :func:`bayesterra.analysis.inference.run_prior`.

    ResultError where the folder exists (and ``overwrite`` is not given) or cannot be written; SupportError where the
    prior leaves no parameter set that fits the conditions of the table.
    """
    check_free(out, overwrite=overwrite)
    with whole_folder(out, overwrite=overwrite) as part:
        return run_prior(study, seed=seed).write(part)


def opened(path: Path) -> Study | Result:
    """The result folder or the study at a path; BayesterraError where it is neither, or something in it is wrong."""
    if is_result(path):
        return load_result(path)
    if path.is_file() or (path / "study.toml").is_file():
        return load_study(path)
    missing = "neither run.json nor study.toml in it" if path.is_dir() else "no such file or folder"
    raise ResultError(f"'{path}' is neither a study nor a result: {missing}")


def opened_for_design(path: Path) -> Study | Result:
    """The result in a folder that ``run`` wrote, else the study, with or without readings."""
    if is_result(path) and not is_prior(path):
        return load_result(path)
    check_sums(path, STUDY_FILE, "measurements.csv")
    return load_study(path, prior_only=True)


def opened_for_stream(path: Path) -> Path | Result:
    """The result at a path; the path itself where it is a study or a stream that was put down."""
    from bayesterra.follow.stream import STATE, Stream

    if (path / Stream.MARK).exists() or (path / STATE).exists() or not is_result(path):
        return path
    return load_result(path)


ANEW = "`bayesterra holdout` makes each fit anew"


def judged(result: PooledResult, seed: int) -> PooledResult:
    """The result with its verdicts on fit and prediction in the record.

    Their random streams are of the run's ``seed``, beside those of :func:`bayesterra.pooling.run.run_pooled`.
    """
    study, draws, failures = result.study, result.values(), Failures()
    joint, levels = joint_posterior(study), ways(study)
    fitting, predicting = SeedSequence(seed).spawn(8)[6:]
    with threadpool_limits(limits=1):  # matrices are small: threads of the linear algebra wait for each other
        fit = failures.attempt(
            "predictive_checks", lambda: fit_of_groups(study, joint, draws, levels, default_rng(fitting))
        )
        prediction = failures.attempt("levels", lambda: prediction_of_levels(study, joint, draws, levels, predicting))
    verdicts = (
        result.verdicts[0],
        fit or unknown_verdict("Fit", failures.said("predictive_checks")),
        prediction or unknown_verdict("Prediction", failures.said("levels")),
    )
    record = {**result.record, "verdicts": [verdict.record() for verdict in verdicts], "untested": untested(study)}
    found = replace(result, record=with_failures(record, failures))
    return replace(found, record={**found.record, "sentence": found.sentence})


def fit_of_groups(
    study: Study, joint: JointPosterior, draws: FloatArray, levels: Mapping[str, tuple[Fold, ...]], rng: Generator
) -> Verdict:
    """Verdict on the group whose readings look the strangest, as one of so many."""
    parts, order = parts_of(study, levels), study.observations.used().rows
    found = {}
    for (group, own), x in zip(joint.groups.items(), joint.values_of_groups(draws), strict=True):
        mine = np.isin(order, own.likelihood.observations.rows)
        found[group] = uncalibrated_checks(own, x, rng, {by: number[mine] for by, number in parts.items()})
    group, worst = min(found.items(), key=lambda item: item[1].overall)
    worst = replace(worst, overall=min(1.0, len(found) * worst.overall))
    verdict = fit_verdict(worst)
    if verdict.grade == "good":
        number = sum(len(checks.checks) for checks in found.values())
        said = f"No group looks strange: the least p of {number} statistics, times their number, is"
        return replace(verdict, sentence=f"{said} {probability(worst.overall)}.")
    claim = verdict.claim.replace(" fit: ", f" fit {group}: ")
    return replace(verdict, sentence=f"{group}: {verdict.sentence}", claim=claim)


def prediction_of_levels(
    study: Study, joint: JointPosterior, draws: FloatArray, levels: Mapping[str, tuple[Fold, ...]], seed: SeedSequence
) -> Verdict:
    """Verdict on levels left out, those that draws of the joint posterior reach by their weights."""
    if not joint.rows_apart:
        return prediction_verdict(None, study.model.name, f"Errors of the model tie rows together: {ANEW}.")
    leaving, predicting = seed.spawn(2)
    left = list(dict.fromkeys(places(study, fold) for folds in levels.values() for fold in folds))
    found = without_levels(joint, draws, leaving, left)
    records = predicted(study, joint, levels, found, default_rng(predicting))
    told = [row for row in records if row["reliable"]]
    beyond = list(dict.fromkeys(str(row["level"]) for row in records if not row["reliable"]))
    rest = f"{enumerated(beyond)}: the posterior without {'it' if len(beyond) == 1 else 'each'} is quite another one"
    if records and not told:
        return prediction_verdict(None, study.model.name, f"Not tested: {rest}; {ANEW}.")
    verdict = prediction_verdict(told, study.model.name)
    return replace(verdict, sentence=f"{verdict.sentence} Not tested: {rest}; {ANEW}.") if beyond else verdict
