"""The report of a result: one HTML file that needs no network and no script."""

from __future__ import annotations

from pathlib import Path

from bayesterra.folders import write_text
from bayesterra.report.page import page, render
from bayesterra.results import Result

__all__ = ["html", "write"]


def html(result: Result) -> str:
    """The report as a self-contained HTML page; the same result gives the same text."""
    return render(page(result))


def write(result: Result, path: str | Path) -> None:
    """Write the report to ``path``, whole or not at all."""
    write_text(Path(path), html(result))
