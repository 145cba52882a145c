"""How unevenly the readings inform the directions of parameter space."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from bayesterra.figures.style import INK, POSTERIOR, own_axes, styled
from bayesterra.identifiability.local import LocalAnalysis

LOWEST = 1e-6
"""Eigenvalues below this are drawn at it: so little is nothing."""
TENTH_LEFT = 9.0
"""Information that leaves a tenth of the prior's variance."""


@styled
def spectrum(found: LocalAnalysis, ax: Axes | None = None) -> Axes:
    """Draw the eigenvalues of the information over the posterior, best informed direction first.

    Dots: medians; bars: 5 to 95 % of the parameter sets. At the broken line the readings know as much as the
    prior; at the dotted one they leave a tenth of its variance.
    """
    ax = own_axes(ax, 4.6, 3.0)
    low, middle, high = np.maximum(np.quantile(found.spectra, [0.05, 0.5, 0.95], axis=0), LOWEST)
    places = np.arange(1, len(middle) + 1)
    ax.vlines(places, low, high, color=POSTERIOR, linewidth=5, alpha=0.3)
    ax.plot(places, middle, "o", color=POSTERIOR)
    for level, dashes in ((1.0, (0, (4, 3))), (TENTH_LEFT, (0, (1, 2)))):
        ax.axhline(level, color=INK, linewidth=0.8, linestyle=dashes)
    ax.set(yscale="log", xticks=places, xlabel="direction", ylabel="information, prior = 1")
    return ax
