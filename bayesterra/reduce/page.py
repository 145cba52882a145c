"""Reduced logs as a page, figures and lines on a terminal."""

from importlib.metadata import version

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from bayesterra.arrays import FloatArray
from bayesterra.errors import counted
from bayesterra.reduce.log import LOGGED, Log
from bayesterra.reduce.reduction import Branch, Reduction
from bayesterra.reduce.windows import Window
from bayesterra.report.blocks import Block, Blocks, Gallery, Overview, Table, Text, drawing
from bayesterra.report.figures import DATA, GRID, POSTERIOR, figure_of, literal, new_figure, styled
from bayesterra.report.sections import Prose, Section, VerdictPage

say = Prose("reduce")

REJECTED = "#B0B0B0"
SHOWN = ("travel_speed", "rim_speed", "slip", "load", "sinkage", "normal_force", "drawbar_pull", "resistance_moment")
MOST_POINTS = 4000
FEW_LOGS = 12
"""Logs whose pictures stand on the page; more would make it heavy."""


def reduced_page(reduction: Reduction) -> VerdictPage:
    """Put the page together."""
    kinds = list(dict.fromkeys(log.kind for log in reduction.logs))
    counts = counted(len(reduction.branches), "plate test"), counted(len(reduction.kept), "row")
    pictures = Section("pictures", "Pictures", _pictures(reduction))
    rows = Section("rows", "What was kept and what not", _outcome(reduction))
    return VerdictPage(
        title=f"Reduction of {', '.join(log.name for log in reduction.logs[:3])}{' …' * (len(reduction.logs) > 3)}",
        facts=(counted(len(reduction.logs), "log"), counts[0] if reduction.branches else counts[1]),
        verdicts=(),
        sections=(pictures, rows, Section("columns", "What was understood", _understood(reduction))),
        version=version("bayesterra"),
        warning=Markup(""),
        kind=" and ".join(kinds),
        template="reduced.html",
    )


def reduced_overview(reduction: Reduction) -> Overview:
    """The rows, what was rejected, and why."""
    kinds = {log.kind for log in reduction.logs} - {"measured"}
    return (*_outcome(reduction), *(Text(f"The data are {kind}.") for kind in sorted(kinds)))


def _outcome(reduction: Reduction) -> tuple[Table | Text, ...]:
    if reduction.branches:
        return tuple(Text(f"{branch.test}: {'; '.join(branch.notes)}.") for branch in reduction.branches)
    names = [name for name in ("slip", *SHOWN[3:]) if any(name in window.mean for window in reduction.kept)]
    units = (f"{LOGGED[name].symbol} [{LOGGED[name].unit}]".removesuffix(" [-]") for name in names)
    header = ("log", "from [s]", "to [s]", "periods", *units)
    rows = [
        (w.log, f"{w.start:.1f}", f"{w.end:.1f}", str(w.blocks), *(_with_sd(w, name) for name in names))
        for w in reduction.kept
    ]
    rejected = tuple((w.log, f"{w.start:.1f}", f"{w.end:.1f}", w.rejected) for w in reduction.windows if w.rejected)
    table = Table("Steady windows: mean ± standard error", "lrrr" + "r" * len(names), header, tuple(rows))
    refused = Table("Rejected", "lrrl", ("log", "from [s]", "to [s]", "why"), rejected)
    return (table, refused) if rejected else (table,)


def _with_sd(window: Window, name: str) -> str:
    if name not in window.mean:
        return ""
    mean, sd = window.mean[name] / LOGGED[name].scale, window.sd[name] / LOGGED[name].scale
    places = int(np.clip(1 - np.floor(np.log10(sd)), 0, 6)) if sd > 0 else 4
    return f"{mean:.{places}f} ± {sd:.{places}f}".replace("-", "−")


def _understood(reduction: Reduction) -> Blocks:
    blocks: list[Block] = []
    for log in reduction.logs:
        rows = tuple((each.header, each.name or "–", each.remark, each.readings) for each in log.headings)
        blocks.append(Table(f"{log.name} ({log.form}; {log.kind})", "llll", ("column", "is", "in", "readings"), rows))
        for name, (offset, sd) in log.zeros.items():
            unit, scale = LOGGED[name].unit, LOGGED[name].scale
            blocks.append(Text(say("understood", name, offset / scale, sd / scale, unit)))
    return tuple(blocks)


def _pictures(reduction: Reduction) -> Blocks:
    shown = []
    for log in reduction.logs[:FEW_LOGS]:
        windows = [window for window in reduction.windows if window.log == log.name]
        if windows:
            caption = "Blue: steady windows, with their means; grey: rejected stretches."
            shown.append(Gallery("whole", (drawing(drive_over_time(log, windows), f"{log.name} over time"),), caption))
    curves = tuple(drawing(branch_curve(b), f"{b.test}, loading branch") for b in reduction.branches[: 2 * FEW_LOGS])
    if curves:
        shown.append(Gallery("half", curves, "Grey: all samples; blue: loading branch; black: readings."))
    return tuple(shown)


@styled
def drive_over_time(log: Log, windows: list[Window]) -> FloatArray:
    """Draw the channels of a drive over time, a panel for each, with its windows; returns the array of axes."""
    names = [name for name in SHOWN if name in log.values]
    figure = new_figure(7.2, 1.15 * len(names) + 0.5)
    axes = np.asarray(figure.subplots(len(names), 1, sharex=True, squeeze=False)).ravel()
    time = log.values["time"]
    thin = slice(None, None, max(len(time) // MOST_POINTS, 1))
    for ax, name in zip(axes, names, strict=True):
        channel = LOGGED[name]
        ax.plot(time[thin], log.values[name][thin] / channel.scale, color=DATA, linewidth=0.4, rasterized=True)
        ax.set_ylabel(f"{channel.symbol} [{channel.unit}]")
        for window in windows:
            colour = REJECTED if window.rejected else POSTERIOR
            ax.axvspan(window.start, window.end, color=colour, alpha=0.2, linewidth=0)
            if name in window.mean:
                mean = window.mean[name] / channel.scale
                ax.plot([window.start, window.end], [mean, mean], color=POSTERIOR, linewidth=1.6)
        ax.set_ylim(*_limits(time, log.values[name] / channel.scale, windows))
    axes[-1].set_xlabel("time [s]")
    figure.suptitle(literal(f"{log.name}, {log.kind}"))
    return axes


def _limits(time: FloatArray, samples: FloatArray, windows: list[Window]) -> tuple[float, float]:
    """Limits of a panel: thrice the range within windows that give rows, else the range of all samples."""
    kept = [(time >= w.start) & (time <= w.end) for w in windows if not w.rejected]
    inside = samples[np.any(kept, axis=0)] if kept else samples
    low, high = np.quantile(inside[~np.isnan(inside)], [0.002, 0.998])
    margin = (1.0 if kept else 0.1) * (high - low) + 1e-9
    return float(low - margin), float(high + margin)


@styled
def branch_curve(branch: Branch) -> Axes:
    """Draw a plate test: all samples, the loading branch and its readings; returns the axes."""
    ax = new_figure(3.5, 2.5).subplots()
    name = next(name for name in (branch.stress, "normal_force", "load") if name in branch.log.values)
    channel, values = LOGGED[branch.stress], branch.log.values
    sinkage = (values["sinkage"] - branch.zero) * 1e3
    stress = (values[name] - branch.air) / channel.scale
    ax.plot(sinkage, stress, color=GRID, linewidth=0.8, rasterized=True)
    at = branch.loading
    ax.plot(sinkage[at], stress[at], ".", color=POSTERIOR, markersize=2, rasterized=True)
    ax.plot(branch.readings[:, 0] * 1e3, branch.readings[:, 1] / channel.scale, ".", color=DATA, markersize=3)
    ax.set(xlabel="sinkage from contact [mm]", ylabel=f"{branch.stress} [{channel.unit}]")
    figure_of(ax).suptitle(literal(f"{branch.test}, {branch.log.kind}"))
    return ax
