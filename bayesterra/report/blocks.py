"""What a report is made of; the template turns each kind into HTML."""

from __future__ import annotations

from base64 import b64encode
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

from markupsafe import Markup

from bayesterra.figures.style import Drawn, css_width, png, svg

Cell: TypeAlias = str | Markup


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    kind: ClassVar[str] = "text"
    text: Cell
    tone: str = ""


@dataclass(frozen=True)
class Table:
    """A table with a caption; ``align`` has one letter per column: l, r or c."""

    kind: ClassVar[str] = "table"
    caption: Cell
    align: str
    header: tuple[Cell, ...]
    rows: tuple[tuple[Cell, ...], ...]

    @property
    def sides(self) -> tuple[str, ...]:
        """Class of every column."""
        return tuple({"l": "left", "r": "right", "c": "centre"}[letter] for letter in self.align)


@dataclass(frozen=True)
class Picture:
    """An image with the text that stands for it.

    Attributes
    ----------
    data : as a ``data:`` address.
    width : at 1 × scale, CSS pixels.
    """

    data: str
    alt: str
    width: int


@dataclass(frozen=True)
class Gallery:
    """Pictures side by side with one caption; ``size`` is small, half or whole."""

    kind: ClassVar[str] = "gallery"
    size: str
    pictures: tuple[Picture, ...]
    caption: Cell


Block: TypeAlias = Text | Table | Gallery


@dataclass(frozen=True)
class Section:
    """A part of the report under a heading."""

    anchor: str
    title: str
    blocks: tuple[Block, ...]


def drawing(drawn: Drawn, alt: str) -> Picture:
    """A figure of few marks, as SVG."""
    return Picture(_address("image/svg+xml", svg(drawn)), alt, css_width(drawn))


def photograph(drawn: Drawn, alt: str, width: int | None = None) -> Picture:
    """A figure of many marks, as PNG with two dots per CSS pixel; ``width`` in CSS pixels."""
    width = width or css_width(drawn)
    return Picture(_address("image/png", png(drawn, 2 * width)), alt, width)


def _address(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{b64encode(content).decode('ascii')}"
