"""Parameters and their laws on a page: laws in words, the axis of a prior, rows of the strip."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from bayesterra.arrays import FloatArray
from bayesterra.parameters import MODULI, PARAMETERS, Parameter
from bayesterra.report.blocks import Text
from bayesterra.report.figures import MARKS, POSTERIOR, PRIOR, TAIL, Axis, density
from bayesterra.report.numbers import given, interval, plain, resolution, rounded
from bayesterra.report.sections import Prose
from bayesterra.report.symbols import amount, angles, letters, listed, raised
from bayesterra.report.verdicts import failed
from bayesterra.stats.laws import RANGED, Law
from bayesterra.stats.quantile_law import QuantileLaw
from bayesterra.study.result import DrawnResult, Result, SummaryRow

say = Prose("study")


def unconverged(result: DrawnResult, text: str) -> Markup:
    """A text with advice for its ``{}`` where the sampling has not converged; else empty."""
    if result.converged:
        return Markup("")
    checks = result.record["verdict"]["checks"]
    return Markup(text).format(listed(check["advice"] for check in checks if not check["passed"]))  # noqa: S704 (constants)


def axis(result: Result, name: str) -> Axis:
    """The range of a free parameter's prior, without the outer thousandth of priors without bounds.

    It is widened where the posterior reaches beyond that.
    """
    prior, scale, ends = result.study.prior, PARAMETERS[name].scale, np.array([TAIL, 1.0 - TAIL])
    law = prior.laws[name]
    if prior.stretched and name in MODULI:  # whose laws are about something else
        return axis_of(law, (-np.inf, np.inf), np.quantile(result.column(name, "prior"), ends), result.column(name))
    return axis_of(law, (law.range[0] / scale, law.range[1] / scale), law.quantile(ends) / scale, result.column(name))


def axis_of(law: Law, ends: tuple[float, float], tails: FloatArray, draws: FloatArray) -> Axis:
    """Axis between the ends of a law, field units; where one is infinite, what tails (2,) and draws reach."""
    reach = np.quantile(draws, [TAIL, 1.0 - TAIL])
    return Axis(
        ends[0] if np.isfinite(ends[0]) else float(min(tails[0], reach[0])),
        ends[1] if np.isfinite(ends[1]) else float(max(tails[1], reach[1])),
        law.dist == "loguniform",
        ends,
    )


WIDTH, PAD = 560.0, 9.0
BASE, TALL = 25.0, 22.0
LANE, FIRST_LANE = 9.5, 34.0


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
    mode_at: str
    word: str
    remark: Markup


def strip_row(
    quantity: Parameter,
    along: Axis,
    row: SummaryRow,
    draws: tuple[FloatArray, FloatArray],
    points: Mapping[str, float],
    words: tuple[str, Markup],
    hollow: Sequence[str] = (),
) -> StripRow:
    """The row of a parameter from its row of the summary, with its verdict and what stands beside that.

    ``draws``, ``points`` and ``hollow`` are those of its :func:`drawing`.
    """
    step = resolution(*row.hdi)
    return StripRow(
        symbol=letters(quantity.symbol),
        description=angles(quantity.description + (", log scale" if along.log else "")),
        unit=raised(quantity.unit), low=axis_end(along.low, along), high=axis_end(along.high, along),
        drawing=drawing(draws, along, row, points, hollow), median=rounded(row.median, step),
        hdi=interval(*row.hdi), mode=rounded(row.mode, step), mode_outside=row.mode_outside,
        mode_at="" if row.mode_at == "inside" else row.mode_at, word=words[0], remark=words[1],
    )  # fmt: skip


def keys(methods: Iterable[str]) -> tuple[tuple[Markup, str], ...]:
    """Looks of prior and posterior in the strip, and the marks of these methods."""
    looks = ("prior", "posterior", "90 % HDI", "mode")
    marks = tuple((say("key", _shape(name, MARKS[name].marker)), MARKS[name].label) for name in methods)
    return (*((say("key", say("look", look, PRIOR, POSTERIOR)), look) for look in looks), *marks)


def axis_end(value: float, along: Axis) -> str:
    """An end of an axis: all digits of a bound that a person gave, three of one that was computed."""
    return given(float(f"{value:.6g}")) if value in along.bounds else plain(value)


def drawing(
    draws: tuple[FloatArray, FloatArray],
    along: Axis,
    row: SummaryRow,
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
    alt = f"posterior median {plain(row.median)}, 90 % HDI {interval(*row.hdi)}, mode {plain(row.mode)}"
    size, line = (WIDTH + 2 * PAD, height), (PAD, BASE, PAD + WIDTH)
    outlines = (_outline(prior, along, 0.5), _outline(posterior, along, 1.0))
    return say("strip", size, alt, *outlines, line, (low, high), mode, marks, PRIOR, POSTERIOR)


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
    return say("placed", *at, text, _shape(method, marker, hollow=hollow))


def _shape(method: str, marker: str, *, hollow: bool = False) -> Markup:
    mark = MARKS[method]
    fill, stroke = ("none", mark.colour) if mark.hollow or hollow else (mark.colour, "none")
    return say("mark", marker, fill, stroke)


def law_text(name: str, law: Law) -> Markup:
    """A prior law in field units.

    >>> str(law_text("phi", Law("uniform", lower=0.0, upper=0.8726646259971648)))
    'flat from 0 to 50&nbsp;deg'
    """
    scale = PARAMETERS[name].scale
    if isinstance(law, QuantileLaw):
        low, middle, high = (plain(value / scale, 4) for value in law.quantile(np.array([0.05, 0.5, 0.95])))
        return Markup("tabulated (median {}, 90 % in {} to {})").format(middle, low, amount(name, high))
    limits = (law.lower / scale, law.upper / scale)
    ends = Markup("{} to {}").format(_end(limits[0]), amount(name, _end(limits[1])))
    if law.dist in RANGED:
        return Markup("flat {}from {}").format("" if law.dist == "uniform" else "in its logarithm ", ends)
    shape = {k: amount(name, given(v / scale)) if k in ("loc", "scale") else given(v) for k, v in law.shape.items()}
    cut = Markup(", cut to {}").format(ends) if any(abs(x) < float("inf") for x in limits) else Markup("")
    if law.dist == "norm":
        middle = given(law.shape.get("loc", 0.0) / scale)
        return Markup("normal, {} ± {}{}").format(middle, shape.get("scale") or amount(name, given(1.0 / scale)), cut)
    inside = Markup(", ").join(Markup("{} {}").format(*argument) for argument in shape.items())
    return Markup("{} ({}){}").format(law.dist, inside, cut)


def _end(value: float) -> str:
    return given(value) if abs(value) < float("inf") else "−∞" if value < 0 else "∞"


def crosscheck(record: Mapping[str, Any]) -> tuple[Text, ...]:
    """Verdict of nested sampling at two settings, if it was asked for."""
    found = record.get("crosscheck")
    if found is None:
        return tuple(Text(line, "bad") for line in (failed(record, "crosscheck"),) if line)
    text = say("crosscheck", found["verdict"], found["worst"], found["threshold"])
    return (Text(text),)


def crosscheck_line(record: Mapping[str, Any]) -> tuple[Text, ...]:
    """The same in a line of a terminal."""
    found = record.get("crosscheck")
    said = f"Cross-check by nested sampling: {found['verdict']} ({found['worst']})." if found else ""
    return (Text(said),) if said else ()
