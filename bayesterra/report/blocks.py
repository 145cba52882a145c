"""Blocks of a page: text, tables, pictures, verdicts; what may fail; and templates that make HTML of them."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from bayesterra.report.failures import REPORT, Failures, sentences, with_failures
from bayesterra.report.symbols import angles, in_symbols

if TYPE_CHECKING:
    from bayesterra.report.figures import Drawn

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
Blocks: TypeAlias = tuple[Block, ...]


@dataclass(frozen=True)
class Section:
    """A part of the report under a heading."""

    anchor: str
    title: str
    blocks: Blocks


def drawing(drawn: Drawn, alt: str) -> Picture:
    """A figure of few marks, as SVG."""
    from bayesterra.report.figures import css_width, svg

    return Picture(_address("image/svg+xml", svg(drawn)), alt, css_width(drawn))


def photograph(drawn: Drawn, alt: str, width: int | None = None) -> Picture:
    """A figure of many marks, as PNG with two dots per CSS pixel; ``width`` in CSS pixels."""
    from bayesterra.report.figures import css_width, png

    width = width or css_width(drawn)
    return Picture(_address("image/png", png(drawn, 2 * width)), alt, width)


def _address(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{b64encode(content).decode('ascii')}"


Record: TypeAlias = dict[str, Any]


def records(table: pd.DataFrame) -> list[Record]:
    """One dictionary per row, by column."""
    return [{str(name): value for name, value in row.items()} for row in table.to_dict("records")]


@dataclass(frozen=True)
class VerdictPage:
    """Everything that the template shows, in its order.

    Attributes
    ----------
    facts : what was analysed, in one line.
    warning : what to do about a result that cannot be relied on, else empty.
    failures : what could not be made of this page.
    template : that is filled with it.
    """

    title: str
    facts: tuple[Cell, ...]
    verdicts: tuple[Verdict, ...]
    sections: tuple[Section, ...]
    version: str
    warning: Markup
    failures: Failures = field(default_factory=Failures, kw_only=True)
    template: str = field(default="report.html", kw_only=True)

    def html(self) -> str:
        """The page as self-contained HTML; the same page gives the same text."""
        return render(self, self.template)


Overview: TypeAlias = tuple[Table | Text, ...]
"""A result in short, for a terminal and a notebook: poor lines warn, empty rows part a table."""


def notebook(overview: Overview) -> str:
    """An overview as HTML, plain symbols set as in the literature."""
    return "".join(
        str(Markup("<p>{}</p>").format(_set(block.text))) if isinstance(block, Text) else _set_table(block)
        for block in overview
    )


def _set(cell: Cell) -> Markup:
    return cell if isinstance(cell, Markup) else in_symbols(cell)


def _set_table(block: Table) -> str:
    lines = Markup("").join(
        Markup("<tr>{}</tr>").format(_cells("td", row, block)) for row in block.rows if row
    )
    filled = Markup("<div><b>{}</b><table><thead><tr>{}</tr></thead><tbody>{}</tbody></table></div>")
    return str(filled.format(_set(block.caption), _cells("th", block.header, block), lines))


def _cells(tag: str, cells: Sequence[Cell], block: Table) -> Markup:
    start = Markup('<{} style="text-align:{};padding:2px 10px">{}</{}>')
    sides = zip(cells, block.sides, strict=True)
    return Markup("").join(start.format(tag, side, _set(cell), tag) for cell, side in sides)


def section(
    failures: Failures, anchor: str, title: str, make: Callable[[], Blocks], without: str = ""
) -> Section:
    """A section, or a line under its heading: ``without`` what it shows, or where it cannot be made."""
    if without:
        return Section(anchor, title, (Text(without, "poor"),))
    part = f"{REPORT}{title}"
    return failures.attempt(
        part, lambda: Section(anchor, title, make()), lambda: said(failures, part, title, anchor)
    )


def said(failures: Failures, part: str, title: str, anchor: str = "missing") -> Section:
    """A section that only says why it is empty."""
    return Section(anchor, title, (Text(failures.said(part), "poor"),))


def missing(record: Mapping[str, Any], failures: Failures) -> Markup:
    """Sentences on what could not be computed, of a result and of its page; empty where all could."""
    return Markup("{}").format(angles(sentences(with_failures(record, failures))))


def verdict(failures: Failures, title: str, make: Callable[[], Verdict]) -> Verdict:
    """A verdict, or the word that it is not known."""
    part = f"{REPORT}verdict on {title.lower()}"

    def unknown() -> Verdict:
        return Verdict(title, "not known", "fair", Markup("{}").format(failures.said(part)))

    return failures.attempt(part, make, unknown)


def origin_rows(record: Mapping[str, Any], *fingerprints: str) -> tuple[tuple[Cell, ...], ...]:
    """Rows of a table that says what a result was made with; ``fingerprints``: of ``study`` and ``data``."""
    return (
        ("versions", ", ".join(f"{name} {version}" for name, version in record["versions"].items())),
        *((("machine", record["machine"]),) if "machine" in record else ()),
        *(
            (f"fingerprint of the {what}", Markup("<code>{}</code>").format(record["fingerprints"][what]))
            for what in fingerprints
        ),
    )


def render(content: object, template: str = "report.html") -> str:
    """Fill a template with a page; everything that is not marked as HTML is escaped."""
    environment = Environment(
        loader=PackageLoader("bayesterra.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template).render(page=content)


SIGNS = {"good": "✓", "fair": "◐", "poor": "✕"}
UNSEEN = "A second solution that no ensemble found would not show."
"""Limit of what convergence can say."""


@dataclass(frozen=True)
class Verdict:
    """One verdict.

    Attributes
    ----------
    grade : ``good``, ``fair`` or ``poor``.
    """

    title: str
    word: str
    grade: str
    sentence: Markup

    @property
    def sign(self) -> str:
        """A sign that says the grade without colour."""
        return SIGNS[self.grade]
