"""Blocks of a page and of an overview: text, tables, pictures."""

from base64 import b64encode
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

from markupsafe import Markup

if TYPE_CHECKING:
    import pandas as pd

    from bayesterra.report.figures import Drawn

Cell: TypeAlias = str | Markup
HALF = 104
"""Letters, at most, of a table that takes half of a page."""
LONG = 61
"""Rows above which a table is long; see ``style.css``."""


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    kind: ClassVar[str] = "text"
    text: Cell
    tone: str = ""


@dataclass(frozen=True)
class Table:
    """A table with a caption; ``align`` has one letter per column: l, r or c; ``number``: on its page."""

    kind: ClassVar[str] = "table"
    caption: Cell
    align: str
    header: tuple[Cell, ...]
    rows: tuple[tuple[Cell, ...], ...]
    number: int = 0

    @property
    def wide(self) -> bool:
        """Whether its cells need more than half of a page."""
        longest = (max(map(_length, column)) for column in zip(self.header, *self.rows, strict=True))
        return sum(min(length, 40) + 3 for length in longest) > HALF

    @property
    def long(self) -> bool:
        """Whether it scrolls on a screen, and ends early on paper."""
        return len(self.rows) > LONG

    @property
    def sides(self) -> tuple[str, ...]:
        """Class of every column."""
        return tuple({"l": "left", "r": "right", "c": "centre"}[letter] for letter in self.align)


def _length(cell: Cell) -> int:
    return len(cell.striptags() if isinstance(cell, Markup) else cell)


@dataclass(frozen=True)
class Picture:
    """An image with the text that stands for it."""

    data: str  # as a ``data:`` address
    alt: str
    width: int  # at 1 × scale, CSS pixels
    drawn: "Drawn" = field(repr=False, compare=False)  # what it shows, for other formats


@dataclass(frozen=True)
class Gallery:
    """Pictures side by side with one caption; ``size`` is small, half or whole; ``number``: on its page."""

    kind: ClassVar[str] = "gallery"
    size: str
    pictures: tuple[Picture, ...]
    caption: Cell
    number: int = 0


Block: TypeAlias = Text | Table | Gallery
Blocks: TypeAlias = tuple[Block, ...]


def drawing(drawn: "Drawn", alt: str) -> Picture:
    """A figure as SVG; what is of many marks may be a picture within it."""
    from bayesterra.report.figures import css_width, svg

    content = b64encode(svg(drawn)).decode("ascii")
    return Picture(f"data:image/svg+xml;base64,{content}", alt, css_width(drawn), drawn)


Record: TypeAlias = dict[str, Any]


def records(table: "pd.DataFrame") -> list[Record]:
    """One dictionary per row, by column."""
    return [{str(name): value for name, value in row.items()} for row in table.to_dict("records")]


Overview: TypeAlias = tuple[Table | Text, ...]
"""A result in short, for a terminal and a notebook: bad lines warn, empty rows part a table."""
