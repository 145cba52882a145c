"""The terminal: a console that shows text as text, notes, and bars of what is under way."""

import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from typing import Any

from markupsafe import Markup
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar
from rich.table import Table as RichTable
from rich.text import Text as RichText

from bayesterra.errors import printable
from bayesterra.report.blocks import Cell, Overview, Table, Text
from bayesterra.report.verdicts import sentences


class PlainConsole(Console):
    """A console that knows no markup and no emoji codes, and lets no control character through."""

    def __init__(self, *, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, markup=False, emoji=False, highlight=False)

    def render_str(self, text: str, **options: Any) -> RichText:
        """Text of a sentence or of a cell: brackets are units, and what does not show is spelled out."""
        options |= {"markup": False, "emoji": False}
        return super().render_str("\n".join(map(_harmless, text.split("\n"))), **options)


def show(overview: Overview, *lines: str, console: PlainConsole | None = None) -> None:
    """Print an overview and lines under it; bad lines of it go to standard error."""
    console = console or PlainConsole()
    for block in (*overview, *map(Text, lines)):
        if isinstance(block, Table):
            console.print(_table(block))
        else:
            chosen = PlainConsole(stderr=True) if block.tone == "bad" else console
            chosen.print(_plain(block.text), soft_wrap=True)


def _table(block: Table) -> RichTable:
    """A table whose numbers stay whole; empty rows part the others."""
    table = RichTable(title=_plain(block.caption) or None, box=SIMPLE_HEAD, padding=(0, 1))
    for i, (header, letter) in enumerate(zip(block.header, block.align, strict=True)):
        words = [word for row in block.rows for cell in row[i : i + 1] for word in _plain(cell).split()]
        least = min(max(map(len, words), default=0), 12)  # a column of text never vanishes
        how = {"justify": "right", "no_wrap": True} if letter == "r" else {"min_width": least}
        table.add_column(_plain(header), **how)
    for row in block.rows:
        if row:
            table.add_row(*map(_plain, row))
        else:
            table.add_section()
    return table


def _plain(cell: Cell) -> str:
    return cell.replace("<sup>", "^").striptags() if isinstance(cell, Markup) else cell


def failure_lines(record: Mapping[str, Any]) -> Overview:
    """What could not be computed; nothing where all could."""
    text = sentences(record)
    return (Text(f"{text} run.json says where it failed: please report it."),) if text else ()


def _harmless(line: str) -> str:
    """A line with its spaces as they are."""
    return "".join(part if part.isspace() else printable(part) for part in re.split(r"( +)", line))


def note(sentence: str) -> None:
    """Print a note on standard error, in one line."""
    PlainConsole(stderr=True).print(f"note: {sentence}", soft_wrap=True)


@contextmanager
def task_bar(stage: str, tasks: str, *, show: bool) -> Iterator[Callable[[str, int, int, float | None, str], None]]:
    """A bar of finished tasks and the time left on standard error, on a terminal and with ``show`` only.

    It is told the stage, how many tasks of how many are done, the seconds left, and a remark.
    """
    with shown_bar(stage, show=show) as tell:
        yield lambda stage, done, of, left, remark: tell(
            stage, done / of, f"{done} of {of} {tasks}{remark}{_in_words(left)}"
        )


@contextmanager
def shown_bar(stage: str, *, show: bool) -> Iterator[Callable[[str, float, str], None]]:
    """A bar on standard error, on a terminal and with ``show`` only; it is told the stage, the share done, figures."""
    silent = not (show and sys.stderr.isatty())
    columns = (TextColumn("{task.description:<11}"), BarColumn(), TextColumn("{task.fields[figures]}"))
    bar = Bar(*columns, console=PlainConsole(stderr=True), disable=silent, transient=True)
    with nullcontext() if silent else bar:  # rich before 14.3 ends a line also for a bar that is not shown
        task = bar.add_task(stage, total=1.0, figures="")
        yield lambda stage, done, figures: bar.update(task, description=stage, completed=done, figures=figures)


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
