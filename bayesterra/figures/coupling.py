"""How parameters and groups depend on each other, and what the data added: posterior beside cut prior."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from bayesterra.figures.style import DATA, GRID, INK, POSTERIOR, PRIOR, label, own_axes, styled
from bayesterra.identifiability.coupling import Coupling
from bayesterra.identifiability.information import Information
from bayesterra.identifiability.verdicts import DETERMINED, WEAK
from bayesterra.identifiability.wording import GROUP_WORDS as WORDS
from bayesterra.parameters import PARAMETERS


@styled
def coupling_map(found: Coupling, ax: Axes | None = None) -> Axes:
    """Draw normal-score correlations: posterior below the diagonal, cut prior above, the groups boxed.

    A star marks pairs in which nearest neighbours find more dependence, or less, than the correlation says.
    """
    count = len(found.names)
    ax = own_axes(ax, 0.52 * count + 1.2, 0.48 * count + 1.2)
    lower = np.tri(count, k=-1, dtype=bool)
    values = np.where(lower, found.copula, found.prior_copula)
    np.fill_diagonal(values, np.nan)
    ax.pcolormesh(np.ma.masked_invalid(values), cmap="PuOr_r", vmin=-1.6, vmax=1.6, edgecolors="none")
    starred = _starred(found)
    for i, j in zip(*np.nonzero(~np.eye(count, dtype=bool)), strict=True):
        text = _number(values[i, j]) + ("*" if lower[i, j] and {i, j} in starred else "")
        ax.text(j + 0.5, i + 0.5, text, ha="center", va="center", fontsize=7.5)
    ax.plot([0, count], [0, count], color=GRID, linewidth=0.7)
    _boxes(ax, found.groups)
    _name_cells(ax, found.names)
    ax.text(0.0, count + 0.12, "below: posterior", ha="left", va="top", fontsize=8, color=POSTERIOR)
    ax.text(count, count + 0.12, "above: prior after the cut", ha="right", va="top", fontsize=8, color=PRIOR)
    return ax


def _starred(found: Coupling) -> list[set[int]]:
    rows = found.pairs[found.pairs["disagree"].astype(bool)]
    places = {name: i for i, name in enumerate(found.names)}
    return [{places[a], places[b]} for a, b in zip(rows["first"], rows["second"], strict=True)]


def _number(value: float) -> str:
    return f"{round(value, 2) + 0.0:.2f}".replace("-", "−")


def _boxes(ax: Axes, groups: Mapping[str, Sequence[int]]) -> None:
    """Frame the pairs within each group of the paper."""
    for group, columns in groups.items():
        if list(columns) != list(range(columns[0], columns[0] + len(columns))):
            continue  # parameters that do not stand side by side
        corner, size = (columns[0], columns[0]), len(columns)
        ax.add_patch(Rectangle(corner, size, size, fill=False, edgecolor=INK, linewidth=1.3, clip_on=False))
        ax.text(columns[0] + 0.5, columns[0] + 0.5, _group(group), color=DATA, fontsize=9, ha="center",
                va="center", bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0})  # fmt: skip


def _name_cells(ax: Axes, names: Sequence[str]) -> None:
    ticks, labels = np.arange(len(names)) + 0.5, [label(PARAMETERS[name], unit=False) for name in names]
    ax.set(xticks=ticks, xticklabels=labels, yticks=ticks, yticklabels=labels, aspect="equal")
    ax.set(xlim=(-0.05, len(names) + 0.05), ylim=(len(names) + 0.05, -0.05))
    ax.tick_params(length=0, labelsize=10)
    ax.xaxis.tick_top()
    ax.spines[:].set_visible(False)


@styled
def group_coupling(found: Coupling, ax: Axes | None = None) -> Axes:
    """Draw the mutual information of every pair of groups: copula (bar), nearest neighbours (mark), prior."""
    table = found.between
    ax = own_axes(ax, 4.4, 0.5 * len(table) + 1.1)
    places = np.arange(len(table))[::-1]
    ax.barh(places + 0.14, table["information"], height=0.28, color=POSTERIOR, alpha=0.75)
    ax.barh(places - 0.14, table["prior_information"], height=0.28, color=PRIOR, alpha=0.75)
    ax.errorbar(
        table["nearest"], places + 0.14, xerr=table["nearest_error"], fmt="o", color=DATA, markersize=4,
        markerfacecolor="none",
    )  # fmt: skip
    names = [f"{WORDS[a]} –\n{WORDS[b]}" for a, b in zip(table["first"], table["second"], strict=True)]
    ax.set(yticks=places, yticklabels=names, xlabel="mutual information [nat]")
    ax.set_xlim(left=min(0.0, float(table["nearest"].min())) if len(table) else 0.0)
    ax.tick_params(axis="y", length=0, labelsize=9)
    near = Line2D(
        [], [], color=DATA, marker="o", markerfacecolor="none", linestyle="none", label="neighbours"
    )
    bars = [
        Patch(color=POSTERIOR, alpha=0.75, label="posterior"),
        Patch(color=PRIOR, alpha=0.75, label="prior after the cut"),
    ]
    ax.legend(handles=[*bars, near], loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    return ax


def _group(name: str) -> str:
    return rf"$P_\mathrm{{{name.removeprefix('P_')}}}$" if name.startswith("P_") else name


@styled
def contraction_bars(found: Information, ax: Axes | None = None) -> Axes:
    """Draw what the data contract of the cut prior, and what the cut has contracted of the stated one."""
    table = found.parameters
    ax = own_axes(ax, 4.6, 0.42 * len(table) + 1.1)
    places = np.arange(len(table))[::-1]
    bars = (
        ("contraction", 0.16, POSTERIOR, "data, of the prior after the cut"),
        ("cut_contraction", -0.16, PRIOR, "physical cut, of the stated prior"),
    )
    for column, shift, colour, said in bars:
        shares = np.clip(table[column].to_numpy(dtype=np.float64), 0.0, 1.0)
        ax.barh(places + shift, shares, height=0.32, color=colour, alpha=0.75, label=said)
    for limit in (WEAK, DETERMINED):
        ax.axvline(limit, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
    names = [label(PARAMETERS[name], unit=False) for name in table["parameter"]]
    ax.set(yticks=places, yticklabels=names, xlim=(0, 1), xlabel="contraction 1 − var(after) / var(before)")
    ax.tick_params(axis="y", length=0)
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=1)
    return ax
