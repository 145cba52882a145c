"""Figures of a result: corner plot, correlations, traces and ranks."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from functools import cache
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from scipy.ndimage import gaussian_filter
from scipy.stats import rankdata

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.checking.validation import estimates, spread_draws
from bayesterra.parameters import PARAMETERS, field_values
from bayesterra.report import figures
from bayesterra.study.page import axis
from bayesterra.study.result import Result, summary_rows

CORNER_DRAWS = 60_000
CORNER_BINS = 36
PRIOR_MASS = 0.99
PRIOR_BINS = 30
PALE = ("#FFFFFF00", "#8A8A8A2E")
GAP = 0.05
"""Between panels of the corner plot, in panels."""


@cache
def _hist2d() -> Callable[..., Any]:
    """``corner.hist2d`` by its file alone: the package around it imports all of ArviZ and more, of no use here."""
    package = find_spec("corner")
    home = Path(package.origin).with_name("core.py") if package and package.origin else Path()
    spec = spec_from_file_location("corner_core", home) if home.is_file() and "corner" not in sys.modules else None
    if spec is None or spec.loader is None:
        import corner as core
    else:
        core = module_from_spec(spec)
        spec.loader.exec_module(core)
    draw: Callable[..., Any] = core.hist2d
    return draw


@figures.styled
def corner(result: Result) -> FloatArray:
    """Draw all pairs of parameters in field units; returns the axes (d, d), none above the diagonal.

    Blue contours hold 50 and 90 % of the posterior, the grey area 99 % of the prior after the physical cut.
    Dashed line and plus: posterior mode. Marks: least squares and, hollow, published or true values.
    """
    names, size = result.names, 1.45 * len(result.names) + 0.6
    scale = np.array([PARAMETERS[name].scale for name in names])
    posterior, prior = spread_draws(result, CORNER_DRAWS) / scale, result.values("prior") / scale
    figure, limits = Figure(figsize=(size, size)), _limits(result, posterior)
    FigureCanvasAgg(figure)
    axes = _panels(figure, limits, [figures.label(PARAMETERS[name]) for name in names])
    _prior_layer(axes, prior, [(along.low, along.high) for along in (axis(result, name) for name in names)])
    _posterior_layer(axes, posterior, limits)
    _points(axes, result, scale)
    _corner_legend(figure, result)
    return axes


def _panels(figure: Figure, limits: list[tuple[float, float]], labels: list[str]) -> FloatArray:
    """Empty axes on and below the diagonal, with labels at the left and at the bottom."""
    count = len(limits)
    axes = np.full((count, count), None)
    side = 0.91 / (count + GAP * (count - 1))
    for i, j in zip(*np.tril_indices(count), strict=True):
        at = (0.08 + (1 + GAP) * j * side, 0.99 - (1 + GAP) * i * side - side)
        ax = axes[i, j] = figure.add_axes((*at, side, side), xlim=limits[j])
        ax.xaxis.set_major_locator(MaxNLocator(3, prune="lower"))
        ax.tick_params(labelrotation=45, labelbottom=i == count - 1, labelleft=j == 0)
        if i == count - 1:
            ax.set_xlabel(labels[j])
            ax.xaxis.set_label_coords(0.5, -0.35)
        if i == j:
            ax.set_yticks([])
            continue
        ax.set_ylim(limits[i])
        ax.yaxis.set_major_locator(MaxNLocator(3, prune="lower"))
        if j == 0:
            ax.set_ylabel(labels[i])
            ax.yaxis.set_label_coords(-0.35, 0.5)
    return axes


def _prior_layer(axes: FloatArray, draws: FloatArray, ranges: list[tuple[float, float]]) -> None:
    """Prior on its whole range, so that the area holds the mass it says, smoothed over three bins of 30."""
    for ax, x, y, pair in _pairs(axes, draws, ranges):
        _hist2d()(
            x, y, PRIOR_BINS, pair, ax=ax, smooth=3.0, levels=(PRIOR_MASS,), fill_contours=True, color=figures.PRIOR,
            contour_kwargs={"alpha": 0.4, "linewidths": 0.7}, contourf_kwargs={"colors": PALE}, **_BARE,
        )  # fmt: skip
    for ax, column, ends in zip(np.diagonal(axes), draws.T, ranges, strict=True):
        ax.stairs(*_marginal(column, ends, PRIOR_BINS, 2.0), color=figures.PRIOR, alpha=0.6, baseline=None)


def _posterior_layer(axes: FloatArray, draws: FloatArray, limits: list[tuple[float, float]]) -> None:
    for ax, x, y, pair in _pairs(axes, draws, limits):
        _hist2d()(
            x, y, CORNER_BINS, pair, ax=ax, smooth=1.2, levels=figures.PROBABILITIES, no_fill_contours=True,
            color=figures.POSTERIOR, **_BARE,
        )  # fmt: skip
    for ax, column, ends in zip(np.diagonal(axes), draws.T, limits, strict=True):
        heights, edges = _marginal(column, ends, CORNER_BINS, 1.0)
        ax.stairs(heights, edges, color=figures.POSTERIOR, baseline=None)
        ax.set_ylim(0, 1.12 * max(float(drawn.get_data().values.max()) for drawn in ax.patches))


_BARE = {"plot_datapoints": False, "plot_density": False}


def _pairs(
    axes: FloatArray, draws: FloatArray, ranges: list[tuple[float, float]]
) -> Iterator[tuple[Axes, FloatArray, FloatArray, tuple[tuple[float, float], tuple[float, float]]]]:
    """Panels below the diagonal, with the draws (n,) along both sides and the sides' ranges."""
    for i, j in zip(*np.tril_indices(len(axes), -1), strict=True):
        yield axes[i, j], draws[:, j], draws[:, i], (ranges[j], ranges[i])


def _marginal(draws: FloatArray, ends: tuple[float, float], count: int, smooth: float) -> tuple[FloatArray, FloatArray]:
    """Histogram of one column, smoothed, its area one, and the edges of its bins."""
    counts, edges = np.histogram(draws, count, ends)
    heights = gaussian_filter(counts.astype(np.float64), smooth)
    return heights / heights.sum() * count / (ends[1] - ends[0]), edges


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
            axes[i, i].axvline(rows[x].mode, color=figures.POSTERIOR, linewidth=0.9, linestyle=(0, (4, 2)))
            continue
        axes[i, j].plot(
            rows[x].mode, rows[y].mode, "P", color=figures.POSTERIOR, markersize=6.5, markeredgecolor="white"
        )
        for method, values in estimates(result).items():
            mark, at = figures.MARKS[method], {**nan, **values}
            axes[i, j].plot(
                at[x] / scale[j], at[y] / scale[i], mark.marker, color=mark.colour, markersize=4.5,
                markerfacecolor="none" if mark.hollow else mark.colour,
            )  # fmt: skip


def _corner_legend(figure: Figure, result: Result) -> None:
    entries: list[Line2D | Patch] = [
        Line2D([], [], color=figures.POSTERIOR, label="posterior: 50 and 90 %"),
        Patch(facecolor=PALE[1], edgecolor=figures.PRIOR, label=f"prior: {100 * PRIOR_MASS:.0f} %"),
        Line2D([], [], color=figures.POSTERIOR, marker="P", linestyle="none", label="mode"),
    ]
    entries += map(figures.mark_key, estimates(result))
    figure.legend(handles=entries, loc="upper right", bbox_to_anchor=(0.97, 0.97), fontsize=12)


@figures.styled
def correlations(result: Result, ax: Axes | None = None) -> Axes:
    """Draw the correlation of every pair of parameters, the paper's groups P_I, P_II and P_III boxed."""
    ax = figures.own_axes(ax, 5.0, 4.4)
    names, matrix = result.names, np.atleast_2d(np.corrcoef(result.values().T))
    shown = np.where(np.tri(len(names), k=-1, dtype=bool), matrix, np.nan)
    ax.pcolormesh(np.ma.masked_invalid(shown), cmap="PuOr_r", vmin=-1.6, vmax=1.6, edgecolors="none")
    for i, j in zip(*np.tril_indices(len(names), -1), strict=True):
        text = f"{round(matrix[i, j], 2) + 0.0:.2f}".replace("-", "−")
        ax.text(j + 0.5, i + 0.5, text, ha="center", va="center", fontsize=8)
    _group_boxes(ax, names)
    figures.name_cells(ax, names)
    return ax


def _group_boxes(ax: Axes, names: tuple[str, ...]) -> None:
    """Frame the pairs within each group of the paper."""
    groups = [PARAMETERS[name].group for name in names]
    for group in dict.fromkeys(g for g in groups if g):
        first, size = groups.index(group), groups.count(group)
        corners = np.array([[0, 0], [0, size], [size, size], [0, 0]]) + first
        ax.plot(corners[:, 0], corners[:, 1], color=figures.INK, linewidth=1.4)
        subscript = group.removeprefix("P_")
        ax.text(first + size / 2 + 0.12, first + size / 2 - 0.12, rf"$P_\mathrm{{{subscript}}}$",
                color=figures.DATA, fontsize=9, ha="left", va="bottom")  # fmt: skip


SHADES = ("#08306B", "#2171B5", "#6BAED6", "#41B6A6", "#7A7A7A", "#B8B8B8")
RANK_BINS = 20
COLUMNS = 5
"""Panels in a row where all parameters are drawn."""


@figures.styled
def trace(result: Result, name: str = "lp", ax: Axes | None = None) -> Axes:
    """Draw a parameter, or the log density ``lp``, over the steps of every ensemble.

    Lines: median and 5 and 95 % of the walkers, one shade per ensemble. Level bands that overlie each other
    show ensembles that agree.
    """
    ax = figures.own_axes(ax)
    steps, bands = _walker_bands(result, figures.one_of("name", name, ("lp", *result.names)))
    for i, band in enumerate(bands):
        shade = SHADES[i % len(SHADES)]
        ax.plot(steps, band[1], color=shade, linewidth=0.9)
        ax.plot(steps, band[[0, 2]].T, color=shade, linewidth=0.5, alpha=0.7)
    shown = "log density" if name == "lp" else figures.label(PARAMETERS[name])
    ax.set(xlabel="step", ylabel=shown, xlim=(steps[0], steps[-1]))
    return ax


def _walker_bands(result: Result, name: str) -> tuple[IntArray, FloatArray]:
    """Steps, and 5, 50 and 95 % over the walkers of every ensemble at each, (ensembles, 3, steps)."""
    sampled = result.draws["sample_stats"]
    steps = np.unique(sampled["step"].to_numpy())
    if name == "lp":
        values = sampled["lp"].to_numpy()
    else:
        values = field_values(name, result.draws["posterior"][name].to_numpy())
    walkers = values.reshape(len(values), -1, len(steps))
    return steps, np.quantile(walkers, [0.05, 0.5, 0.95], axis=1).swapaxes(0, 1)


@figures.styled
def traces(result: Result) -> FloatArray:
    """Draw the log density and all parameters as :func:`trace` does, side by side; returns their axes."""
    axes = figures.panels(1 + len(result.names), COLUMNS)
    for ax, name in zip(axes, ("lp", *result.names), strict=True):
        trace(result, name, ax)
    for ax in axes[:-COLUMNS]:
        ax.set_xlabel("")
    return axes


@figures.styled
def ranks(result: Result, name: str, ax: Axes | None = None) -> Axes:
    """Draw how the draws of every ensemble rank among all (Vehtari et al. 2021): flat where ensembles agree.

    Grey: where 95 % of the steps lie if they do, for the effective number of draws.
    """
    ax = figures.own_axes(ax)
    draws = result.draws["posterior"][figures.one_of("name", name, result.names)].to_numpy()
    order = rankdata(draws, axis=None).reshape(draws.shape) / draws.size
    edges = np.linspace(0, 1, RANK_BINS + 1)
    ess = summary_rows(result)[name].ess_bulk
    spread = 1.96 * np.sqrt((RANK_BINS - 1) * len(draws) / ess)
    ax.axhspan(1 - spread, 1 + spread, color=figures.PRIOR, alpha=0.2, linewidth=0)
    for i, chain in enumerate(order):
        heights = np.histogram(chain, edges)[0] * RANK_BINS / chain.size
        ax.stairs(heights, edges, color=SHADES[i % len(SHADES)], linewidth=1.0, baseline=None)
    ax.axhline(1, color=figures.INK, linewidth=0.5)
    reach = max(0.25, 2.5 * spread)
    ax.set(xlabel=f"rank of {figures.label(PARAMETERS[name], unit=False)} among all draws", ylabel="relative frequency")
    ax.set(xlim=(0, 1), ylim=(max(0.0, 1 - reach), 1 + reach))
    return ax


@figures.styled
def all_ranks(result: Result) -> FloatArray:
    """Draw all parameters as :func:`ranks` does, side by side on one scale; returns their axes."""
    axes = figures.panels(len(result.names), COLUMNS)
    for ax, name in zip(axes, result.names, strict=True):
        ranks(result, name, ax)
        ax.set(xlabel="", ylabel="", xticks=(0, 0.5, 1))
        ax.set_title(figures.label(PARAMETERS[name], unit=False), y=0.86)
    reach = max(ax.get_ylim()[1] for ax in axes)
    for i, ax in enumerate(axes):
        ax.set_ylim(max(0.0, 2 - reach), reach)
        if i % COLUMNS == 0:
            ax.set_ylabel("relative frequency")
    for ax in axes[-COLUMNS:]:
        ax.set_xlabel("rank among all draws")
    return axes
