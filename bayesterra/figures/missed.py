"""The model's own error over slip."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from bayesterra.figures.style import DATA, INK, POSTERIOR, own_axes, styled
from bayesterra.missed import Missed
from bayesterra.parameters import CHANNELS
from bayesterra.results import field_values


@styled
def discrepancy(found: Missed, ax: Axes | None = None) -> Axes:
    """Draw a discrepancy over slip: bands of 50 and 90 %, median, and reading less model as dots."""
    ax, channel = own_axes(ax), CHANNELS[found.channel]
    bands = field_values(found.channel, found.bands)
    for low, high, alpha in ((0, 4, 0.18), (1, 3, 0.32)):
        ax.fill_between(found.slip, bands[low], bands[high], color=POSTERIOR, alpha=alpha, linewidth=0)
    ax.axhline(0, color=INK, linewidth=0.7)
    ax.plot(found.slip, bands[2], color=POSTERIOR)
    residuals = field_values(found.channel, found.residuals)
    ax.plot(found.rows, residuals, "o", color=DATA, markersize=4)
    shown = np.concatenate([bands.ravel(), residuals, [0.0]])
    margin = 0.08 * float(np.ptp(shown))
    ax.set_ylim(shown.min() - margin, shown.max() + margin)
    ax.set(xlabel="slip ratio $s$ [–]", ylabel=rf"$\delta_{{{channel.latex}}}$ [{channel.unit}]")
    return ax
