"""What a report is made of; the template turns each kind into HTML."""

from __future__ import annotations

from base64 import b64encode
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesterra.figures.style import png, svg

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
    heading: Cell = ""


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


def drawing(axes: Axes | np.ndarray, alt: str, heading: Cell = "") -> Picture:
    """A figure of few marks, as SVG."""
    figure = _figure(axes)
    return Picture(_address("image/svg+xml", svg(figure)), alt, _width(figure), heading)


def photograph(axes: Axes | np.ndarray, alt: str, heading: Cell = "", width: int | None = None) -> Picture:
    """A figure of many marks, as PNG with two dots per CSS pixel; ``width`` in CSS pixels."""
    figure = _figure(axes)
    width = width or _width(figure)
    return Picture(
        _address("image/png", png(figure, 2 * width / figure.get_size_inches()[0])), alt, width, heading
    )


def _figure(axes: Axes | np.ndarray) -> Figure:
    figure = np.asarray(axes).ravel()[0].get_figure()
    if not isinstance(figure, Figure):
        raise TypeError("axes must belong to a figure")
    return figure


def _width(figure: Figure) -> int:
    return round(96 * float(figure.get_size_inches()[0]))


def _address(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{b64encode(content).decode('ascii')}"
