"""The three verdicts: each a word, a grade that is also a sign, and a sentence with its figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from bayesterra.adequacy import FitCheck
from bayesterra.failures import failed
from bayesterra.figures.rows import found_rows
from bayesterra.identifiability.information import ALL
from bayesterra.report.determined import finding, marginal
from bayesterra.report.numbers import plain
from bayesterra.report.symbols import listed, symbols
from bayesterra.report.validation import alarm_sentence
from bayesterra.results import Result
from bayesterra.validation import Validation

SIGNS = {"good": "✓", "fair": "◐", "poor": "✕"}
UNSEEN = "A second solution that no ensemble found would not show."
"""What convergence cannot say."""
FEW_READINGS = 3
"""Readings per free parameter below which the check of the fit can hardly fail."""


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


def failed_checks(result: Result) -> list[Mapping[str, Any]]:
    """The checks of the sampling that did not pass."""
    return [check for check in result.record["verdict"]["checks"] if not check["passed"]]


def sampling_verdict(result: Result) -> Verdict:
    """Whether the draws can be relied on."""
    verdict, settings = result.record["verdict"], result.record["settings"]
    figures = Markup("R-hat {}, {} effective draws of {} ensembles").format(
        plain(verdict["r_hat"], 4), plain(verdict["ess"]), settings["ensembles"]
    )
    if result.converged:
        return Verdict("Sampling", "converged", "good", figures + Markup(". {}").format(UNSEEN))
    reasons = listed(check["name"] for check in failed_checks(result))
    return Verdict("Sampling", "not converged", "poor", Markup("{}. Failed: {}.").format(figures, reasons))


def fit_verdict(result: Result, checks: tuple[FitCheck, ...]) -> Verdict:
    """Whether the readings look as the model says that they look."""
    found = Validation.from_record(result.record).checks
    if found is None:
        why = failed(result.record, "predictive_checks")
        return Verdict("Model fit", "not known", "fair", Markup("{}").format(why))
    sentence = alarm_sentence(found)
    overstated = [check.channel for check in checks if check.overstated]
    if overstated:
        sentence += Markup(" Noise of {} looks overstated.").format(symbols(overstated))
    return Verdict(
        "Model fit",
        "not adequate" if found.alarm else "adequate",
        "poor" if found.alarm else "good",
        sentence + few_readings(result, checks),
    )


def few_readings(result: Result, checks: tuple[FitCheck, ...]) -> Markup:
    """A warning where there are so few readings that the model can bend to them."""
    count, free = sum(check.readings for check in checks), len(result.names)
    if count >= FEW_READINGS * free:
        return Markup("")
    return Markup(" {} readings for {} parameters: a lenient test.").format(count, free)


def identifiability_verdict(result: Result) -> Verdict:
    """How many independent combinations of parameters the data determine."""
    found = result.record.get("directions")
    if found is None:
        why = failed(result.record, "identifiability", "directions")
        return Verdict("Identifiability", "not known", "fair", Markup("{}").format(why))
    counts = [row for row in marginal(found) if row["scope"] == ALL] or [{**found, "directions": found["of"]}]
    determined, of = counts[0]["determined"], counts[0]["directions"]
    alone = [name for name, row in found_rows(result).items() if row.verdict == "determined"]
    known = Markup("On their own: {}.").format(symbols(alone)) if alone else "No parameter on its own."
    plain = Markup("Directions of the parameter space whose variance shrinks tenfold or more. {}").format(
        known
    )
    sentence = finding(result) or plain
    grade = "good" if determined == of else "fair" if determined else "poor"
    return Verdict("Identifiability", f"{determined} of {of} determined", grade, sentence)
