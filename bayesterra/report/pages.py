"""What every page without a parameter strip shows: prior, comparison, calibration."""

from __future__ import annotations

from dataclasses import dataclass, field

from markupsafe import Markup

from bayesterra.failures import Failures
from bayesterra.report.blocks import Cell, Section
from bayesterra.report.verdicts import Verdict


@dataclass(frozen=True)
class VerdictPage:
    """Everything that the template shows, in its order.

    Attributes
    ----------
    facts : what was analysed, in one line.
    warning : what to do about a result that cannot be relied on, else empty.
    failures : what could not be made of this page.
    """

    title: str
    facts: tuple[Cell, ...]
    verdicts: tuple[Verdict, ...]
    sections: tuple[Section, ...]
    version: str
    warning: Markup
    failures: Failures = field(default_factory=Failures, kw_only=True)
