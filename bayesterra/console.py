"""What a run shows on a terminal: progress, and the verdict at its end."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar
from rich.table import Table

from bayesterra.calibration import Progress as CalibrationProgress
from bayesterra.design.judging import Progress as DesignProgress
from bayesterra.figures.rows import Found, found_rows
from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.prior_only import PriorResult
from bayesterra.report.numbers import interval, probability, resolution, rounded
from bayesterra.report.validation import alarming, misfit_text
from bayesterra.report.verdicts import UNSEEN
from bayesterra.results import Result
from bayesterra.sampling.sampler import Progress
from bayesterra.terminal import PlainConsole, print_failures
from bayesterra.validation import Validation


@contextmanager
def progress_bar(*, show: bool) -> Iterator[Callable[[Progress], None]]:
    """A progress bar on standard error; without ``show`` a silent one."""
    columns = (TextColumn("{task.description:<11}"), BarColumn(), TextColumn("{task.fields[figures]}"))
    with Bar(*columns, console=PlainConsole(stderr=True), disable=not show, transient=True) as bar:
        task = bar.add_task("reading", total=1.0, figures="")

        def update(progress: Progress) -> None:
            bar.update(task, description=progress.stage, completed=progress.done, figures=_figures(progress))

        yield update


def note(sentence: str) -> None:
    """Say something on standard error, in one line."""
    PlainConsole(stderr=True).print(f"note: {sentence}", soft_wrap=True)


@contextmanager
def calibration_bar(*, show: bool) -> Iterator[Callable[[CalibrationProgress], None]]:
    """A bar of finished replications; see :func:`task_bar`."""
    with task_bar("calibrating", "replications", show=show) as bar:

        def update(progress: CalibrationProgress) -> None:
            remark = f", {progress.unsettled} not converged" if progress.unsettled else ""
            bar("calibrating", progress.done, progress.of, progress.seconds_left, remark)

        yield update


@contextmanager
def design_bar(*, show: bool) -> Iterator[Callable[[DesignProgress], None]]:
    """A bar of judged candidates, from drive to drive; see :func:`task_bar`."""
    with task_bar("judging", "candidates", show=show) as bar:

        def update(progress: DesignProgress) -> None:
            stage = f"judging for drive {progress.drive}"
            bar(stage, progress.done, progress.of, progress.seconds_left, "")

        yield update


@contextmanager
def task_bar(
    stage: str, tasks: str, *, show: bool
) -> Iterator[Callable[[str, int, int, float | None, str], None]]:
    """A bar of finished tasks and the time left on standard error, on a terminal and with ``show`` only.

    It is told the stage, how many tasks of how many are done, the seconds left, and a remark.
    """
    console = PlainConsole(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[figures]}"))
    silent = not (show and console.is_terminal)
    with Bar(*columns, console=console, disable=silent, transient=True) as bar:
        task = bar.add_task(stage, total=1.0, figures="")

        def update(stage: str, done: int, of: int, left: float | None, remark: str) -> None:
            figures = f"{done} of {of} {tasks}{remark}{_in_words(left)}"
            bar.update(task, description=stage, completed=done / of, figures=figures)

        yield update


def _in_words(left: float | None) -> str:
    """The time left."""
    if left is None:
        return ""
    return f", {left / 60:.0f} min left" if left > 90 else f", {left:.0f} s left"


@contextmanager
def stages(*, show: bool) -> Iterator[Callable[[str], None]]:
    """A line on standard error that names the part at work; nothing without ``show`` or a terminal."""
    console = PlainConsole(stderr=True)
    if not (show and console.is_terminal):
        yield lambda part: None
        return
    with console.status("") as status:
        yield status.update


def _figures(progress: Progress) -> str:
    """Acceptance, effective draws, R-hat and time left, once they are known."""
    diagnosis = progress.diagnosis
    if diagnosis is None:
        return ""
    left = f", {progress.seconds_left:.0f} s left" if progress.seconds_left else ""
    return (
        f"{diagnosis.ess:.0f} effective draws, R-hat {diagnosis.worst_r_hat:.3f},"
        f" acceptance {diagnosis.acceptance:.2f}{left}"
    )


def print_result(result: Result, report: Path) -> None:
    """Print the verdict, the parameters and the name of the report."""
    console = PlainConsole()
    console.print(_table(result))
    console.print(verdict_line(result.record), highlight=False, soft_wrap=True)
    if misfit := misfit_line(result):
        PlainConsole(stderr=True).print(misfit, highlight=False, soft_wrap=True)
    if found := result.record.get("crosscheck"):
        console.print(
            f"Cross-check by nested sampling: {found['verdict']} ({found['worst']}).", highlight=False
        )
    print_failures(console, result.record)
    console.print(f"Report: {report}", highlight=False, soft_wrap=True)


def print_pooled(record: Mapping[str, Any], report: Path) -> None:
    """Print what a run with groups found: convergence, what is shared, and the name of the report."""
    console, found = PlainConsole(), record["pooling"]
    table = Table(box=SIMPLE_HEAD, padding=(0, 1))
    for header in ("pooling", "log evidence", "elpd of rows", "elpd of groups"):
        table.add_column(header, justify="left" if header == "pooling" else "right", no_wrap=True)
    for row in found["degrees"]:
        figures = (row["log_evidence"], row["elpd_rows"], row["elpd_groups"])
        table.add_row(row["pooling"], *(f"{figure:.1f}" for figure in figures))
    console.print(table)
    console.print(verdict_line(record), highlight=False, soft_wrap=True)
    console.print(f"Evidence prefers: {found['preferred']}. {found['sentence']}", highlight=False)
    if found.get("sentence_as_stated"):
        console.print(
            f"With the other parameters as this study has them: {found['sentence_as_stated']}",
            highlight=False,
        )
    print_failures(console, record)
    console.print(f"Report: {report}", highlight=False, soft_wrap=True)


def print_prior(result: PriorResult, report: Path) -> None:
    """Print what physics leaves of the prior, and the name of the report."""
    console = PlainConsole()
    table = Table(title=result.study.title or None, box=SIMPLE_HEAD, padding=(0, 1))
    for header in ("quantity", "unit", "prior median", "90 % HDI"):
        table.add_column(header, justify="right" if header[-1] in "nI" else "left", no_wrap=True)
    for row in result.summary.to_dict("records"):
        low, high = row["prior_hdi90_lo"], row["prior_hdi90_hi"]
        middle = rounded(row["prior_median"], resolution(low, high))
        table.add_row(row["parameter"], row["unit"], middle, interval(low, high))
    console.print(table)
    share = result.record["prior_support"]["shares"]["inside the support"]
    console.print(f"Prior only, no readings used: physics leaves {100 * share:.3g} % of it.", highlight=False)
    print_failures(console, result.record)
    console.print(f"Report: {report}", highlight=False, soft_wrap=True)


def _table(result: Result) -> Table:
    words = {name: _verdict(row) for name, row in found_rows(result).items()}
    table = Table(title=result.study.title or None, box=SIMPLE_HEAD, padding=(0, 1))
    for header in ("parameter", "unit"):
        table.add_column(header)
    for header in ("mode", "median", "90 % HDI"):
        table.add_column(header, justify="right", no_wrap=True)
    table.add_column("verdict")
    for row in result.summary.to_dict("records"):
        if row["parameter"] in words:
            table.add_row(*_cells(row), words[row["parameter"]])
    return table


def _cells(row: Mapping[Hashable, Any]) -> tuple[str, ...]:
    """A row of the summary, to the precision that its interval supports."""
    low, high = row["hdi90_lo"], row["hdi90_hi"]
    step = resolution(low, high)
    figures = (rounded(row["mode"], step), rounded(row["median"], step), interval(low, high))
    return (PARAMETERS[row["parameter"]].symbol, row["unit"], *figures)


def _verdict(row: Found) -> str:
    """The word, with the partner of a coupled parameter."""
    if row.verdict != "coupled":
        return row.verdict
    return f"coupled with {PARAMETERS[row.coupled_with].symbol if row.coupled_with else 'several'}"


def misfit_line(result: Result) -> str:
    """One line where the model cannot make readings like these, with what is wrong; else empty."""
    checks = Validation.from_record(result.record).checks
    if checks is None or not checks.alarm:
        return ""
    parts = "; ".join(f"{CHANNELS[one.channel].description} {one.finding}" for one in alarming(checks))
    return misfit_text(f"{parts} (overall p {probability(checks.overall)})")


def verdict_line(record: Mapping[str, Any]) -> str:
    """One line: converged or not, with the figures behind the word."""
    verdict = record["verdict"]
    figures = f"{verdict['ess']:.0f} effective draws, R-hat {verdict['r_hat']:.4f}"
    if verdict["converged"]:
        return f"Sampling converged: {figures}. {UNSEEN}"
    failed = "; ".join(
        f"{check['name']} {check['value']:.4g} (asked: {check['threshold']:.4g})"
        for check in verdict["checks"]
        if not check["passed"]
    )
    return f"Sampling did NOT converge: {failed}. {figures}."
