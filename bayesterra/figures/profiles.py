"""Profiles of likelihood and posterior over the ranges of the prior."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesterra.arrays import FloatArray
from bayesterra.figures.style import GRID, INK, POSTERIOR, PRIOR, label, new_figure, styled
from bayesterra.identifiability.profiles import LEVELS, Profile, Profiles
from bayesterra.parameters import PARAMETERS

HIGHEST = 6.0
"""Upper end of the axis of 2 Δ log density."""
COLUMNS = 4
NARROW = 0.12
"""Share of the prior's range; intervals narrower than that are drawn on a part of it."""
LINES: dict[str, tuple[str, tuple[float, ...], float]] = {
    "likelihood": (INK, (5.0, 3.0), 1.2),
    "posterior": (POSTERIOR, (), 1.9),
}
"""Colour, dashes and width of the curves; the broken one lies on top, so that both show where they agree."""


@styled
def profile_panels(found: Profiles) -> FloatArray:
    """Draw one panel per parameter over its prior's range; returns the array of axes (d,).

    Blue: 2 Δ log posterior; broken: 2 Δ log likelihood; 0 is the best point of all. Dots: interval ends,
    where a curve crosses the 68 or 95 % line. Crosses: points that no descent solved. Grey bars: ends of the
    prior's range; grey areas: nothing is possible there. The title of a panel says its class, the
    likelihood's first where the two differ.
    """
    count = len(found.names)
    columns = min(COLUMNS, count)
    rows = -(-count // columns)
    figure = new_figure(2.35 * columns + 0.3, 2.15 * rows + 0.4)
    axes = np.atleast_1d(np.asarray(figure.subplots(rows, columns))).ravel()
    for i, name in enumerate(found.names):
        _panel(axes[i], found, name)
        axes[i].tick_params(labelleft=i % columns == 0)
        if i % columns == 0:
            axes[i].set_ylabel(r"2 $\Delta$ log density")
    for spare in axes[count:]:
        spare.remove()
    _legend(figure, found)
    return np.asarray(axes[:count])


def _panel(ax: Axes, found: Profiles, name: str) -> None:
    scale = PARAMETERS[name].scale
    ends = found.ranges[found.names.index(name)] / scale
    for percent, level in LEVELS.items():
        ax.axhline(level, color=GRID, linewidth=0.9)
        ax.annotate(
            f"{percent} %", (1.0, level), xycoords=("axes fraction", "data"), fontsize=6.5,
            ha="right", va="bottom", color=PRIOR,
        )  # fmt: skip
    for kind in found.found:
        _curve(ax, found.profile(name, kind), scale)
    window = _window(found, name) / scale
    margin = 0.03 * (window[1] - window[0])
    _bounds(ax, found.profile(name), ends, scale)
    part = (window[1] - window[0]) / (ends[1] - ends[0])
    note = "" if part > 0.99 else f", {100 * part:.2g} % of the range"
    ax.set(xlim=(window[0] - margin, window[1] + margin), ylim=(-0.15, HIGHEST))
    ax.set_xlabel(label(PARAMETERS[name]) + note, labelpad=2)
    ax.set_title(_title(found, name), fontsize=8.5)


def _curve(ax: Axes, profile: Profile, scale: float) -> None:
    colour, dashes, width = LINES[profile.kind]
    grid, height = _smooth(profile)
    style = (0, dashes) if dashes else "-"
    ax.plot(grid / scale, height, color=colour, linewidth=width, linestyle=style, zorder=3 if dashes else 2)
    lost = profile.values[profile.failed] / scale
    height = np.minimum(profile.rise[profile.failed], HIGHEST - 0.2)
    ax.plot(lost, height, "x", color=colour, markersize=4.0)
    for percent, level in LEVELS.items():
        ends = np.array(profile.crossings(percent)) / scale
        ax.plot(ends, [level, level], "o", color=colour, markersize=3.2)


def _smooth(profile: Profile) -> tuple[FloatArray, FloatArray]:
    """The curve between its points: the signed root of the rise is close to straight there."""
    usable = np.isfinite(profile.rise) & ~profile.failed
    values, root = profile.values[usable], np.sqrt(np.maximum(profile.rise[usable], 0.0))
    root = np.where(values < profile.best, -root, root)
    grid = np.unique(np.concatenate([values, np.linspace(values[0], values[-1], 400)]))
    return grid, np.interp(grid, values, root) ** 2


def _bounds(ax: Axes, profile: Profile, ends: FloatArray, scale: float) -> None:
    """Mark the ends of the prior's range, and what of it is impossible."""
    possible = profile.values[np.isfinite(profile.rise)][[0, -1]] / scale
    for end, reached in zip(ends, possible, strict=True):
        ax.axvline(end, color=PRIOR, linewidth=2.2, alpha=0.7)
        if abs(end - reached) > 1e-6 * (ends[1] - ends[0]):
            ax.axvspan(*sorted((end, reached)), color=PRIOR, alpha=0.18, linewidth=0)


def _window(found: Profiles, name: str) -> FloatArray:
    """The part of the axis that is drawn: the prior's range, or three intervals' widths if that is less."""
    ends = found.ranges[found.names.index(name)]
    intervals = np.array([found.profile(name, kind).interval(95) for kind in found.found])
    low, high = intervals[:, 0].min(), intervals[:, 1].max()
    if high - low > NARROW * (ends[1] - ends[0]):
        return np.asarray(ends)
    return np.asarray(np.clip([low - (high - low), high + (high - low)], *ends))


def _title(found: Profiles, name: str) -> str:
    shapes = dict.fromkeys(found.profile(name, kind).shape for kind in found.found)
    text = " / ".join(shapes)
    return text if len(text) < 28 else text.replace(" / ", " /\n")


def _legend(figure: Figure, found: Profiles) -> None:
    entries: list[Line2D | Patch] = []
    for kind in found.found:
        colour, dashes, width = LINES[kind]
        entries.append(
            Line2D(
                [], [], color=colour, linestyle=(0, dashes) if dashes else "-", linewidth=width, label=kind
            )
        )
    entries += [
        Line2D([], [], color=INK, marker="o", markersize=3.2, linestyle="none", label="end of an interval"),
        *_lost(found),
        Line2D([], [], color=PRIOR, linewidth=2.2, alpha=0.7, label="end of the prior's range"),
        Patch(color=PRIOR, alpha=0.18, linewidth=0, label="impossible"),
    ]
    figure.legend(handles=entries, loc="outside lower center", ncols=len(entries))


def _lost(found: Profiles) -> list[Line2D]:
    """The cross of points that failed, where there are any."""
    if not any(profile.failed.any() for each in found.found.values() for profile in each):
        return []
    return [Line2D([], [], color=INK, marker="x", markersize=4.0, linestyle="none", label="not solved")]


def profiles_in_words(found: Profiles) -> str:
    """What the panels show, for those who do not see them."""
    said = []
    for profile in found.found["likelihood"]:
        parameter = PARAMETERS[profile.name]
        low, high = (f"{end / parameter.scale:.3g}" for end in profile.interval(95))
        unit = "" if parameter.unit == "-" else f" {parameter.unit}"
        said.append(f"{parameter.symbol} {profile.shape}, 95 % from {low} to {high}{unit}")
    return "Likelihood profiles: " + "; ".join(said) + "."
