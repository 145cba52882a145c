"""Progress of a sampler on a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar

from bayesterra.report.terminal import PlainConsole
from bayesterra.sampling.sampler import Progress


@contextmanager
def progress_bar(*, show: bool) -> Iterator[Callable[[Progress], None]]:
    """A progress bar on standard error; without ``show`` a silent one."""
    columns = (TextColumn("{task.description:<11}"), BarColumn(), TextColumn("{task.fields[figures]}"))
    with Bar(*columns, console=PlainConsole(stderr=True), disable=not show, transient=True) as bar:
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
