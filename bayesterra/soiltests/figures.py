"""Soil tests: readings with bands, tests beside their predictions, and two parameters against each other."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from bayesterra.arrays import FloatArray
from bayesterra.report.figures import figure_of, label, new_figure, own_axes, styled
from bayesterra.report.style import DATA, GRID, MARKS, POSTERIOR, PRIOR
from bayesterra.soiltests.analysis import SoilTestResult
from bayesterra.soiltests.schema import QUANTITIES

AXES = {
    "plate": ("sinkage $z$ [mm]", "pressure $p$ [kPa]"),
    "shear": ("displacement $j$ [mm]", r"shear stress $\tau$ [kPa]"),
}
DRAWS = 1500


@styled
def readings(result: SoilTestResult) -> FloatArray:
    """Draw the readings of every plate or normal stress; returns the array of axes (levels,).

    Thin lines: readings of one test each. Line: median of the mean curve. Bands: 50 and 90 % of new tests.
    Plates have logarithmic axes, on which Bekker's law is a straight line.
    """
    test = result.test.readings
    levels, column = np.unique(test.levels), result.bands.columns[0]
    scale = 1e-3 if test.kind == "plate" else 1e3
    figure = new_figure(2.9 * max(len(levels), 2) + 0.3, 2.9)
    axes = np.atleast_1d(np.asarray(figure.subplots(1, len(levels), sharey=True, sharex=True)))
    for ax, level in zip(axes, levels, strict=True):
        bands = result.bands[np.isclose(result.bands[column], level / scale)]
        path = bands.iloc[:, 1].to_numpy()
        for low, high, alpha in (("q05", "q95", 0.18), ("q25", "q75", 0.3)):
            ax.fill_between(
                path, bands[f"test_{low}"], bands[f"test_{high}"], color=POSTERIOR, alpha=alpha, linewidth=0
            )
        ax.plot(path, bands["curve_q50"], color=POSTERIOR)
        for number in np.flatnonzero(test.levels == level):
            own = test.test == number
            ax.plot(
                1e3 * test.path[own],
                test.stress[own] / 1e3,
                "-",
                color=DATA,
                linewidth=0.6,
                marker=".",
                markersize=2,
            )
        where = f"$b$ = {1e3 * level:g} mm" if test.kind == "plate" else rf"$\sigma$ = {level / 1e3:g} kPa"
        ax.set_title(f"{where}, {int((test.levels == level).sum())} tests")
        ax.set_xlabel(AXES[test.kind][0])
        if test.kind == "plate":
            ax.set(xscale="log", yscale="log")
            for axis in (ax.xaxis, ax.yaxis):
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
                axis.set_minor_formatter(NullFormatter())
    axes[0].set_ylabel(AXES[test.kind][1])
    figure.legend(
        handles=[
            Line2D([], [], color=POSTERIOR, label="mean curve, median"),
            Patch(color=POSTERIOR, alpha=0.45, label="new test, 50 %"),
            Patch(color=POSTERIOR, alpha=0.18, label="new test, 90 %"),
            Line2D([], [], color=DATA, linewidth=0.6, marker=".", markersize=2, label="readings of one test"),
        ],
        loc="outside lower center",
        ncols=4,
    )
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
    ax.set(
        ylim=(-0.03, 1.03),
        ylabel="share of the prediction below",
        xticks=[],
        xlabel="tests, by plate or stress",
    )
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
