"""The whole page: what the template needs, and the template's environment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from bayesterra.adequacy import FitCheck, fit_checks
from bayesterra.failures import Failures, failed
from bayesterra.report.added import added_sections
from bayesterra.report.attempts import missing, said, section, verdict
from bayesterra.report.blocks import Section
from bayesterra.report.closing import methods_section, prior_section, reproduce_section
from bayesterra.report.determined import identifiability_section
from bayesterra.report.driving import Driving, driving
from bayesterra.report.inputs import data_section
from bayesterra.report.missed import missed_sections
from bayesterra.report.outputs import posterior_section, predictive_section, sampling_section
from bayesterra.report.strip import StripRow, legend, strip
from bayesterra.report.symbols import listed
from bayesterra.report.validation import alarm_sentence, cross_validation_section, misfit_warning
from bayesterra.report.verdicts import (
    Verdict,
    failed_checks,
    fit_verdict,
    identifiability_verdict,
    sampling_verdict,
)
from bayesterra.report.words import Finding, findings
from bayesterra.results import Result
from bayesterra.validation import Validation


@dataclass(frozen=True)
class Page:
    """Everything that the template shows, in its order.

    Attributes
    ----------
    facts : wheel, soil, model and date in one line; the kind of data stands apart in ``kind``.
    warning : what to do about a model that does not fit or a sampling that has not converged, and what could
        not be computed; else empty.
    failures : what could not be made of this page.
    """

    title: str
    kind: str
    facts: tuple[str, ...]
    warning: Markup
    verdicts: tuple[Verdict, ...]
    strip: tuple[StripRow, ...]
    legend: tuple[tuple[Markup, str], ...]
    driving: Driving
    findings: tuple[Finding, ...]
    sections: tuple[Section, ...]
    version: str
    failures: Failures


def page(result: Result) -> Page:
    """Put the page of a result together; a part that cannot be made is a line that says so."""
    failures = Failures()
    checks = failures.attempt("report: χ² checks", lambda: fit_checks(result), tuple[FitCheck, ...])
    judged = (
        verdict(failures, "Sampling", lambda: sampling_verdict(result)),
        verdict(failures, "Model fit", lambda: fit_verdict(result, checks)),
        verdict(failures, "Identifiability", lambda: identifiability_verdict(result)),
    )
    shown = failures.attempt("report: strip", lambda: (strip(result), legend(result)), lambda: ((), ()))
    driven = failures.attempt("report: driving", lambda: driving(result), Driving.unknown)
    found = failures.attempt("report: findings", lambda: findings(result), tuple[Finding, ...])
    sections = _sections(result, failures)
    return Page(
        title=result.study.title or "Soil parameters from wheel tests",
        kind=result.study.kind,
        facts=_facts(result),
        warning=Markup(" ").join(filter(None, (warning(result), missing(result.record, failures)))),
        verdicts=judged,
        strip=shown[0],
        legend=shown[1],
        driving=driven,
        findings=found,
        sections=sections,
        version=result.record["versions"]["bayesterra"],
        failures=failures,
    )


def _sections(result: Result, failures: Failures) -> tuple[Section, ...]:
    """All sections, in their order."""
    needed = {"loo": ("loo",), "identifiability": ("identifiability",), "methods": ("standings",)}

    def made(anchor: str, title: str, make: Callable[[Result], Section]) -> Section:
        without = failed(result.record, *needed.get(anchor, ()))
        return section(failures, anchor, title, lambda: make(result), without)

    def some(title: str, make: Callable[[Result], tuple[Section, ...]]) -> tuple[Section, ...]:
        part = f"report: {title}"
        return failures.attempt(part, lambda: make(result), lambda: (said(failures, part, title),))

    return (
        made("data", "Data and model", data_section),
        made("sampling", "Sampling quality", sampling_section),
        made("posterior", "Posterior", posterior_section),
        *some("What the wheel adds", added_sections),
        *some("What the model misses", missed_sections),
        made("checks", "Predictive checks", predictive_section),
        made("loo", "Cross-validation", cross_validation_section),
        made("identifiability", "Identifiability", identifiability_section),
        made("methods", "Least squares side by side", methods_section),
        made("prior", "Sensitivity to the prior", prior_section),
        made("reproduce", "Reproduce this", reproduce_section),
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


def _facts(result: Result) -> tuple[str, ...]:
    study, rows = result.study, result.study.observations
    wheels = ", ".join(study.wheels)
    used = f"{int(rows.use.sum())} of {len(rows)} rows in the fit"
    parts = (
        f"wheel {wheels}" if len(study.wheels) == 1 else f"wheels {wheels}",
        study.soil,
        study.date,
        used,
        f"model {study.model.name}, {study.drive}-driven",
        f"analysed {str(result.record['made'])[:10]}",
    )
    return tuple(part for part in parts if part)


def warning(result: Result) -> Markup:
    """What forbids to use the figures as they stand, and what to do about it; empty where nothing does."""
    return Markup(" ").join(part for part in (_misfit(result), _unsettled(result)) if part)


def _misfit(result: Result) -> Markup:
    """That the model cannot make readings like these; empty where it can, or where that is not known."""
    checks = Validation.from_record(result.record).checks
    if checks is None or not checks.alarm:
        return Markup("")
    return misfit_warning(alarm_sentence(checks))


def _unsettled(result: Result) -> Markup:
    """What to do about a sampling that has not converged; empty where it has."""
    if result.converged:
        return Markup("")
    advice = listed(check["advice"] for check in failed_checks(result))
    return Markup(
        "The sampling has <b>not converged</b>: intervals and verdicts below may be wrong. What to do: {}. "
        "A greater <code>max_steps</code> in [sampling] lets it run longer; tighter priors or fewer free "
        "parameters make it easier."
    ).format(advice)
