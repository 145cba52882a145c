"""Figures of a result: corner plot, correlations, traces and ranks."""

from __future__ import annotations

import corner as corner_library
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.stats import rankdata

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.checking.validation import estimates, spread_draws
from bayesterra.parameters import PARAMETERS, field_values
from bayesterra.report.figures import (
    DATA,
    INK,
    MARKS,
    POSTERIOR,
    PRIOR,
    PROBABILITIES,
    label,
    mark_key,
    name_cells,
    one_of,
    own_axes,
    styled,
)
from bayesterra.study.page import axis
from bayesterra.study.result import Result, summary_rows

CORNER_DRAWS = 60_000
PRIOR_MASS = 0.99
PALE = ("#FFFFFF00", "#8A8A8A2E")


@styled
def corner(result: Result) -> FloatArray:
    """Draw all pairs of parameters in field units; returns the axes (d, d).

    Blue contours hold 50 and 90 % of the posterior, the grey area 99 % of the prior after the physical cut.
    Dashed line and plus: posterior mode. Marks: least squares and, hollow, published or true values.
    """
    names, size = result.names, 1.45 * len(result.names) + 0.6
    scale = np.array([PARAMETERS[name].scale for name in names])
    posterior, prior = spread_draws(result, CORNER_DRAWS) / scale, result.values("prior") / scale
    figure, limits = Figure(figsize=(size, size)), _limits(result, posterior)
    labels = [label(PARAMETERS[name]) for name in names]
    ranges = [(along.low, along.high) for along in (axis(result, name) for name in names)]
    _prior_layer(figure, prior, ranges)
    _posterior_layer(figure, posterior, limits, labels)
    axes = np.asarray(figure.axes).reshape(len(names), len(names))
    _points(axes, result, scale)
    _tidy(axes, limits)
    _corner_legend(figure, result)
    return axes


_COMMON = {"plot_datapoints": False, "plot_density": False, "max_n_ticks": 3, "labelpad": 0.05}


def _prior_layer(figure: Figure, draws: FloatArray, ranges: list[tuple[float, float]]) -> None:
    """Prior on its whole range, so that the area holds the mass it says, smoothed over three bins of 30."""
    corner_library.corner(
        draws, fig=figure, range=ranges, bins=30, smooth=3.0, smooth1d=2.0, levels=(PRIOR_MASS,),
        fill_contours=True, color=PRIOR, **_COMMON,
        contour_kwargs={"alpha": 0.4, "linewidths": 0.7}, contourf_kwargs={"colors": PALE},
        hist_kwargs={"color": PRIOR, "alpha": 0.6},
    )  # fmt: skip


def _posterior_layer(figure: Figure, draws: FloatArray, limits: list[tuple[float, float]], labels: list[str]) -> None:
    corner_library.corner(
        draws, fig=figure, range=limits, bins=36, smooth=1.2, smooth1d=1.0, levels=PROBABILITIES,
        no_fill_contours=True, color=POSTERIOR, labels=labels, **_COMMON,
    )  # fmt: skip


def _limits(result: Result, draws: FloatArray) -> list[tuple[float, float]]:
    """Ranges that hold 99.8 % of the draws and the point estimates that lie inside the prior's range."""
    rows = summary_rows(result)
    limits = []
    for i, name in enumerate(result.names):
        along = axis(result, name)
        others = [v[name] / PARAMETERS[name].scale for v in estimates(result).values() if name in v]
        values = np.array([*np.quantile(draws[:, i], [0.001, 0.999]), rows[name].mode, *others])
        low, high = values.min(), values.max()
        margin = 0.04 * (high - low)
        limits.append((float(max(low - margin, along.low)), float(min(high + margin, along.high))))
    return limits


def _points(axes: FloatArray, result: Result, scale: FloatArray) -> None:
    rows = summary_rows(result)
    nan = dict.fromkeys(result.names, np.nan)
    for i, j in zip(*np.tril_indices(len(axes)), strict=True):
        x, y = result.names[j], result.names[i]
        if i == j:
            axes[i, i].axvline(rows[x].mode, color=POSTERIOR, linewidth=0.9, linestyle=(0, (4, 2)))
            continue
        axes[i, j].plot(rows[x].mode, rows[y].mode, "P", color=POSTERIOR, markersize=6.5, markeredgecolor="white")
        for method, values in estimates(result).items():
            mark, at = MARKS[method], {**nan, **values}
            axes[i, j].plot(
                at[x] / scale[j], at[y] / scale[i], mark.marker, color=mark.colour, markersize=4.5,
                markerfacecolor="none" if mark.hollow else mark.colour,
            )  # fmt: skip


def _tidy(axes: FloatArray, limits: list[tuple[float, float]]) -> None:
    """Give every panel its range, and the marginals, prior first, an area of one."""
    for i, j in zip(*np.tril_indices(len(axes)), strict=True):
        axes[i, j].set_xlim(limits[j])
        if i != j:
            axes[i, j].set_ylim(limits[i])
    for ax in np.diagonal(axes):
        curves = ax.get_lines()[:2]
        for curve in curves:
            curve.set_ydata(curve.get_ydata() / np.trapezoid(curve.get_ydata(), curve.get_xdata()))
        ax.set_ylim(0, 1.12 * max(curve.get_ydata().max() for curve in curves))
    axes[0, 0].figure.subplots_adjust(left=0.08, bottom=0.08, right=0.99, top=0.99)


def _corner_legend(figure: Figure, result: Result) -> None:
    entries: list[Line2D | Patch] = [
        Line2D([], [], color=POSTERIOR, label="posterior: 50 and 90 %"),
        Patch(facecolor=PALE[1], edgecolor=PRIOR, label=f"prior: {100 * PRIOR_MASS:.0f} %"),
        Line2D([], [], color=POSTERIOR, marker="P", linestyle="none", label="mode"),
    ]
    entries += map(mark_key, estimates(result))
    figure.legend(handles=entries, loc="upper right", bbox_to_anchor=(0.97, 0.97), fontsize=12)


@styled
def correlations(result: Result, ax: Axes | None = None) -> Axes:
    """Draw the correlation of every pair of parameters, the paper's groups P_I, P_II and P_III boxed."""
    ax = own_axes(ax, 5.0, 4.4)
    names, matrix = result.names, np.atleast_2d(np.corrcoef(result.values().T))
    shown = np.where(np.tri(len(names), k=-1, dtype=bool), matrix, np.nan)
    ax.pcolormesh(np.ma.masked_invalid(shown), cmap="PuOr_r", vmin=-1.6, vmax=1.6, edgecolors="none")
    for i, j in zip(*np.tril_indices(len(names), -1), strict=True):
        text = f"{round(matrix[i, j], 2) + 0.0:.2f}".replace("-", "−")
        ax.text(j + 0.5, i + 0.5, text, ha="center", va="center", fontsize=8)
    _group_boxes(ax, names)
    name_cells(ax, names)
    return ax


def _group_boxes(ax: Axes, names: tuple[str, ...]) -> None:
    """Frame the pairs within each group of the paper."""
    groups = [PARAMETERS[name].group for name in names]
    for group in dict.fromkeys(g for g in groups if g):
        first, size = groups.index(group), groups.count(group)
        corners = np.array([[0, 0], [0, size], [size, size], [0, 0]]) + first
        ax.plot(corners[:, 0], corners[:, 1], color=INK, linewidth=1.4)
        subscript = group.removeprefix("P_")
        ax.text(first + size / 2 + 0.12, first + size / 2 - 0.12, rf"$P_\mathrm{{{subscript}}}$",
                color=DATA, fontsize=9, ha="left", va="bottom")  # fmt: skip


SHADES = ("#08306B", "#2171B5", "#6BAED6", "#41B6A6", "#7A7A7A", "#B8B8B8")
RANK_BINS = 20


@styled
def trace(result: Result, name: str = "lp", ax: Axes | None = None) -> Axes:
    """Draw a parameter, or the log density ``lp``, over the steps of every ensemble.

    Lines: median and 5 and 95 % of the walkers, one shade per ensemble. Level bands that overlie each other
    show ensembles that agree.
    """
    ax = own_axes(ax)
    steps, bands = _bands(result, one_of("name", name, ("lp", *result.names)))
    for i, band in enumerate(bands):
        shade = SHADES[i % len(SHADES)]
        ax.plot(steps, band[1], color=shade, linewidth=0.9)
        ax.plot(steps, band[[0, 2]].T, color=shade, linewidth=0.5, alpha=0.7)
    shown = "log density" if name == "lp" else label(PARAMETERS[name])
    ax.set(xlabel="step", ylabel=shown, xlim=(steps[0], steps[-1]))
    return ax


def _bands(result: Result, name: str) -> tuple[IntArray, FloatArray]:
    """Steps, and 5, 50 and 95 % over the walkers of every ensemble at each, (ensembles, 3, steps)."""
    sampled = result.draws["sample_stats"]
    steps = np.unique(sampled["step"].to_numpy())
    if name == "lp":
        values = sampled["lp"].to_numpy()
    else:
        values = field_values(name, result.draws["posterior"][name].to_numpy())
    walkers = values.reshape(len(values), -1, len(steps))
    return steps, np.quantile(walkers, [0.05, 0.5, 0.95], axis=1).swapaxes(0, 1)


@styled
def ranks(result: Result, name: str, ax: Axes | None = None) -> Axes:
    """Draw how the draws of every ensemble rank among all (Vehtari et al. 2021): flat where ensembles agree.

    Grey: where 95 % of the steps lie if they do, for the effective number of draws.
    """
    ax = own_axes(ax)
    draws = result.draws["posterior"][one_of("name", name, result.names)].to_numpy()
    order = rankdata(draws, axis=None).reshape(draws.shape) / draws.size
    edges = np.linspace(0, 1, RANK_BINS + 1)
    ess = summary_rows(result)[name].ess_bulk
    spread = 1.96 * np.sqrt((RANK_BINS - 1) * len(draws) / ess)
    ax.axhspan(1 - spread, 1 + spread, color=PRIOR, alpha=0.2, linewidth=0)
    for i, chain in enumerate(order):
        heights = np.histogram(chain, edges)[0] * RANK_BINS / chain.size
        ax.stairs(heights, edges, color=SHADES[i % len(SHADES)], linewidth=1.0, baseline=None)
    ax.axhline(1, color=INK, linewidth=0.5)
    reach = max(0.25, 2.5 * spread)
    ax.set(xlabel=f"rank of {label(PARAMETERS[name], unit=False)} among all draws", ylabel="relative frequency")
    ax.set(xlim=(0, 1), ylim=(max(0.0, 1 - reach), 1 + reach))
    return ax
