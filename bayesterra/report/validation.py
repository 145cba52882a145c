"""Predictive checks and cross-validation as blocks of the report."""

from __future__ import annotations

from markupsafe import Markup

from bayesterra import figures
from bayesterra.crossvalidation import FEW_ROWS, INDISTINCT, CrossValidation, LeftOut
from bayesterra.diagnostics import pareto_limit
from bayesterra.discrepancies import DISCREPANCIES
from bayesterra.failures import failed
from bayesterra.parameters import CHANNELS
from bayesterra.predictive_checks import ALARM, CONFLICT, Check, PredictiveChecks, PriorCheck
from bayesterra.report.blocks import Block, Cell, Gallery, Section, Table, Text, drawing
from bayesterra.report.inputs import estimated_noise
from bayesterra.report.numbers import NOTHING, interval, plain, probability, resolution, rounded, share
from bayesterra.report.symbols import listed, symbol, symbols, unit
from bayesterra.results import Result
from bayesterra.uniformity import calibrated
from bayesterra.validation import Validation

PRIOR_WORDS = {"mean": "mean", "slope": "slope over slip", "largest": "largest reading"}


def posterior_checks(result: Result) -> tuple[Block, ...]:
    """The alarm, and every statistic of every channel."""
    checks = Validation.from_record(result.record).checks
    if checks is None:
        return (Text(failed(result.record, "predictive_checks"), "poor"),)
    return Text(alarm_sentence(checks), "poor" if checks.alarm else ""), _statistics(result, checks)


def alarm_sentence(checks: PredictiveChecks) -> Markup:
    """What all statistics together say."""
    if not checks.alarm:
        text = Markup("{} of the tables that the model itself makes look as strange (alarm below {}).")
        return text.format(share(checks.overall), share(ALARM))
    parts = (Markup("{} {}").format(symbol(check.channel), check.finding) for check in alarming(checks))
    return Markup("{} (overall <i>p</i> {}).").format(listed(parts), probability(checks.overall))


def misfit_warning(
    found: Markup,
    check: str = "units, loads and priors",
    then: str = "another model, or a [discrepancy]",
) -> Markup:
    """What a page opens with where the model cannot make readings like these."""
    return Markup(
        "The model does <b>not fit</b> these readings: {} Intervals and verdicts below would hold only if it "
        "did. What to do: check {}; then {}."
    ).format(found, check, then)


def misfit_text(found: str, check: str = "units, loads and priors") -> str:
    """The same in one line for a terminal."""
    return f"warning: the model does not fit these readings: {found}; check {check} before you use any figure"


def alarming(checks: PredictiveChecks, most: int = 3) -> tuple[Check, ...]:
    """The strangest statistic of each channel that has a strange one, ``most`` channels at most."""
    found: dict[str, Check] = {}
    for check in checks.checks:
        if check.calibrated < ALARM or not found:
            found.setdefault(check.channel, check)
    return tuple(found.values())[:most]


def _statistics(result: Result, checks: PredictiveChecks) -> Table:
    cells = {(check.channel, check.statistic): check for check in checks.checks}
    channels = list(result.study.noise)
    names = [name for name in DISCREPANCIES if any((channel, name) in cells for channel in channels)]
    rows = tuple(
        (DISCREPANCIES[name].words, *(_cell(cells.get((channel, name))) for channel in channels))
        for name in names
    )
    caption = Markup(
        "Posterior-predictive checks. First figure: share of {} replicated tables, each with a posterior of "
        "its own, that are as strange in this statistic; in brackets: <i>p</i>, the posterior-predictive "
        "probability of a larger value, which alone is too lenient. Residuals are in standard deviations of "
        "the noise. Single figures below {:g} are bold; with so many of them some are to be expected. What "
        "decides is the overall <i>p</i>, the share of replicated tables whose strangest statistic is as "
        "strange as the strangest here.{}"
    ).format(checks.replicates, ALARM, estimated_noise(result.study))
    return Table(caption, "l" + "r" * len(channels), ("", *(symbol(c) for c in channels)), rows)


def _cell(check: Check | None) -> Cell:
    if check is None:
        return NOTHING
    text = Markup("<b>{}</b>") if check.calibrated < ALARM else Markup("{}")
    return Markup("{} ({})").format(text.format(probability(check.calibrated)), probability(check.p))


def prior_predictive(result: Result) -> Block:
    """The readings under the prior alone."""
    checks = Validation.from_record(result.record).prior
    if checks is None:
        return Text(failed(result.record, "prior_checks", "prior_predictive"), "poor")
    word = (
        "The readings contradict the prior: they lie where it predicts next to nothing."
        if checks.conflict
        else "The prior can predict such readings."
        if checks.checks
        else "There is nothing to judge."
    )
    if result.study.drive == "both" and all(check.channel != "normal_force" for check in checks.checks):
        word += (
            " Loads are taken as the normal force of each row tells them: the range of loads is one to"
            " integrate over and no belief, so the normal force itself and rows without one are not judged."
        )
    caption = Markup(
        "Prior-predictive check: statistics of the readings beside what draws of the prior predict. {} "
        "Overall <i>p</i> {} (smallest <i>p</i> times the number of statistics; conflict below {:g})."
    ).format(word, probability(checks.overall), CONFLICT)
    header = ("channel", "statistic", "unit", "readings", "90 % of the prior", Markup("<i>p</i>"))
    return Table(caption, "lllrrr", header, tuple(map(_prior_row, checks.checks)))


def _prior_row(check: PriorCheck) -> tuple[Cell, ...]:
    scale = CHANNELS[check.channel].scale
    low, high, value = check.low / scale, check.high / scale, check.value / scale
    step = resolution(low, high)
    per = Markup("{}{}").format(unit(check.channel), " per unit slip" if check.statistic == "slope" else "")
    ends = interval(low, high, step)
    return (symbol(check.channel), PRIOR_WORDS[check.statistic], per, rounded(value, step / 10), ends,
            probability(check.p))  # fmt: skip


def cross_validation_section(result: Result) -> Section:
    """Every row predicted by the others."""
    loo = CrossValidation.from_record(result.record["loo"])
    blocks: list[Block] = [Text(_sum(loo)), _rows(result, loo)]
    return Section("loo", "Cross-validation", (*blocks, *_pit(result, loo)))


def _sum(loo: CrossValidation) -> Markup:
    return Markup(
        "Sum of the log densities with which every row is predicted by all others: elpd {} ± {} (standard "
        "error from the spread between {} rows). Only differences between models for the same readings mean "
        "something, and those below {:g} or below two of their own standard errors do not distinguish them. "
        "The fit uses {} effective parameters."
    ).format(rounded(loo.elpd, 0.1), rounded(loo.se, 0.1), len(loo.rows), INDISTINCT,
             rounded(loo.effective_parameters, 0.1))  # fmt: skip


def _rows(result: Result, loo: CrossValidation) -> Table:
    slips = dict(zip(result.study.observations.rows, result.study.observations.slip, strict=True))
    rows = tuple(
        (str(row.row), f"{slips[row.row]:.4g}", rounded(row.elpd, 0.01), plain(row.error, 1),
         rounded(before - row.elpd, 0.01), f"{row.k:.2f}", _way(row))
        for row, before in zip(loo.rows, loo.full, strict=True)
    )  # fmt: skip
    caption = Markup(
        "Rows left out one at a time, with all their readings; slip and load stay known. Loss: how much "
        "worse a row is predicted than fitted; large values mark rows that the others do not foresee. Pareto "
        "k̂: above {:.2f} weights from the full posterior cannot be relied on. Rows with a greater k̂, and all "
        "rows of tables with fewer than {}, are left out by a new sampling."
    ).format(pareto_limit(4000), FEW_ROWS)
    header = ("row", symbol("slip"), "elpd", "Monte Carlo error", "loss", "k̂", "left out by")
    return Table(caption, "lrrrrrl", header, rows)


def _way(row: LeftOut) -> str:
    return "new sampling" if row.refitted else "weights"


def _pit(result: Result, loo: CrossValidation) -> tuple[Block, ...]:
    if not loo.pit:
        return ()
    pictures = tuple(
        drawing(figures.loo_pit(result, name), f"LOO-PIT of {CHANNELS[name].description}") for name in loo.pit
    )
    outside = [name for name, values in loo.pit.items() if not calibrated(values)]
    found = (
        Markup("{} leaves the band.").format(symbols(outside)) if outside else "No channel leaves the band."
    )
    caption = Markup(
        "LOO-PIT: where each reading lies in what the other rows predict for it. Drawn is the share of "
        "values below, less the uniform one; grey: simultaneous 95 % band. An arch means an offset, an S "
        "that the noise is over- or understated. {}"
    ).format(found)
    return (Gallery("small", pictures, caption),)
