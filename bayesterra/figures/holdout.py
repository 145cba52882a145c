"""Readings that were left out, beside what fits to the others say of them."""

from __future__ import annotations

from io import BytesIO
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesterra.arrays import FloatArray
from bayesterra.figures.style import (
    DATA,
    GRID,
    INK,
    POSTERIOR,
    figure_of,
    label,
    literal,
    new_figure,
    one_of,
    own_axes,
    styled,
)
from bayesterra.holdout import Band, Holdout
from bayesterra.holdout.baselines import BASELINES
from bayesterra.parameters import CHANNELS

COLOURS = {"polynomial": "#E69F00", "Gaussian process": "#009E73"}
"""Colours of the baselines that are drawn."""
MOST = 12
"""Levels, at most, that get a panel of their own."""


def channels(table: pd.DataFrame) -> list[str]:
    """Channels that are scored."""
    return list(dict.fromkeys(table["channel"]))


def _colours(table: pd.DataFrame) -> dict[str, str]:
    """Predictors that are drawn: everything that is no baseline, which is one model, then the baselines."""
    models = [name for name in dict.fromkeys(table["predictor"]) if name not in BASELINES]
    return {**dict.fromkeys(models, POSTERIOR), **COLOURS}


@styled
def left_out(table: pd.DataFrame, channel: str, ax: Axes | None = None) -> Axes:
    """Draw the readings of one channel beside predictions that do not know the row's level.

    Parameters
    ----------
    table : as of :attr:`bayesterra.holdout.Holdout.table`.
    channel : a scored one.

    One place for every left-out row, levels apart from each other. Bars: central 50 and 90 % of the
    predictive law of a reading, tick: its median; blue the model, orange the polynomial, green the Gaussian
    process. Dots: the readings. Grey ground: slips beyond those of the training rows.
    """
    ax = own_axes(ax, 7.2, 2.6)
    table = table[table["channel"] == one_of("channel", channel, channels(table))]
    place, colours = _places(table), _colours(table)
    for position, (name, colour) in enumerate(colours.items()):
        own = table[(table["predictor"] == name) & table["crps"].notna()]
        x = own["row"].map(place).to_numpy(np.float64) + 0.24 * (position - 0.5 * (len(colours) - 1))
        ax.vlines(x, own["q05"], own["q95"], color=colour, linewidth=1.3)
        ax.vlines(x, own["q25"], own["q75"], color=colour, linewidth=5)
        ax.plot(x, own["q50"], "_", color="white", markersize=5, markeredgewidth=1.2, zorder=5)
    own = table[table["predictor"] == table["predictor"].iloc[-1]]  # baselines have every row
    x = own["row"].map(place).to_numpy(np.float64)
    ax.hlines(own["observed"], x - 0.4, x + 0.4, color=DATA, linewidth=0.8, zorder=4)
    ax.plot(x, own["observed"], "o", color=DATA, markersize=3.6, zorder=6)
    _ground(ax, own, place)
    _limit(ax, table)
    ax.set(ylabel=label(CHANNELS[channel]), xlim=(-0.7, max(place.values()) + 0.7))
    return ax


def _places(table: pd.DataFrame) -> dict[int, float]:
    """Where every row stands: rows of a level side by side, a gap between levels, ascending slip."""
    rows = table.drop_duplicates("row").sort_values("slip", kind="stable")
    order = {level: i for i, level in enumerate(rows["level"].unique())}
    rows = rows.sort_values("level", key=lambda names: names.map(order), kind="stable")
    gaps = (rows["level"] != rows["level"].shift()).cumsum() - 1
    return dict(zip(rows["row"], (np.arange(len(rows)) + 0.6 * gaps).astype(float), strict=True))


def _ground(ax: Axes, rows: pd.DataFrame, place: dict[int, float]) -> None:
    """Names of the levels, and grey where they are extrapolated."""
    ticks, names = [], []
    for name, own in rows.groupby("level", sort=False):
        at = own["row"].map(place)
        ticks.append(float(at.mean()))
        names.append(str(name).removeprefix("slip "))
        if own["extrapolated"].any():
            ax.axvspan(at.min() - 0.7, at.max() + 0.7, color=GRID, alpha=0.45, linewidth=0, zorder=0)
    turned: dict[str, Any] = {"rotation": 45, "ha": "right"} if max(map(len, names)) > 8 else {}
    ax.set_xticks(ticks, [literal(str(name)) for name in names], **turned)


def _limit(ax: Axes, table: pd.DataFrame) -> None:
    """Keep readings and most bars in view; wild baselines may leave it."""
    seen = table[table["predictor"] != "mean"]
    known = np.concatenate([seen["observed"], seen["q25"].dropna(), seen["q75"].dropna()])
    reach = float(np.ptp(known)) or 1.0
    low, high = table["observed"].min() - 0.6 * reach, table["observed"].max() + 0.6 * reach
    drawn = np.concatenate([seen["q05"].dropna(), seen["q95"].dropna(), seen["observed"]])
    low, high = max(low, drawn.min()), min(high, drawn.max())
    ax.set_ylim(low - 0.06 * (high - low), high + 0.06 * (high - low))


@styled
def all_left_out(table: pd.DataFrame) -> FloatArray:
    """Draw :func:`left_out` for every channel, one below the other; returns the axes."""
    names = channels(table)
    figure = new_figure(7.2, 2.4 * len(names) + 0.6)
    axes = np.asarray(figure.subplots(len(names), 1, squeeze=False)).ravel()
    for ax, name in zip(axes, names, strict=True):
        left_out(table, name, ax)
    slips = table["level"].str.startswith("slip ").all()
    axes[-1].set_xlabel("left out: slip level $s$ [–]" if slips else "left out")
    entries: list[Patch | Line2D] = [
        Line2D([], [], color=colour, linewidth=5, label=name) for name, colour in _colours(table).items()
    ]
    entries.append(Line2D([], [], color=DATA, marker="o", markersize=3.6, linewidth=0.8, label="reading"))
    if table["extrapolated"].any():
        entries.append(Patch(color=GRID, alpha=0.6, label="extrapolated"))
    figure.legend(handles=entries, loc="outside lower center", ncols=len(entries), labelcolor=INK)
    return axes


@styled
def bands_without(found: Holdout) -> FloatArray:
    """Draw, for every channel (rows) and level (columns, 12 at most), the model fitted without the level.

    Line and band: median and 90 % of the readings that the fit expects over slip, at the median load. Dots:
    the training rows; rings: the rows that were left out.
    """
    names = channels(found.table)
    shown = [i for i, outcome in enumerate(found.outcomes) if outcome.bands][:MOST]
    figure = new_figure(max(1.75 * len(shown), 3.0) + 0.5, 1.75 * len(names) + 0.5)
    axes = np.asarray(
        figure.subplots(len(names), max(len(shown), 1), squeeze=False, sharex=True, sharey="row")
    )
    for column, i in enumerate(shown):
        for row, name in enumerate(names):
            _without(axes[row, column], found, i, name)
        axes[0, column].set_title(f"without {literal(found.levels[i].name)}", fontsize=8.5)
    for row, name in enumerate(names):
        axes[row, 0].set_ylabel(label(CHANNELS[name]))
    figure.supxlabel("slip ratio $s$ [–]", fontsize=9, color=INK)
    return axes


def _without(ax: Axes, found: Holdout, number: int, channel: str) -> None:
    rows, level, scale = found.study.observations, found.levels[number], CHANNELS[channel].scale
    wheel = rows.wheel[int(np.argmax(level.left))]
    band = next(b for b in found.outcomes[number].bands if (b.wheel, b.channel) == (wheel, channel))
    _band(ax, band)
    mine = np.array([name == wheel for name in rows.wheel])
    values = rows.values[channel] / scale
    for chosen, face in ((rows.use & ~level.left & mine, DATA), (level.left, "white")):
        style: dict[str, Any] = {"color": DATA, "markerfacecolor": face, "markersize": 3.5, "zorder": 6}
        ax.plot(rows.slip[chosen], values[chosen], "o", **style)


def _band(ax: Axes, band: Band) -> None:
    ax.fill_between(band.slip, band.low, band.high, color=POSTERIOR, alpha=0.25, linewidth=0)
    ax.plot(band.slip, band.middle, color=POSTERIOR)


@styled
def left_out_png(table: pd.DataFrame, dpi: float = 200) -> bytes:
    """The drawing of :func:`all_left_out` as PNG on white, the same bytes each time."""
    return _png(figure_of(all_left_out(table)), dpi)


@styled
def bands_png(found: Holdout, dpi: float = 200) -> bytes:
    """The drawing of :func:`bands_without` as PNG on white, the same bytes each time."""
    return _png(figure_of(bands_without(found)), dpi)


def _png(figure: Figure, dpi: float) -> bytes:
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, facecolor="white", metadata={"Software": None})
    return buffer.getvalue()
