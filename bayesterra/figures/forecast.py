"""Predictions for wheels, loads and slips that were not measured."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesterra.arrays import FloatArray
from bayesterra.figures.style import DATA, GRID, INK, POSTERIOR, label, literal, new_figure, own_axes, styled
from bayesterra.prediction import PREDICTED, UNANSWERED, Prediction, quantiles

DOUBTFUL = "#D55E00"
"""Colour of what cannot be relied on."""
_EDGES = 0.03
_PALE: dict[str, Any] = {"color": GRID, "alpha": 0.45, "linewidth": 0, "zorder": 0}


@styled
def prediction(
    curve: Prediction, quantity: str, ax: Axes | None = None, *, at: Prediction | None = None
) -> Axes:
    """Draw one quantity of a prediction over slip.

    Parameters
    ----------
    curve : a prediction on a slip grid: its median and 90 % band, without and with measurement noise.
    quantity : a key of ``prediction.PREDICTED``.
    at : the same wheel and load at single slips: median and 90 % interval of the readings, or of the modelled
        values where there are none.

    Grey ground: slips that were not driven. Hatched: more than 5 % of the draws have no answer.
    """
    ax = own_axes(ax)
    column, scale = list(PREDICTED).index(quantity), PREDICTED[quantity].scale
    modelled, readings = bands(curve.modelled, column) / scale, bands(curve.readings, column) / scale
    for band, alpha in ((readings, 0.18), (modelled, 0.42)):
        ax.fill_between(curve.slip, band[0], band[2], color=POSTERIOR, alpha=alpha, linewidth=0)
    ax.plot(curve.slip, modelled[1], color=POSTERIOR)
    if at is not None:
        noisy = at.modelled if np.isnan(at.readings[:, :, column]).all() else at.readings
        _points(ax, at.slip, bands(noisy, column) / scale)
    _limit(ax, modelled, readings)
    _ground(ax, curve)
    ax.set(xlabel="slip ratio $s$ [–]", ylabel=label(PREDICTED[quantity]))
    return ax


@styled
def predictions(cases: Sequence[tuple[Prediction, Prediction | None]]) -> FloatArray:
    """Draw every quantity (columns) of some predictions (rows); returns the axes (cases, quantities).

    Parameters
    ----------
    cases : per row the prediction on a slip grid, and at single slips where there is one.
    """
    figure = new_figure(2.55 * len(PREDICTED), 2.35 * len(cases) + 0.75)
    axes = np.asarray(figure.subplots(len(cases), len(PREDICTED), squeeze=False))
    for row, (curve, at) in zip(axes, cases, strict=True):
        for ax, quantity in zip(row, PREDICTED, strict=True):
            prediction(curve, quantity, ax, at=at)
            ax.set_title(PREDICTED[quantity].description, fontsize=9)
        row[0].annotate(
            f"wheel {literal(curve.name)}, {curve.load:.4g} N", (0, 1), (0, 22), xycoords="axes fraction",
            textcoords="offset points", fontsize=10, fontweight="bold",
        )  # fmt: skip
    _legend(figure, cases)
    return axes


@styled
def predictions_png(cases: Sequence[tuple[Prediction, Prediction | None]], dpi: float = 200) -> bytes:
    """The drawing of :func:`predictions` as PNG on white, the same bytes each time."""
    buffer = BytesIO()
    figure = predictions(cases)[0, 0].get_figure()
    figure.savefig(buffer, format="png", dpi=dpi, facecolor="white", metadata={"Software": None})
    return buffer.getvalue()


def bands(values: FloatArray, column: int) -> FloatArray:
    """5, 50 and 95 % of the draws that have an answer at each slip, (3, k)."""
    return np.column_stack([quantiles(values[:, i, column])[[0, 2, 4]] for i in range(values.shape[1])])


def _points(ax: Axes, slip: FloatArray, band: FloatArray) -> None:
    low, middle, high = band
    ax.errorbar(
        slip, middle, yerr=[middle - low, high - middle], fmt="o", color=DATA, markersize=3.5, capsize=2.5,
        elinewidth=0.9, zorder=6,
    )  # fmt: skip


def _limit(ax: Axes, modelled: FloatArray, readings: FloatArray) -> None:
    """Keep the bands in view, except where an efficiency falls without end at the smallest slips."""
    known = np.concatenate([modelled.ravel(), readings.ravel()])
    known = known[np.isfinite(known)]
    if not known.size:
        return
    medians = modelled[1][np.isfinite(modelled[1])]
    reach = 3 * max(float(np.ptp(medians)), 0.05 * float(np.abs(medians).max()), 1e-9)
    low, high = max(known.min(), medians.min() - reach), min(known.max(), medians.max() + reach)
    ax.set_ylim(low - 0.06 * (high - low), high + 0.06 * (high - low))


def _ground(ax: Axes, curve: Prediction) -> None:
    """Show where the slips were not driven, and where too many draws have no answer."""
    left, right = float(curve.slip[0]), float(curve.slip[-1])
    margin = _EDGES * (right - left) or 0.02
    ax.set_xlim(left - margin, right + margin)
    if left < curve.driven[0]:
        ax.axvspan(left - margin, curve.driven[0], **_PALE)
    if right > curve.driven[1]:
        ax.axvspan(curve.driven[1], right + margin, **_PALE)
    hatch_failing(ax, curve.slip, curve.unanswered)


def hatch_failing(ax: Axes, x: FloatArray, shares: FloatArray, colour: str = DOUBTFUL) -> None:
    """Hatch the stretches of ``x`` (k,) in which over ``UNANSWERED`` of the draws fail; the worst share."""
    left, right = ax.get_xlim()
    for low, high, share in _stretches(x, shares):
        ax.axvspan(
            low, high, facecolor="none", edgecolor=colour, hatch="////", alpha=0.5, linewidth=0, zorder=5
        )
        ax.text(
            min(max(0.5 * (low + high), left), right), 0.97, f"{100 * share:.0f} %", color=colour,
            transform=ax.get_xaxis_transform(), ha="center", va="top", fontsize=7.5, zorder=7,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.0},
        )  # fmt: skip
    ax.set_xlim(left, right)


def _stretches(x: FloatArray, shares: FloatArray) -> list[tuple[float, float, float]]:
    """Ends of stretches with more than ``UNANSWERED`` of the draws without an answer, and the worst share."""
    wrong = np.flatnonzero(shares > UNANSWERED)
    half = 0.5 * float(np.diff(x).max(initial=0.02))
    runs = np.split(wrong, np.flatnonzero(np.diff(wrong) > 1) + 1) if wrong.size else []
    ends = [(float(x[run[0]]), float(x[run[-1]])) for run in runs]
    worst = [float(shares[run].max()) for run in runs]
    return [(low - half, high + half, share) for (low, high), share in zip(ends, worst, strict=True)]


def _legend(figure: Figure, cases: Sequence[tuple[Prediction, Prediction | None]]) -> None:
    entries: list[Patch | Line2D] = [
        Line2D([], [], color=POSTERIOR, label="median"),
        Patch(color=POSTERIOR, alpha=0.5, label="90 %, without noise"),
        Patch(color=POSTERIOR, alpha=0.18, label="90 %, with measurement noise"),
    ]
    if any(at is not None for _, at in cases):
        entries.append(Line2D([], [], color=DATA, marker="o", markersize=3.5, label="asked-for slips, 90 %"))
    if any(not c.driven[0] <= s <= c.driven[1] for c, _ in cases for s in c.slip[[0, -1]]):
        entries.append(Patch(color=GRID, alpha=0.6, label="slip not driven"))
    if any(curve.marked for curve, _ in cases):
        entries.append(
            Patch(
                facecolor="none", edgecolor=DOUBTFUL, hatch="////", label="over 5 % of draws without answer"
            )
        )
    figure.legend(handles=entries, loc="outside lower center", ncols=len(entries), labelcolor=INK)
