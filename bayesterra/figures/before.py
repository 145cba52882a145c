"""What the prior says before any reading exists."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from bayesterra.figures.style import INK, PRIOR, label, own_axes, styled
from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.prior_only import PriorResult
from bayesterra.results import field_values

BINS = 40


@styled
def prior_density(result: PriorResult, name: str, ax: Axes | None = None) -> Axes:
    """Draw one parameter's prior: grey what physics leaves of it, line the law as stated."""
    ax = own_axes(ax, 2.6, 1.7)
    values = field_values(name, result.draws["prior"][name].to_numpy().ravel())
    ax.hist(values, bins=BINS, density=True, color=PRIOR, alpha=0.55, linewidth=0)
    grid = np.linspace(values.min(), values.max(), 200)
    scale = PARAMETERS[name].scale
    stated = np.exp(result.study.prior.laws[name].log_density(grid * scale)) * scale
    ax.plot(grid, stated, color=INK, linewidth=1.0)
    ax.set(xlabel=label(PARAMETERS[name]), yticks=[], ylim=(0, None))
    ax.spines["left"].set_visible(False)
    return ax


@styled
def prior_bands(
    result: PriorResult, channel: str, ax: Axes | None = None, *, wheel: str | None = None
) -> Axes:
    """Draw what the prior predicts for one channel of one wheel over slip.

    Dark and pale: 50 and 90 % of the modelled values; broken lines: 90 % of readings, noise included; line:
    median; ticks: slips of the table.
    """
    ax = own_axes(ax)
    wheel = wheel or next(iter(result.study.wheels))
    curves = result.draws["curves"].sel(wheel=wheel)
    slip = curves["slip"].to_numpy()
    bands, noisy = (
        field_values(channel, curves[kind].sel(outcome=channel).to_numpy())
        for kind in ("modelled", "readings")
    )
    for low, high, alpha in ((0, 4, 0.25), (1, 3, 0.45)):
        ax.fill_between(slip, bands[low], bands[high], color=PRIOR, alpha=alpha, linewidth=0)
    ax.plot(slip, bands[2], color=INK)
    for edge in noisy[[0, 4]]:
        ax.plot(slip, edge, color=INK, linewidth=0.8, dashes=(4, 3))
    rows = result.study.observations
    mine = np.array([name == wheel for name in rows.wheel]) & rows.use
    ax.plot(rows.slip[mine], np.zeros(mine.sum()), "|", color=INK, transform=ax.get_xaxis_transform())
    ax.set(xlabel="slip ratio $s$ [–]", ylabel=label(CHANNELS[channel]))
    return ax
