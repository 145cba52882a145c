"""Predictions, comparisons, calibrations and identifiability as tables on a terminal."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console, JustifyMethod
from rich.table import Table

from bayesterra.calibration import Calibration
from bayesterra.calibration.judging import UNSETTLED
from bayesterra.calibration.quantities import AT_SLIP
from bayesterra.calibration.ranks import COVERAGES
from bayesterra.design.choosing import BIT, Design
from bayesterra.design.choosing import UNANSWERED as LOST
from bayesterra.holdout import Holdout
from bayesterra.identified import Foreseen, Identified, expected_contraction
from bayesterra.notebook import evidence_lines
from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.prediction import PREDICTED, UNANSWERED, Prediction
from bayesterra.report.design import figures_of
from bayesterra.report.numbers import NOTHING, interval, number, plain, resolution, rounded, with_error
from bayesterra.rover.geometry import AXLES
from bayesterra.rover.outlook import RoverOutlook
from bayesterra.side_by_side import Comparison
from bayesterra.soiltests.analysis import SoilTestResult
from bayesterra.soiltests.quantities import QUANTITIES as SOIL_TEST_QUANTITIES

PRINTED = 15
"""Candidates in the table on a terminal; design.csv has all."""


def print_forecast(points: Sequence[Prediction], folder: Path, console: Console | None = None) -> None:
    """Print the bands at the slips that were asked for, what is doubtful, and where the files are."""
    console = console or _console()
    for at in points:
        console.print(_bands(at))
        console.print(_derived(at))
        for line in _remarks(at):
            console.print(line, highlight=False, soft_wrap=True)
    console.print(f"Written: {folder}   Plot: {folder / 'prediction.png'}", highlight=False, soft_wrap=True)


def _console() -> Console:
    """Brackets are units here, not markup."""
    return Console(markup=False)


def _bands(at: Prediction) -> Table:
    table = Table(title=f"wheel {at.name} under {at.load:.4g} N", box=SIMPLE_HEAD, padding=(0, 1))
    for header in ("slip", "", "median", "90 %", "90 % of readings", "no answer"):
        table.add_column(header, justify="right" if header else "left", no_wrap=True)
    rows = at.table.set_index(["slip", "quantity"])
    for slip, share in zip(at.slip, at.unanswered, strict=True):
        for i, (name, known) in enumerate(PREDICTED.items()):
            unit = "" if known.unit == "-" else f" [{known.unit}]"
            mark = f"{100 * share:.3g} %{' !' if share > UNANSWERED else ''}"
            first, last = ("", "") if i else (f"{slip:.4g}", mark)
            table.add_row(first, f"{known.symbol}{unit}", *_cells(rows.loc[(slip, name)].to_dict()), last)
        table.add_section()
    return table


def _cells(row: Mapping[str, float]) -> tuple[str, str, str]:
    low, high = row["modelled_q05"], row["modelled_q95"]
    step = resolution(low, high)
    readings = row["reading_q05"], row["reading_q95"]
    noisy = "" if np.isnan(readings).any() else interval(*readings)
    return rounded(row["modelled_q50"], step), interval(low, high, step), noisy


def _derived(at: Prediction) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 1))
    for header, side in (("derived", "left"), ("unit", "left"), ("median", "right"), ("90 % HDI", "right")):
        table.add_column(header, justify="right" if side == "right" else "left")
    table.add_column("prior 90 %", justify="right")
    for row in at.derived_table.to_dict("records"):
        step = resolution(row["hdi90_lo"], row["hdi90_hi"])
        table.add_row(
            str(row["quantity"]).replace("_", " "),
            str(row["unit"]),
            rounded(row["median"], step),
            interval(row["hdi90_lo"], row["hdi90_hi"], step),
            interval(row["prior_q05"], row["prior_q95"]),
        )
    return table


def _remarks(at: Prediction) -> list[str]:
    lines = [f"Note: {note}." for note in at.notes]
    rows = at.table.drop_duplicates("slip").set_index("slip")
    for slip in at.marked:
        row = rows.loc[slip]
        lines.append(
            f"! At slip {slip:.4g} the model has no answer for {row['no_answer']} of {row['draws']} draws"
            f" ({row['reason']}): the band holds the others only, do not rely on it."
        )
    return lines


def print_outlook(outlook: RoverOutlook, folder: Path, console: Console | None = None) -> None:
    """Print what a rover does on every slope, the greatest slope, notes, and where the files are."""
    console = console or _console()
    title = f"rover {outlook.rover.name}, {outlook.rover.weight:.4g} N"
    table = Table(title=title, box=SIMPLE_HEAD, padding=(0, 1))
    for header in ROVER_COLUMNS:
        table.add_column(header, justify="right", no_wrap=True)
    for (slope, tow), rows in outlook.table.groupby(["slope [deg]", "tow [N]"], sort=False):
        cells = rows.set_index(["quantity", "axle"]).to_dict("index")
        slips, depth = _median_90(cells["slip", "rear"], 0.01), _median_90(cells["sinkage", "rear"], 0.1)
        loads = " / ".join(rounded(cells["load", axle]["q50"], 1.0) for axle in AXLES)
        shares = (float(rows[name].iloc[0]) for name in ("cannot", "unanswered"))
        marks = ", ".join(f"{100 * share:.0f}{'!' if share > UNANSWERED else ''}" for share in shares)
        table.add_row(f"{slope:.4g}", f"{tow:.4g}", slips, depth, loads, f"{marks} %")
    console.print(table)
    for line in outlook_lines(outlook):
        console.print(line, highlight=False, soft_wrap=True)
    console.print(f"Written: {folder}   Plot: {folder / 'rover.png'}", highlight=False, soft_wrap=True)


ROVER_COLUMNS = ("slope\n[°]", "tow\n[N]", "slip", "z rear\n[mm]", "loads\n[N]", "cannot,\nno answer")


def _median_90(row: Mapping[Hashable, Any], least: float) -> str:
    """The median, and 5 and 95 %, to a step of ``least`` or coarser."""
    low, high = row["q05"], row["q95"]
    step = max(resolution(low, high), least)
    return f"{rounded(row['q50'], step)} ({interval(low, high, step)})"


def outlook_lines(outlook: RoverOutlook) -> list[str]:
    """The greatest slope and tow force, then what is doubtful and what is assumed."""
    lines = []
    for row in outlook.greatest_table.to_dict("records"):
        low, high = row["q05"], row["q95"]
        step = resolution(low, high)
        where = "" if row["slips"] == "all" else " at driven slips"
        name, unit = str(row["quantity"]).replace("_", " "), "°" if row["unit"] == "deg" else " N"
        middle, ends = rounded(row["q50"], step), interval(low, high, step)
        lines.append(f"{name.capitalize()}{where}: {middle}{unit}, 90 % {ends}{unit}.")
    return [*lines, *(f"Note: {note}." for note in outlook.notes)]


def print_comparison(comparison: Comparison, folder: Path, console: Console | None = None) -> None:
    """Print medians and intervals side by side, what the evidence says, and the name of the page."""
    console = console or _console()
    console.print(_side_by_side(comparison))
    for line in evidence_lines(comparison):
        console.print(line, highlight=False)
    console.print(f"Page: {folder / 'comparison.html'}", highlight=False, soft_wrap=True)


def _side_by_side(comparison: Comparison) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 1))
    table.add_column("median (90 % HDI)")
    table.add_column("unit")
    for name in comparison.names:
        table.add_column(name, justify="right")
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for row in comparison.parameters.to_dict("records"):
        step = resolution(row["hdi90_lo"], row["hdi90_hi"])
        ends = interval(row["hdi90_lo"], row["hdi90_hi"], step)
        key = (str(row["quantity"]).replace("_", " "), str(row["unit"]))
        cells.setdefault(key, {})[str(row["result"])] = f"{rounded(row['median'], step)} ({ends})"
    for (quantity, unit), found in cells.items():
        table.add_row(quantity, unit, *(found.get(name, "") for name in comparison.names))
    return table


def print_calibration(found: Calibration, report: Path, console: Console | None = None) -> None:
    """Print the verdict with what stands behind it, and the name of the report."""
    console = console or _console()
    table = Table(title=found.study.title or None, box=SIMPLE_HEAD, padding=(0, 1))
    for header in ("quantity", "p", "shift", "width", *(f"{100 * q:.0f} %" for q in COVERAGES)):
        table.add_column(header, justify="left" if header == "quantity" else "right", no_wrap=True)
    for row in found.tests.to_dict("records"):
        table.add_row(*_ranked(row))
    console.print(table)
    console.print("shift and width in sd of a right posterior; truths inside central intervals in %")
    for line in calibration_lines(found):
        console.print(line, highlight=False, soft_wrap=True)
    console.print(f"Report: {report}", highlight=False, soft_wrap=True)


def _ranked(row: Mapping[Hashable, Any]) -> tuple[str, ...]:
    name = _short(str(row["quantity"]))
    if row["verdict"] == "constant":
        return (name, "constant")
    mark = "" if row["verdict"] == "uniform" else " ✕"
    shares = (f"{100 * row[f'covered_{100 * q:.0f}']:.0f}" for q in COVERAGES)
    return (name, f"{row['p_value']:.4f}{mark}", f"{row['shift']:+.2f}", f"{row['width']:.2f}", *shares)


def _short(quantity: str) -> str:
    """A test quantity in few letters: parameters by their names, channels by their symbols."""
    channel = quantity.removesuffix(AT_SLIP)
    if channel in CHANNELS:
        return f"{CHANNELS[channel].symbol} at largest slip"
    return quantity if quantity in PARAMETERS else quantity.replace("_", " ")


def calibration_lines(found: Calibration) -> list[str]:
    """The verdict, what did not converge, and what would have been noticed."""
    n, power = len(found.table), found.power.iloc[1]
    smallest = found.tests["p_value"].min() if found.tested else np.nan
    word = "NOT calibrated" if found.failing else found.verdict
    lines = [f"Posterior {word}: smallest p {smallest:.2g}, threshold {found.threshold:.2g}."]
    if found.unsettled:
        allowed = f"{UNSETTLED:.0%} allowed"
        lines.append(f"{found.unsettled} of {n} replications did not converge ({allowed}).")
    lines.append(
        f"{n} replications notice a {power['error']} with probability {power['one']:.2f} in one parameter,"
        f" {power['all']:.2f} in all."
    )
    return lines


def print_identified(made: Identified, report: Path, console: Console | None = None) -> None:
    """Print the finding, the verdict on every parameter with its figures, and the name of the page."""
    console = console or _console()
    table = Table(title=made.study.title or None, box=SIMPLE_HEAD, padding=(0, 1))
    for header in IDENTIFIED:
        side: JustifyMethod = "right" if header == "contraction" else "left"
        table.add_column(header, justify=side, no_wrap=header != "verdict")
    for row in made.found.verdicts.to_dict("records"):
        table.add_row(*_identified(row))
    console.print(table)
    for row in made.found.verdicts.to_dict("records"):
        if row["against"]:
            symbol = PARAMETERS[row["parameter"]].symbol
            console.print(f"! {symbol}: {row['against']}.", highlight=False, soft_wrap=True)
    if not made.record["converged"]:
        console.print("! The sampling did not converge: do not rely on what rests on draws.", highlight=False)
    console.print(made.sentence, highlight=False, soft_wrap=True)
    console.print(f"Report: {report}", highlight=False, soft_wrap=True)


IDENTIFIED = ("", "verdict", "contraction", "tied to", "profile")
PROFILES = {"bounded only by the prior": "prior-bound"}
"""Classes of profiles in fewer letters, so that no row of the table breaks on 80 columns."""


def _identified(row: Mapping[Hashable, Any]) -> tuple[str, ...]:
    tied = row["tied_to"] != row["parameter"]
    tie = f"{PARAMETERS[row['tied_to']].symbol} {row['tie']:+.2f}".replace("-", "−") if tied else ""
    profile = PROFILES.get(row["profile"], row["profile"])
    return (PARAMETERS[row["parameter"]].symbol, row["verdict"], _share(row["contraction"]), tie, profile)


def _share(contraction: float) -> str:
    return f"{max(contraction, 0.0):.2f}"


def print_foreseen(made: Foreseen, console: Console | None = None) -> None:
    """Print what a design could determine, and what contraction to expect."""
    console = console or _console()
    table = Table(title=made.study.title or None, box=SIMPLE_HEAD, padding=(0, 1))
    for header in ("", "the design could", "contraction to expect"):
        table.add_column(header, justify="right" if header.startswith("contraction") else "left")
    seen = made.found.structure.determined
    for name, expected in zip(made.found.names, expected_contraction(made), strict=True):
        word = "determine it" if name in seen else "NOT determine it"
        table.add_row(PARAMETERS[name].symbol, word, _share(expected))
    console.print(table)
    for null in made.found.structure.nulls:
        console.print(f"{null.words[:1].upper()}{null.words[1:]}.", highlight=False, soft_wrap=True)
    console.print("Expected over the prior after the physical cut, were the readings made.", highlight=False)


def print_design(design: Design, folder: Path, console: Console | None = None) -> None:
    """Print the ranking with its Monte Carlo errors, what is recommended, and where the files are."""
    console = console or _console()
    console.print(_ranking(design))
    for line in design_lines(design):
        console.print(line, highlight=False, soft_wrap=True)
    console.print(
        f"Page: {folder / 'report.html'}   Plot: {folder / 'design.png'}", highlight=False, soft_wrap=True
    )


def _ranking(design: Design) -> Table:
    about = design.about[:3]
    table = Table(title=f"one more drive, about {', '.join(design.about)}", box=SIMPLE_HEAD, padding=(0, 1))
    for header in ("", "drive", "channels"):
        table.add_column(header)
    deviations = [f"sd {PARAMETERS[name].symbol} [{PARAMETERS[name].unit}]" for name in about]
    for header in ("gain [bit]", "behind the best", *deviations):
        table.add_column(header, justify="right", no_wrap=True)
    for rank, index in enumerate(design.ranking.order[:PRINTED], start=1):
        table.add_row(str(rank), *_candidate(design, index, len(about)))
    return table


def _candidate(design: Design, index: int, deviations: int) -> tuple[str, ...]:
    candidate, one = design.candidates[index], design.ranking.estimates[index]
    lag, lag_error = (value / BIT for value in design.ranking.behind(index))
    symbols = " ".join(CHANNELS[name].symbol for name in candidate.channels)
    mark = " !" if 1 - one.answered > LOST else ""
    known = with_error(one.values[0] / BIT, one.errors[0] / BIT) if np.isfinite(one.values[0]) else (NOTHING,)
    behind = " ± ".join(with_error(lag, lag_error)) if lag > 0 else ""
    changes = (" → ".join(figures_of(design, i, one)[:2]) for i in range(deviations))
    return (candidate.where + mark, symbols, " ± ".join(known), behind, *changes)


def design_lines(design: Design) -> list[str]:
    """What is recommended and expected, and what to keep in mind."""
    last = design.together[-1]
    gain, error = with_error(last.values[0] / BIT, last.errors[0] / BIT)
    drives = "; ".join(one.where for one in design.chosen)
    lines = [f"Recommended: {drives}: {gain} ± {error} bit about {', '.join(design.about)}."]
    for i, name in enumerate(design.about):
        before, after, off = figures_of(design, i, last)
        unit = "" if PARAMETERS[name].unit == "-" else f" {PARAMETERS[name].unit}"
        lines.append(f"  sd of {PARAMETERS[name].symbol} from {before} to {after} ± {off}{unit}")
    if "regression" in (design.method, design.ranking.method):
        lines.append("Few draws remain effective after such readings: gains are lower bounds, by regression.")
    if design.situation.source == "prior":
        lines.append(
            "From the prior alone, no readings used; a result folder in place of the study builds on them."
        )
    marked = sum(1 - one.answered > LOST for one in design.ranking.estimates)
    if marked:
        lines.append(f"! At {marked} candidates the model has no answer for over {LOST:.0%} of the draws.")
    return lines


def print_holdout(found: Holdout, folder: Path, console: Console | None = None) -> None:
    """Print coverage and mean scores of model and baselines, and where the files are."""
    console = console or _console()
    title = f"{len(found.levels)} levels left out, one at a time"
    table = Table(title=title, box=SIMPLE_HEAD, padding=(0, 1))
    for header in ("", "", "rows", "mean CRPS", "in 50 %", "in 90 %"):
        table.add_column(header, justify="right" if header else "left", no_wrap=True)
    rows = found.summary[found.summary["part"] == "all"] if len(found.table) else found.table
    for channel in rows["channel"].unique():
        for row in rows[rows["channel"] == channel].to_dict("records"):
            table.add_row(*_scored(row))
        table.add_section()
    console.print(table)
    for outcome in found.outcomes:
        if outcome.status != "converged":
            line = f"! Without {outcome.level}: {outcome.status}. {outcome.note}".rstrip()
            console.print(line, highlight=False, soft_wrap=True)
    console.print(
        f"Page: {folder / 'report.html'}   Plot: {folder / 'holdout.png'}", highlight=False, soft_wrap=True
    )


def _scored(row: Mapping[Hashable, Any]) -> tuple[str, ...]:
    shares = (f"{number(100 * row[name], 0)} %" for name in ("covered50", "covered90"))
    score = f"{plain(row['crps'])} ± {plain(row['crps_se'], 2)} {row['unit']}"
    return (CHANNELS[row["channel"]].symbol, row["predictor"], str(row["rows"]), score, *shares)


def print_soil_test(found: SoilTestResult, report: Path, console: Console | None = None) -> None:
    """Print the parameters of a soil test, what is against the model, and the name of the report."""
    console = console or _console()
    table = Table(title=found.record["title"] or None, box=SIMPLE_HEAD, padding=(0, 1))
    for header in ("", "unit", "median", "90 % HDI", "verdict"):
        table.add_column(header, justify="right" if header in ("median", "90 % HDI") else "left")
    words = found.identifiability.set_index("parameter")["verdict"].to_dict()
    for row in found.summary.to_dict("records"):
        known = SOIL_TEST_QUANTITIES.get(row["parameter"])
        low, high = row["hdi90_lo"], row["hdi90_hi"]
        figures = rounded(row["median"], resolution(low, high)), interval(low, high)
        symbol = known.symbol if known else row["parameter"]
        table.add_row(symbol, row["unit"], *figures, words.get(row["parameter"], ""))
    console.print(table)
    for note in (*found.test.notes, *found.record["fits"]["notes"]):
        console.print(f"note: {note}.", highlight=False, soft_wrap=True)
    if found.record["alarm"]:
        checks = found.record["checks"]
        worst = min(checks, key=lambda name: checks[name])
        console.print(f"! New tests are not as predicted: {worst} (p {checks[worst]:.2g}).", highlight=False)
    if not found.converged:
        console.print("! The sampling did not converge: do not rely on what rests on draws.", highlight=False)
    console.print(found.sentence, highlight=False, soft_wrap=True)
    console.print(f"Report: {report}", highlight=False, soft_wrap=True)
