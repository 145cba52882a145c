"""Soil test as a page, figures and a terminal table."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from bayesterra.arrays import FloatArray
from bayesterra.checking.validation_page import misfit_text, misfit_warning
from bayesterra.identifiability.verdicts import STRUCTURAL
from bayesterra.parameters import MODULI
from bayesterra.report.blocks import Blocks, Cell, Gallery, Overview, Record, Table, Text, drawing, photograph, records
from bayesterra.report.figures import (
    DATA,
    GRID,
    MARKS,
    POSTERIOR,
    PRIOR,
    TAIL,
    Axis,
    fan,
    figure_of,
    label,
    new_figure,
    own_axes,
    styled,
)
from bayesterra.report.numbers import estimate, plain, probability, resolution, rounded
from bayesterra.report.sections import Draft, VerdictPage, in_a_line, origin_rows
from bayesterra.report.symbols import in_symbols, letters
from bayesterra.report.terminal import failure_lines
from bayesterra.report.verdicts import Verdict, failed, sampling_verdict, unknown_verdict
from bayesterra.soiltests.analysis import SoilTestResult
from bayesterra.soiltests.checks import ALARM, METHODS
from bayesterra.soiltests.schema import LEVELS, QUANTITIES
from bayesterra.study.page import StripRow, axis_of, keys, strip_row, unconverged
from bayesterra.study.result import shown, summary_rows

CHECK = "units, plate sizes or normal stresses, and priors"
LAWS = {
    "plate": Markup(
        "Bekker: <i>p</i> = (<i>k</i><sub>c</sub>/<i>b</i> + <i>k</i><sub>φ</sub>) "
        "<i>z</i><sup><i>n</i></sup>, "
        "<i>b</i> the radius of the plate. Either modulus may be negative; the sum is positive under every "
        "plate."
    ),
    "shear": Markup(
        "Janosi and Hanamoto: <i>τ</i> = (<i>c</i> + <i>σ</i> tan <i>φ</i>) (1 − exp(−<i>j</i>/<i>K</i>)), "
        "on the whole curve of every test."
    ),
}


@dataclass(frozen=True)
class SoilTestPage(VerdictPage):
    """A :class:`VerdictPage` with a parameter strip."""

    strip: tuple[StripRow, ...]
    legend: tuple[tuple[Markup, str], ...]


def soil_test_page(result: SoilTestResult) -> SoilTestPage:
    """Put the page together."""
    record, test, draft = result.record, result.test, Draft(result)
    kinds = {"plate": "plate sinkage", "shear": "annular shear"}
    counts = (f"{record['tests']} tests", f"{record['readings']} readings")

    verdicts = (
        draft.verdict("Sampling", lambda result: sampling_verdict(result.record)),
        draft.verdict("New tests", _fit, "left_out"),
        draft.verdict("Identifiability", _found),
    )
    rows = draft.failures.attempt(
        "report: strip", lambda: tuple(_row(result, name) for name in result.names), tuple[StripRow, ...]
    )
    sections = (
        draft.section("readings", "Readings", _readings),
        draft.section("tests", "Predictions of new tests", _tests, "left_out"),
        draft.section("parameters", "Parameters", _parameters),
        draft.section("least-squares", "Least squares", _squares, "fits"),
        draft.section("assumptions", "Assumptions and prior", _assumptions),
        draft.section("reproduce", "Reproduce this", _reproduce),
    )
    unsettled = unconverged(result, "The sampling has <b>not converged</b>. What to do: {}.")
    return SoilTestPage(
        title=record["title"] or "Soil test", kind=record["kind"],
        facts=tuple(filter(None, (kinds[test.kind], test.content.soil, *counts))),
        warning=draft.warning(_misfit(result), unsettled), verdicts=verdicts, strip=rows,
        legend=keys(result.least_squares["method"].unique()), sections=sections,
        version=record["versions"]["bayesterra"], failures=draft.failures, template="soiltest.html",
    )  # fmt: skip


def _misfit(result: SoilTestResult) -> Markup:
    """Warning of tests that are not as the others predict them; empty without, or where that is not known."""
    if not result.record["alarm"]:
        return Markup("")
    return misfit_warning(Markup("{}.").format(result.misfit), CHECK, "another law, or wider [noise]")


def _fit(result: SoilTestResult) -> Verdict:
    """Verdict on new tests: predicted as well as the intervals say, or not."""
    table, checks = result.left_out, result.record["checks"]
    inside = int(((table["level_pit"] > 0.05) & (table["level_pit"] < 0.95)).sum())
    text = Markup("Every test predicted from the others: the level of {} of {} lies in its 90 % interval.").format(
        inside, len(table)
    )
    if not checks:
        return Verdict("New tests", "too few to tell", "doubtful", text)
    worst = min(checks, key=lambda name: checks[name])
    if result.record["alarm"]:
        text += Markup(" Against the model: {} (p {}).").format(worst, probability(checks[worst]))
        return Verdict("New tests", "not as predicted", "bad", text)
    return Verdict("New tests", "as predicted", "good", text)


def _found(result: SoilTestResult) -> Verdict:
    directions = result.record.get("directions")
    if directions is None:
        return unknown_verdict("Identifiability", failed(result.record, "identifiability"))
    determined, of = directions["determined"], directions["of"]
    grade = "good" if determined == of else "doubtful" if determined else "bad"
    return Verdict("Identifiability", f"{determined} of {of} determined", grade, in_symbols(result.sentence))


def _row(result: SoilTestResult, name: str) -> StripRow:
    quantity, along, row = QUANTITIES[name], _axis(result, name), summary_rows(result)[name]
    column = result.names.index(name)
    prior, posterior = (result.values(group)[:, column] / quantity.scale for group in ("prior", "posterior"))
    fits = records(result.least_squares)
    points = {str(fit["method"]): float(fit["value"]) for fit in fits if fit["parameter"] == name}
    return strip_row(quantity, along, row, (prior, posterior), points, _words(result, name))


def _axis(result: SoilTestResult, name: str) -> Axis:
    """The prior's range, without the outer thousandth of priors without bounds."""
    column, scale, prior = result.names.index(name), QUANTITIES[name].scale, result.posterior().prior
    law, draws = prior.laws[name], result.values()[:, column] / scale
    if prior.reference != 1.0 and name in MODULI:  # they hang on n: long tails, of which the middle is shown
        tails = np.quantile(result.values("prior")[:, column] / scale, [0.15, 0.85])
        return axis_of(law, (-np.inf, np.inf), tails, draws)
    tails = law.quantile(np.array([TAIL, 1.0 - TAIL])) / scale
    return axis_of(law, (law.range[0] / scale, law.range[1] / scale), tails, draws)


def _words(result: SoilTestResult, name: str) -> tuple[str, Markup]:
    row = result.identifiability.set_index("parameter").loc[name]
    word = shown(str(row["verdict"]))
    if word == "one-sided":
        return word, Markup("at its {} bound").format(row["bound"])
    if word in ("coupled", STRUCTURAL) and row["tied_to"] != name:
        return word, Markup("with {}").format(letters(QUANTITIES[str(row["tied_to"])].symbol))
    return word, Markup("")


def _readings(result: SoilTestResult) -> Blocks:
    kind = result.test.kind
    scale = " Both axes are logarithmic." if kind == "plate" else ""
    data = {"measured": "Measured", "simulated": "Simulated", "digitised": "Digitised"}[result.record["kind"]]
    caption = (
        f"{data} readings that are used (black, one line for each test), the mean curve (line: posterior "
        f"median), and what new tests would read (bands: 50 and 90 %, test-to-test scatter included).{scale}"
    )
    picture = drawing(readings(result), "Readings of every test with the bands of new tests")
    notes = tuple(Text(f"{note}.") for note in (*result.test.notes, *result.record["fits"]["notes"]))
    return (Text(LAWS[kind]), Gallery("whole", (picture,), caption), *notes)


def _tests(result: SoilTestResult) -> Blocks:
    level = str(result.left_out.columns[1])
    header = ("test", level.replace("_", " "), "readings", "level", "slope", "in 50 %", "in 90 %", "k̂")
    rows = tuple(_test_row(row, level) for row in records(result.left_out))
    share = Markup(
        "Each test predicted from all others. Level and slope: share of the prediction below what was read "
        "(level: mean log residual; slope: further half less nearer half). In 50 %, in 90 %: share of the "
        "test's readings inside the bands of a new test; readings of one test go together, so that these "
        "shares scatter widely. k̂: reliability of the importance weights; * sampled anew without the test."
    )
    checks = result.record["checks"]
    lines = tuple((name, probability(p)) for name, p in checks.items())
    limit = f"one below {ALARM / max(len(checks), 1):.3g}"
    said = f"p values of the checks; {limit} is an alarm, as there are {len(checks)} of them."
    picture = drawing(left_out(result), "Level and slope of every test within its prediction")
    caption = (
        "Where each test lies in its prediction from the others. Right predictions scatter evenly over the "
        "height; grey: the middle 90 and 50 %. Intervals that are too narrow drive the marks to both ends."
    )
    p_values = (Table(said, "lr", ("check", "p"), lines),) if checks else ()
    return (Gallery("half", (picture,), caption), *p_values, Table(share, "lrrrrrrr", header, rows))


def _test_row(row: Record, level: str) -> tuple[Cell, ...]:
    shares = (probability(row[name]) for name in ("level_pit", "slope_pit"))
    inside = (f"{100 * row[name]:.0f} %" for name in ("covered_50", "covered_90"))
    reliability = f"{row['k_hat']:.2f}{'*' if row['anew'] else ''}"
    return (str(row["test"]), f"{row[level]:g}", str(row["readings"]), *shares, *inside, reliability)


def _parameters(result: SoilTestResult) -> Blocks:
    pairs = combinations([name for name in result.test.soil if name in result.names], 2)
    pictures = tuple(
        photograph(pair(result, a, b), f"{QUANTITIES[a].symbol} against {QUANTITIES[b].symbol}") for a, b in pairs
    )
    caption = (
        "Soil parameters against each other: prior after the physical cut (grey), posterior (blue), least "
        "squares (marks)."
    )
    gallery = (Gallery("small", pictures, caption),) if pictures else ()
    return (*gallery, _posterior_table(result), _words_table(result))


def _posterior_table(result: SoilTestResult) -> Table:
    header = ("", "unit", "median", "90 % HDI", "mode", "effective draws", "R-hat")
    rows: list[tuple[Cell, ...]] = []
    for row in records(result.summary):
        quantity, ends = QUANTITIES.get(row["parameter"]), (row["hdi90_lo"], row["hdi90_hi"])
        name = letters(quantity.symbol) if quantity else row["parameter"]
        figures = (*estimate(row["median"], *ends), rounded(row["mode"], resolution(*ends)))
        rows.append((name, row["unit"], *figures, plain(row["ess_bulk"]), f"{row['r_hat']:.4f}"))
    said = (
        "Posterior. The last rows are mean stresses at the middle of the readings (sinkage or displacement; "
        "plate radius or normal stress), what such tests measure directly. The unit of moduli hangs on n: "
        "moduli of different n cannot be compared as they stand."
    )
    return Table(said, "llrrrrr", header, tuple(rows))


def _words_table(result: SoilTestResult) -> Table:
    rows = tuple(
        (letters(QUANTITIES[row["parameter"]].symbol), row["verdict"], f"{max(row['contraction'], 0):.2f}")
        for row in records(result.identifiability)
    )
    at = ", of moduli at the sinkage where their laws are stated" if result.test.reference != 1.0 else ""
    said = f"What the data say; contraction: share of the prior's variance that they took away{at}."
    return Table(said, "llr", ("", "verdict", "contraction"), rows)


def _squares(result: SoilTestResult) -> Blocks:
    rows = tuple(
        (METHODS[row["method"]], letters(QUANTITIES[row["parameter"]].symbol), row["unit"],
         plain(row["value"], 4), plain(row["published"], 4), plain(row["posterior_share"], 2))
        for row in records(result.least_squares)
    )  # fmt: skip
    header = ("method", "", "unit", "value", "published or true", "posterior below")
    caption = (
        "Least squares as in usual practice, which takes all readings as independent; share of the posterior "
        "below each value. What the tests cannot separate is missing."
    )
    return (Table(caption, "lllrrr", header, rows),)


def _assumptions(result: SoilTestResult) -> Blocks:
    rows = [
        "The mean curve has exactly the form of the law above, the same for all tests.",
        "Logs of readings depart from it by a Gaussian deviation that is the test's own: independent from "
        "test to test, with correlation exp(−distance/ℓ) along the log of sinkage or displacement.",
        "Plates: the zero of the sinkage is wrong by z_0 in all tests, and by a part that differs from test "
        "to test, to first order in its ratio to the sinkage.",
        "Readings outside the range, or closer together than the spacing of the file, are left out; leaving "
        "out by pressure is leaving out by an outcome, which matters at the ends of the range only.",
        "Errors of single readings are taken as part of the deviation.",
    ]
    if result.test.independent:
        rows[1:3] = [
            "Readings are independent of each other, as [noise] says: where they are not, intervals are far too narrow."
        ]
    text, line = Markup("").join(Markup("{}<br>").format(row) for row in rows), Markup("{}: {}<br>")
    prior = Markup("").join(
        line.format(letters(QUANTITIES[name].symbol), entry if isinstance(entry, float) else f"{entry} (SI)")
        for name, entry in result.test.entries.items()
    )
    if result.test.reference != 1.0:
        prior += Markup(
            "Laws of k_c and k_φ are stated for k_c zⁿ and k_φ zⁿ, the parts of the pressure, at z = {:g} mm."
        ).format(1e3 * result.test.reference)
    return (Text(text), Text(prior))


def _reproduce(result: SoilTestResult) -> Blocks:
    record = result.record
    integral = record.get("evidence")
    evidence = f"{integral['log_z']:.2f} ± {integral['error']:.2f}" if integral else "not known"
    rows = (
        ("command", Markup("<code>bayesterra soiltest FILE --seed {}</code>").format(record["seed"])),
        ("made", record["made"]),
        ("source", record["source"] or "not given"),
        ("log evidence", evidence),
        ("settings", in_a_line(record["settings"])),
        *origin_rows(record),
    )
    return (Table("", "ll", ("", ""), rows),)


AXES = {
    "plate": ("sinkage $z$ [mm]", "pressure $p$ [kPa]"),
    "shear": ("displacement $j$ [mm]", r"shear stress $\tau$ [kPa]"),
}
DRAWS = 1500
LINE: dict[str, Any] = {"color": DATA, "linewidth": 0.6, "marker": ".", "markersize": 2}
"""Look of the readings of one test."""


@styled
def readings(result: SoilTestResult) -> FloatArray:
    """Draw the readings of every plate or normal stress; returns the array of axes (levels,).

    Thin lines: readings of one test each. Line: median of the mean curve. Bands: 50 and 90 % of new tests.
    Plates have logarithmic axes, on which Bekker's law is a straight line.
    """
    test = result.test.readings
    levels, column = np.unique(test.levels), result.bands.columns[0]
    of = LEVELS[test.kind]
    figure = new_figure(2.9 * max(len(levels), 2) + 0.3, 2.9)
    axes = np.atleast_1d(np.asarray(figure.subplots(1, len(levels), sharey=True, sharex=True)))
    for ax, level in zip(axes, levels, strict=True):
        bands = result.bands[np.isclose(result.bands[column], level / of.scale)]
        path = bands.iloc[:, 1].to_numpy()
        fan(ax, path, bands.filter(like="test_q").to_numpy().T, POSTERIOR, (0.18, 0.3))
        ax.plot(path, bands["curve_q50"], color=POSTERIOR)
        for number in np.flatnonzero(test.levels == level):
            own = test.test == number
            ax.plot(1e3 * test.path[own], test.stress[own] / 1e3, **LINE)
        where = f"${of.latex}$ = {level / of.scale:g} {of.unit}"
        ax.set_title(f"{where}, {int((test.levels == level).sum())} tests")
        ax.set_xlabel(AXES[test.kind][0])
        if test.kind == "plate":
            ax.set(xscale="log", yscale="log")
            for axis in (ax.xaxis, ax.yaxis):
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
                axis.set_minor_formatter(NullFormatter())
    axes[0].set_ylabel(AXES[test.kind][1])
    handles = [
        Line2D([], [], color=POSTERIOR, label="mean curve, median"),
        Patch(color=POSTERIOR, alpha=0.45, label="new test, 50 %"),
        Patch(color=POSTERIOR, alpha=0.18, label="new test, 90 %"),
        Line2D([], [], label="readings of one test", **LINE),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return axes


@styled
def left_out(result: SoilTestResult, ax: Axes | None = None) -> Axes:
    """Draw where every test lies in its prediction from the others: level (dots) and slope (crosses).

    Right predictions scatter evenly between 0 and 1; intervals that are too narrow drive them to the ends.
    """
    ax = own_axes(ax, 4.6, 2.9)
    table = result.left_out
    place = np.arange(len(table))
    ax.axhspan(0.05, 0.95, color=GRID, alpha=0.45, linewidth=0)
    ax.axhspan(0.25, 0.75, color=GRID, alpha=0.6, linewidth=0)
    ax.plot(place, table["level_pit"], "o", color=POSTERIOR, markersize=5, label="level")
    ax.plot(place, table["slope_pit"], "x", color=DATA, markersize=5, label="slope")
    levels = table.iloc[:, 1].to_numpy()
    for edge in np.flatnonzero(np.diff(levels)) + 0.5:
        ax.axvline(edge, color=DATA, linewidth=0.5)
    ax.set(ylim=(-0.03, 1.03), ylabel="share of the prediction below")
    ax.set(xticks=[], xlabel="tests, by plate or stress")
    figure_of(ax).legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return ax


@styled
def pair(result: SoilTestResult, first: str, second: str, ax: Axes | None = None) -> Axes:
    """Draw two parameters against each other: prior (grey), posterior (blue), least squares (marks)."""
    ax = own_axes(ax, 3.4, 2.9)
    names = result.names
    for group, colour, size in (("prior", PRIOR, 1.2), ("posterior", POSTERIOR, 1.6)):
        draws = result.values(group)
        draws = draws[:: max(1, len(draws) // DRAWS)]
        x, y = (draws[:, names.index(name)] / QUANTITIES[name].scale for name in (first, second))
        ax.plot(x, y, ".", color=colour, markersize=size, alpha=0.5, rasterized=True)
    table = result.least_squares
    for method in table["method"].unique():
        own = table[table["method"] == method].set_index("parameter")["value"]
        if {first, second} <= set(own.index):
            mark = MARKS[str(method)]
            ax.plot(own[first], own[second], mark.marker, color=mark.colour, label=mark.label, markersize=6)
    ax.set(xlabel=label(QUANTITIES[first]), ylabel=label(QUANTITIES[second]))
    handles, labels = ax.get_legend_handles_labels()
    if handles:
        figure_of(ax).legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return ax


def soil_test_overview(result: SoilTestResult) -> Overview:
    """Parameters of a soil test with their verdicts, and what is against the model."""
    words = result.identifiability.set_index("parameter")["verdict"].map(shown).to_dict()
    rows = []
    for row in records(result.summary):
        quantity = QUANTITIES.get(row["parameter"])
        figures = estimate(row["median"], row["hdi90_lo"], row["hdi90_hi"])
        name = quantity.symbol if quantity else row["parameter"]
        rows.append((name, row["unit"], *figures, words.get(row["parameter"], "")))
    lines = [Text(f"note: {note}.") for note in (*result.test.notes, *result.record["fits"]["notes"])]
    if result.misfit:
        lines.append(Text(misfit_text(result.misfit, CHECK), "bad"))
    if not result.converged:
        lines.append(Text("! The sampling did not converge: do not rely on what rests on draws."))
    if result.sentence:
        lines.append(Text(result.sentence))
    header = ("", "unit", "median", "90 % HDI", "verdict")
    table = Table(result.record["title"], "llrrl", header, tuple(rows))
    return (table, *lines, *failure_lines(result.record))
