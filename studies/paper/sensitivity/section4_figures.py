"""The two figures of the study."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesterra.arrays import FloatArray
from bayesterra.report.figures import DATA, GRID, MARKS, POSTERIOR, PRIOR, new_figure, styled

OUTCOMES = {"sinkage": "$z$", "drawbar_pull": r"$F_\mathrm{DP}$", "resistance_moment": r"$M_\mathrm{DR}$"}
GROUPS = {"P_I": r"$P_\mathrm{I}$", "P_II": r"$P_\mathrm{II}$", "P_III": r"$P_\mathrm{III}$"}
OFF = MARKS["IM1"].colour
SERIES = {
    "influence": ("share of squared influence about G1 (Table 9)", DATA),
    "near G1": ("total Sobol index, 20 % about G1", POSTERIOR),
    "planetary": ("total Sobol index, prior planetary", MARKS["IM2"].colour),
    "paper-box": ("total Sobol index, prior paper-box", OFF),
}


@styled
def errors(table: pd.DataFrame) -> Figure:
    """Printed errors of Tables 6 to 8 less ours, with where the printed ones must lie."""
    figure = new_figure(9.2, 5.4)
    panels = figure.subplots(1, 3, sharey=True)
    for ax, (outcome, symbol) in zip(panels, OUTCOMES.items(), strict=True):
        _errors_panel(ax, table[table["outcome"] == outcome])
        ax.set_xlabel(f"error (16) of {symbol}, printed less ours [points]")
    names = table["group"].unique()
    panels[0].set_yticks(np.arange(len(names)), names)
    panels[0].invert_yaxis()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def _errors_panel(ax: Axes, some: pd.DataFrame) -> None:
    rows = np.arange(len(some))
    low, high, printed = ((some[name] - some["ours"]).to_numpy() for name in ("low", "high", "printed"))
    ax.hlines(rows, low, high, color=GRID, lw=7, label="where the printed value must lie")
    ax.axvline(0, color=POSTERIOR, lw=1, label="ours, against G1's curve")
    off = (some["verdict"] == "differs").to_numpy()
    ax.plot(printed[~off], rows[~off], "o", mfc="none", mec=DATA, ms=5, label="printed, reproduced")
    ax.plot(printed[off], rows[off], "D", mfc="none", mec=OFF, mew=1.6, ms=5, label="printed, differs")
    for edge in some["table"].diff().to_numpy().nonzero()[0][1:]:
        ax.axhline(edge - 0.5, color=PRIOR, lw=0.6)


@styled
def indices(words: pd.DataFrame, sobol: pd.DataFrame) -> Figure:
    """Squared influences about G1 beside total Sobol indices, by outcome and parameter group."""
    figure = new_figure(9.2, 3.6)
    panels = figure.subplots(1, 3, sharey=True)
    for ax, (outcome, symbol) in zip(panels, OUTCOMES.items(), strict=True):
        local = words[words["outcome"] == outcome].set_index("parameter_group").loc[list(GROUPS)]
        _bars(ax, _shares(local, sobol[(sobol["outcome"] == outcome) & sobol["slip"].isna()]))
        printed = [word.replace(" ", "\n") for word in local["printed"]]
        labels = [f"{mark}\n{word}" for mark, word in zip(GROUPS.values(), printed, strict=True)]
        ax.set_xticks(np.arange(len(GROUPS)), labels)
        ax.set_title(symbol)
    panels[0].set_ylabel("share")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def _shares(local: pd.DataFrame, sobol: pd.DataFrame) -> dict[str, FloatArray]:
    """What each series says of the three parameter groups."""
    squares = local["influence"].to_numpy() ** 2
    shares = {"influence": squares / squares.sum()}
    for box, some in sobol.groupby("box"):
        shares[str(box)] = some.set_index("parameter_group")["total"].loc[list(GROUPS)].to_numpy()
    return shares


def _bars(ax: Axes, shares: dict[str, FloatArray]) -> None:
    for place, (name, (text, colour)) in enumerate(SERIES.items()):
        where = np.arange(len(GROUPS)) + 0.2 * (place - 1.5)
        ax.bar(where, shares[name], width=0.18, color=colour, label=text)
    ax.set_ylim(0, 1)
