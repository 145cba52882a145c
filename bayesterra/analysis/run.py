"""The job ``run``: a study in, a result folder with its report out; and what a path holds, opened."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Self, cast

from bayesterra.analysis import inference
from bayesterra.analysis.prior_only import PriorResult, run_prior
from bayesterra.analysis.storage import is_pooled, read_pooled, read_result, write_result
from bayesterra.checking.validation import Validation
from bayesterra.errors import BayesterraError, ResultError, StudyError, check_kind, check_seed, checked_path
from bayesterra.pooling.run import PooledResult, run_pooled
from bayesterra.report.failures import with_failures
from bayesterra.runtime.checkpoints import Checkpoints, digest
from bayesterra.runtime.folders import check_free, clear_up, part_of, whole_folder, write_text
from bayesterra.runtime.netcdf import is_result
from bayesterra.runtime.ownership import WORK, unfinished
from bayesterra.runtime.reading import UNREADABLE, check_sums, read_json, reason
from bayesterra.runtime.status import job_folder
from bayesterra.sampling.sampler import Progress
from bayesterra.study.canonical import identity
from bayesterra.study.result import Result
from bayesterra.study.study import STUDY_FILE, Study, load_study


class RunResult(Result):
    """A result that can be saved as a folder with its report."""

    @classmethod
    def of(cls, result: Result) -> Self:
        """The same result, with a report to write."""
        return cls(**{field.name: getattr(result, field.name) for field in fields(Result)})

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write the result folder, whole or not at all; returns the path of the report.

        Raises
        ------
        ResultError : the folder exists (and ``overwrite`` is not given) or cannot be written.
        """
        with whole_folder(Path(folder), overwrite=overwrite) as part:
            self._write(part)
        return Path(folder) / "report.html"

    @property
    def validation(self) -> Validation:
        """Predictive checks under posterior and prior, and leave-one-out by row."""
        return Validation.from_record(self.record)

    def _repr_html_(self) -> str:
        from bayesterra.analysis.page import result_table

        return result_table(self)

    def _write(self, part: Path) -> Self:
        """Write all files; returns the result with what could not be made of its report in the record."""
        from bayesterra.analysis.page import html_and_failures

        text, failures = html_and_failures(self)
        complete = replace(self, record=with_failures(self.record, failures))
        write_result(complete, part)
        write_text(part / "report.html", text)
        return complete


class PooledRun(PooledResult):
    """A result of a study with groups that can be saved as a folder with its report."""

    @classmethod
    def of(cls, result: PooledResult) -> Self:
        """The same result, with a report to write."""
        return cls(**{field.name: getattr(result, field.name) for field in fields(PooledResult)})

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write the result folder, whole or not at all; returns the path of the report.

        Raises
        ------
        ResultError : the folder exists (and ``overwrite`` is not given) or cannot be written.
        """
        with whole_folder(Path(folder), overwrite=overwrite) as part:
            self._write(part)
        return Path(folder) / "report.html"

    def _write(self, part: Path) -> Self:
        """Write all files; returns the result with what could not be made of its report in the record."""
        from bayesterra.pooling.page import pooled_and_failures

        text, failures = pooled_and_failures(self)
        complete = replace(self, record=with_failures(self.record, failures))
        write_result(complete, part)
        write_text(part / "report.html", text)
        return complete


def run(
    study: Study,
    *,
    seed: int = 1,
    progress: Callable[[Progress], None] = lambda update: None,
    crosscheck: bool = False,
) -> RunResult:
    """Sample the posterior of a study and compare it with least squares.

    The work is done by :func:`bayesterra.analysis.inference.run`.

    Of a study with a [pooling] table the result is a :class:`PooledRun`; see :mod:`bayesterra.pooling.run`.

    Raises
    ------
    StudyError : no study is given, or a cross-check is asked of one with groups.
    """
    check_kind("bt.run", study, Study)
    check_seed(seed)
    if study.pooling is not None:
        _no_crosscheck(crosscheck)
        return cast(RunResult, PooledRun.of(run_pooled(study, seed=seed, report=progress)))
    return RunResult.of(inference.run(study, seed=seed, report=progress, crosscheck=crosscheck))


def load_result(folder: str | Path) -> RunResult:
    """Read a saved result folder.

    Raises
    ------
    ResultError : the folder is missing, incomplete or damaged.
    StudyError : no path is given.
    """
    path = checked_path("bt.load_result", folder, "a result folder")
    if is_pooled(path):
        return cast(RunResult, PooledRun.of(read_pooled(path)))
    return RunResult.of(read_result(path))


def load_single(folder: str | Path) -> RunResult:
    """Read a saved result folder of a study without groups.

    Raises
    ------
    ResultError : the folder is missing, incomplete or damaged, or holds a joint posterior of several groups.
    """
    return RunResult.of(read_result(Path(folder)))


def run_study(
    study: Study,
    *,
    out: Path,
    seed: int = 1,
    overwrite: bool = False,
    resume: bool = False,
    quiet: bool = False,
    crosscheck: bool = False,
) -> RunResult:
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
    from bayesterra.sampling.progress import progress_bar

    if study.pooling is not None:
        _no_crosscheck(crosscheck)
    if resume and not overwrite and (done := _finished(study, out, seed)):
        return done
    check_free(out, overwrite=overwrite)
    with job_folder(out, overwrite=overwrite, resume=resume) as (part, status):
        checkpoints = Checkpoints.opened(part / WORK, identity(study, seed))
        resumed = bool(unfinished(part)[1])
        for sentence in checkpoints.notes if not quiet else ():
            note(sentence)
        with progress_bar(show=not quiet and sys.stderr.isatty()) as show:

            def update(progress: Progress) -> None:
                progress.note_in(status)
                show(progress)

            update(Progress("drawing from the prior", 0.0))
            how: dict[str, Any] = {"seed": seed, "report": update, "checkpoint_store": checkpoints}
            with _from_segments(part) if resumed else nullcontext():
                if study.pooling is None:
                    result = RunResult.of(inference.run(study, crosscheck=crosscheck, **how))
                else:
                    result = cast(RunResult, PooledRun.of(run_pooled(study, **how)))
            update(Progress("writing the report", 1.0))
            result = result._write(part)
    return result


@contextmanager
def _from_segments(part: Path) -> Iterator[None]:
    """Error for saved segments that are whole and of this run, and yet no run can go on from them."""
    try:
        yield
    except BayesterraError:
        raise
    except UNREADABLE as error:
        raise ResultError(
            f"'{part}' holds segments that this run cannot go on from ({reason(error)}): add --overwrite in"
            " place of --resume to begin anew"
        ) from error


def _no_crosscheck(asked: bool) -> None:
    if asked:
        raise StudyError("--crosscheck takes studies without a [pooling] table")


def _finished(study: Study, out: Path, seed: int) -> RunResult | None:
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


def run_prior_study(study: Study, *, out: Path, seed: int = 1, overwrite: bool = False) -> PriorResult:
    """Report on a study's prior alone into a folder; see :func:`bayesterra.analysis.prior_only.run_prior`.

    Raises
    ------
    ResultError : the folder exists (and ``overwrite`` is not given) or cannot be written.
    SupportError : the prior leaves no parameter set that fits the conditions of the table.
    """
    from bayesterra.analysis.prior_page import prior_and_failures

    check_free(out, overwrite=overwrite)
    with whole_folder(out, overwrite=overwrite) as part:
        result = run_prior(study, seed=seed)
        text, failures = prior_and_failures(result)
        result = replace(result, record=with_failures(result.record, failures))
        write_result(result, part)
        write_text(part / "report.html", text)
    return result


def opened(path: Path) -> Study | Result:
    """The result folder or the study at a path.

    Raises
    ------
    BayesterraError : it is neither, or something in it is wrong.
    """
    if is_result(path):
        return load_single(path)
    if path.is_file() or (path / "study.toml").is_file():
        return load_study(path)
    missing = "neither run.json nor study.toml in it" if path.is_dir() else "no such file or folder"
    raise ResultError(f"'{path}' is neither a study nor a result: {missing}")


def opened_for_design(path: Path) -> Study | Result:
    """The result in a folder that ``run`` wrote, else the study, with or without readings."""
    if is_result(path) and not _prior_only(path):
        return load_single(path)
    check_sums(path, STUDY_FILE, "measurements.csv")
    return load_study(path, prior_only=True)


def opened_for_stream(path: Path) -> Path | Result:
    """The result at a path; the path itself where it is a study or a stream that was put down."""
    from bayesterra.follow.stream import MARK, STATE

    if (path / MARK).exists() or (path / STATE).exists() or not is_result(path):
        return path
    return load_result(path)


def _prior_only(folder: Path) -> bool:
    try:
        return bool(read_json(folder / "run.json").get("prior_only"))
    except (OSError, ValueError, AttributeError):
        return False
