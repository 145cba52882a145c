"""Parameter strip: every parameter with prior, posterior and point estimates on the prior's scale."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesterra.arrays import FloatArray
from bayesterra.checking.validation import estimates, held
from bayesterra.identifiability.verdicts import SHIFT, WEAK
from bayesterra.parameters import PARAMETERS, field_values
from bayesterra.report.figures import MARKS, POSTERIOR, PRIOR, Axis, density, label, new_figure, styled
from bayesterra.report.numbers import MINUS, interval, resolution, rounded
from bayesterra.report.symbols import angles, symbol, unit
from bayesterra.study.page import StripRow, axis, axis_end, drawing, keys
from bayesterra.study.result import Result, SummaryRow, identifiability_rows, summary_rows


def strip(result: Result) -> tuple[StripRow, ...]:
    """All free parameters."""
    return tuple(_row(result, name) for name in result.names)


def legend(result: Result) -> tuple[tuple[Markup, str], ...]:
    """Small drawings and what they stand for."""
    return keys(estimates(result))


def mode_outside(result: Result) -> tuple[str, ...]:
    """Parameters whose posterior mode lies outside their 90 % HDI by more than a twentieth of its width."""
    rows = summary_rows(result)
    return tuple(name for name in result.names if _apart(rows[name]))


def _apart(row: SummaryRow) -> bool:
    margin = 0.05 * (row.hdi90_hi - row.hdi90_lo)
    return not row.hdi90_lo - margin <= row.mode <= row.hdi90_hi + margin


def _row(result: Result, name: str) -> StripRow:
    parameter, along = PARAMETERS[name], axis(result, name)
    row = summary_rows(result)[name]
    step = resolution(*row.hdi)
    word, remark = _words(result, name)
    return StripRow(
        symbol=symbol(name),
        description=angles(parameter.description + (", log scale" if along.log else "")),
        unit=unit(name),
        low=axis_end(along.low, along),
        high=axis_end(along.high, along),
        drawing=_drawing(result, name, along),
        median=rounded(row.median, step),
        hdi=interval(*row.hdi),
        mode=rounded(row.mode, step),
        mode_outside=name in mode_outside(result),
        word=word,
        remark=remark,
    )


def _words(result: Result, name: str) -> tuple[str, Markup]:
    """The identifiability word and what stands beside it in small print."""
    row = identifiability_rows(result)[name]
    word = row.word
    if word == "moved":
        return word, Markup("{}prior and data disagree").format(moved_by(row.shift))
    if word == "one-sided":
        return word, Markup("at its {} bound").format(row.bound)
    if word != "coupled":
        return word, Markup("")
    alone = ", alone like its prior" if row.contraction < WEAK else ""
    partner = symbol(row.coupled_with) if row.coupled_with else Markup("several others")
    return word, Markup("with {}{}").format(partner, alone)


def moved_by(shift: float) -> str:
    """Shift of the mean, in words before others; nothing where it is not the mean that moved."""
    return f"by {shift:+.1f} prior sd: ".replace("-", MINUS) if abs(shift) >= SHIFT else ""


def _drawing(result: Result, name: str, along: Axis) -> Markup:
    column = result.names.index(name)
    prior, posterior = (field_values(name, result.values(g)[:, column]) for g in ("prior", "posterior"))
    scale = PARAMETERS[name].scale
    points = {method: v[name] / scale for method, v in estimates(result).items() if name in v}
    hollow = [method for method in points if name in held(result, method)]
    return drawing((prior, posterior), along, summary_rows(result)[name], points, hollow)


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
