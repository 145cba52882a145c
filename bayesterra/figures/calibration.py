"""Ranks of true values among posterior draws: their distribution less the uniform one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from bayesterra.calibration import Calibration
from bayesterra.calibration.quantities import AT_SLIP, LOG_LIKELIHOOD, LOG_PRIOR
from bayesterra.derived import DERIVED
from bayesterra.figures.style import INK, POSTERIOR, PRIOR, one_of, own_axes, styled
from bayesterra.parameters import CHANNELS, PARAMETERS, Channel, Parameter


@styled
def rank_ecdf(calibration: Calibration, quantity: str, ax: Axes | None = None) -> Axes:
    """Draw the share of true values below each rank, less the uniform share.

    Dark grey: where the whole curve of one right quantity lies with probability 0.95. Pale: the same at the
    level of the verdict, which allows for the number of quantities; a curve that leaves it fails.
    """
    ax = own_axes(ax, 2.55, 1.75)
    ranks = calibration.ranks(one_of("quantity", quantity, calibration.tested))
    test = calibration.test(quantity)
    points = np.concatenate([[0.0], test.points, [1.0]])
    for level, alpha in ((calibration.threshold, 0.18), (0.05, 0.28)):
        low, high = (np.concatenate([[0.0], end, [1.0]]) for end in test.band(level))
        ax.fill_between(points, low - points, high - points, color=PRIOR, alpha=alpha, linewidth=0)
    share = np.concatenate([[0.0], test.below(ranks) / len(ranks), [1.0]])
    ax.axhline(0, color=INK, linewidth=0.7)
    failing = quantity in calibration.failing
    ax.plot(
        points, share - points, color="#D55E00" if failing else POSTERIOR, linewidth=1.6 if failing else 1.3
    )
    ax.set(xlim=(0, 1), xticks=[0, 0.5, 1], xticklabels=["0", "0.5", "1"])
    ax.set(xlabel="rank among draws", ylabel="share below − uniform")
    ax.set_title(_name(quantity), loc="left")
    return ax


def _name(quantity: str) -> str:
    """A test quantity as the title of its plot."""
    if quantity in (LOG_LIKELIHOOD, LOG_PRIOR):
        return quantity.replace("_", " ")
    ending = " at the largest slip" if quantity.endswith(AT_SLIP) else ""
    known: Mapping[str, Parameter | Channel] = {**CHANNELS, **PARAMETERS, **DERIVED}
    return f"${known[quantity.removesuffix(AT_SLIP)].latex}${ending}"
