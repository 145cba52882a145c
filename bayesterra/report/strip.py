"""The parameter strip: one table row per parameter with a small drawing on the scale of its prior."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from bayesterra.adequacy import estimates, held
from bayesterra.arrays import FloatArray
from bayesterra.figures.axis import Axis, axis, density
from bayesterra.figures.rows import Row, found_rows, summary_rows
from bayesterra.figures.style import MARKS, POSTERIOR, PRIOR
from bayesterra.identifiability import SHIFT, WEAK
from bayesterra.parameters import PARAMETERS
from bayesterra.report.numbers import MINUS, given, interval, plain, resolution, rounded
from bayesterra.report.symbols import angles, symbol, unit
from bayesterra.results import Result, field_values

WIDTH, PAD = 560.0, 9.0
BASE, TALL = 25.0, 22.0
LANE, FIRST_LANE = 9.5, 34.0
SHAPES = {
    "^": "M0 -4.6L4.4 3.4L-4.4 3.4Z",
    "s": "M-3.6 -3.6H3.6V3.6H-3.6Z",
    "D": "M0 -4.8L4.8 0L0 4.8L-4.8 0Z",
    "X": "M-4 -2.2L-2.2 -4L0 -1.8L2.2 -4L4 -2.2L1.8 0L4 2.2L2.2 4L0 1.8L-2.2 4L-4 2.2L-1.8 0Z",
    "o": "M-4 0A4 4 0 1 1 4 0A4 4 0 1 1 -4 0Z",
    "<": "M-5 0L3 -4L3 4Z",
    ">": "M5 0L-3 -4L-3 4Z",
}
"""The marks of the figures as SVG paths about the origin."""


@dataclass(frozen=True)
class StripRow:
    """A row of the strip, ready for the template."""

    symbol: Markup
    description: Markup
    unit: Markup
    low: str
    high: str
    drawing: Markup
    median: str
    hdi: str
    mode: str
    mode_outside: bool
    word: str
    remark: Markup


def strip(result: Result) -> tuple[StripRow, ...]:
    """All free parameters."""
    return tuple(_row(result, name) for name in result.names)


def legend(result: Result) -> tuple[tuple[Markup, str], ...]:
    """Small drawings and what they stand for."""
    return keys(estimates(result))


def keys(methods: Iterable[str]) -> tuple[tuple[Markup, str], ...]:
    """What prior and posterior look like in the strip, and the marks of these methods."""
    small = Markup(
        '<svg class="drawn" viewBox="-9 -6 18 12" width="18" height="12" aria-hidden="true">{}</svg>'
    )
    fixed = (
        (f'<rect x="-8" y="-4" width="16" height="8" fill="{PRIOR}" fill-opacity=".28"/>', "prior"),
        (f'<path d="M-8 5C-3 5 -3 -5 0 -5S3 5 8 5Z" fill="{POSTERIOR}" fill-opacity=".5"/>', "posterior"),
        (f'<rect x="-8" y="-2" width="16" height="4" fill="{POSTERIOR}"/>', "90 % HDI"),
        (f'<rect x="-.9" y="-6" width="1.8" height="12" fill="{POSTERIOR}"/>', "mode"),
    )
    marks = tuple((small.format(_shape(name, MARKS[name].marker)), MARKS[name].label) for name in methods)
    return (*((small.format(Markup(shape)), text) for shape, text in fixed), *marks)  # noqa: S704 (constants)


def mode_outside(result: Result) -> tuple[str, ...]:
    """Parameters whose posterior mode lies outside their 90 % HDI by more than a twentieth of its width."""
    rows = summary_rows(result)
    return tuple(name for name in result.names if _apart(rows[name]))


def _apart(row: Row) -> bool:
    margin = 0.05 * (row.hdi90_hi - row.hdi90_lo)
    return not row.hdi90_lo - margin <= row.mode <= row.hdi90_hi + margin


def _row(result: Result, name: str) -> StripRow:
    parameter, along = PARAMETERS[name], axis(result, name)
    row = summary_rows(result)[name]
    step = resolution(*row.hdi)
    word, remark = _words(result, name)
    return StripRow(
        symbol=symbol(name),
        description=angles(parameter.description + (", log scale" if along.log else "")),
        unit=unit(name),
        low=axis_end(along.low, along),
        high=axis_end(along.high, along),
        drawing=_drawing(result, name, along),
        median=rounded(row.median, step),
        hdi=interval(*row.hdi),
        mode=rounded(row.mode, step),
        mode_outside=name in mode_outside(result),
        word=word,
        remark=remark,
    )


def axis_end(value: float, along: Axis) -> str:
    """An end of an axis: all digits of a bound that a person gave, three of one that was computed."""
    return given(float(f"{value:.6g}")) if value in along.bounds else plain(value)


def _words(result: Result, name: str) -> tuple[str, Markup]:
    """The identifiability word and what stands beside it in small print."""
    row = found_rows(result)[name]
    word = {"weakly": "weakly determined"}.get(row.verdict, row.verdict)
    if word == "moved":
        return word, Markup("{}prior and data disagree").format(moved_by(row.shift))
    if word == "one-sided":
        return word, Markup("at its {} bound").format(row.bound)
    if word != "coupled":
        return word, Markup("")
    alone = ", alone like its prior" if row.contraction < WEAK else ""
    partner = symbol(row.coupled_with) if row.coupled_with else Markup("several others")
    return word, Markup("with {}{}").format(partner, alone)


def moved_by(shift: float) -> str:
    """How far the mean moved, in words before others; nothing where it is not the mean that moved."""
    return f"by {shift:+.1f} prior sd: ".replace("-", MINUS) if abs(shift) >= SHIFT else ""


def _drawing(result: Result, name: str, along: Axis) -> Markup:
    column = result.names.index(name)
    prior, posterior = (field_values(name, result.values(g)[:, column]) for g in ("prior", "posterior"))
    scale = PARAMETERS[name].scale
    points = {method: v[name] / scale for method, v in estimates(result).items() if name in v}
    hollow = [method for method in points if name in held(result, method)]
    return drawing((prior, posterior), along, summary_rows(result)[name], points, hollow)


def drawing(
    draws: tuple[FloatArray, FloatArray],
    along: Axis,
    row: Row,
    points: Mapping[str, float],
    hollow: Sequence[str] = (),
) -> Markup:
    """The small drawing of a parameter.

    Parameters
    ----------
    draws : of the cut prior and of the posterior, field units.
    along : the range that is shown.
    row : its row of the summary.
    points : point estimates by method, keys of ``MARKS``; field units.
    hollow : methods that held the parameter.
    """
    prior, posterior = draws
    marks, lanes = _marks(points, hollow, along)
    low, high, mode = (float(x) for x in _place(along.position(np.array([*row.hdi, row.mode]))))
    height = FIRST_LANE + LANE * (lanes - 1) + 6
    return Markup(
        '<svg class="drawn" viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{alt}">'
        '<path d="{prior}" fill="{grey}" fill-opacity=".28"/>'
        '<path d="{posterior}" fill="{blue}" fill-opacity=".5"/>'
        '<path d="M{left:g} {base:g}H{right:g}" stroke="{grey}" stroke-width="1"/>'
        '<path d="M{low:.1f} {base:g}H{high:.1f}" stroke="{blue}" stroke-width="4.4"/>'
        '<path d="M{mode:.1f} 3V{below:g}" stroke="{blue}" stroke-width="1.8"/>{marks}</svg>'
    ).format(
        width=WIDTH + 2 * PAD, height=height, alt=_alternative(row), grey=PRIOR, blue=POSTERIOR,
        prior=_outline(prior, along, 0.5), posterior=_outline(posterior, along, 1.0),
        left=PAD, right=PAD + WIDTH, base=BASE, below=BASE + 4.5, low=low, high=high, mode=mode, marks=marks,
    )  # fmt: skip


def _alternative(row: Row) -> str:
    return f"posterior median {plain(row.median)}, 90 % HDI {interval(*row.hdi)}, mode {plain(row.mode)}"


def _place(position: FloatArray) -> FloatArray:
    """Horizontal place of positions along the axis, held inside the drawing."""
    return PAD + WIDTH * np.clip(position, 0.0, 1.0)


def _outline(draws: FloatArray, along: Axis, tall: float) -> str:
    """A density as a closed path on the base line."""
    heights = density(draws, along, 161)
    x, y = _place(np.linspace(0, 1, 161)), BASE - TALL * tall * heights
    points = "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True))
    return f"M{x[0]:.1f} {BASE:g}L{points}L{x[-1]:.1f} {BASE:g}Z"


def _marks(points: Mapping[str, float], hollow: Sequence[str], along: Axis) -> tuple[Markup, int]:
    """Point estimates below the line, and the number of lanes that they need not to overlap."""
    places = [float(_place(along.position(value))) for value in points.values()]
    lanes = _lanes(places)
    drawn = (
        _mark(method, value, (x, FIRST_LANE + LANE * lane), along, hollow=method in hollow)
        for (method, value), x, lane in zip(points.items(), places, lanes, strict=True)
    )
    return Markup("").join(drawn), max(lanes, default=0) + 1


def _lanes(places: list[float]) -> list[int]:
    """The first lane of each mark in which no earlier one is nearer than a mark is wide."""
    lanes: list[int] = []
    for i, x in enumerate(places):
        near = {lanes[j] for j in range(i) if abs(places[j] - x) < 11}
        lanes.append(next(lane for lane in range(i + 1) if lane not in near))
    return lanes


def _mark(method: str, value: float, at: tuple[float, float], along: Axis, *, hollow: bool) -> Markup:
    marker = "<" if value < along.low else ">" if value > along.high else MARKS[method].marker
    text = f"{MARKS[method].label}: {plain(value)}{', held' if hollow else ''}"
    moved = Markup('<g transform="translate({:.1f} {:g})"><title>{}</title>{}</g>')
    return moved.format(*at, text, _shape(method, marker, hollow=hollow))


def _shape(method: str, marker: str, *, hollow: bool = False) -> Markup:
    mark = MARKS[method]
    fill, stroke = ("none", mark.colour) if mark.hollow or hollow else (mark.colour, "none")
    return Markup('<path d="{}" fill="{}" stroke="{}" stroke-width="1.4"/>').format(
        SHAPES[marker], fill, stroke
    )
