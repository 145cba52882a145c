"""Result of a run on one soil, with its page and what the terminal says of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesterra.analysis.record import RunRecord
from bayesterra.checking.validation import Validation
from bayesterra.study.result import Result

if TYPE_CHECKING:
    from bayesterra.analysis.page import Page
    from bayesterra.report.blocks import Overview


class RunResult(Result):
    """The outcome of a run on one soil."""

    RECORD = RunRecord

    @property
    def validation(self) -> Validation:
        """Predictive checks under posterior and prior, and leave-one-out by row."""
        return Validation.from_record(self.record)

    def page(self) -> Page:
        """The report, with what could not be made of it."""
        from bayesterra.analysis.page import page

        return page(self)

    def overview(self) -> Overview:
        """Parameters with their verdicts, the verdict on the sampling, and what speaks against the model."""
        from bayesterra.analysis.terminal import run_overview

        return run_overview(self)
