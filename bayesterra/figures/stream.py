"""What is known of every parameter after each row of a stream."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from bayesterra.arrays import FloatArray
from bayesterra.figures.style import DATA, GRID, POSTERIOR, figure_of, label, new_figure, styled
from bayesterra.parameters import PARAMETERS, Parameter

ALARM = "#D55E00"
COLUMNS = 4


@styled
def bands_over_rows(updates: pd.DataFrame, truth: Mapping[str, float] | None = None) -> FloatArray:
    """Draw median and 90 % band of every parameter after each row; returns the array of axes.

    Of long streams the first fiftieth does not count for the limits of the axes.

    Dashed: the row at which the soil seems to have changed, where there was an alarm. Dotted: true values of
    simulated data.

    Parameters
    ----------
    updates : a table as ``updates.csv``; a column ``soil`` counts the soils of a stream that began anew.
    truth : SI values by parameter.
    """
    names = [name for name in PARAMETERS if _column(PARAMETERS[name], "q50") in updates.columns]
    lines = -(-len(names) // COLUMNS)
    figure = new_figure(8.0, 1.75 * lines + 0.35)
    axes = np.asarray(figure.subplots(lines, COLUMNS, sharex=True, squeeze=False))
    for ax, name in zip(axes.ravel(), names, strict=False):
        _band(ax, updates, PARAMETERS[name])
        if truth and name in truth:
            ax.axhline(truth[name] / PARAMETERS[name].scale, color=DATA, linewidth=1.0, linestyle=":")
        _alarms(ax, updates)
    for ax in axes.ravel()[len(names) :]:
        ax.set_visible(False)
    for index in range(len(names)):
        if index + COLUMNS >= len(names):
            axes.ravel()[index].set_xlabel("row")
            axes.ravel()[index].tick_params(labelbottom=True)
    _legend(axes, updates, with_truth=bool(truth))
    return axes


@styled
def bands_over_rows_png(
    updates: pd.DataFrame, truth: Mapping[str, float] | None = None, dpi: float = 150
) -> bytes:
    """The drawing of :func:`bands_over_rows` as PNG on white, the same bytes each time."""
    buffer = BytesIO()
    figure = figure_of(bands_over_rows(updates, truth))
    figure.savefig(buffer, format="png", dpi=dpi, facecolor="white", metadata={"Software": None})
    return buffer.getvalue()


def _column(parameter: Parameter, key: str) -> str:
    unit = "" if parameter.unit == "-" else f" [{parameter.unit}]"
    return f"{parameter.name}_{key}{unit}"


def _band(ax: Axes, updates: pd.DataFrame, parameter: Parameter) -> None:
    low, middle, high = (_column(parameter, key) for key in ("q05", "q50", "q95"))
    soils = updates["soil"] if "soil" in updates.columns else pd.Series(1, index=updates.index)
    for _, part in updates.groupby(soils.to_numpy()):
        ax.fill_between(part["row"], part[low], part[high], color=POSTERIOR, alpha=0.25, linewidth=0)
        ax.plot(part["row"], part[middle], color=POSTERIOR, marker="" if len(part) > 1 else ".")
    # the first rows of a long stream know so little that nothing later could be seen beside them
    settled = updates.iloc[len(updates) // 50 :]
    bottom, top = float(settled[low].min()), float(settled[high].max())
    margin = 0.05 * (top - bottom) or 1e-12
    ax.set_ylim(bottom - margin, top + margin)
    ax.set_ylabel(label(parameter))
    ax.xaxis.set_major_locator(MaxNLocator(4, integer=True))
    ax.grid(color=GRID, linewidth=0.4, alpha=0.6)


def _alarms(ax: Axes, updates: pd.DataFrame) -> None:
    for since in updates["alarm"].dropna() if "alarm" in updates.columns else ():
        ax.axvline(float(since), color=ALARM, linewidth=1.0, linestyle="--")


def _legend(axes: FloatArray, updates: pd.DataFrame, *, with_truth: bool) -> None:
    entries: list[Patch | Line2D] = [
        Line2D([], [], color=POSTERIOR, label="median"),
        Patch(color=POSTERIOR, alpha=0.25, label="90 % interval"),
    ]
    if with_truth:
        entries.append(Line2D([], [], color=DATA, linewidth=1.0, linestyle=":", label="true value"))
    if "alarm" in updates.columns and updates["alarm"].notna().any():
        entries.append(Line2D([], [], color=ALARM, linewidth=1.0, linestyle="--", label="soil changed"))
    figure_of(axes).legend(handles=entries, loc="outside lower center", ncols=len(entries))
