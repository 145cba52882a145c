"""Pages of one line, for results whose pages nobody looks at: to draw one takes seconds."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from bayesterra.report.verdicts import Failures


@contextmanager
def plain_pages() -> Iterator[None]:
    """Results of runs that are written have a report of one line."""
    page = SimpleNamespace(html=lambda: "report\n", failures=Failures())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayesterra.analysis.page.run_page", lambda result: page)
        yield


@contextmanager
def undrawn() -> Iterator[None]:
    """Pages have empty pictures: their figures are made, and no mark of them is set."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayesterra.report.figures.svg", lambda drawn: b'<svg xmlns="http://www.w3.org/2000/svg"/>')
        yield


@contextmanager
def unpainted() -> Iterator[None]:
    """Folders too have empty pictures: their figures are made, and no dot of them is set."""
    with undrawn(), pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayesterra.report.figures.white_png", lambda drawn, dpi=200: b"\x89PNG")
        yield
