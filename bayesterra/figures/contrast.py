"""Several results in one picture."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from bayesterra.arrays import FloatArray
from bayesterra.derived import DERIVED
from bayesterra.figures.axis import Axis, axis, density
from bayesterra.figures.forecast import bands
from bayesterra.figures.rows import summary_rows
from bayesterra.figures.style import DATA, INK, label, literal, own_axes, styled
from bayesterra.parameters import CHANNELS
from bayesterra.prediction import PREDICTED
from bayesterra.results import Result, field_values
from bayesterra.side_by_side import Comparison, outcomes_of

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""One Okabe–Ito colour per result, in their order."""
_LANE = 0.16
NEAR = 0.05
"""Readings under a load within this share of the common one are shown."""


@styled
def contrast(comparison: Comparison, name: str, ax: Axes | None = None) -> Axes:
    """Draw one parameter in all results, each in its colour.

    Filled: posterior density. Dashed: prior after the physical cut, where the parameter is free. Bars:
    90 % highest-density interval with the median as a dot; a vertical line where the parameter is fixed.
    """
    ax = own_axes(ax, 6.0, 0.52 + 0.1 * len(comparison.names))
    free = {n: result for n, result in comparison.results.items() if name in result.names}
    along = _common([axis(result, name) for result in free.values()])
    grid = along.grid(200)
    for lane, (one, result) in enumerate(comparison.results.items()):
        colour = COLOURS[lane]
        if one not in free:
            _fixed(ax, result, name, along, colour)
            continue
        prior, drawn = (field_values(name, _column(result, group, name)) for group in ("prior", "posterior"))
        ax.plot(grid, 0.5 * density(prior, along), color=colour, linewidth=0.8, dashes=(3, 2), alpha=0.7)
        ax.fill_between(grid, density(drawn, along), color=colour, alpha=0.28, linewidth=0)
        ax.plot(grid, density(drawn, along), color=colour, linewidth=1.0)
        row = summary_rows(result)[name]
        _bar(ax, lane, row.hdi, row.median, colour)
    _frame(ax, along, len(comparison.names))
    return ax


@styled
def contrast_derived(comparison: Comparison, name: str, ax: Axes | None = None) -> Axes:
    """Draw one derived quantity (a key of ``derived.DERIVED``) in all results, as :func:`contrast` does.

    Every result drives its own wheel under the common load; priors are left out, they are far wider.
    """
    ax = own_axes(ax, 6.0, 0.52 + 0.1 * len(comparison.names))
    table = comparison.parameters
    table = table[table["quantity"] == name].set_index("result")
    draws = {one: comparison.curves[one].derived[name] for one in table.index}
    known = {one: values[np.isfinite(values)] / DERIVED[name].scale for one, values in draws.items()}
    ends = np.concatenate([np.quantile(values, [0.002, 0.998]) for values in known.values()])
    margin = 0.03 * float(np.ptp(ends)) or 0.01
    along = Axis(float(ends.min() - margin), float(ends.max() + margin), False, (-np.inf, np.inf))
    for one, values in known.items():
        lane = comparison.names.index(one)
        height = density(values, along)
        ax.fill_between(along.grid(200), height, color=COLOURS[lane], alpha=0.28, linewidth=0)
        ax.plot(along.grid(200), height, color=COLOURS[lane], linewidth=1.0)
        row = table.loc[one]
        _bar(ax, lane, (row["hdi90_lo"], row["hdi90_hi"]), row["median"], COLOURS[lane])
    _frame(ax, along, len(comparison.names))
    return ax


@styled
def contrast_prediction(comparison: Comparison, quantity: str, ax: Axes | None = None) -> Axes:
    """Draw one quantity (a key of ``prediction.PREDICTED``) over slip in all results, each in its colour.

    Lines: medians; bands: 90 % of the modelled values, without noise, under the common load. Dots: readings
    in the fits that were taken with the same wheel and load.
    """
    ax = own_axes(ax)
    column, scale = list(PREDICTED).index(quantity), PREDICTED[quantity].scale
    for (one, curve), colour in zip(comparison.curves.items(), COLOURS, strict=False):
        low, middle, high = bands(curve.modelled, column) / scale
        ax.fill_between(curve.slip, low, high, color=colour, alpha=0.22, linewidth=0)
        ax.plot(curve.slip, middle, color=colour, linewidth=1.3, label=literal(one))
    _readings(ax, comparison, quantity)
    ax.set(xlabel="slip ratio $s$ [–]", ylabel=label(PREDICTED[quantity]))
    return ax


def _readings(ax: Axes, comparison: Comparison, quantity: str) -> None:
    """Readings of any of the results that were taken with its predicted wheel under the common load."""
    shown = set()
    for name, result in comparison.results.items():
        rows, curve = result.study.observations.used(), comparison.curves[name]
        if quantity not in rows.values or outcomes_of(result) in shown:
            continue
        loads = np.where(np.isnan(rows.load), rows.values.get("normal_force", rows.load), rows.load)
        driven = np.array([result.study.wheels[wheel] == curve.wheel for wheel in rows.wheel])
        mine = driven & (np.abs(loads / curve.load - 1) < NEAR)
        values = rows.values[quantity][mine] / CHANNELS[quantity].scale
        ax.plot(rows.slip[mine], values, "o", color=DATA, markersize=4, zorder=6)
        shown.add(outcomes_of(result))


def _column(result: Result, group: str, name: str) -> FloatArray:
    return result.values(group)[:, result.names.index(name)]


def _common(axes: list[Axis]) -> Axis:
    """The range that holds all ranges; logarithmic where all are."""
    return Axis(
        min(one.low for one in axes),
        max(one.high for one in axes),
        all(one.log for one in axes),
        axes[0].bounds,
    )


def _bar(ax: Axes, lane: int, ends: tuple[float, float], median: float, colour: str) -> None:
    height = -_LANE * (lane + 1)
    ax.plot(ends, [height, height], color=colour, linewidth=3.5, solid_capstyle="butt")
    ax.plot([median], [height], "o", color="white", markeredgecolor=colour, markersize=4.5, zorder=5)


def _fixed(ax: Axes, result: Result, name: str, along: Axis, colour: str) -> None:
    """A line at the value that a result holds the parameter at."""
    value = result.study.prior.fixed.get(name)
    if value is not None:
        ax.axvline(float(field_values(name, np.array(value))), color=colour, linewidth=1.2)


def _frame(ax: Axes, along: Axis, lanes: int) -> None:
    ax.set(
        xlim=(along.low, along.high), ylim=(-_LANE * (lanes + 0.7), 1.05), yticks=[],
        xscale="log" if along.log else "linear",
    )  # fmt: skip
    ax.axhline(0, color=INK, linewidth=0.5)
    ax.spines["left"].set_visible(False)
