"""Sections on what came out: sampling quality, posterior, and what it means for driving."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from bayesterra.analysis import figures as analysis_figures
from bayesterra.analysis.figures import PRIOR_MASS
from bayesterra.arrays import FloatArray
from bayesterra.checking import validation_page
from bayesterra.checking.validation import complete_soils
from bayesterra.checking.validation_page import posterior_checks, prior_predictive
from bayesterra.likelihood.forward import reference_load
from bayesterra.models.traction import SLIP_GRID
from bayesterra.parameters import CHANNELS, DERIVED, field_values
from bayesterra.report.blocks import Block, Blocks, Cell, Gallery, Table, Text, drawing, photograph
from bayesterra.report.numbers import (
    NOTHING,
    estimate,
    given,
    interval,
    moments,
    plain,
    resolution,
    rounded,
    with_error,
)
from bayesterra.report.symbols import QUANTITIES, amount, angles, listed, symbol, unit, with_unit
from bayesterra.report.verdicts import failed
from bayesterra.study.page import crosscheck
from bayesterra.study.result import Result, summary_rows

RANKS = (
    "Ranks of each ensemble's draws among all draws. Ensembles that sample the same distribution are flat; "
    "grey: where 95 % of the steps lie then, for the effective number of draws. A slope or a hump outside "
    "the grey means that an ensemble disagrees with the others."
)
TRACES = (
    "Log density and parameters over the kept steps: median, 5 and 95 % of the walkers of each ensemble, "
    "one shade each. Level bands that overlie each other mean that no ensemble is still on its way."
)
CORNER = (
    "All pairs of parameters. Blue contours hold 50 and 90 % of the posterior, the grey area "
    f"{100 * PRIOR_MASS:.0f} % of the prior after the physical cut; dashed lines and plus signs: posterior "
    "mode; marks: point estimates. Long thin contours are trades between two parameters; where blue fills "
    "the grey, the data say nothing."
)
CORRELATIONS = Markup(
    "Correlation of every pair in the posterior (orange: rise together, violet: one rises as the other "
    "falls). Framed: the groups bearing <i>P</i><sub>I</sub>, shearing <i>P</i><sub>II</sub>, contact "
    "angles <i>P</i><sub>III</sub>. Strong colour outside the frames: the groups cannot be fitted apart."
)


def sampling_section(result: Result) -> Blocks:
    """Sampling quality."""
    ranks = drawing(analysis_figures.all_ranks(result), "Rank histograms of every parameter")
    traces = photograph(analysis_figures.traces(result), "Traces of the log density and of every parameter")
    return (
        _checks(result), Text(_evidence(result.record)), *crosscheck(result.record), _chains(result),
        Gallery("whole", (ranks,), RANKS), Gallery("whole", (traces,), TRACES),
    )  # fmt: skip


def _evidence(record: Mapping[str, Any]) -> Markup:
    """The log evidence in a sentence, and how far to trust it."""
    evidence = record.get("evidence")
    if evidence is None:
        return Markup("{}").format(failed(record, "evidence"))
    z, error = with_error(evidence["log_z"], evidence["error"])
    share, share_error = with_error(evidence["log_share"], evidence["log_share_error"])
    doubt = "" if evidence["reliable"] else f" {_doubt(evidence)}: the true error may be much larger."
    return Markup(
        "Log evidence {} ± {} for these readings under the stated prior, which is not renormalised after the "
        "physical cut (log share left by it: {} ± {}). From {} draws of the pooled proposals, {:.0f} % "
        "effective, Pareto k̂ {:.2f} (reliable to {:.2f}).{}"
    ).format(
        z, error, share, share_error, evidence["draws"], 100 * evidence["efficiency"], evidence["k_hat"],
        evidence["limit"], doubt,
    )  # fmt: skip


def _doubt(evidence: Mapping[str, Any]) -> str:
    """Doubt about an evidence that cannot be relied on."""
    if evidence["k_hat"] is not None and evidence["k_hat"] <= evidence["limit"]:
        return f"The ensembles’ own values lie {evidence['spread']:.2g} off (root mean square)"
    return "The weights have a heavy tail"


def _checks(result: Result) -> Table:
    rows = tuple(
        (
            Markup("<b>{}</b>").format("passed" if check["passed"] else "FAILED"),
            check["name"],
            plain(check["value"], 4),
            plain(check["threshold"], 4),
            "" if check["passed"] else check["advice"],
        )
        for check in result.record["verdict"]["checks"]
    )
    sampling, settings = result.record["sampling"], result.record["settings"]
    caption = Markup(
        "Every check of the sampling: {} independent ensembles of {} walkers, {} steps kept, acceptance {}. "
        "Walkers of one ensemble depend on each other, so R-hat compares ensembles only. All ensembles "
        "follow one recipe from the prior on: a narrow mode far from the rest can escape every one of "
        "them; then they agree, the evidence leaves that mode out, and no check here tells."
    ).format(settings["ensembles"], settings["walkers"], sampling["steps"], plain(sampling["acceptance"], 2))
    return Table(caption, "llrrl", ("", "check", "value", "threshold", "advice"), rows)


def _chains(result: Result) -> Table:
    tau = result.record["sampling"]["tau"]
    rows: list[tuple[Cell, ...]] = []
    for name, row in summary_rows(result).items():
        effective = (plain(value) for value in (row.ess_bulk, row.ess_tail, tau.get(name)))
        errors = (plain(error, 2) for error in (row.mcse_mean, row.mcse_median, row.mcse_sd))
        rows.append((symbol(name), f"{row.r_hat:.4f}", *effective, *errors))
    caption = (
        "Effective number of draws for the centre (bulk) and the tails, autocorrelation time in steps, and "
        "the Monte Carlo standard errors of mean, median and sd, in the parameter's unit: digits below "
        "these errors mean nothing."
    )
    header = ("", "R-hat", "bulk ESS", "tail ESS", "τ [steps]", "MCSE mean", "MCSE median", "MCSE sd")
    return Table(caption, "lrrrrrrr", header, tuple(rows))


def posterior_section(result: Result) -> Blocks:
    """The posterior: table, corner plot, correlations."""
    corner = photograph(
        analysis_figures.corner(result),
        "Corner plot of all pairs of parameters: posterior, prior and point estimates",
        width=1060,
    )
    heat = drawing(analysis_figures.correlations(result), "Correlations of all pairs of parameters")
    return (_summary(result), Gallery("whole", (corner,), CORNER), Gallery("half", (heat,), CORRELATIONS))


def _summary(result: Result) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for name, row in summary_rows(result).items():
        step = resolution(*row.hdi)
        values = (rounded(value, step) for value in (row.mode, row.median, row.mean))
        prior = moments(row.prior_mean, row.prior_sd)
        what = (symbol(name), angles(QUANTITIES[name].description), unit(name) or NOTHING)
        rows.append((*what, *values, plain(row.sd, 2), interval(*row.hdi), *prior))
    caption = (
        "Posterior of parameters and derived quantities. The mode is the densest point of all parameters "
        "together; interval: 90 % highest-density interval. Sinkage moduli of different exponents do not "
        "compare; bearing pressure and shear strength do."
    )
    header = ("", "quantity", "unit", "mode", "median", "mean", "sd", "90 % HDI", "prior mean", "prior sd")
    return Table(caption, "lllrrrrrrr", header, tuple(rows))


def predictive_section(result: Result) -> Blocks:
    """Predictive checks."""
    blocks: list[Block] = list(posterior_checks(result))
    if line := failed(result.record, "curves"):
        blocks.append(Text(line, "bad"))
    else:
        for wheel in result.study.wheels:
            blocks += [_bands(result, wheel), slip_table(result, wheel)]
    blocks += [_residuals(result), prior_predictive(result)]
    return tuple(blocks)


def _bands(result: Result, wheel: str) -> Gallery:
    channels = [str(name) for name in result.draws["curves"]["outcome"].to_numpy()]
    drawn = {name: validation_page.predictive(result, name, wheel=wheel) for name in channels}
    pictures = tuple(
        drawing(axes, f"{CHANNELS[name].description} over slip, wheel {wheel}") for name, axes in drawn.items()
    )
    caption = Markup(
        "Wheel {}: readings (dots, ± 1 sd; hollow: not in the fit), 50 and 90 % bands of new readings, "
        "noise included, and their median, at {}. A channel that was not measured shows the modelled "
        "values. {} About nine readings in ten should lie in the pale band."
    ).format(wheel, result.study.drive.level, _lines(result))
    return Gallery("small", pictures, caption)


LINES = {
    "IM1": "long dashes (vermilion)",
    "IM2": "dots (green)",
    "IM3": "dash-dot (purple)",
    "joint": "short dashes (orange)",
}
SIGNS = {"IM1": "▲", "IM2": "■", "IM3": "◆", "joint": "✖"}


def _lines(result: Result) -> Markup:
    """Legend of the broken lines, those of the methods that gave every parameter."""
    drawn = listed(f"{name} {LINES[name]}" for name in complete_soils(result))
    if not drawn:
        return Markup("")
    return Markup(
        "Broken lines: least squares, run by the same model: {}; they end where an estimate has no answer."
    ).format(drawn)


def _residuals(result: Result) -> Gallery:
    pictures = tuple(
        drawing(validation_page.residuals(result, name), f"Standardised residuals of {CHANNELS[name].description}")
        for name in result.study.noise
    )
    marks = ", ".join(f"{name} {SIGNS[name]}" for name in complete_soils(result))
    beside = f"; marks beside them: {marks}, hollow at the edge where they are farther out" if marks else ""
    caption = (
        "Residuals (reading − model) in standard deviations of the noise: bars hold 90 % of the draws, dots "
        f"are their means{beside}. A run of one sign over slip would mean that the model has the wrong shape."
    )
    return Gallery("small", pictures, caption)


FEW = 3


@dataclass(frozen=True)
class Driving:
    """The small tables of the first screen and their remark.

    Attributes
    ----------
    rows : quantity, median and interval of the derived quantities.
    slip_header, slip_rows : pull and sinkage at a few of the driven slips.
    """

    heading: str
    rows: tuple[tuple[Cell, ...], ...]
    slip_header: tuple[Cell, ...]
    slip_rows: tuple[tuple[Cell, ...], ...]
    remark: Markup

    @classmethod
    def unknown(cls) -> Driving:
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
        middle, ends = reached(name, *summary[name].hdi, *estimate(summary[name].median, *summary[name].hdi))
        derived.append((DERIVED[name].description, amount(name, middle), ends))
    return Driving(
        f"Wheel {wheel}" if np.isnan(load) else f"Wheel {wheel} under {given(round(load, 1))} N",
        tuple(derived),
        header,
        rows,
        _remark(result, slips),
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
        return (*[NOTHING] * (len(cells) - 1), f"not reached below {SLIP_GRID[-1]:.2g}")
    return (*cells[:-1], f"{rounded(low, resolution(low, high))} or more")


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
    rows = []
    for slip in slips:
        cells: list[Cell] = [f"{slip:.3g}"]
        for name in outcomes:
            bands = drawn[name][[0, 2, 4]]
            low, middle, high = (np.interp(slip, curves["slip"].to_numpy(), band) for band in bands)
            cells += estimate(middle, low, high)
        rows.append(tuple(cells))
    return (Markup("at slip {}").format(symbol("slip")), *heads), tuple(rows)


def _remark(result: Result, slips: FloatArray) -> Markup:
    """Remark on where the numbers leave the driven slips."""
    row = summary_rows(result).get("peak_pull_slip")
    sentences = [Markup("Modelled values without measurement noise.")]
    if result.study.errors.discrepancy:
        sentences.append(Markup("Those at slips hold the discrepancy, all others are the model’s alone."))
    if row is None:
        return sentences[0]
    if row.hdi90_hi >= SLIP_GRID[-1] - 1e-9:
        sentences.append(Markup("The greatest pull is searched up to slip {:.2g}.").format(SLIP_GRID[-1]))
    if row.hdi90_hi > slips[-1]:
        sentences.append(Markup("Above the last driven slip, {:.2g}, it is extrapolated.").format(slips[-1]))
    return Markup(" ").join(sentences)


def slip_table(result: Result, wheel: str) -> Table:
    """All outcomes at every driven slip of a wheel."""
    outcomes = tuple(str(name) for name in result.draws["curves"]["outcome"].to_numpy())
    header, rows = _at_slips(result, wheel, outcomes, driven_slips(result, wheel))
    caption = Markup(
        "Modelled outcomes of wheel {} at the driven slips, without measurement noise: median and "
        "equal-tailed 90 % interval of the draws, read off the curves above."
    ).format(wheel)
    return Table(caption, "l" + "rr" * len(outcomes), header, rows)
