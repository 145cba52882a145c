"""How the ensembles moved and whether they agree."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from scipy.stats import rankdata

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.figures.rows import summary_rows
from bayesterra.figures.style import INK, PRIOR, label, one_of, own_axes, styled
from bayesterra.parameters import PARAMETERS
from bayesterra.results import Result, field_values

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
    values = (
        sampled["lp"].to_numpy()
        if name == "lp"
        else field_values(name, result.draws["posterior"][name].to_numpy())
    )
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
    ax.set(
        xlabel=f"rank of {label(PARAMETERS[name], unit=False)} among all draws", ylabel="relative frequency"
    )
    ax.set(xlim=(0, 1), ylim=(max(0.0, 1 - reach), 1 + reach))
    return ax
