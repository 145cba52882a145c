"""A rover on slopes and against tow forces, on the soils of a posterior."""

from __future__ import annotations

from io import BytesIO

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesterra.arrays import FloatArray
from bayesterra.figures.forecast import DOUBTFUL, hatch_failing
from bayesterra.figures.style import DATA, GRID, INK, POSTERIOR, PRIOR, figure_of, new_figure, styled
from bayesterra.prediction import UNANSWERED, quantiles
from bayesterra.rover.climbing import Greatest
from bayesterra.rover.equilibrium import State
from bayesterra.rover.geometry import AXLES
from bayesterra.rover.outlook import DEGREE, QUANTITIES, RoverOutlook, cannot, unanswered

REAR, BOTH = "#E69F00", "#009E73"
COLOURS = (POSTERIOR, REAR)
_LABELS = {"slip": "slip ratio $s$ [–]", "sinkage": "sinkage $z$ [mm]", "load": "load of a wheel [N]"}
_STEPS = 200


@styled
def rover_outlook(outlook: RoverOutlook) -> FloatArray:
    """Draw slip, sinkage and wheel load over slope (first row) and tow force (second, if asked for).

    Lines: medians of the draws that hold; dark and pale bands: 50 and 90 % of them. Front axle blue, rear
    axle orange; one line where they are alike. Hatched orange: over 5 % of the draws do not hold; grey: over
    5 % have no answer. Last column: share of the draws
    that hold a slope or tow force at any slip, and at the driven ones only (dashed). Returns the axes.
    """
    rows = 1 if outlook.over_tow is None else 2
    figure = new_figure(10.4, 2.5 * rows + 0.9)
    axes = np.asarray(figure.subplots(rows, 4, squeeze=False))
    _row(axes[0], outlook, outlook.over_slope, "slope")
    _chance(
        axes[0, 3],
        outlook.slopes,
        outlook.slopes_driven,
        DEGREE,
        "slope α [°]",
        "share of draws that climb it",
    )
    if outlook.over_tow is not None:
        _row(axes[1], outlook, outlook.over_tow, "tow")
        _chance(
            axes[1, 3],
            outlook.tows,
            outlook.tows_driven,
            1.0,
            "tow force on the flat [N]",
            "share of draws that hold it",
        )
    _legend(axes, outlook)
    return axes


@styled
def rover_outlook_png(outlook: RoverOutlook, dpi: float = 200) -> bytes:
    """The drawing of :func:`rover_outlook` as PNG on white, the same bytes each time."""
    buffer = BytesIO()
    figure = figure_of(rover_outlook(outlook))
    figure.savefig(buffer, format="png", dpi=dpi, facecolor="white", metadata={"Software": None})
    return buffer.getvalue()


def _row(axes: FloatArray, outlook: RoverOutlook, states: State, over: str) -> None:
    x = states.slope[0] / DEGREE if over == "slope" else states.tow[0]
    fixed = (
        f"{states.tow[0, 0]:.3g} N tow" if over == "slope" else f"slope {states.slope[0, 0] / DEGREE:.3g}°"
    )
    for ax, (field, title) in zip(axes, _LABELS.items(), strict=False):
        alike = field == "slip" and outlook.rover.equal_slip
        for axle in (1,) if alike else (0, 1):
            colour = BOTH if alike else COLOURS[axle]
            _band(ax, x, getattr(states, field)[:, :, axle] / QUANTITIES[field][1], colour)
        if field == "slip":
            ax.axhspan(outlook.driven[1], 1, color=GRID, alpha=0.45, linewidth=0, zorder=0)
            ax.set_ylim(0, _top(states))
        else:
            ax.set_ylim(0, None)
        ax.set(xlabel="slope α [°]" if over == "slope" else "tow force [N]", ylabel=title, xlim=(x[0], x[-1]))
        ax.set_title(fixed, fontsize=8.5)
        ax.set_ylim(top=1.12 * ax.get_ylim()[1])
        hatch_failing(ax, x, cannot(states))
        hatch_failing(ax, x, unanswered(states), PRIOR)


def _top(states: State) -> float:
    """Highest end of the 90 % band of the slip."""
    ends = [quantiles(states.slip[:, i].max(axis=1))[4] for i in range(states.slip.shape[1])]
    return float(np.nanmax(ends, initial=0.05))


def _band(ax: Axes, x: FloatArray, values: FloatArray, colour: str) -> None:
    q05, q25, q50, q75, q95 = np.column_stack([quantiles(values[:, i]) for i in range(len(x))])
    ax.fill_between(x, q05, q95, color=colour, alpha=0.2, linewidth=0)
    ax.fill_between(x, q25, q75, color=colour, alpha=0.35, linewidth=0)
    ax.plot(x, q50, color=colour)


def _chance(ax: Axes, found: Greatest, driven: Greatest, scale: float, label: str, share: str) -> None:
    """One minus the distribution of the greatest value."""
    values = np.nan_to_num(found.value, nan=-np.inf) / scale
    x = np.linspace(0, 1.05 * max(float(values.max()), 1e-9), _STEPS)
    for one, line in ((found, "-"), (driven, "--")):
        least = np.nan_to_num(one.value, nan=-np.inf) / scale
        ax.plot(x, (least >= x[:, None]).mean(axis=1), color=DATA, linestyle=line)
    ax.set(xlabel=label, ylabel=share, xlim=(0, x[-1]), ylim=(0, 1.03))


def _legend(axes: FloatArray, outlook: RoverOutlook) -> None:
    entries: list[Line2D | Patch] = [
        *([Line2D([], [], color=BOTH, label="all wheels")] if outlook.rover.equal_slip else []),
        *(
            Line2D([], [], color=colour, label=f"{axle} axle")
            for colour, axle in zip(COLOURS, AXLES, strict=True)
        ),
        Patch(color=INK, alpha=0.5, label="50 %"),
        Patch(color=INK, alpha=0.2, label="90 % of the draws that hold"),
        Line2D([], [], color=DATA, linestyle="--", label="at driven slips"),
        Patch(color=GRID, alpha=0.6, label="slip not driven"),
    ]
    curves = [outlook.over_slope, *([] if outlook.over_tow is None else [outlook.over_tow])]
    for shares, colour, title in (
        (cannot, DOUBTFUL, "over 5 % of draws do not hold"),
        (unanswered, PRIOR, "over 5 % without answer"),
    ):
        if any((shares(curve) > UNANSWERED).any() for curve in curves):
            entries.append(Patch(facecolor="none", edgecolor=colour, hatch="////", label=title))
    figure_of(axes).legend(handles=entries, loc="outside lower center", ncols=5, labelcolor=INK)
