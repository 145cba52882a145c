"""Predictions and rovers as figures, notebook and terminal tables."""

from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesterra.arrays import FloatArray
from bayesterra.models.statics import Greatest, State
from bayesterra.prediction.outlook import DEGREE, QUANTITIES, RoverOutlook, cannot, unanswered
from bayesterra.prediction.prediction import PREDICTED, UNANSWERED, Case, Predicted, Prediction, quantiles, say
from bayesterra.prediction.rover import AXLES
from bayesterra.report import figures
from bayesterra.report.blocks import Cell, Overview, Table, Text, records
from bayesterra.report.numbers import estimate, given, interval, resolution, rounded
from bayesterra.report.numbers import share as percent

DOUBTFUL = "#D55E00"
"""Colour of what cannot be relied on."""
_EDGES = 0.03
_PALE: dict[str, Any] = {"color": figures.GRID, "alpha": 0.45, "linewidth": 0, "zorder": 0}


@figures.styled
def prediction(curve: Prediction, quantity: str, ax: Axes | None = None, *, at: Prediction | None = None) -> Axes:
    """Draw one quantity of a prediction over slip.

    Parameters
    ----------
    curve : a prediction on a slip grid: its median and 90 % band, without and with measurement noise.
    quantity : a key of ``prediction.PREDICTED``.
    at : the same wheel and load at single slips: median and 90 % interval of the readings, or of the modelled
        values where there are none.

    Grey ground: slips that were not driven. Hatched: more than 5 % of the draws have no answer.
    """
    ax = figures.own_axes(ax)
    column, scale = list(PREDICTED).index(quantity), PREDICTED[quantity].scale
    modelled, readings = (quantiles(of[:, :, column])[::2] / scale for of in (curve.modelled, curve.readings))
    for band, alpha in ((readings, 0.18), (modelled, 0.42)):
        ax.fill_between(curve.slip, band[0], band[2], color=figures.POSTERIOR, alpha=alpha, linewidth=0)
    ax.plot(curve.slip, modelled[1], color=figures.POSTERIOR)
    if at is not None:
        noisy = at.modelled if np.isnan(at.readings[:, :, column]).all() else at.readings
        low, middle, high = quantiles(noisy[:, :, column])[::2] / scale
        ax.errorbar(
            at.slip, middle, yerr=np.stack([middle - low, high - middle]), fmt="o", color=figures.DATA,
            markersize=3.5, capsize=2.5, elinewidth=0.9, zorder=6,
        )  # fmt: skip
    _limit(ax, modelled, readings)
    _ground(ax, curve)
    ax.set(xlabel="slip ratio $s$ [–]", ylabel=figures.label(PREDICTED[quantity]))
    return ax


@figures.styled
def predictions(forecast: Predicted) -> FloatArray:
    """Draw every quantity (columns) of some predictions (rows); returns the axes (cases, quantities)."""
    cases = forecast.cases
    figure = figures.new_figure(2.55 * len(PREDICTED), 2.35 * len(cases) + 0.75)
    axes = np.asarray(figure.subplots(len(cases), len(PREDICTED), squeeze=False))
    for row, (curve, at) in zip(axes, cases, strict=True):
        for ax, quantity in zip(row, PREDICTED, strict=True):
            prediction(curve, quantity, ax, at=at)
            ax.set_title(PREDICTED[quantity].description, fontsize=9)
        row[0].annotate(
            f"wheel {figures.literal(curve.name)}, {curve.load:.4g} N", (0, 1), (0, 22), xycoords="axes fraction",
            textcoords="offset points", fontsize=10, fontweight="bold",
        )  # fmt: skip
    _legend_of_bands(figure, cases)
    return axes


def _limit(ax: Axes, modelled: FloatArray, readings: FloatArray) -> None:
    """Keep the bands in view, except where an efficiency falls without end at the smallest slips."""
    values = np.concatenate([modelled.ravel(), readings.ravel()])
    values = values[np.isfinite(values)]
    if not values.size:
        return
    medians = modelled[1][np.isfinite(modelled[1])]
    reach = 3 * max(float(np.ptp(medians)), 0.05 * float(np.abs(medians).max()), 1e-9)
    low, high = max(values.min(), medians.min() - reach), min(values.max(), medians.max() + reach)
    figures.limit_y(ax, low, high, 0.06)


def _ground(ax: Axes, curve: Prediction) -> None:
    """Show where the slips were not driven, and where too many draws have no answer."""
    left, right = float(curve.slip[0]), float(curve.slip[-1])
    margin = _EDGES * (right - left) or 0.02
    ax.set_xlim(left - margin, right + margin)
    if left < curve.driven[0]:
        ax.axvspan(left - margin, curve.driven[0], **_PALE)
    if right > curve.driven[1]:
        ax.axvspan(curve.driven[1], right + margin, **_PALE)
    hatch_failing(ax, curve.slip, curve.unanswered)


def hatch_failing(ax: Axes, x: FloatArray, shares: FloatArray, colour: str = DOUBTFUL) -> None:
    """Hatch the stretches of ``x`` (k,) in which over ``UNANSWERED`` of the draws fail; the worst share."""
    left, right = ax.get_xlim()
    wrong = np.flatnonzero(shares > UNANSWERED)
    half = 0.5 * float(np.diff(x).max(initial=0.02))
    for run in np.split(wrong, np.flatnonzero(np.diff(wrong) > 1) + 1) if wrong.size else ():
        low, high, share = float(x[run[0]]) - half, float(x[run[-1]]) + half, float(shares[run].max())
        ax.axvspan(low, high, facecolor="none", edgecolor=colour, hatch="////", alpha=0.5, linewidth=0, zorder=5)
        ax.text(
            min(max(0.5 * (low + high), left), right), 0.97, f"{100 * share:.0f} %", color=colour,
            transform=ax.get_xaxis_transform(), ha="center", va="top", fontsize=7.5, zorder=7,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.0},
        )  # fmt: skip
    ax.set_xlim(left, right)


def _legend_of_bands(figure: Figure, cases: Sequence[Case]) -> None:
    entries: list[Patch | Line2D] = [
        Line2D([], [], color=figures.POSTERIOR, label="median"),
        Patch(color=figures.POSTERIOR, alpha=0.5, label="90 %, without noise"),
        Patch(color=figures.POSTERIOR, alpha=0.18, label="90 %, with measurement noise"),
    ]
    if any(at is not None for _, at in cases):
        entries.append(Line2D([], [], color=figures.DATA, marker="o", markersize=3.5, label="asked-for slips, 90 %"))
    if any(not c.driven[0] <= s <= c.driven[1] for c, _ in cases for s in c.slip[[0, -1]]):
        entries.append(Patch(color=figures.GRID, alpha=0.6, label="slip not driven"))
    if any(curve.marked for curve, _ in cases):
        entries.append(_hatched(DOUBTFUL, "over 5 % of draws without answer"))
    figure.legend(handles=entries, loc="outside lower center", ncols=len(entries), labelcolor=figures.INK)


def _hatched(colour: str, label: str) -> Patch:
    return Patch(facecolor="none", edgecolor=colour, hatch="////", label=label)


def forecast_overview(forecast: Predicted) -> Overview:
    """The bands at the slips that were asked for, what is doubtful, and probabilities that were asked for."""
    blocks: list[Table | Text] = []
    for at in forecast.points:
        blocks += [_bands(at), _derived(at), *map(Text, _remarks(at))]
    return (*blocks, *_probabilities(forecast.tables().get("probabilities")))


def _probabilities(table: pd.DataFrame | None) -> Overview:
    """Probabilities of conditions, and whether the error of the model is in them; nothing where none was asked for."""
    if table is None:
        return ()
    keys = [name for name in table.columns if name not in ("no_answer", "model_error", "extrapolated")]
    rows = [(*(_asked(row[key]) for key in keys[:-1]), percent(row["probability"])) for row in records(table)]
    align = "".join("l" if key in ("wheel", "condition") else "r" for key in keys)
    return (
        Table("Probabilities", align, tuple(keys), tuple(rows)),
        Text(say.plain("probabilities", table["model_error"].all())),
    )


def _asked(value: object) -> str:
    """A name, or a number where there is one."""
    return value if isinstance(value, str) else given(float(f"{float(str(value)):.4g}")) if str(value) != "nan" else ""


def _bands(at: Prediction) -> Table:
    table = at.table.set_index(["slip", "quantity"])
    rows: list[tuple[Cell, ...]] = []
    for slip, share in zip(at.slip, at.unanswered, strict=True):
        mark = (Markup("<b>{:.3g} % !</b>") if share > UNANSWERED else Markup("{:.3g} %")).format(100 * share)
        for i, (name, quantity) in enumerate(PREDICTED.items()):
            unit = "" if quantity.unit == "-" else f" [{quantity.unit}]"
            first, last = ("", "") if i else (f"{slip:.4g}", mark)
            rows.append((first, f"{quantity.symbol}{unit}", *_cells(table.loc[(slip, name)].to_dict()), last))
        rows.append(())
    header = ("slip", "", "median", "90 %", "90 % of readings", "no answer")
    return Table(f"wheel {at.name} under {at.load:.4g} N", "rlrrrr", header, tuple(rows))


def _cells(row: Mapping[str, float]) -> tuple[str, str, str]:
    readings = row["reading_q05"], row["reading_q95"]
    noisy = "" if np.isnan(readings).any() else interval(*readings)
    return *estimate(row["modelled_q50"], row["modelled_q05"], row["modelled_q95"]), noisy


def _derived(at: Prediction) -> Table:
    rows = []
    for row in records(at.derived_table):
        after = estimate(row["median"], row["hdi90_lo"], row["hdi90_hi"])
        before = interval(row["prior_q05"], row["prior_q95"])
        rows.append((str(row["quantity"]).replace("_", " "), str(row["unit"]), *after, before))
    header = ("derived", "unit", "median", "90 % HDI", "prior 90 %")
    return Table("", "llrrr", header, tuple(rows))


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


REAR, BOTH = "#E69F00", "#009E73"
COLOURS = (figures.POSTERIOR, REAR)
_LABELS = {"slip": "slip ratio $s$ [–]", "sinkage": "sinkage $z$ [mm]", "load": "load of a wheel [N]"}
_STEPS = 200


@figures.styled
def rover_outlook(outlook: RoverOutlook) -> FloatArray:
    """Draw slip, sinkage and wheel load over slope (first row) and tow force (second, if asked for).

    Lines: medians of the draws that hold; dark and pale bands: 50 and 90 % of them. Front axle blue, rear
    axle orange; one line where they are alike. Hatched orange: over 5 % of the draws do not hold; grey: over
    5 % have no answer. Last column: share of the draws
    that hold a slope or tow force at any slip, and at the driven ones only (dashed). Returns the axes.
    """
    rows = 1 if outlook.over_tow is None else 2
    figure = figures.new_figure(10.4, 2.5 * rows + 0.9)
    axes = np.asarray(figure.subplots(rows, 4, squeeze=False))
    _row(axes[0], outlook, outlook.over_slope, "slope")
    _chance(axes[0, 3], outlook.slopes, outlook.slopes_driven, DEGREE)
    axes[0, 3].set(xlabel="slope α [°]", ylabel="share of draws that climb it")
    if outlook.over_tow is not None:
        _row(axes[1], outlook, outlook.over_tow, "tow")
        _chance(axes[1, 3], outlook.tows, outlook.tows_driven, 1.0)
        axes[1, 3].set(xlabel="tow force on the flat [N]", ylabel="share of draws that hold it")
    _legend(axes, outlook)
    return axes


def _row(axes: FloatArray, outlook: RoverOutlook, states: State, over: str) -> None:
    x = states.slope[0] / DEGREE if over == "slope" else states.tow[0]
    fixed = f"{states.tow[0, 0]:.3g} N tow" if over == "slope" else f"slope {states.slope[0, 0] / DEGREE:.3g}°"
    for ax, (field, title) in zip(axes, _LABELS.items(), strict=False):
        alike = field == "slip" and outlook.rover.equal_slip
        for axle in (1,) if alike else (0, 1):
            colour = BOTH if alike else COLOURS[axle]
            levels = quantiles(getattr(states, field)[:, :, axle] / QUANTITIES[field][1])
            figures.fan(ax, x, levels, colour, (0.2, 0.35))
            ax.plot(x, levels[2], color=colour)
        if field == "slip":
            ax.axhspan(outlook.driven[1], 1, color=figures.GRID, alpha=0.45, linewidth=0, zorder=0)
            ax.set_ylim(0, float(np.nanmax(quantiles(states.slip.max(axis=2))[4], initial=0.05)))
        else:
            ax.set_ylim(0, None)
        ax.set(xlabel="slope α [°]" if over == "slope" else "tow force [N]", ylabel=title, xlim=(x[0], x[-1]))
        ax.set_title(fixed, fontsize=8.5)
        ax.set_ylim(top=1.12 * ax.get_ylim()[1])
        hatch_failing(ax, x, cannot(states))
        hatch_failing(ax, x, unanswered(states), figures.PRIOR)


def _chance(ax: Axes, overall: Greatest, driven: Greatest, scale: float) -> None:
    """One minus the distribution of the greatest value."""
    values = np.nan_to_num(overall.value, nan=-np.inf) / scale
    x = np.linspace(0, 1.05 * max(float(values.max()), 1e-9), _STEPS)
    for peak, line in ((overall, "-"), (driven, "--")):
        least = np.nan_to_num(peak.value, nan=-np.inf) / scale
        ax.plot(x, (least >= x[:, None]).mean(axis=1), color=figures.DATA, linestyle=line)
    ax.set(xlim=(0, x[-1]), ylim=(0, 1.03))


def _legend(axes: FloatArray, outlook: RoverOutlook) -> None:
    entries: list[Line2D | Patch] = [
        *([Line2D([], [], color=BOTH, label="all wheels")] if outlook.rover.equal_slip else []),
        *(Line2D([], [], color=c, label=f"{axle} axle") for c, axle in zip(COLOURS, AXLES, strict=True)),
        Patch(color=figures.INK, alpha=0.5, label="50 %"),
        Patch(color=figures.INK, alpha=0.2, label="90 % of the draws that hold"),
        Line2D([], [], color=figures.DATA, linestyle="--", label="at driven slips"),
        Patch(color=figures.GRID, alpha=0.6, label="slip not driven"),
    ]
    curves = [outlook.over_slope, *([] if outlook.over_tow is None else [outlook.over_tow])]
    for shares, colour, title in (
        (cannot, DOUBTFUL, "over 5 % of draws do not hold"),
        (unanswered, figures.PRIOR, "over 5 % without answer"),
    ):
        if any((shares(curve) > UNANSWERED).any() for curve in curves):
            entries.append(_hatched(colour, title))
    figures.figure_of(axes).legend(handles=entries, loc="outside lower center", ncols=5, labelcolor=figures.INK)


def rover_overview(outlook: RoverOutlook) -> Overview:
    """What a rover does on every slope, the greatest slope, and notes."""
    lines = []
    for (slope, tow), rows in outlook.table.groupby(["slope [deg]", "tow [N]"], sort=False):
        cells = rows.set_index(["quantity", "axle"]).to_dict("index")
        slips, depth = _median_90(cells["slip", "rear"], 0.01), _median_90(cells["sinkage", "rear"], 0.1)
        loads = " / ".join(rounded(cells["load", axle]["q50"], 1.0) for axle in AXLES)
        shares = (float(rows[name].iloc[0]) for name in ("cannot", "unanswered"))
        marks = ", ".join(f"{100 * share:.0f}{'!' if share > UNANSWERED else ''}" for share in shares)
        lines.append((f"{slope:.4g}", f"{tow:.4g}", slips, depth, loads, f"{marks} %"))
    title = f"rover {outlook.rover.name}, {outlook.rover.weight:.4g} N"
    told = _probabilities(outlook.tables().get("probabilities"))
    return (Table(title, "rrrrrr", ROVER_COLUMNS, tuple(lines)), *map(Text, outlook_lines(outlook)), *told)


ROVER_COLUMNS = ("slope\n[°]", "tow\n[N]", "slip", "z rear\n[mm]", "loads\n[N]", "cannot,\nno answer")


def _median_90(row: Mapping[Hashable, Any], least: float) -> str:
    """The median, and 5 and 95 %, to a step of ``least`` or coarser."""
    low, high = row["q05"], row["q95"]
    step = max(resolution(low, high), least)
    return f"{rounded(row['q50'], step)} ({interval(low, high, step)})"


def outlook_lines(outlook: RoverOutlook) -> list[str]:
    """The greatest slope and tow force, then what is doubtful and what is assumed."""
    lines = []
    for row in records(outlook.greatest_table):
        middle, ends = estimate(row["q50"], row["q05"], row["q95"])
        where = "" if row["slips"] == "all" else " at driven slips"
        name, unit = str(row["quantity"]).replace("_", " "), "°" if row["unit"] == "deg" else " N"
        lines.append(f"{name.capitalize()}{where}: {middle}{unit}, 90 % {ends}{unit}.")
    return [*lines, *(f"Note: {note}." for note in outlook.notes)]
