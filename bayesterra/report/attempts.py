"""Parts of a page that may fail: each is a line that says so, and the others stand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from markupsafe import Markup

from bayesterra.failures import REPORT, Failures, sentences, with_failures
from bayesterra.report.blocks import Section, Text
from bayesterra.report.symbols import angles
from bayesterra.report.verdicts import Verdict


def section(
    failures: Failures, anchor: str, title: str, make: Callable[[], Section], without: str = ""
) -> Section:
    """A section, or a line under its heading: ``without`` what it shows, or where it cannot be made."""
    if without:
        return Section(anchor, title, (Text(without, "poor"),))
    part = f"{REPORT}{title}"
    return failures.attempt(part, make, lambda: said(failures, part, title, anchor))


def said(failures: Failures, part: str, title: str, anchor: str = "missing") -> Section:
    """A section that only says why it is empty."""
    return Section(anchor, title, (Text(failures.said(part), "poor"),))


def missing(record: Mapping[str, Any], failures: Failures) -> Markup:
    """What could not be computed, of a result and of its page; empty where all could."""
    return Markup("{}").format(angles(sentences(with_failures(record, failures))))


def verdict(failures: Failures, title: str, make: Callable[[], Verdict]) -> Verdict:
    """A verdict, or the word that it is not known."""
    part = f"{REPORT}verdict on {title.lower()}"

    def unknown() -> Verdict:
        return Verdict(title, "not known", "fair", Markup("{}").format(failures.said(part)))

    return failures.attempt(part, make, unknown)
