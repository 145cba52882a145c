"""Figures of a result: corner plot, correlations, traces and ranks."""

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from itertools import combinations, combinations_with_replacement, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from contourpy import FillType, contour_generator
from matplotlib import path
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Bbox, TransformedBbox
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter, map_coordinates
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
PALE = "#8A8A8A2E"
GAP = 0.05
"""Between panels of the corner plot, in panels."""
TICK = 3.5 / 72
"""Length of a tick, inches."""


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
def corner(result: Result) -> Axes:
    """Draw all pairs of parameters in field units, each on a panel of one axes; returns these.

    Blue contours hold 50 and 90 % of the posterior, the grey area 99 % of the prior after the physical cut.
    Dashed line and plus: posterior mode. Marks: least squares and, hollow, published or true values.
    """
    names, size = result.names, 1.45 * len(result.names) + 0.6
    scale = np.array([PARAMETERS[name].scale for name in names])
    posterior, prior = spread_draws(result, CORNER_DRAWS) / scale, result.values("prior") / scale
    panels = _Panels(size, _limits(result, posterior))
    panels.frame([figures.label(PARAMETERS[name]) for name in names])
    _outlines(panels, prior, [(along.low, along.high) for along in (axis(result, name) for name in names)], _PRIOR)
    _outlines(panels, posterior, panels.limits, _POSTERIOR)
    _marginals(panels, result, prior, posterior)
    _points(panels, result, scale)
    _corner_legend(panels.ax, result)
    return panels.ax


class _Panels:
    """Squares of side 1 on and below the diagonal of one axes: axes for each would take most of the time."""

    def __init__(self, size: float, limits: list[tuple[float, float]]) -> None:
        count = len(limits)
        whole = count + GAP * (count - 1)
        self.limits, self.tick = limits, TICK / (0.91 * size) * whole
        figure = Figure(figsize=(size, size))
        FigureCanvasAgg(figure)
        self.ax = figure.add_axes((0.08, 0.08, 0.91, 0.91), xlim=(0, whole), ylim=(0, whole))
        self.ax.set_axis_off()

    def at(self, i: int, j: int, points: ArrayLike) -> FloatArray:
        """Points (2,) or (n, 2) of the panel in row i and column j, its lower left end (0, 0), on the axes."""
        return np.add(points, [(1 + GAP) * j, (1 + GAP) * (len(self.limits) - 1 - i)])

    def along(self, i: int, values: FloatArray | float) -> FloatArray:
        """Places of values of parameter i along a side of a panel, 0 to 1."""
        low, high = self.limits[i]
        return (np.asarray(values) - low) / (high - low)

    def add(self, i: int, j: int, lines: list[FloatArray], **look: Any) -> None:
        """Draw polygons (n, 2) in a panel's own coordinates, and nothing of them beyond it."""
        if lines:
            whole = path.Path.make_compound_path(*(path.Path(self.at(i, j, line)) for line in lines))
            patch = self.ax.add_artist(PathPatch(whole, **look))
            patch.set_clip_box(TransformedBbox(Bbox(self.at(i, j, [[0, 0], [1, 1]])), self.ax.transData))

    def frame(self, labels: list[str]) -> None:
        """Draw frames, ticks, and at the left and at the bottom numbers and labels."""
        last = len(labels) - 1
        ticks = [_ticks(*ends) for ends in self.limits]
        lines: list[FloatArray] = []
        for j, i in combinations_with_replacement(range(len(labels)), 2):
            lines.append(self.at(i, j, [[0, 1], [0, 0], [1, 0]]))
            lines += [self.at(i, j, [[x, 0], [x, -self.tick]]) for x in self.along(j, ticks[j])]
            if i != j:
                lines += [self.at(i, j, [[0, y], [-self.tick, y]]) for y in self.along(i, ticks[i])]
        self.ax.add_collection(LineCollection(lines, colors=figures.INK, linewidths=0.7, clip_on=False), autolim=False)
        for k, label in enumerate(labels):
            for value, x in zip(ticks[k], self.along(k, ticks[k]), strict=True):
                text = f"{value:g}".replace("-", "−")
                self._write(self.at(last, k, (x, -2 * self.tick)), text, fontsize=8, rotation=45, va="top")
                if k > 0:
                    self._write(self.at(k, 0, (-2 * self.tick, x)), text, fontsize=8, rotation=45, ha="right")
            self._write(self.at(last, k, (0.5, -0.35)), label, va="top")
            if k > 0:
                self._write(self.at(k, 0, (-0.35, 0.5)), label, rotation=90, ha="right")

    def _write(self, at: FloatArray, text: str, **look: Any) -> None:
        x, y = at
        self.ax.text(x, y, text, **{"ha": "center", "va": "center", **look})


def _ticks(low: float, high: float) -> FloatArray:
    """Round numbers within a range, four or so, none close to its lower end."""
    values = np.asarray(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10], prune="lower").tick_values(low, high))
    return values[(values >= low + 0.06 * (high - low)) & (values <= high)]  # the neighbour has a number at the end


@dataclass(frozen=True)
class _Panel:
    """What stands for the axes of a pair where corner draws contours."""

    panels: _Panels
    i: int
    j: int
    places: FloatArray  # of the draws (2, n)
    shares: tuple[float, ...]  # of them that outlines hold

    def levels(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Densities above which these shares lie: corner's are of whole bins, and of draws that are smoothed."""
        at = (self.places[1] - y[0]) / (y[1] - y[0]), (self.places[0] - x[0]) / (x[1] - x[0])
        return np.asarray(np.quantile(map_coordinates(z, at, order=1), 1 - np.array(self.shares)))

    def get_facecolor(self) -> str:
        return "none"

    def set_xlim(self, _: object) -> None:
        """Nothing: the panels have their limits."""

    set_ylim = set_xscale = set_yscale = set_xlim

    def contour(
        self, x: FloatArray, y: FloatArray, z: FloatArray, levels: FloatArray, *, colors: str, **look: Any
    ) -> None:
        found: Any = contour_generator(x, y, z)
        lines = [line for level in self.levels(x, y, z) for line in found.lines(level)]
        self.panels.add(self.i, self.j, lines, fill=False, ec=colors, **look)

    def contourf(
        self, x: FloatArray, y: FloatArray, z: FloatArray, levels: FloatArray, *, colors: str = "", **_: Any
    ) -> None:
        if colors:  # else it would hide points, of which there are none
            contours: Any = contour_generator(x, y, z, fill_type=FillType.OuterOffset)
            found = contours.filled(self.levels(x, y, z)[0], levels[-1])
            areas = [points[start:end] for points, ends in zip(*found, strict=True) for start, end in pairwise(ends)]
            self.panels.add(self.i, self.j, areas, fc=colors, lw=0.0)


_PRIOR = {
    "bins": PRIOR_BINS, "smooth": 3.0, "levels": (PRIOR_MASS,), "fill_contours": True, "color": figures.PRIOR,
    "contour_kwargs": {"alpha": 0.4, "linewidth": 0.7}, "contourf_kwargs": {"colors": PALE},
}  # fmt: skip
"""On the prior's whole range, so that the area holds the mass it says, smoothed over three bins of 30."""
_POSTERIOR = {
    "bins": CORNER_BINS, "smooth": 1.2, "levels": figures.PROBABILITIES, "no_fill_contours": True,
    "color": figures.POSTERIOR, "contour_kwargs": {"linewidth": 1.3},
}  # fmt: skip


def _outlines(
    panels: _Panels, draws: FloatArray, ranges: list[tuple[float, float]], settings: Mapping[str, Any]
) -> None:
    """Contours of all pairs, of draws on these ranges."""
    at = [panels.along(i, column) for i, column in enumerate(draws.T)]
    ends = [tuple(panels.along(i, np.array(pair))) for i, pair in enumerate(ranges)]
    bare: dict[str, Any] = {"plot_datapoints": False, "plot_density": False}
    for j, i in combinations(range(len(ranges)), 2):
        panel = _Panel(panels, i, j, np.stack([at[j], at[i]]), settings["levels"])
        _hist2d()(at[j], at[i], range=(ends[j], ends[i]), ax=panel, **bare, **settings)


def _marginals(panels: _Panels, result: Result, prior: FloatArray, posterior: FloatArray) -> None:
    """Smoothed histograms on the diagonal, and the mode."""
    rows = summary_rows(result)
    for i, name in enumerate(result.names):
        along = axis(result, name)
        grey = _marginal(prior[:, i], (along.low, along.high), PRIOR_BINS, 2.0)
        blue = _marginal(posterior[:, i], panels.limits[i], CORNER_BINS, 1.0)
        top = 1.12 * max(grey[0].max(), blue[0].max())
        for (heights, edges), look in ((grey, {"ec": figures.PRIOR, "alpha": 0.6}), (blue, {"ec": figures.POSTERIOR})):
            steps = np.repeat(panels.along(i, edges), 2)[1:-1], np.repeat(heights / top, 2)
            panels.add(i, i, [np.column_stack(steps)], fill=False, linewidth=1.0, **look)
        x = float(panels.along(i, rows[name].mode))
        panels.add(i, i, [np.array([[x, 0], [x, 1]])], fill=False, ec=figures.POSTERIOR, lw=0.9, ls=(0, (4, 2)))


def _marginal(draws: FloatArray, ends: tuple[float, float], count: int, smooth: float) -> tuple[FloatArray, FloatArray]:
    """Histogram of one column, smoothed, its area one, and the edges of its bins."""
    counts, edges = np.histogram(draws, count, ends)
    heights = gaussian_filter(counts.astype(np.float64), smooth)
    return heights / heights.sum() * count / (ends[1] - ends[0]), edges


def _limits(result: Result, draws: FloatArray) -> list[tuple[float, float]]:
    """Ranges that hold 99.8 % of the draws and the point estimates that lie inside the prior's range."""
    rows, limits = summary_rows(result), []
    for i, name in enumerate(result.names):
        along = axis(result, name)
        others = [v[name] / PARAMETERS[name].scale for v in estimates(result).values() if name in v]
        values = np.array([*np.quantile(draws[:, i], [0.001, 0.999]), rows[name].mode, *others])
        low, high = values.min(), values.max()
        margin = 0.04 * (high - low)
        limits.append((float(max(low - margin, along.low)), float(min(high + margin, along.high))))
    return limits


def _points(panels: _Panels, result: Result, scale: FloatArray) -> None:
    rows = summary_rows(result)
    mode = np.array([rows[name].mode for name in result.names])
    _mark(panels, mode, marker="P", color=figures.POSTERIOR, markersize=6.5, markeredgecolor="white")
    for method, values in estimates(result).items():
        mark, at = figures.MARKS[method], np.array([values.get(name, np.nan) for name in result.names]) / scale
        face = "none" if mark.hollow else mark.colour
        _mark(panels, at, marker=mark.marker, color=mark.colour, markersize=4.5, markerfacecolor=face)


def _mark(panels: _Panels, values: FloatArray, **look: Any) -> None:
    """Mark a set of values (d,) on all panels that it lies on."""
    along = np.array([panels.along(i, value) for i, value in enumerate(values)])
    pairs = [(j, i) for j, i in combinations(range(len(values)), 2) if (np.abs(along[[j, i]] - 0.5) <= 0.5).all()]
    places = [panels.at(i, j, along[[j, i]]) for j, i in pairs]
    if places:
        panels.ax.plot(*np.transpose(places), linestyle="none", clip_on=False, **look)


def _corner_legend(ax: Axes, result: Result) -> None:
    entries: list[Line2D | Patch] = [
        Line2D([], [], color=figures.POSTERIOR, label="posterior: 50 and 90 %"),
        Patch(facecolor=PALE, edgecolor=figures.PRIOR, label=f"prior: {100 * PRIOR_MASS:.0f} %"),
        Line2D([], [], color=figures.POSTERIOR, marker="P", linestyle="none", label="mode"),
    ]
    entries += map(figures.mark_key, estimates(result))
    ax.legend(handles=entries, loc="upper right", fontsize=12)


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
TRACE_STEPS = 400
"""Steps of a trace, at most: two to a dot."""
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
    """Steps, evenly spaced, and 5, 50 and 95 % over the walkers of every ensemble at each, (ensembles, 3, steps)."""
    sampled = result.draws["sample_stats"]
    steps = np.unique(sampled["step"].to_numpy())
    every = slice(None, None, -(-len(steps) // TRACE_STEPS))
    if name == "lp":
        values = sampled["lp"].to_numpy()
    else:
        values = field_values(name, result.draws["posterior"][name].to_numpy())
    walkers = values.reshape(len(values), -1, len(steps))[..., every]
    return steps[every], np.quantile(walkers, [0.05, 0.5, 0.95], axis=1).swapaxes(0, 1)


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
