"""The report of a result: one HTML file that needs no network and no script."""

from __future__ import annotations

from importlib.metadata import version

from bayesterra.calibration import Calibration
from bayesterra.design.choosing import Design
from bayesterra.failures import Failures
from bayesterra.holdout import Holdout
from bayesterra.identified import Identified
from bayesterra.pooled import PooledResult
from bayesterra.prior_only import PriorResult
from bayesterra.report.before import prior_page
from bayesterra.report.calibration import calibration_page
from bayesterra.report.contrast import contrast_page
from bayesterra.report.design import design_page
from bayesterra.report.holdout import holdout_page
from bayesterra.report.identifiability import identifiability_page
from bayesterra.report.page import page, render
from bayesterra.report.pooled import pooled_page
from bayesterra.report.soiltests import soil_test_page
from bayesterra.results import Result
from bayesterra.side_by_side import Comparison
from bayesterra.soiltests.analysis import SoilTestResult

__all__ = [
    "calibration_html",
    "comparison_html",
    "design_html",
    "holdout_html",
    "html",
    "html_and_failures",
    "identifiability_html",
    "pooled_and_failures",
    "pooled_html",
    "prior_and_failures",
    "prior_html",
    "soil_test_and_failures",
    "soil_test_html",
]


def html(result: Result) -> str:
    """The report as a self-contained HTML page; the same result gives the same text."""
    return render(page(result))


def html_and_failures(result: Result) -> tuple[str, Failures]:
    """The same, and those of its sections that could not be made."""
    made = page(result)
    return render(made), made.failures


def pooled_html(result: PooledResult) -> str:
    """The report of a study with groups as a self-contained HTML page."""
    return pooled_and_failures(result)[0]


def pooled_and_failures(result: PooledResult) -> tuple[str, Failures]:
    """The same, and those of its sections that could not be made."""
    made = pooled_page(result)
    return render(made, "pooled.html"), made.failures


def prior_html(result: PriorResult) -> str:
    """The report of a prior without readings as a self-contained HTML page."""
    return prior_and_failures(result)[0]


def prior_and_failures(result: PriorResult) -> tuple[str, Failures]:
    """The same, and those of its sections that could not be made."""
    made = prior_page(result)
    return render(made, "before.html"), made.failures


def comparison_html(comparison: Comparison) -> str:
    """Several results side by side as a self-contained HTML page."""
    return render(contrast_page(comparison), "contrast.html")


def calibration_html(calibration: Calibration) -> str:
    """The report of a calibration as a self-contained HTML page."""
    return render(calibration_page(calibration), "calibration.html")


def identifiability_html(made: Identified) -> str:
    """An identifiability analysis as a self-contained HTML page."""
    return render(identifiability_page(made), "identifiability.html")


def design_html(design: Design) -> str:
    """Which drive next, as a self-contained HTML page."""
    return render(design_page(design, version("bayesterra")), "design.html")


def holdout_html(found: Holdout) -> str:
    """Levels left out and predicted, as a self-contained HTML page."""
    return render(holdout_page(found, version("bayesterra")), "holdout.html")


def soil_test_html(result: SoilTestResult) -> str:
    """The result of a soil test as a self-contained HTML page."""
    return soil_test_and_failures(result)[0]


def soil_test_and_failures(result: SoilTestResult) -> tuple[str, Failures]:
    """The same, and those of its sections that could not be made."""
    made = soil_test_page(result)
    return render(made, "soiltest.html"), made.failures
