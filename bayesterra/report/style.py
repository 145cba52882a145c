"""Style of figures: colours, marks of point estimates, settings of matplotlib."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

POSTERIOR = "#0072B2"
PRIOR = "#8A8A8A"
DATA = "#111111"
INK = "#333333"
GRID = "#D9D9D9"
"""Okabe–Ito colours for what is inferred, greys for what is given."""

PROBABILITIES = (0.5, 0.9)
"""Masses of bands and contours."""


@dataclass(frozen=True)
class Mark:
    """Mark of a point estimate, the same in all figures."""

    label: str
    colour: str
    marker: str
    dashes: tuple[float, ...] = ()
    hollow: bool = False


MARKS = {
    "IM1": Mark("IM1", "#D55E00", "^", (6.0, 2.0)),
    "IM2": Mark("IM2", "#009E73", "s", (2.0, 1.5)),
    "IM3": Mark("IM3", "#CC79A7", "D", (6.0, 2.0, 1.5, 2.0)),
    "joint": Mark("joint", "#E69F00", "X", (3.0, 2.0)),
    "regression": Mark("lines", "#D55E00", "^", (6.0, 2.0)),
    "nonlinear": Mark("one fit", "#E69F00", "X", (3.0, 2.0)),
    "published": Mark("published", DATA, "o", hollow=True),
    "truth": Mark("truth", DATA, "o", hollow=True),
}

SETTINGS: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "axes.labelsize": 9.0,
    "axes.titlesize": 9.5,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "axes.unicode_minus": True,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "text.color": INK,
    "lines.linewidth": 1.3,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "mathtext.fontset": "dejavusans",
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "svg.hashsalt": "bayesterra",
    "svg.fonttype": "path",
}
