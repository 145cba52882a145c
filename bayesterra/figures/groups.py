"""Parameters of groups with a joint posterior: what they share, and each group's own beside the others'."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from bayesterra.arrays import FloatArray
from bayesterra.figures.style import DATA, MARKS, POSTERIOR, PRIOR, label, literal, new_figure, styled
from bayesterra.parameters import PARAMETERS
from bayesterra.pooled import PooledResult

WIDTH, ROW = 4.4, 0.34


@styled
def group_strip(result: PooledResult, name: str) -> Axes:
    """Draw one parameter for every group: 50 and 90 % intervals over the range of its prior.

    Grey bars: the group alone. Blue bars: all groups together. A shared parameter has one blue bar for all, a
    hierarchical one its population's mean too. Circle: the true or published value, where there is one.
    """
    joint, alone = result.draws["posterior"], result.draws["alone"]
    scale, groups = PARAMETERS[name].scale, list(result.groups)
    figure = new_figure(WIDTH, ROW * (len(groups) + 2) + 0.35)
    ax: Axes = figure.subplots()
    shared = "group" not in joint[name].dims
    for i, group in enumerate(groups):
        _bar(ax, alone[name].sel(group=group).to_numpy() / scale, i + 0.15, PRIOR)
        if not shared:
            _bar(ax, joint[name].sel(group=group).to_numpy().ravel() / scale, i - 0.15, POSTERIOR)
    rows = [*groups]
    if shared or f"{name}.mean" in joint:
        source = name if shared else f"{name}.mean"
        _bar(ax, joint[source].to_numpy().ravel() / scale, len(groups), POSTERIOR)
        rows.append("all groups" if shared else "population mean")
    known = result.study.truth or result.study.published
    if known is not None and name in known.values:
        mark = MARKS["truth"]
        ax.plot([known.values[name] / scale] * len(rows), np.arange(len(rows)), mark.marker, color=DATA,
                markerfacecolor="none", markersize=5, linestyle="none")  # fmt: skip
    names = [literal(row) for row in rows]
    ax.set(yticks=np.arange(len(rows)), yticklabels=names, ylim=(len(rows) - 0.4, -0.6))
    ax.set_xlim(*_limits(result, name))
    ax.set_xlabel(label(PARAMETERS[name]))
    ax.tick_params(axis="y", length=0)
    return ax


def _bar(ax: Axes, draws: FloatArray, at: float, colour: str) -> None:
    low, first, middle, third, high = np.quantile(draws, [0.05, 0.25, 0.5, 0.75, 0.95])
    ax.plot([low, high], [at, at], color=colour, linewidth=1.2, solid_capstyle="butt")
    ax.plot([first, third], [at, at], color=colour, linewidth=4.0, solid_capstyle="butt")
    ax.plot([middle], [at], "|", color=colour, markersize=9)


def _limits(result: PooledResult, name: str) -> tuple[float, float]:
    """The range of the prior, without the outer thousandth where it has no end."""
    law = result.study.prior.laws[name]
    tails = law.quantile(np.array([0.001, 0.999]))
    ends = [end if np.isfinite(end) else tail for end, tail in zip(law.range, tails, strict=True)]
    return ends[0] / PARAMETERS[name].scale, ends[1] / PARAMETERS[name].scale
