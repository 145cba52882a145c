"""The figure of the main README: the c that IM1 returns against the c it starts from, beside the posterior."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

LOOKS = {
    "lsqcurvefit": ("#D55E00", "o", "IM1, the paper's solver (emulated)"),
    "converged": ("#0072B2", "s", "IM1, run to its minimum"),
}


def start_figure(starts: pd.DataFrame, posteriors: pd.DataFrame, true: float) -> Figure:
    """Ends of IM1 on noise-free readings of one wheel by start, with the 90 % of its posterior."""
    some = starts.query("data == 'Wh11' and parameter == 'c'")
    at = posteriors.query("data == 'Wh11' and model == 'M1' and drive == 'load' and parameter == 'c'").iloc[0]
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    axes = figure.subplots()
    axes.axhspan(at["low"], at["high"], color="#0072B2", alpha=0.14, linewidth=0)
    axes.axhline(at["median"], color="#0072B2", alpha=0.5, linewidth=1)
    axes.text(
        0.0165, at["high"] + 0.03, f"posterior: 90 % from {at['low']:.2f} to {at['high']:.1f} kPa, median"
        f" {at['median']:.2f}", va="bottom", color="#0072B2", fontsize=9,
    )  # fmt: skip
    line = np.geomspace(0.016, 3.0, 50)
    axes.plot(line, line, color="0.6", linewidth=1, linestyle=":")
    axes.text(1.55, 1.62, "end = start", color="0.45", fontsize=9, ha="right")
    for solver, (colour, marker, label) in LOOKS.items():
        ends = some[some["solver"] == solver].sort_values("start")
        axes.plot(ends["start"], ends["c"], marker=marker, color=colour, label=label, linewidth=1.2, markersize=5)
    own = some.query("solver == 'lsqcurvefit' and start == 0.2").iloc[0]
    axes.plot(own["start"], own["c"], marker="o", markersize=13, markerfacecolor="none", color="#D55E00")
    axes.annotate(
        "the paper's start, 0.2 kPa", (own["start"], own["c"]), (0.03, 0.55), color="#D55E00", fontsize=9,
        arrowprops={"arrowstyle": "-", "color": "#D55E00", "linewidth": 0.8},
    )  # fmt: skip
    axes.axhline(true, color="0.2", linewidth=0.8, linestyle="--")
    axes.text(4.4, true - 0.02, "truth", fontsize=9, ha="right", va="top", color="0.2")
    axes.set_xscale("log")
    axes.set(
        xlim=(0.016, 4.6), ylim=(-0.05, at["high"] + 0.45), xlabel="start value of c, kPa", ylabel="c returned, kPa"
    )
    axes.set_xticks([0.02, 0.05, 0.2, 1, 3], ["0.02", "0.05", "0.2", "1", "3"])
    axes.legend(frameon=False, loc="upper left", fontsize=9)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return figure
