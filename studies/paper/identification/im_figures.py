"""The two figures of the study."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from paper_data import NAMES, printed

from bayesterra.report.figures import DATA, GRID, MARKS, POSTERIOR, PRIOR, new_figure, styled

LABELS = {
    "Ks": r"$K_\mathrm{s}$ [kPa/m$^N$]", "n0": r"$n_0$", "n1": r"$n_1$", "c": r"$c$ [kPa]",
    "phi": r"$\varphi$ [deg]", "K": r"$K$ [mm]", "c1": r"$c_1$", "c2": r"$c_2$",
}  # fmt: skip
FREE = NAMES[1:]
SHOWN = ("Wh31", "Wh22", "HIT")
LINES = {"Wh31": (POSTERIOR, "Wh31, simulated"), "Wh22": (MARKS["IM2"].colour, "Wh22, simulated"),
         "HIT": (MARKS["IM1"].colour, "Wh32, HIT, digitised")}  # fmt: skip
MODELS = {"M1": POSTERIOR, "M2": MARKS["IM2"].colour, "M3": MARKS["IM3"].colour}


@styled
def convergence(paths: pd.DataFrame) -> Figure:
    """Parameters of IM1 after every pass; a ring where δ = 0.002 stops, dashes at the truth."""
    figure = new_figure(9.2, 4.6)
    panels = figure.subplots(2, 4, sharex=True).ravel()
    for ax, name in zip(panels, FREE, strict=False):
        for data in SHOWN:
            colour, label = LINES[data]
            steps = paths[paths["data"] == data].reset_index(drop=True)
            moved = steps[["c1", "c2"]].diff().abs().max(axis=1).to_numpy()
            stop = int(np.argmax(moved < 0.002))
            ax.plot(steps["pass"], steps[name], color=colour, label=label)
            ax.plot(steps["pass"][stop], steps[name][stop], "o", mfc="white", mec=colour, ms=6)
            if data != "HIT":
                ax.axhline(float(printed(10).loc[data, name]), color=colour, lw=0.8, ls=(0, (4, 3)))
        ax.set_ylabel(LABELS[name])
        ax.set_xlabel("pass of IM1")
    handles = panels[0].get_legend_handles_labels()
    panels[-1].axis("off")
    panels[-1].legend(*handles, loc="center", title="ring: stop with δ = 0.002\ndashes: truth")
    return figure


@styled
def beside(posteriors: pd.DataFrame, fits: pd.DataFrame) -> Figure:
    """HIT, load drive, K_s held: central 90 % and median of M1, M2 and M3 with the point estimates."""
    chosen = posteriors.query("data == 'HIT' and drive == 'load' and Ks_held")
    points = fits.query("data == 'HIT' and Ks_held").set_index("method")
    tables = {"Table 10": printed(10).loc["Wh32"], "Table 14": printed(14).loc["Wh32"]}
    figure = new_figure(9.2, 4.4)
    panels = figure.subplots(2, 4).ravel()
    for ax, name in zip(panels, FREE, strict=False):
        ax.set_xlabel(LABELS[name])
        for y, (model, colour) in enumerate(MODELS.items()):
            row = chosen[(chosen["model"] == model) & (chosen["parameter"] == name)].iloc[0]
            ax.hlines(y, row["low"], row["high"], color=colour, lw=5, alpha=0.45)
            ax.plot(row["median"], y, "|", color=colour, ms=12, mew=2)
        for y, method in enumerate(("IM1", "IM2", "IM3")):
            mark = MARKS[method]
            ax.plot(points.loc[method, name], y, mark.marker, color=mark.colour, ms=6, label=method, zorder=3)
        for y, (label, values) in zip((0, 2), tables.items(), strict=True):
            shape = "o" if label == "Table 10" else "s"
            ax.plot(values[name], y + 0.3, shape, mfc="none", mec=DATA, ms=5, label=f"{label}, printed")
        ax.set_yticks(range(3), MODELS)
        ax.set_ylim(2.6, -0.5)
        ax.grid(axis="x", color=GRID, lw=0.6)
    handles = panels[0].get_legend_handles_labels()
    panels[-1].axis("off")
    panels[-1].hlines([], [], [], color=PRIOR, lw=5, alpha=0.45)
    panels[-1].legend(*handles, loc="center", title="bars: central 90 %,\nticks: medians")
    return figure
