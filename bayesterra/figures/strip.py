"""All parameters at a glance: prior, posterior and point estimates on the prior's own scale."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesterra.adequacy import estimates, held
from bayesterra.arrays import FloatArray
from bayesterra.figures.axis import axis, density
from bayesterra.figures.rows import summary_rows
from bayesterra.figures.style import MARKS, POSTERIOR, PRIOR, label, new_figure, styled
from bayesterra.parameters import PARAMETERS
from bayesterra.results import Result, field_values


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
        _row(ax, result, name)
    _legend(figure, result)
    return axes


def _row(ax: Axes, result: Result, name: str) -> None:
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
    ax.set(
        xlim=(along.low, along.high), ylim=(-0.75, 1.05), yticks=[], xscale="log" if along.log else "linear"
    )
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
    for method in estimates(result):
        mark = MARKS[method]
        face = "none" if mark.hollow else mark.colour
        entries.append(
            Line2D([], [], color=mark.colour, marker=mark.marker, markerfacecolor=face, linestyle="none",
                   label=mark.label)
        )  # fmt: skip
    figure.legend(handles=entries, loc="outside lower center", ncols=len(entries), columnspacing=1.2)
