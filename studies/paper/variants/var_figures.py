"""The figure of the study."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from var_fits import CONSTANT, REFERENCE

from bayesterra.report.figures import DATA, GRID, MARKS, POSTERIOR, new_figure, styled

SHOWN = {"Wh11": "Wh11, simulated", "HIT": "Wh32, HIT, digitised"}
LINES = {REFERENCE: (POSTERIOR, r"$N = n_0 + n_1 s$"), CONSTANT: (MARKS["IM1"].colour, "constant $n$ (below 0)")}


@styled
def normal_forces(table: pd.DataFrame) -> Figure:
    """F_N of M2 over sinkage at slip 0.2, with what IM2 found in either variant, and the load of the test."""
    figure = new_figure(8.0, 3.2)
    panels = figure.subplots(1, 2, sharey=True)
    depths = [name for name in table if str(name).endswith(" mm")]
    z = np.array([float(str(name).split()[0]) for name in depths])
    for ax, (data, title) in zip(panels, SHOWN.items(), strict=True):
        for variant, (colour, label) in LINES.items():
            row = table[(table["data"] == data) & (table["variant"] == variant)].iloc[0]
            ax.plot(z, [float(row[name]) for name in depths], color=colour, marker="o", ms=4, label=label)
        ax.axhline(80, color=DATA, lw=0.8, ls=(0, (4, 3)), label="load, 80 N")
        ax.set_title(title)
        ax.set_xlabel("sinkage [mm]")
        ax.grid(color=GRID, lw=0.6)
    panels[0].set_ylabel(r"$F_\mathrm{N}$ at slip 0.2 [N]")
    panels[0].legend(loc="upper left")
    return figure
