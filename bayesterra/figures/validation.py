"""Whether rows are predicted by the others: distribution of LOO-PIT values."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from bayesterra.crossvalidation import CrossValidation
from bayesterra.figures.style import INK, POSTERIOR, PRIOR, own_axes, styled
from bayesterra.parameters import CHANNELS
from bayesterra.results import Result
from bayesterra.uniformity import ecdf_band


@styled
def loo_pit(result: Result, channel: str, ax: Axes | None = None) -> Axes:
    """Draw the distribution of one channel's LOO-PIT values less the uniform one.

    A LOO-PIT value is the probability of a reading below the measured one, predicted by the other rows. Grey:
    where the whole curve lies with probability 0.95 if the predictions are right.
    """
    ax = own_axes(ax)
    pit = CrossValidation.from_record(result.record["loo"]).pit[channel]
    values = np.sort([p for p in pit if np.isfinite(p)])
    points = np.arange(1, len(values) + 1) / len(values)
    low, high = ecdf_band(len(values))
    share = np.searchsorted(values, points, side="right") / len(values)
    ax.fill_between(points, low - points, high - points, color=PRIOR, alpha=0.25, linewidth=0, step="mid")
    ax.axhline(0, color=INK, linewidth=0.7)
    ax.plot(points, share - points, color=POSTERIOR, drawstyle="steps-mid")
    ax.set(xlabel=f"LOO-PIT of ${CHANNELS[channel].latex}$", ylabel="share below − uniform")
    return ax
