"""Sections, verdicts, and the page made of them: what may fail of it, and templates that make HTML."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import count
from typing import Any, Generic, Protocol, TypeVar

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from bayesterra.report.blocks import Block, Blocks, Cell, Overview, Table, Text
from bayesterra.report.symbols import angles, in_symbols, listed, symbol, symbols
from bayesterra.report.verdicts import REPORT, Failures, Verdict, failed, sentences, unknown_verdict, with_failures

R = TypeVar("R", bound="Recorded")


@dataclass(frozen=True)
class Section:
    """A part of the report under a heading."""

    anchor: str
    title: str
    blocks: Blocks


def numbered(sections: Sequence[Section]) -> tuple[Section, ...]:
    """Sections whose tables and figures with captions are numbered through."""
    numbers = {"table": count(1), "gallery": count(1)}

    def counted(block: Block) -> Block:
        if isinstance(block, Text) or not block.caption:
            return block
        return replace(block, number=next(numbers[block.kind]))

    return tuple(replace(section, blocks=tuple(map(counted, section.blocks))) for section in sections)


@dataclass(frozen=True)
class VerdictPage:
    """Everything that the template shows, in its order."""

    title: str
    facts: tuple[Cell, ...]  # what was analysed, in one line
    verdicts: tuple[Verdict, ...]
    sections: tuple[Section, ...]
    version: str
    warning: Markup  # what to do about a result that cannot be relied on, else empty
    failures: Failures = field(default_factory=Failures, kw_only=True)  # what could not be made of this page
    kind: str = field(default="", kw_only=True)  # of the data, where it stands apart from the facts
    sentence: str = field(default="", kw_only=True)  # what may be quoted of the result, where there is one
    template: str = field(default="report.html", kw_only=True)  # that is filled with it

    @property
    def quoted(self) -> Markup:
        """The sentence with its symbols set as in the literature."""
        return in_symbols(self.sentence)

    @property
    def numbered(self) -> tuple[Section, ...]:
        """All sections, their tables and figures counted through."""
        return numbered(self.sections)

    @property
    def grade(self) -> str:
        """The worst grade of the verdicts."""
        grades = {verdict.grade for verdict in self.verdicts}
        return next((grade for grade in ("bad", "doubtful") if grade in grades), "good")

    def html(self) -> str:
        """The page as self-contained HTML; the same page gives the same text."""
        return render(self, self.template)


class Recorded(Protocol):
    """A result with the record of how it was made."""

    @property
    def record(self) -> Mapping[str, Any]: ...  # noqa: D102


class Draft(Generic[R]):
    """Sections and verdicts of the page of a result; in place of one that cannot be made stands why.

    ``needs``: parts of the result without which there is nothing to show.
    """

    def __init__(self, result: R) -> None:
        self.failures = Failures()
        self._result = result

    def section(self, anchor: str, title: str, make: Callable[[R], Blocks], *needs: str) -> Section:
        """A section, or a line under its heading."""
        if without := failed(self._result.record, *needs):
            return Section(anchor, title, (Text(without, "bad"),))
        return self.sections(title, lambda result: (Section(anchor, title, make(result)),), anchor)[0]

    def sections(
        self, title: str, make: Callable[[R], tuple[Section, ...]], anchor: str = "missing"
    ) -> tuple[Section, ...]:
        """The sections of a subject, if there are any, or one that says why they are missing."""
        part = f"{REPORT}{title}"
        return self.failures.attempt(
            part,
            lambda: make(self._result),
            lambda: (Section(anchor, title, (Text(self.failures.said(part), "bad"),)),),
        )

    def verdict(self, title: str, make: Callable[[R], Verdict], *needs: str) -> Verdict:
        """A verdict, or the word that it is not known."""
        if without := failed(self._result.record, *needs):
            return unknown_verdict(title, without)
        part = f"{REPORT}verdict on {title.lower()}"
        return self.failures.attempt(
            part, lambda: make(self._result), lambda: unknown_verdict(title, self.failures.said(part))
        )

    def warning(self, *warnings: Markup) -> Markup:
        """Warnings, and what could not be computed, of the result and of its page."""
        text = sentences(with_failures(self._result.record, self.failures))
        return Markup(" ").join(filter(None, (*warnings, angles(text))))


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


def repeated(command: str, record: Mapping[str, Any]) -> Table:
    """A table of what makes a result again."""
    again = Markup("<code>bayesterra {} --seed {}</code>").format(command, record["seed"])
    facts = (("command", again), ("made", record["made"]), *origin_rows(record, "study"))
    return Table("The same study, seed and versions give the same draws.", "ll", ("", ""), facts)


def in_a_line(settings: Mapping[str, Any]) -> str:
    """All settings in one line, tables by their names."""
    entries = []
    for name, value in settings.items():
        inner = f"({in_a_line(value)})" if isinstance(value, Mapping) else value
        entries.append(f"{name.replace('_', ' ')} {inner}")
    return ", ".join(entries)


class Prose:
    """Words of a page, from ``templates/prose/<page>.html``.

    Sentences stand in the template, on lines of any length; figures, names and choices come from the caller.
    Everything that is not marked as HTML is escaped.
    """

    def __init__(self, page: str) -> None:
        self._file = f"prose/{page}.html"

    def __call__(self, name: str, *values: object) -> Markup:
        """The macro of this name, with its arguments."""
        return Markup(_BLANKS.sub(" ", self._named(name)(*values)).strip(" "))  # noqa: S704 (escaped by the template)

    def plain(self, name: str, *values: object) -> str:
        """The same for a record or a terminal, where nothing is HTML."""
        return self(name, *values).unescape()

    def rows(self, name: str) -> tuple[tuple[Cell, ...], ...]:
        """Rows of a table that the template sets under this name."""
        return tuple(self._named(name))

    def table(self, name: str, rows: Iterable[Sequence[Cell]], *values: object, more: Iterable[Cell] = ()) -> Table:
        """A table with the caption of this name and its columns, each a side and a head; ``more``: heads of numbers."""
        columns = [Markup(column) for column in self._named(f"{name}_columns")]  # noqa: S704 (of the template)
        header = (*(column[2:] for column in columns), *more)
        align = "".join(column[0] for column in columns).ljust(len(header), "r")
        return Table(self(name, *values), align, header, tuple(map(tuple, rows)))

    def _named(self, name: str) -> Any:
        return getattr(_environment().get_template(self._file).module, name)


_BLANKS = re.compile("[ \n]+")


@cache
def _environment(package: str = "bayesterra.report") -> Environment:
    loaders = [PackageLoader(name) for name in dict.fromkeys((package, "bayesterra.report"))]
    environment = Environment(
        loader=ChoiceLoader(loaders), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters |= {"form": format, "symbol": symbol, "symbols": symbols, "listed": listed}
    environment.filters["in_symbols"] = in_symbols
    return environment


def notebook(overview: Overview) -> str:
    """An overview as HTML, plain symbols set as in the literature."""
    return render(overview, "notebook.html")


def render(content: object, template: str = "report.html", package: str = "bayesterra.report") -> str:
    """Fill a template, of another room where it says so, with a page; what is not marked as HTML is escaped."""
    return _environment(package).get_template(template).render(page=content)
