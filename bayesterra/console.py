"""What a run shows on a terminal: progress, and the verdict at its end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar
from rich.table import Table

from bayesterra.parameters import PARAMETERS
from bayesterra.results import Result
from bayesterra.sampling.sampler import Progress


@contextmanager
def progress_bar(*, show: bool) -> Iterator[Callable[[Progress], None]]:
    """A progress bar on standard error; without ``show`` a silent one."""
    columns = (TextColumn("{task.description:<11}"), BarColumn(), TextColumn("{task.fields[figures]}"))
    with Bar(*columns, console=Console(stderr=True), disable=not show, transient=True) as bar:
        task = bar.add_task("reading", total=1.0, figures="")

        def update(progress: Progress) -> None:
            bar.update(task, description=progress.stage, completed=progress.done, figures=_figures(progress))

        yield update


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
    console = Console()
    console.print(_table(result))
    console.print(verdict_line(result), highlight=False)
    console.print(f"Report: {report}", highlight=False, soft_wrap=True)


def _table(result: Result) -> Table:
    from rich.box import SIMPLE_HEAD

    words = result.identifiability.set_index("parameter")["verdict"]
    table = Table(title=result.study.title or None, box=SIMPLE_HEAD, padding=(0, 1))
    for header, justify in (("parameter", "left"), ("unit", "left"), ("mode", "right"), ("median", "right"),
                            ("90 % HDI", "right"), ("the data", "left")):  # fmt: skip
        table.add_column(header, justify=justify)  # type: ignore[arg-type]  # rich wants its literals
    rows = result.summary[result.summary["parameter"].isin(words.index)]
    for row in rows.itertuples():
        interval = f"{row.hdi90_lo:.3g} to {row.hdi90_hi:.3g}"
        name = str(row.parameter)
        cells = (f"{row.mode:.3g}", f"{row.median:.3g}", interval, _word(words[name]))
        table.add_row(PARAMETERS[name].symbol, str(row.unit), *cells)
    return table


def _word(verdict: str) -> str:
    """The verdict as the end of a sentence that begins with "the data"."""
    return {
        "determined": "determine it",
        "coupled": "couple it with another",
        "weakly": "say a little",
        "repeats its prior": "say nothing: it repeats its prior",
    }.get(verdict, verdict)


def verdict_line(result: Result) -> str:
    """One line: converged or not, with the figures behind the word."""
    verdict = result.record["verdict"]
    figures = f"{verdict['ess']:.0f} effective draws, R-hat {verdict['r_hat']:.4f}"
    if verdict["converged"]:
        return f"Sampling converged: {figures}."
    failed = "; ".join(
        f"{check['name']} {check['value']:.4g} (asked: {check['threshold']:.4g})"
        for check in verdict["checks"]
        if not check["passed"]
    )
    return f"Sampling did NOT converge: {failed}. {figures}."
