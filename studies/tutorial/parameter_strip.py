"""The parameter strip of a report as a figure, for slides and papers."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesterra.arrays import FloatArray
from bayesterra.checking.validation import estimates, held
from bayesterra.parameters import PARAMETERS, field_values
from bayesterra.report.figures import MARKS, POSTERIOR, PRIOR, density, label, mark_key, new_figure, styled
from bayesterra.study.page import axis
from bayesterra.study.result import Result, summary_rows


@styled
def parameter_strip(result: Result) -> FloatArray:
    """Draw one row per parameter over the range of its prior; returns the array of axes (d,).

    Pale: prior after the physical cut. Filled: posterior. Thick line: its 90 % highest-density interval.
    Tick: posterior mode. Marks: least squares, hollow where a value was held, and circles for published or
    true values; arrows point at those outside the range. Prior and posterior are each scaled to the row.
    """
    names = result.names
    figure = new_figure(7.5, 0.62 * len(names) + 0.5)
    axes = np.atleast_1d(np.asarray(figure.subplots(len(names), 1)))
    for ax, name in zip(axes, names, strict=True):
        _row_of_figure(ax, result, name)
    _legend(figure, result)
    return axes


def _row_of_figure(ax: Axes, result: Result, name: str) -> None:
    along = axis(result, name)
    grid = along.grid(200)
    column = result.names.index(name)
    for group, colour, height, alpha in (("prior", PRIOR, 0.5, 0.3), ("posterior", POSTERIOR, 1.0, 0.45)):
        draws = field_values(name, result.values(group)[:, column])
        ax.fill_between(grid, height * density(draws, along), color=colour, alpha=alpha, linewidth=0)
    row = summary_rows(result)[name]
    ax.plot(row.hdi, [0, 0], color=POSTERIOR, linewidth=4, solid_capstyle="butt")
    ax.plot([row.mode] * 2, [-0.3, 1.0], color=POSTERIOR, linewidth=1.2)
    for method, values in estimates(result).items():
        if name in values:
            value = values[name] / PARAMETERS[name].scale
            _point(ax, method, value, (along.low, along.high), hollow=name in held(result, method))
    ax.set(xlim=(along.low, along.high), ylim=(-0.75, 1.05), yticks=[], xscale="log" if along.log else "linear")
    ax.spines["left"].set_visible(False)
    ax.set_ylabel(label(PARAMETERS[name]), rotation=0, ha="right", va="center")


def _point(ax: Axes, method: str, value: float, limits: tuple[float, float], *, hollow: bool) -> None:
    """A mark below the line; an arrow at the end of the axis for a value beyond it; hollow where held."""
    mark = MARKS[method]
    low, high = limits
    marker = "<" if value < low else ">" if value > high else mark.marker
    face = "none" if mark.hollow or hollow else mark.colour
    ax.plot(
        [min(max(value, low), high)], [-0.42], marker, color=mark.colour, markerfacecolor=face,
        markersize=8 if mark.hollow else 5.5, clip_on=False, zorder=5,
    )  # fmt: skip


def _legend(figure: Figure, result: Result) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries: list[Patch | Line2D] = [
        Patch(color=PRIOR, alpha=0.3, label="prior"),
        Patch(color=POSTERIOR, alpha=0.45, label="posterior"),
        Line2D([], [], color=POSTERIOR, linewidth=4, label="90 % HDI"),
        Line2D([], [], color=POSTERIOR, marker="|", markersize=10, linestyle="none", label="mode"),
    ]
    entries += map(mark_key, estimates(result))
    figure.legend(handles=entries, loc="outside lower center", ncols=len(entries), columnspacing=1.2)
