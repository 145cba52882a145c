"""What every candidate drive is expected to tell, against its slip."""

from __future__ import annotations

from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from bayesterra.design.candidates import Candidate
from bayesterra.design.choosing import BIT, Design
from bayesterra.figures.style import DATA, GRID, figure_of, literal, own_axes, styled

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
DASHES: tuple[tuple[float, ...], ...] = ((), (5.0, 2.0), (1.5, 1.5))


@styled
def gain_over_slip(design: Design, ax: Axes | None = None) -> Axes:
    """Draw the gain about the parameters of interest, bits, with a band of two Monte Carlo errors.

    One line for every wheel, load and set of channels; level, the study's rows driven again with new sensors.
    Rings: the rows that are recommended. Grey ground: slips that were not driven.
    """
    ax = own_axes(ax, 6.4, 3.4)
    lines: dict[str, list[int]] = {}
    for index, candidate in enumerate(design.candidates):
        lines.setdefault(_line(design, candidate), []).append(index)
    for number, (label, members) in enumerate(lines.items()):
        style: dict[str, Any] = {"color": COLOURS[number % 6], "dashes": DASHES[number // 6 % 3]}
        _draw(ax, design, members, label, style)
    _ground(ax, design)
    _rings(ax, design)
    ax.set(xlabel="slip ratio $s$ [–]", ylabel="expected information [bit]", ylim=(0, None))
    if len(lines) > 1:
        figure_of(ax).legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return ax


@styled
def gain_over_slip_png(design: Design, dpi: float = 200) -> bytes:
    """The drawing of :func:`gain_over_slip` as PNG on white, the same bytes each time."""
    buffer = BytesIO()
    figure = figure_of(gain_over_slip(design))
    figure.savefig(buffer, format="png", dpi=dpi, facecolor="white", metadata={"Software": None})
    return buffer.getvalue()


def _line(design: Design, candidate: Candidate) -> str:
    """What tells a line from the others."""
    if candidate.repeats:
        return f"all rows again, only {_channels(candidate)}"
    others = [one for one in design.candidates if not one.repeats]
    parts = [f"wheel {literal(candidate.wheel[0])}"] if len({one.wheel for one in others}) > 1 else []
    parts += [f"{candidate.load[0]:.4g} N"] if len({float(one.load[0]) for one in others}) > 1 else []
    parts += [_channels(candidate)] if len({one.channels for one in others}) > 1 else []
    return ", ".join(parts)


def _channels(candidate: Candidate) -> str:
    return ", ".join(name.replace("_", " ") for name in candidate.channels)


def _draw(ax: Axes, design: Design, members: list[int], label: str, style: dict[str, Any]) -> None:
    gain = np.array([design.ranking.estimates[i].values[0] for i in members]) / BIT
    error = 2 * np.array([design.ranking.estimates[i].errors[0] for i in members]) / BIT
    slip = np.array([design.candidates[i].slip[0] for i in members])
    if design.candidates[members[0]].repeats:
        ends = np.array([float(one.slip[0]) for one in design.candidates if not one.repeats])
        slip, gain, error = np.array([ends.min(), ends.max()]), np.repeat(gain, 2), np.repeat(error, 2)
    marker = "o" if len(slip) < 3 or np.isnan(gain).any() else ""
    ax.fill_between(slip, gain - error, gain + error, color=style["color"], alpha=0.2, linewidth=0)
    ax.plot(slip, gain, label=label, marker=marker, markersize=3.5, **style)


def _ground(ax: Axes, design: Design) -> None:
    driven = design.situation.study.observations.used().slip
    low, high = ax.get_xlim()
    for first, last in ((low, driven.min()), (driven.max(), high)):
        if last > first:
            ax.axvspan(first, last, color=GRID, alpha=0.45, linewidth=0, zorder=0)
    ax.set_xlim(low, high)


def _rings(ax: Axes, design: Design) -> None:
    for index in dict.fromkeys(design.picks):
        candidate = design.candidates[index]
        if candidate.repeats:
            continue
        height = design.ranking.estimates[index].values[0] / BIT
        ax.plot(
            candidate.slip[0], height, "o", markersize=9, fillstyle="none", color=DATA, zorder=5,
            clip_on=False,
        )  # fmt: skip
        times = design.picks.count(index)
        if times > 1:
            ax.annotate(f"{times} ×", (candidate.slip[0], height), (-8, 2), textcoords="offset points",
                        ha="right", fontsize=8)  # fmt: skip
