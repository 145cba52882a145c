"""Page of a result: first screen with its verdicts, data and model, and all sections in order."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from bayesterra.analysis import closing_page
from bayesterra.analysis import figures as analysis_figures
from bayesterra.analysis.figures import PRIOR_MASS
from bayesterra.analysis.findings_page import Finding, findings, strip
from bayesterra.analysis.soil_tests_page import soil_tests_sections
from bayesterra.arrays import FloatArray, spaced
from bayesterra.checking import validation_page
from bayesterra.checking.validation import complete_soils, estimates, spread_draws
from bayesterra.identifiability.evidence_page import identifiability_section
from bayesterra.likelihood.correlated import TYPICAL
from bayesterra.likelihood.forward import reference_load
from bayesterra.likelihood.page import conditions, prior_sources, slip_note, stated_law, support
from bayesterra.likelihood.posterior import posterior
from bayesterra.models.traction import SLIP_GRID
from bayesterra.parameters import CHANNELS, DERIVED, PARAMETERS, field_values, in_order
from bayesterra.report import numbers
from bayesterra.report.blocks import Block, Blocks, Cell, Gallery, Overview, Table, Text, drawing
from bayesterra.report.figures import MARKS
from bayesterra.report.sections import Draft, Prose, Section, VerdictPage
from bayesterra.report.symbols import amount, angles, listed, quantity_of, symbol, unit, with_unit
from bayesterra.report.terminal import failure_lines
from bayesterra.report.verdicts import Verdict, failed
from bayesterra.stats.quantile_law import QuantileLaw
from bayesterra.study.page import StripRow, crosscheck, crosscheck_line, keys, unconverged
from bayesterra.study.result import IdentifiabilityRow, Result, identifiability_rows, summary_rows
from bayesterra.study.study import Study

say = Prose("run")


@dataclass(frozen=True, kw_only=True)
class Page(VerdictPage):
    """Everything that the template shows, with strip, driving and findings on the first screen."""

    strip: tuple[StripRow, ...]
    legend: tuple[tuple[Markup, str], ...]
    driving: "Driving | None"
    findings: tuple[Finding, ...]


def run_page(result: Result) -> Page:
    """Put the page of a result together; a part that cannot be made is a line that says so."""
    draft = Draft(result)
    failures = draft.failures
    judged = failures.attempt("report: verdicts", lambda: result.verdicts, tuple[Verdict, ...])
    shown = failures.attempt("report: strip", lambda: (tuple(strip(result)), keys(estimates(result))), lambda: ((), ()))
    driven = None
    if result.study.wheels:
        driven = failures.attempt("report: driving", lambda: driving(result), Driving.unknown)
    statements = failures.attempt("report: findings", lambda: findings(result), tuple[Finding, ...])
    sections = _sections(draft, result)
    return Page(
        title=result.study.title or f"Soil parameters from {'wheel' if result.study.wheels else 'soil'} tests",
        kind=result.study.kind,
        facts=_facts(result), warning=draft.warning(warning(result)), verdicts=judged,
        strip=shown[0], legend=shown[1], driving=driven, findings=statements, sections=sections,
        version=result.record["versions"]["bayesterra"], failures=failures,
        sentence=failures.attempt("report: sentence", lambda: result.sentence, str),
    )  # fmt: skip


def _sections(draft: Draft[Result], result: Result) -> tuple[Section, ...]:
    """All sections, in their order; those about rows of wheels where there are any."""
    driven = bool(result.study.wheels)
    of_rows = (
        *draft.sections("What the model misses", validation_page.missed_sections),
        draft.section("checks", "Predictive checks", predictive_section),
        draft.section("loo", "Cross-validation", validation_page.cross_validation_section, "loo"),
    ) if driven else ()  # fmt: skip
    of_methods = (draft.section("methods", "Least squares side by side", closing_page.methods_section, "standings"),)
    return (
        draft.section("data", "Data and model" if driven else "Model and prior", data_section),
        draft.section("sampling", "Sampling quality", sampling_section),
        draft.section("posterior", "Posterior", posterior_section),
        *draft.sections("Soil tests", soil_tests_sections),
        *draft.sections("What the wheel adds", closing_page.added_sections),
        *of_rows,
        draft.section("identifiability", "Identifiability", identifiability_section, "identifiability"),
        *(of_methods if driven else ()),
        draft.section("prior", "Sensitivity to prior and noise", closing_page.prior_section),
        draft.section("words", "What the words mean", closing_page.words_section),
        draft.section("reproduce", "Reproduce this", closing_page.reproduce_section),
        draft.section("signing", "Methods and sign-off", closing_page.signing_section),
    )


def _facts(result: Result) -> tuple[str, ...]:
    study, rows, described = result.study, result.study.observations, result.study.described.values()
    wheels, analysed = ", ".join(study.wheels), f"analysed {str(result.record['made'])[:10]}"
    tests = [f"{len(test.readings.tests)} {test.kind} tests {name}" for name, test in study.soil_tests.items()]
    if not study.wheels:
        return tuple(filter(None, (*tests, *described, analysed)))
    used = f"{int(rows.use.sum())} of {len(rows)} rows in the fit"
    facts = (
        f"wheel {wheels}" if len(study.wheels) == 1 else f"wheels {wheels}", *described, used,
        f"model {study.model.name}, {study.drive}-driven", *tests, analysed,
    )  # fmt: skip
    return tuple(part for part in facts if part)


MISFIT = {
    "Fit": ("units, loads and priors", "another model, or a [discrepancy]"),
    "Soil tests": ("units, plate sizes or normal stresses, and priors", "another law, or wider noise of the tests"),
}
"""Verdicts of which bad ones forbid the use of a result: what to check, and what to do then."""


def warning(result: Result) -> Markup:
    """Warning against the use of the figures as they stand, and the mend; empty where nothing forbids it."""
    misfit = (
        validation_page.misfit_warning(verdict.html, *MISFIT[verdict.name])
        for verdict in result.verdicts
        if verdict.name in MISFIT and verdict.grade == "bad"
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
    if not result.study.wheels:
        notes = (Text(Markup("Note: {}").format(note)) for note in result.study.notes)
        return (*notes, _priors(result), *prior_sources(result.study), cut)
    note = slip_note(posterior(result.study), spread_draws(result, TYPICAL))
    return (*conditions(result.study), *note, _priors(result), *prior_sources(result.study), cut)


def _priors(result: Result) -> Table:
    entries = result.study.prior.entries
    rows = summary_rows(result)
    body: list[tuple[Cell, ...]] = []
    for name in in_order(entries):
        cut = numbers.moments(rows[name].prior_mean, rows[name].prior_sd) if name in rows else ("", "")
        what = (symbol(name), angles(PARAMETERS[name].description))
        body.append((*what, stated_law(name, entries[name]), *cut))
    caption, at = say("priors", _joined(result.study)), result.study.prior.reference
    if result.study.prior.stretched:
        caption += say("at_sinkage", f"{1e3 * at:g}")
    return Table(caption, "lllrr", ("", "parameter", "stated law", "mean", "sd"), tuple(body))


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
        step = numbers.resolution(*ends)
        figures = (numbers.rounded(row["mode"], step), numbers.rounded(row["median"], step), numbers.interval(*ends))
        name = row["parameter"]
        rows.append((quantity_of(name).symbol, row["unit"], *reached(name, *ends, *figures), words.get(name, "")))
    header = ("parameter", "unit", "mode", "median", "90 % HDI", "verdict")
    return Table(result.study.title, "llrrrl", header, (*rows[: len(words)], (), *rows[len(words) :]))


def _verdict(row: IdentifiabilityRow) -> str:
    """The word, with the partner of a coupled parameter."""
    if row.verdict != "coupled":
        return row.word
    return f"coupled with {PARAMETERS[row.coupled_with].symbol if row.coupled_with else 'several'}"


def sampling_section(result: Result) -> Blocks:
    """Sampling quality."""
    ranks = drawing(analysis_figures.all_ranks(result), "Rank histograms of every parameter")
    traces = drawing(analysis_figures.traces(result), "Traces of the log density and of every parameter")
    return (
        _checks(result), Text(_evidence(result.record)), *crosscheck(result.record), _chains(result),
        Gallery("whole", (ranks,), say("ranks")), Gallery("whole", (traces,), say("traces")),
    )  # fmt: skip


def _evidence(record: Mapping[str, Any]) -> Markup:
    """The log evidence in a sentence, and how far to trust it."""
    evidence = record.get("evidence")
    if evidence is None:
        return Markup("{}").format(failed(record, "evidence"))
    z, error = numbers.with_error(evidence["log_z"], evidence["error"])
    share, share_error = numbers.with_error(evidence["log_share"], evidence["log_share_error"])
    return say("evidence", z, error, share, share_error, evidence)


def _checks(result: Result) -> Table:
    rows = tuple(
        (
            Markup("<b>{}</b>").format("passed" if check["passed"] else "FAILED"),
            check["name"],
            numbers.plain(check["value"], 4),
            numbers.plain(check["threshold"], 4),
            "" if check["passed"] else check["advice"],
        )
        for check in result.record["verdict"]["checks"]
    )
    sampling, settings = result.record["sampling"], result.record["settings"]
    return say.table("checks", rows, settings, sampling["steps"], numbers.plain(sampling["acceptance"], 2))


def _chains(result: Result) -> Table:
    tau = result.record["sampling"]["tau"]
    rows: list[tuple[Cell, ...]] = []
    for name, row in summary_rows(result).items():
        effective = (numbers.plain(value) for value in (row.ess_bulk, row.ess_tail, tau.get(name)))
        errors = (numbers.plain(error, 2) for error in (row.mcse_mean, row.mcse_median, row.mcse_sd))
        rows.append((symbol(name), f"{row.r_hat:.4f}", *effective, *errors))
    return say.table("chains", rows)


def posterior_section(result: Result) -> Blocks:
    """The posterior: table, corner plot, correlations."""
    corner = drawing(
        analysis_figures.corner(result), "Corner plot of all pairs of parameters: posterior, prior and point estimates"
    )
    heat = drawing(analysis_figures.correlations(result), "Correlations of all pairs of parameters")
    pairs = Gallery("whole", (corner,), say("corner", 100 * PRIOR_MASS))
    return (_summary(result), pairs, Gallery("half", (heat,), say("correlations")))


def _summary(result: Result) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for name, row in summary_rows(result).items():
        step = numbers.resolution(*row.hdi)
        values = (numbers.rounded(value, step) for value in (row.mode, row.median, row.mean))
        prior = numbers.moments(row.prior_mean, row.prior_sd)
        what = (symbol(name), angles(quantity_of(name).description), unit(name) or numbers.NOTHING)
        rows.append((*what, *values, numbers.plain(row.sd, 2), numbers.interval(*row.hdi), *prior))
    return say.table("summary", rows)


def predictive_section(result: Result) -> Blocks:
    """Predictive checks."""
    blocks: list[Block] = list(validation_page.posterior_checks(result))
    if line := failed(result.record, "curves"):
        blocks.append(Text(line, "bad"))
    else:
        for wheel in result.study.wheels:
            blocks += [_bands(result, wheel), slip_table(result, wheel)]
    blocks += [_residuals(result), validation_page.prior_predictive(result)]
    return tuple(blocks)


def _bands(result: Result, wheel: str) -> Gallery:
    channels = [str(name) for name in result.draws["curves"]["outcome"].to_numpy()]
    drawn = {name: validation_page.predictive(result, name, wheel=wheel) for name in channels}
    pictures = tuple(
        drawing(axes, f"{CHANNELS[name].description} over slip, wheel {wheel}") for name, axes in drawn.items()
    )
    lines = listed(f"{name} {MARKS[name].line}" for name in complete_soils(result))
    bars = result.study.observations.wheel.count(wheel) <= validation_page.MANY
    return Gallery("small", pictures, say("bands", wheel, result.study.drive.level, lines, bars))


def _residuals(result: Result) -> Gallery:
    pictures = tuple(
        drawing(validation_page.residuals(result, name), f"Standardised residuals of {CHANNELS[name].description}")
        for name in result.study.noise
    )
    marks = ", ".join(f"{name} {MARKS[name].sign}" for name in complete_soils(result))
    return Gallery("small", pictures, say("residuals", marks))


FEW, SLIPS = 3, 30
"""Slips of the small table of the first screen, and of the large one at most."""


@dataclass(frozen=True)
class Driving:
    """The small tables of the first screen and their remark."""

    heading: str
    rows: tuple[tuple[Cell, ...], ...]  # quantity, median and interval of the derived quantities
    slip_header: tuple[Cell, ...]  # head of a table of pull and sinkage at a few of the driven slips
    slip_rows: tuple[tuple[Cell, ...], ...]  # rows of that table
    remark: Markup

    @classmethod
    def unknown(cls) -> "Driving":
        """The table where it cannot be made; the head of the page says why."""
        return cls("", (), (), (), Markup("Not known."))


def driving(result: Result) -> Driving:
    """Derived quantities, and pull and sinkage at a few of the driven slips."""
    wheel, summary = next(iter(result.study.wheels)), summary_rows(result)
    slips = driven_slips(result, wheel)
    few = slips[np.unique(np.linspace(0, len(slips) - 1, FEW).round().astype(int))]
    header, rows = _at_slips(result, wheel, ("drawbar_pull", "sinkage"), few)
    load = reference_load(result.study)
    derived: list[tuple[Cell, ...]] = []
    for name in (name for name in DERIVED if name in summary):
        middle, ends = reached(name, *summary[name].hdi, *numbers.estimate(summary[name].median, *summary[name].hdi))
        derived.append((DERIVED[name].description, amount(name, middle), ends))
    row = summary_rows(result).get("peak_pull_slip")
    peak = row.hdi90_hi if row is not None else -np.inf
    return Driving(
        f"Wheel {wheel}" if np.isnan(load) else f"Wheel {wheel} under {numbers.given(round(load, 1))} N",
        tuple(derived),
        header,
        rows,
        say("remark", bool(result.study.errors.discrepancy), peak, SLIP_GRID[-1], slips[-1]),
    )


def reached(name: str, low: float, high: float, *cells: str) -> tuple[str, ...]:
    """Cells on a quantity, its interval the last; what ends with the search says so.

    >>> reached("peak_pull_slip", 0.8, 0.8, "0.800", "0.800–0.800")
    ('–', 'not reached below 0.8')
    >>> reached("peak_pull_slip", 0.41, 0.8, "0.60", "0.41–0.80")
    ('0.60', '0.41 or more')
    """
    if not name.endswith("_slip") or high < SLIP_GRID[-1] - 1e-9:
        return cells
    if low >= SLIP_GRID[-1] - 1e-9:
        return (*[numbers.NOTHING] * (len(cells) - 1), f"not reached below {SLIP_GRID[-1]:.2g}")
    return (*cells[:-1], f"{numbers.rounded(low, numbers.resolution(low, high))} or more")


def driven_slips(result: Result, wheel: str) -> FloatArray:
    """Slips of the wheel's rows that are in the fit, each once, ascending."""
    rows = result.study.observations.used()
    mine = np.array([name == wheel for name in rows.wheel])
    return np.unique(rows.slip[mine] if mine.any() else rows.slip)


def _at_slips(
    result: Result, wheel: str, channels: tuple[str, ...], slips: FloatArray
) -> tuple[tuple[Cell, ...], tuple[tuple[Cell, ...], ...]]:
    """Head and rows of a table of modelled values at slips, of those channels that the drive gives."""
    curves = result.draws["curves"].sel(wheel=wheel)
    outcomes = [name for name in channels if name in curves["outcome"]]
    drawn = {name: field_values(name, curves["modelled"].sel(outcome=name).to_numpy()) for name in outcomes}
    heads = [head for name in outcomes for head in (with_unit(name), "90 %")]
    at, rows = curves["slip"].to_numpy(), []
    for slip in slips:
        cells: list[Cell] = [f"{slip:.3g}"]
        for name in outcomes:
            low, middle, high = (np.interp(slip, at, band) for band in drawn[name][[0, 2, 4]])
            cells += numbers.estimate(middle, low, high)
        rows.append(tuple(cells))
    return (Markup("at slip {}").format(symbol("slip")), *heads), tuple(rows)


def slip_table(result: Result, wheel: str) -> Table:
    """All outcomes at every driven slip of a wheel; at ``SLIPS`` of more."""
    outcomes = tuple(str(name) for name in result.draws["curves"]["outcome"].to_numpy())
    slips = driven_slips(result, wheel)
    header, rows = _at_slips(result, wheel, outcomes, spaced(slips, SLIPS))
    return Table(say("slip_table", wheel, len(slips), len(rows)), "l" + "rr" * len(outcomes), header, rows)
