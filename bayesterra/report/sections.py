"""Sections, verdicts, and the page made of them: what may fail of it, and templates that make HTML."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from bayesterra.report.blocks import Blocks, Cell, Text
from bayesterra.report.failures import REPORT, Failures, sentences, with_failures
from bayesterra.report.symbols import angles

SIGNS = {"good": "✓", "fair": "◐", "poor": "✕"}
UNSEEN = "A second solution that no ensemble found would not show."
"""Limit of what convergence can say."""


@dataclass(frozen=True)
class Section:
    """A part of the report under a heading."""

    anchor: str
    title: str
    blocks: Blocks


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


@dataclass(frozen=True)
class VerdictPage:
    """Everything that the template shows, in its order.

    Attributes
    ----------
    facts : what was analysed, in one line.
    warning : what to do about a result that cannot be relied on, else empty.
    failures : what could not be made of this page.
    kind : of the data, where it stands apart from the facts.
    template : that is filled with it.
    """

    title: str
    facts: tuple[Cell, ...]
    verdicts: tuple[Verdict, ...]
    sections: tuple[Section, ...]
    version: str
    warning: Markup
    failures: Failures = field(default_factory=Failures, kw_only=True)
    kind: str = field(default="", kw_only=True)
    template: str = field(default="report.html", kw_only=True)

    def html(self) -> str:
        """The page as self-contained HTML; the same page gives the same text."""
        return render(self, self.template)


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


def unknown_verdict(title: str, why: str) -> Verdict:
    """The word that a verdict is not known, and why."""
    return Verdict(title, "not known", "fair", Markup("{}").format(why))


def verdict(failures: Failures, title: str, make: Callable[[], Verdict], without: str = "") -> Verdict:
    """A verdict, or the word that it is not known: ``without`` what it rests on, or where it fails."""
    if without:
        return unknown_verdict(title, without)
    part = f"{REPORT}verdict on {title.lower()}"
    return failures.attempt(part, make, lambda: unknown_verdict(title, failures.said(part)))


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
