"""Soil tests in the page of a result: readings with bands, predictions of new tests, and least squares."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from bayesterra.arrays import FloatArray
from bayesterra.checking.soil_tests import ALARM
from bayesterra.least_squares.soil_tests import METHODS, fit
from bayesterra.report.blocks import Block, Blocks, Cell, Gallery, Record, Table, Text, drawing, records
from bayesterra.report.figures import DATA, GRID, POSTERIOR, fan, figure_of, new_figure, own_axes, styled
from bayesterra.report.numbers import plain, probability
from bayesterra.report.sections import Prose, Section
from bayesterra.report.symbols import symbol, unit
from bayesterra.report.verdicts import failed
from bayesterra.study.result import Result
from bayesterra.study.soil_tests import LEVELS, SoilTest

say = Prose("soil_tests")


def soil_tests_sections(result: Result) -> tuple[Section, ...]:
    """A section where there are soil tests, else none."""
    if not result.study.soil_tests:
        return ()
    lost = failed(result.record, "left_out")
    blocks: list[Block] = [Text(lost, "bad")] if lost else list(_checks(result))
    for test in result.study.soil_tests.values():
        series = () if lost else _series(result, test)
        assumed = Text(say("assumptions", test.kind == "plate", test.independent))
        blocks += [Text(say("law", test.kind)), *series, assumed]
    return (Section("soil-tests", "Soil tests", (*blocks, *_squares(result))),)


def _checks(result: Result) -> Blocks:
    checks = result.record["soil_tests"]["checks"]
    lines = tuple((name, probability(p)) for name, p in checks.items())
    return (say.table("checks", lines, ALARM / max(len(checks), 1), len(checks)),) if lines else ()


def _series(result: Result, test: SoilTest) -> Blocks:
    own, of = result.new_tests[result.new_tests["series"] == test.name], LEVELS[test.kind]
    header = ("test", f"{of.description} [{of.unit}]", "readings", "level", "slope", "in 50 %", "in 90 %", "k̂")
    picture = drawing(readings(result, test.name), "Readings of every test with the bands of new tests")
    places = drawing(left_out(result, test.name), "Level and slope of every test within its prediction")
    return (
        Gallery("whole", (picture,), say("readings", test.name, test.stated.kind, test.kind == "plate")),
        Gallery("half", (places,), say("places")),
        Table(say("predicted"), "lrrrrrrr", header, tuple(map(_test_row, records(own)))),
    )


def _test_row(row: Record) -> tuple[Cell, ...]:
    shares = (probability(row[name]) for name in ("level_pit", "slope_pit"))
    inside = (f"{100 * row[name]:.0f} %" for name in ("covered_50", "covered_90"))
    reliability = f"{row['k_hat']:.2f}{'*' if row['anew'] else ''}"
    return (str(row["test"]), f"{row['level']:g}", str(row["readings"]), *shares, *inside, reliability)


def _squares(result: Result) -> Blocks:
    table, rows = result.least_squares, list[tuple[Cell, ...]]()
    for row in records(table[table["method"].str.contains(", ")]):
        method, series = str(row["method"]).split(", ", 1)
        values = (plain(row["value"], 4), plain(row["published"], 4))
        rows.append((METHODS[method], series, symbol(row["parameter"]), unit(row["parameter"]), *values))
    notes = [f"{name}: {note}" for name, test in result.study.soil_tests.items() for note in fit(test.readings).notes]
    return (say.table("squares", rows), *(Text(f"{note}.") for note in notes))


AXES = {
    "plate": ("sinkage $z$ [mm]", "pressure $p$ [kPa]"),
    "shear": ("displacement $j$ [mm]", r"shear stress $\tau$ [kPa]"),
}
LINE: dict[str, Any] = {"color": DATA, "linewidth": 0.6, "marker": ".", "markersize": 2}
"""Look of the readings of one test."""


@styled
def readings(result: Result, name: str) -> FloatArray:
    """Draw the readings of a series at every plate or normal stress; returns the array of axes (levels,).

    Thin lines: readings of one test each. Line: median of the mean curve. Bands: 50 and 90 % of new tests.
    Plates have logarithmic axes, on which Bekker's law is a straight line.
    """
    test, drawn = result.study.soil_tests[name].readings, result.bands[result.bands["series"] == name]
    levels, of = np.unique(test.levels), LEVELS[test.kind]
    figure = new_figure(2.9 * max(len(levels), 2) + 0.3, 2.9)
    axes = np.atleast_1d(np.asarray(figure.subplots(1, len(levels), sharey=True, sharex=True)))
    for ax, level in zip(axes, levels, strict=True):
        bands = drawn[np.isclose(drawn["level"], level / of.scale)]
        path = bands["path [mm]"].to_numpy()
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
def left_out(result: Result, name: str, ax: Axes | None = None) -> Axes:
    """Draw where every test lies in its prediction from the others: level (dots) and slope (crosses).

    Right predictions scatter evenly between 0 and 1; intervals that are too narrow drive them to the ends.
    """
    ax = own_axes(ax, 4.6, 2.9)
    table = result.new_tests[result.new_tests["series"] == name]
    place = np.arange(len(table))
    ax.axhspan(0.05, 0.95, color=GRID, alpha=0.45, linewidth=0)
    ax.axhspan(0.25, 0.75, color=GRID, alpha=0.6, linewidth=0)
    ax.plot(place, table["level_pit"], "o", color=POSTERIOR, markersize=5, label="level")
    ax.plot(place, table["slope_pit"], "x", color=DATA, markersize=5, label="slope")
    levels = table["level"].to_numpy()
    for edge in np.flatnonzero(np.diff(levels)) + 0.5:
        ax.axvline(edge, color=DATA, linewidth=0.5)
    ax.set(ylim=(-0.03, 1.03), ylabel="share of the prediction below")
    ax.set(xticks=[], xlabel="tests, by plate or stress")
    figure_of(ax).legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return ax
