"""Page of a result: first screen with its verdicts, data and model, and all sections in order."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup

from bayesterra.analysis.closing_page import added_sections, methods_section, prior_section, reproduce_section
from bayesterra.analysis.findings_page import Finding, findings, strip
from bayesterra.analysis.outputs_page import (
    Driving,
    driving,
    posterior_section,
    predictive_section,
    sampling_section,
)
from bayesterra.checking.predictive_checks import PredictiveChecks
from bayesterra.checking.validation import FitCheck, Validation, estimates, fit_checks, spread_draws
from bayesterra.checking.validation_page import (
    alarm_sentence,
    alarming,
    cross_validation_section,
    misfit_text,
    misfit_warning,
    missed_sections,
)
from bayesterra.identifiability.evidence_page import finding, identifiability_section, marginal
from bayesterra.identifiability.information import ALL
from bayesterra.likelihood.correlated import TYPICAL
from bayesterra.likelihood.page import conditions, prior_sources, slip_note, stated_law, support
from bayesterra.likelihood.posterior import posterior
from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.report.blocks import Blocks, Cell, Overview, Table, Text
from bayesterra.report.failures import failed
from bayesterra.report.numbers import interval, moments, probability, resolution, rounded
from bayesterra.report.sections import Draft, Section, Verdict, VerdictPage, unknown_verdict
from bayesterra.report.symbols import QUANTITIES, angles, symbol, symbols
from bayesterra.report.terminal import failure_lines, verdict_line
from bayesterra.stats.quantile_law import QuantileLaw
from bayesterra.study.page import StripRow, crosscheck_line, keys, sampling_verdict, unconverged
from bayesterra.study.result import IdentifiabilityRow, Result, identifiability_rows, summary_rows
from bayesterra.study.study import Study


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
    checks = failures.attempt("report: χ² checks", lambda: fit_checks(result), tuple[FitCheck, ...])
    judged = (
        draft.verdict("Sampling", sampling_verdict),
        draft.verdict("Model fit", lambda result: fit_verdict(result, checks)),
        draft.verdict("Identifiability", identifiability_verdict),
    )
    shown = failures.attempt(
        "report: strip", lambda: (tuple(strip(result)), keys(estimates(result))), lambda: ((), ())
    )
    driven = failures.attempt("report: driving", lambda: driving(result), Driving.unknown)
    statements = failures.attempt("report: findings", lambda: findings(result), tuple[Finding, ...])
    sections = _sections(draft)
    return Page(
        title=result.study.title or "Soil parameters from wheel tests", kind=result.study.kind,
        facts=_facts(result), warning=draft.warning(warning(result)), verdicts=judged, strip=shown[0],
        legend=shown[1], driving=driven, findings=statements, sections=sections,
        version=result.record["versions"]["bayesterra"], failures=failures,
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
        draft.section("prior", "Sensitivity to the prior", prior_section),
        draft.section("reproduce", "Reproduce this", reproduce_section),
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
    checks = _contradiction(result)
    misfit = misfit_warning(alarm_sentence(checks)) if checks else Markup("")
    unsettled = unconverged(
        result,
        "The sampling has <b>not converged</b>: intervals and verdicts below may be wrong. What to do: {}. "
        "A greater <code>max_steps</code> in [sampling] lets it run longer; tighter priors or fewer free "
        "parameters make it easier.",
    )
    check = (Markup("Please check: {}").format(sentence) for sentence in result.study.warnings)
    return Markup(" ").join(filter(None, (misfit, unsettled, *check)))


def _contradiction(result: Result) -> PredictiveChecks | None:
    """The checks where they say that the model cannot make readings like these; else None."""
    checks = Validation.from_record(result.record).checks
    return checks if checks is not None and checks.alarm else None


FEW_READINGS = 3
"""Readings per free parameter below which the check of the fit can hardly fail."""


def fit_verdict(result: Result, checks: tuple[FitCheck, ...]) -> Verdict:
    """Verdict on whether the readings look as the model says that they look."""
    predictive_checks = Validation.from_record(result.record).checks
    if predictive_checks is None:
        return unknown_verdict("Model fit", failed(result.record, "predictive_checks"))
    sentence = alarm_sentence(predictive_checks)
    overstated = [check.channel for check in checks if check.overstated]
    if overstated:
        sentence += Markup(" Noise of {} looks overstated.").format(symbols(overstated))
    count, free = sum(check.readings for check in checks), len(result.names)
    if count < FEW_READINGS * free:  # the model can bend to them
        sentence += Markup(" {} readings for {} parameters: a lenient test.").format(count, free)
    word, grade = ("not adequate", "bad") if predictive_checks.alarm else ("adequate", "good")
    return Verdict("Model fit", word, grade, sentence)


def identifiability_verdict(result: Result) -> Verdict:
    """Number of independent combinations of parameters that the data determine."""
    directions = result.record.get("directions")
    if directions is None:
        return unknown_verdict("Identifiability", failed(result.record, "identifiability", "directions"))
    counts = [row for row in marginal(directions) if row["scope"] == ALL] or [
        {**directions, "directions": directions["of"]}
    ]
    determined, of = counts[0]["determined"], counts[0]["directions"]
    alone = [name for name, row in identifiability_rows(result).items() if row.verdict == "determined"]
    on_their_own = Markup("On their own: {}.").format(symbols(alone)) if alone else "No parameter on its own."
    plain = Markup("Directions of the parameter space whose variance shrinks tenfold or more. {}")
    sentence = finding(result) or plain.format(on_their_own)
    grade = "good" if determined == of else "doubtful" if determined else "bad"
    return Verdict("Identifiability", f"{determined} of {of} determined", grade, sentence)


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
    caption = (
        f"Prior laws as stated in the study, {_joined(result.study)}; mean and standard deviation of the "
        "prior after the physical cut, in the same unit. Wherever this report says prior, the cut one is "
        "meant."
    )
    return Table(caption, "lllrr", ("", "parameter", "stated law", "mean", "sd"), tuple(body))


def _joined(study: Study) -> str:
    parts = ["correlations of their normal scores (a Gaussian copula)"] if study.prior.correlation else []
    parts += [
        f"a mixture of {len(mixture.weights)} normal laws of the scores of {names}"
        for names, mixture in study.prior.mixtures.items()
    ]
    return f"joined by {' and '.join(parts)}" if parts else "independent of each other"


def run_overview(result: Result) -> Overview:
    """Parameters with their verdicts, the verdict on the sampling, and what speaks against the model."""
    lines = [Text(verdict_line(result.record))]
    lines += [Text(f"Warning: {warning}", "bad") for warning in result.study.warnings]
    laws = result.study.prior.laws.values()
    earlier = dict.fromkeys(law.source for law in laws if isinstance(law, QuantileLaw) and law.source)
    lines += [Text(f"Prior: {source}.") for source in earlier]
    if checks := _contradiction(result):
        misfits = (f"{CHANNELS[check.channel].description} {check.finding}" for check in alarming(checks))
        words = f"{'; '.join(misfits)} (overall p {probability(checks.overall)})"
        lines.append(Text(misfit_text(words), "bad"))
    lines += crosscheck_line(result.record)
    return (_parameters(result), *lines, *failure_lines(result.record))


def _parameters(result: Result) -> Table:
    """Parameters and their verdicts, then derived quantities."""
    words = {name: _verdict(row) for name, row in identifiability_rows(result).items()}
    rows = []
    for row in result.summary.to_dict("records"):
        ends = (row["hdi90_lo"], row["hdi90_hi"])
        step = resolution(*ends)
        figures = (rounded(row["mode"], step), rounded(row["median"], step), interval(*ends))
        name = row["parameter"]
        rows.append((QUANTITIES[name].symbol, row["unit"], *figures, words.get(name, "")))
    header = ("parameter", "unit", "mode", "median", "90 % HDI", "verdict")
    return Table(result.study.title, "llrrrl", header, (*rows[: len(words)], (), *rows[len(words) :]))


def _verdict(row: IdentifiabilityRow) -> str:
    """The word, with the partner of a coupled parameter."""
    if row.verdict != "coupled":
        return row.word
    return f"coupled with {PARAMETERS[row.coupled_with].symbol if row.coupled_with else 'several'}"
