"""What the data added to the prior: contraction of parameters and of their combinations."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from bayesterra.arrays import FloatArray
from bayesterra.figures.rows import found_rows
from bayesterra.figures.style import GRID, INK, POSTERIOR, label, own_axes, styled
from bayesterra.identifiability import DETERMINED, WEAK, Identifiability, identifiability
from bayesterra.parameters import PARAMETERS
from bayesterra.results import Result


@styled
def contraction(result: Result, ax: Axes | None = None) -> Axes:
    """Draw 1 − posterior/prior variance of every parameter: 0 repeats the prior, 1 is known exactly."""
    ax = own_axes(ax, 4.4, 0.34 * len(result.names) + 0.9)
    found = dict(reversed(found_rows(result).items()))
    places = np.arange(len(found))
    values = np.clip([row.contraction for row in found.values()], 0.0, 1.0)
    ax.barh(places, values, height=0.55, color=POSTERIOR, alpha=0.75)
    for limit in (WEAK, DETERMINED):
        ax.axvline(limit, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
    names = [label(PARAMETERS[name], unit=False) for name in found]
    ax.set(
        yticks=places, yticklabels=names, xlim=(0, 1), xlabel="contraction 1 − var(posterior) / var(prior)"
    )
    ax.tick_params(axis="y", length=0)
    return ax


@styled
def combinations(result: Result, ax: Axes | None = None) -> Axes:
    """Draw the independent combinations of parameters, the best determined first, with their contraction.

    Cells: weight of each parameter, in units of its prior standard deviation, the largest of each
    combination ± 1.
    """
    ax = own_axes(ax, 5.4, 0.34 * len(result.names) + 1.0)
    found = _information(result)
    weights = _weights(found)
    ax.pcolormesh(weights, cmap="PuOr_r", vmin=-1.7, vmax=1.7, edgecolors=GRID, linewidth=0.4)
    for (i, j), value in np.ndenumerate(weights):
        if abs(value) >= 0.15:
            ax.text(j + 0.5, i + 0.5, f"{value:+.1f}".replace("-", "−"), ha="center", va="center", fontsize=7)
    places = np.arange(len(weights)) + 0.5
    names = [label(PARAMETERS[name], unit=False) for name in result.names]
    ax.set(xticks=places, xticklabels=names, yticks=places, yticklabels=[f"{c:.2f}" for c in _clipped(found)])
    ax.set(ylabel="contraction", ylim=(len(weights), 0))
    ax.tick_params(length=0)
    ax.xaxis.tick_top()
    ax.spines[:].set_visible(False)
    return ax


def _information(result: Result) -> Identifiability:
    laws = [result.study.prior.laws[name] for name in result.names]
    ranges, logs = [law.range for law in laws], np.array([law.logarithmic for law in laws])
    return identifiability(result.names, ranges, result.values("prior"), result.values(), logs=logs)


def _weights(found: Identifiability) -> FloatArray:
    """Rows: combinations; the weight of greatest size +1."""
    rows = found.directions.T
    greatest = rows[np.arange(len(rows)), np.abs(rows).argmax(axis=1)]
    return np.asarray(rows / greatest[:, None])


def _clipped(found: Identifiability) -> FloatArray:
    return np.clip(found.contractions, 0.0, 1.0)
