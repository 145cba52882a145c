"""The whole page: what the template needs, and the template's environment."""

from __future__ import annotations

from dataclasses import dataclass

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from bayesterra.adequacy import fit_checks
from bayesterra.report.added import added_sections
from bayesterra.report.blocks import Section
from bayesterra.report.closing import methods_section, prior_section, reproduce_section
from bayesterra.report.determined import identifiability_section
from bayesterra.report.driving import Driving, driving
from bayesterra.report.inputs import data_section
from bayesterra.report.missed import missed_sections
from bayesterra.report.outputs import posterior_section, predictive_section, sampling_section
from bayesterra.report.strip import StripRow, legend, strip
from bayesterra.report.symbols import listed
from bayesterra.report.validation import cross_validation_section
from bayesterra.report.verdicts import Verdict, failed_checks, verdicts
from bayesterra.report.words import Finding, findings
from bayesterra.results import Result


@dataclass(frozen=True)
class Page:
    """Everything that the template shows, in its order.

    Attributes
    ----------
    facts : wheel, soil, model and date in one line; the kind of data stands apart in ``kind``.
    warning : what to do about a sampling that has not converged, else empty.
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


def page(result: Result) -> Page:
    """Put the page of a result together."""
    checks = fit_checks(result)
    return Page(
        title=result.study.title or "Soil parameters from wheel tests",
        kind=result.study.kind,
        facts=_facts(result),
        warning=warning(result),
        verdicts=verdicts(result, checks),
        strip=strip(result),
        legend=legend(result),
        driving=driving(result),
        findings=findings(result),
        sections=(
            data_section(result),
            sampling_section(result),
            posterior_section(result),
            *added_sections(result),
            *missed_sections(result),
            predictive_section(result),
            cross_validation_section(result),
            identifiability_section(result),
            methods_section(result),
            prior_section(result),
            reproduce_section(result),
        ),
        version=result.record["versions"]["bayesterra"],
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
    """What to do about a sampling that has not converged; empty where it has."""
    if result.converged:
        return Markup("")
    advice = listed(check["advice"] for check in failed_checks(result))
    return Markup(
        "The sampling has <b>not converged</b>: intervals and verdicts below may be wrong. What to do: {}. "
        "A greater <code>max_steps</code> in [sampling] lets it run longer; tighter priors or fewer free "
        "parameters make it easier."
    ).format(advice)
