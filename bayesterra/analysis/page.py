"""Page of a result: first screen with its verdicts, data and model, and all sections in order."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup

from bayesterra.analysis.closing_page import (
    added_sections,
    methods_section,
    prior_section,
    reproduce_section,
    signing_section,
    words_section,
)
from bayesterra.analysis.findings_page import Finding, findings, strip
from bayesterra.analysis.outputs_page import (
    Driving,
    driving,
    posterior_section,
    predictive_section,
    reached,
    sampling_section,
)
from bayesterra.checking.validation import estimates, spread_draws
from bayesterra.checking.validation_page import cross_validation_section, misfit_warning, missed_sections
from bayesterra.identifiability.evidence_page import identifiability_section
from bayesterra.likelihood.correlated import TYPICAL
from bayesterra.likelihood.page import conditions, prior_sources, slip_note, stated_law, support
from bayesterra.likelihood.posterior import posterior
from bayesterra.parameters import PARAMETERS
from bayesterra.report.blocks import Blocks, Cell, Overview, Table, Text
from bayesterra.report.numbers import interval, moments, resolution, rounded
from bayesterra.report.sections import Draft, Prose, Section, VerdictPage
from bayesterra.report.symbols import QUANTITIES, angles, symbol
from bayesterra.report.terminal import failure_lines
from bayesterra.report.verdicts import Verdict
from bayesterra.stats.quantile_law import QuantileLaw
from bayesterra.study.page import StripRow, crosscheck_line, keys, unconverged
from bayesterra.study.result import IdentifiabilityRow, Result, identifiability_rows, summary_rows
from bayesterra.study.study import Study

say = Prose("run")


@dataclass(frozen=True, kw_only=True)
class Page(VerdictPage):
    """Everything that the template shows, with strip, driving and findings on the first screen."""

    strip: tuple[StripRow, ...]
    legend: tuple[tuple[Markup, str], ...]
    driving: Driving
    findings: tuple[Finding, ...]


def run_page(result: Result) -> Page:
    """Put the page of a result together; a part that cannot be made is a line that says so."""
    draft = Draft(result)
    failures = draft.failures
    judged = failures.attempt("report: verdicts", lambda: result.verdicts, tuple[Verdict, ...])
    shown = failures.attempt("report: strip", lambda: (tuple(strip(result)), keys(estimates(result))), lambda: ((), ()))
    driven = failures.attempt("report: driving", lambda: driving(result), Driving.unknown)
    statements = failures.attempt("report: findings", lambda: findings(result), tuple[Finding, ...])
    sections = _sections(draft)
    return Page(
        title=result.study.title or "Soil parameters from wheel tests", kind=result.study.kind,
        facts=_facts(result), warning=draft.warning(warning(result)), verdicts=judged,
        strip=shown[0], legend=shown[1], driving=driven, findings=statements, sections=sections,
        version=result.record["versions"]["bayesterra"], failures=failures,
        sentence=failures.attempt("report: sentence", lambda: result.sentence, str),
    )  # fmt: skip


def _sections(draft: Draft[Result]) -> tuple[Section, ...]:
    """All sections, in their order."""
    return (
        draft.section("data", "Data and model", data_section),
        draft.section("sampling", "Sampling quality", sampling_section),
        draft.section("posterior", "Posterior", posterior_section),
        *draft.sections("What the wheel adds", added_sections),
        *draft.sections("What the model misses", missed_sections),
        draft.section("checks", "Predictive checks", predictive_section),
        draft.section("loo", "Cross-validation", cross_validation_section, "loo"),
        draft.section("identifiability", "Identifiability", identifiability_section, "identifiability"),
        draft.section("methods", "Least squares side by side", methods_section, "standings"),
        draft.section("prior", "Sensitivity to prior and noise", prior_section),
        draft.section("words", "What the words mean", words_section),
        draft.section("reproduce", "Reproduce this", reproduce_section),
        draft.section("signing", "Methods and sign-off", signing_section),
    )


def _facts(result: Result) -> tuple[str, ...]:
    study, rows = result.study, result.study.observations
    wheels = ", ".join(study.wheels)
    used = f"{int(rows.use.sum())} of {len(rows)} rows in the fit"
    facts = (
        f"wheel {wheels}" if len(study.wheels) == 1 else f"wheels {wheels}", study.soil, study.date, used,
        f"model {study.model.name}, {study.drive}-driven", f"analysed {str(result.record['made'])[:10]}",
    )  # fmt: skip
    return tuple(part for part in facts if part)


def warning(result: Result) -> Markup:
    """Warning against the use of the figures as they stand, and the mend; empty where nothing forbids it."""
    misfit = (
        misfit_warning(verdict.html) for verdict in result.verdicts if verdict.name == "Fit" and verdict.grade == "bad"
    )
    unsettled = unconverged(
        result,
        "The sampling has <b>not converged</b>: intervals and verdicts below may be wrong. What to do: {}. "
        "A greater <code>max_steps</code> in [sampling] lets it run longer; tighter priors or fewer free "
        "parameters make it easier.",
    )
    check = (Markup("Please check: {}").format(sentence) for sentence in result.study.warnings)
    return Markup(" ").join(filter(None, (*misfit, unsettled, *check)))


def data_section(result: Result) -> Blocks:
    """Data and model."""
    cut = Text(support(result.record["prior_support"]))
    note = slip_note(posterior(result.study), spread_draws(result, TYPICAL))
    return (*conditions(result.study), *note, _priors(result), *prior_sources(result.study), cut)


def _priors(result: Result) -> Table:
    entries = result.study.prior.entries
    rows = summary_rows(result)
    body: list[tuple[Cell, ...]] = []
    for name in (name for name in PARAMETERS if name in entries):
        cut = moments(rows[name].prior_mean, rows[name].prior_sd) if name in rows else ("", "")
        what = (symbol(name), angles(PARAMETERS[name].description))
        body.append((*what, stated_law(name, entries[name]), *cut))
    return Table(
        say("priors", _joined(result.study)), "lllrr", ("", "parameter", "stated law", "mean", "sd"), tuple(body)
    )


def _joined(study: Study) -> str:
    parts = ["correlations of their normal scores (a Gaussian copula)"] if study.prior.correlation else []
    parts += [
        f"a mixture of {len(mixture.weights)} normal laws of the scores of {names}"
        for names, mixture in study.prior.mixtures.items()
    ]
    return f"joined by {' and '.join(parts)}" if parts else "independent of each other"


def run_overview(result: Result) -> Overview:
    """Parameters with their verdicts, the verdicts on the whole, and the sentence that may be quoted."""
    lines = [verdict.line for verdict in result.verdicts]
    lines += [Text(f"Warning: {warning}", "bad") for warning in result.study.warnings]
    laws = result.study.prior.laws.values()
    earlier = dict.fromkeys(law.source for law in laws if isinstance(law, QuantileLaw) and law.source)
    lines += [Text(f"Prior: {source}.") for source in earlier]
    lines += crosscheck_line(result.record)
    return (_parameters(result), *lines, Text(result.sentence), *failure_lines(result.record))


def _parameters(result: Result) -> Table:
    """Parameters and their verdicts, then derived quantities."""
    words = {name: _verdict(row) for name, row in identifiability_rows(result).items()}
    rows = []
    for row in result.summary.to_dict("records"):
        ends = (row["hdi90_lo"], row["hdi90_hi"])
        step = resolution(*ends)
        figures = (rounded(row["mode"], step), rounded(row["median"], step), interval(*ends))
        name = row["parameter"]
        rows.append((QUANTITIES[name].symbol, row["unit"], *reached(name, *ends, *figures), words.get(name, "")))
    header = ("parameter", "unit", "mode", "median", "90 % HDI", "verdict")
    return Table(result.study.title, "llrrrl", header, (*rows[: len(words)], (), *rows[len(words) :]))


def _verdict(row: IdentifiabilityRow) -> str:
    """The word, with the partner of a coupled parameter."""
    if row.verdict != "coupled":
        return row.word
    return f"coupled with {PARAMETERS[row.coupled_with].symbol if row.coupled_with else 'several'}"
