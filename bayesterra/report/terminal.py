"""The terminal: a console that shows text as text, notes, and bars of what is under way."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar
from rich.text import Text

from bayesterra.errors import printable
from bayesterra.report.failures import sentences


class PlainConsole(Console):
    """A console that knows no markup and no emoji codes, and lets no control character through."""

    def __init__(self, *, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, markup=False, emoji=False, highlight=False)

    def render_str(self, text: str, **options: Any) -> Text:
        """Text of a sentence or of a cell: brackets are units, and what does not show is spelled out."""
        options |= {"markup": False, "emoji": False}
        return super().render_str("\n".join(map(_harmless, text.split("\n"))), **options)


def print_failures(console: Console, record: Mapping[str, Any]) -> None:
    """Print what could not be computed; nothing where all could."""
    if text := sentences(record):
        console.print(
            f"{text} run.json says where it failed: please report it.", highlight=False, soft_wrap=True
        )


def _harmless(line: str) -> str:
    """A line with its spaces as they are."""
    return "".join(part if part.isspace() else printable(part) for part in re.split(r"( +)", line))


def note(sentence: str) -> None:
    """Print a note on standard error, in one line."""
    PlainConsole(stderr=True).print(f"note: {sentence}", soft_wrap=True)


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
