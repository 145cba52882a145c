"""Figure style: colours and marks; densities of draws along the axis of a parameter."""

import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, wraps
from io import BytesIO
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeAlias, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from bayesterra.arrays import FloatArray
from bayesterra.parameters import PARAMETERS, Channel, Parameter, whole_and_part
from bayesterra.runtime.reading import MEGABYTE, read_text

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
    """Mark of a point estimate, the same in all figures; ``line`` and ``sign`` say its look in a sentence."""

    label: str
    colour: str
    marker: str
    dashes: Sequence[float] = ()
    hollow: bool = False
    line: str = ""
    sign: str = ""


_MARKS = tomllib.loads(read_text(Path(__file__).with_name("marks.toml"), MEGABYTE))
MARKS = {name: Mark(**look) for name, look in _MARKS.items()}

P = ParamSpec("P")
R = TypeVar("R")


def mark_key(method: str) -> Line2D:
    """Entry of a legend for a point estimate."""
    mark = MARKS[method]
    face = "none" if mark.hollow else mark.colour
    return Line2D(
        [], [], color=mark.colour, marker=mark.marker, markerfacecolor=face, linestyle="none",
        label=mark.label,
    )  # fmt: skip


@cache
def settings() -> dict[Any, Any]:
    """Settings of matplotlib that all figures share."""
    style = Path(__file__).parent / "templates" / "figures.mplstyle"
    return dict(mpl.rc_params_from_file(style, use_default_template=False))


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """Draw with the shared settings, whatever the reader's own are, and leave those untouched."""

    @wraps(draw)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        with mpl.rc_context():
            mpl.rcdefaults()
            mpl.rcParams.update(settings())
            return draw(*args, **kwargs)

    return wrapped


def one_of(kind: str, value: str, choices: Iterable[str]) -> str:
    """The value, if it is one of those known; else ValueError."""
    choices = list(choices)
    if value not in choices:
        raise ValueError(f"'{kind}' must be one of {', '.join(choices)} (got {value!r})")
    return value


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure (inches) that pyplot does not know of."""
    return _empty(width, height, "constrained")


def _empty(width: float, height: float, layout: Literal["constrained"] | None) -> Figure:
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def own_axes(ax: Axes | None, width: float = 3.6, height: float = 2.5) -> Axes:
    """Return the caller's axes, or those of a new figure, which are given their place when it is saved."""
    return ax if ax is not None else _empty(width, height, None).subplots()


def panels(count: int, columns: int, size: tuple[float, float] = (2.4, 1.75)) -> NDArray[Any]:
    """Axes (count,) side by side in rows, each on a place of this size (inches) with room for its labels."""
    (width, height), rows = size, -(-count // columns)
    figure = _empty(columns * width, rows * height, None)
    inner = ((width - 0.74) / (columns * width), (height - 0.5) / (rows * height))
    axes = np.empty(count, dtype=object)
    for i in range(count):
        row, column = divmod(i, columns)
        at = ((column + 0.6 / width) / columns, (rows - 1 - row + 0.4 / height) / rows)
        axes[i] = figure.add_axes((*at, *inner))
    return axes


def _fit(figure: Figure) -> None:
    """Give the only axes of a figure all of it but the room of their labels.

    A layout engine does the same at three times the cost: it draws the figure once more and measures it twice.
    """
    (ax,) = figure.axes
    outer = ax.get_tightbbox(figure.canvas.get_renderer(), for_layout_only=True) or ax.bbox  # type: ignore[attr-defined]
    room = (np.subtract(ax.bbox.extents, outer.extents)) * (1, 1, -1, -1) + 3.0 / 72 * figure.dpi
    left, bottom, right, top = room / np.tile(figure.bbox.size, 2)
    ax.set_position((left, bottom, 1 - left - right, 1 - bottom - top))


def label(quantity: Parameter | Channel, *, unit: bool = True) -> str:
    """Symbol and field unit as an axis label."""
    base, part = whole_and_part(quantity.name)
    symbol = f"${quantity.latex}$" + (literal(part) if base in PARAMETERS else "")
    text = quantity.unit.replace("m^N", "m$^N$")
    return symbol if not unit or text == "-" else f"{symbol} [{text}]"


def fan(ax: Axes, x: FloatArray, bands: FloatArray, colour: str, alphas: tuple[float, float]) -> None:
    """Fill two bands, wide and narrow, of quantiles (5, k) at ``x`` (k,), with these opacities."""
    for low, high, alpha in zip((0, 1), (4, 3), alphas, strict=True):
        ax.fill_between(x, bands[low], bands[high], color=colour, alpha=alpha, linewidth=0)


def name_cells(ax: Axes, names: Sequence[str]) -> None:
    """Name the rows and columns of a square of cells, the first pair at the top left."""
    ticks, labels = np.arange(len(names)) + 0.5, [label(PARAMETERS[name], unit=False) for name in names]
    ax.set(xticks=ticks, xticklabels=labels, yticks=ticks, yticklabels=labels, aspect="equal")
    ax.set(xlim=(-0.05, len(names) + 0.05), ylim=(len(names) + 0.05, -0.05))
    ax.tick_params(length=0)
    if any(name not in PARAMETERS for name in names):  # long ones, of groups
        ax.tick_params(axis="x", labelrotation=45)
    ax.spines[:].set_visible(False)


def literal(text: str) -> str:
    """A name as it is: its dollars begin no formula, and no underscore hides it from a legend."""
    return f" {text}".replace("$", r"\$") if text.startswith("_") else text.replace("$", r"\$")


Drawn: TypeAlias = Axes | NDArray[Any]
"""Return of a figure function: axes or an array of them."""


def figure_of(drawn: Drawn) -> Figure:
    """The figure that axes belong to."""
    figure = np.asarray(drawn).ravel()[0].get_figure()
    if not isinstance(figure, Figure):
        raise TypeError("axes must belong to a figure")
    return figure


def css_width(drawn: Drawn) -> int:
    """Width of the figure in CSS pixels, 96 to the inch."""
    return round(96 * float(figure_of(drawn).get_size_inches()[0]))


@styled
def svg(drawn: Drawn) -> bytes:
    """The figure as SVG, the same bytes each time."""
    return _saved(drawn, format="svg", dpi=192, metadata={"Date": None, "Creator": None})


@styled
def pdf(drawn: Drawn) -> bytes:
    """The figure as PDF, its text as text, the same bytes each time."""
    return _saved(drawn, format="pdf", metadata={"CreationDate": None, "Creator": None, "Producer": None})


@styled
def png(drawn: Drawn, width: int) -> bytes:
    """The figure as PNG, ``width`` dots wide, on a transparent ground, the same bytes each time."""
    dpi = width / figure_of(drawn).get_size_inches()[0]
    return _saved(drawn, format="png", dpi=dpi, metadata={"Software": None})


@styled
def white_png(drawn: Drawn, dpi: float = 200) -> bytes:
    """The figure as PNG on white, for a file of its own, the same bytes each time."""
    return _saved(drawn, format="png", dpi=dpi, facecolor="white", metadata={"Software": None})


def _saved(drawn: Drawn, **options: Any) -> bytes:
    buffer, figure = BytesIO(), figure_of(drawn)
    if figure.get_layout_engine() is None and len(figure.axes) == 1 and figure.axes[0].axison:
        _fit(figure)
    figure.savefig(buffer, **options)
    return buffer.getvalue()


BINS = 400
TAIL = 0.001


@dataclass(frozen=True)
class Axis:
    """A range, linear or logarithmic."""

    low: float  # its lower end, field units
    high: float  # its upper end
    log: bool  # whether equal distances are equal ratios
    bounds: tuple[float, float]  # the ends of the prior's range, infinite where it has none

    def position(self, values: FloatArray | float) -> FloatArray:
        """Position along the axis, 0 at its low and 1 at its high end; beyond for values outside."""
        low, high = self._scaled(self.low), self._scaled(self.high)
        return np.asarray((self._scaled(values) - low) / (high - low))

    def grid(self, n: int) -> FloatArray:
        """``n`` values at equal distances along the axis."""
        low, high = self._scaled(self.low), self._scaled(self.high)
        values = np.linspace(low, high, n)
        return np.asarray(10.0**values if self.log else values)

    def _scaled(self, values: FloatArray | float) -> FloatArray:
        if not self.log:
            return np.asarray(values, dtype=np.float64)
        return np.log10(np.maximum(values, np.finfo(float).tiny))


def density(draws: FloatArray, along: Axis, n: int = 200) -> FloatArray:
    """Density of draws (m,) at ``n`` places at equal distances along an axis, greatest value 1.

    A Gaussian kernel of Silverman's (1986, eq. 3.31) width for 4000 draws at most, mirrored at the ends.
    """
    position = along.position(draws)
    inside = position[(position >= 0) & (position <= 1)]
    if inside.size < 2:
        return np.zeros(n)
    counts, edges = np.histogram(inside, bins=BINS, range=(0.0, 1.0))
    spread = min(float(inside.std()), float(np.ptp(np.quantile(inside, [0.25, 0.75]))) / 1.34)
    width = float(0.9 * max(spread, 1.0 / BINS) * min(inside.size, 4000) ** -0.2)
    smooth = _smoothed(counts.astype(np.float64), width * BINS)
    heights = np.interp(np.linspace(0, 1, n), 0.5 * (edges[1:] + edges[:-1]), smooth)
    return np.asarray(heights / heights.max())


def _smoothed(counts: FloatArray, width: float) -> FloatArray:
    """Smooth bins with a Gaussian of ``width`` bins, mirrored at both ends."""
    reach = min(len(counts), int(np.ceil(4 * width)) + 1)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(width, 0.3)) ** 2)
    padded = np.pad(counts, reach, mode="symmetric")
    return np.convolve(padded, kernel / kernel.sum(), mode="valid")


def limit_y(ax: Axes, low: float, high: float, share: float) -> None:
    """Limits of the vertical axis about a range, which may be one value, with a share of it to spare."""
    margin = share * (high - low) or share * abs(high) or 1.0
    ax.set_ylim(low - margin, high + margin)
