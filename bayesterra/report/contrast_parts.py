"""The sections of the page that sets several results side by side."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from markupsafe import Markup

from bayesterra import figures
from bayesterra.derived import DERIVED
from bayesterra.figures.contrast import COLOURS
from bayesterra.parameters import PARAMETERS
from bayesterra.prediction import PREDICTED
from bayesterra.report.blocks import Cell, Gallery, Section, Table, Text, drawing
from bayesterra.report.numbers import NOTHING, given, interval, plain, resolution, rounded
from bayesterra.report.symbols import QUANTITIES, angles, symbol, unit
from bayesterra.side_by_side import Comparison

SLIPS = 4
"""Slips in the table of predictions, at most."""
_KEY = Markup('<span class="named"><span class="swatch drawn" style="background:{}"></span>{}</span>')


def keys(comparison: Comparison) -> tuple[Markup, ...]:
    """Every result's name with its colour."""
    return tuple(_KEY.format(colour, name) for name, colour in zip(comparison.names, COLOURS, strict=False))


def driven_by(comparison: Comparison) -> str:
    """Which wheel the predictions are for."""
    wheels = {curve.wheel: curve.name for curve in comparison.curves.values()}
    return f"wheel {next(iter(wheels.values()))}" if len(wheels) == 1 else "each result with its own wheel"


def signed(value: float) -> str:
    """A number with its sign, to a tenth."""
    if not np.isfinite(value):
        return NOTHING
    text = f"{value:+.1f}".replace("-", "−")
    return "0.0" if text in ("+0.0", "−0.0") else text


def parameters_section(comparison: Comparison) -> Section:
    """Densities, intervals and shifts of parameters and derived quantities."""
    rows = [_row(comparison, name) for name in _free(comparison)]
    derived = [_row(comparison, name) for name in DERIVED if _cells(comparison, name)]
    header = ("", "", "median, 90 % HDI", "shift", "width")
    caption = Markup(
        "Posterior densities with 90 % highest-density intervals and medians, one colour per result: {}. "
        "Dashed: priors after the physical cut, at half height. Shift: distance of the mean from that of {}; "
        "width: ratio of the standard deviations; both in units of {}’s standard deviation."
    ).format(Markup(" ").join(keys(comparison)), comparison.names[0], comparison.names[0])
    curve = comparison.curves[comparison.names[0]]
    other = Markup(
        "Derived quantities under {} N, {}. Sinkage moduli of different exponents do not compare; these do."
    ).format(given(round(curve.load, 1)), driven_by(comparison))
    blocks = [Table(caption, "lllrr", header, tuple(rows)), Table(other, "lllrr", header, tuple(derived))]
    return Section("parameters", "Parameters", tuple(block for block in blocks if block.rows))


def _free(comparison: Comparison) -> list[str]:
    names = {name for result in comparison.results.values() for name in result.names}
    return [name for name in PARAMETERS if name in names]


def _cells(comparison: Comparison, name: str) -> list[tuple[Markup, str, str]]:
    """Median with interval, shift and width of every result that has the quantity."""
    table = comparison.parameters
    cells = []
    for row in table[table["quantity"] == name].to_dict("records"):
        step = resolution(row["hdi90_lo"], row["hdi90_hi"])
        ends = interval(row["hdi90_lo"], row["hdi90_hi"], step)
        text = coloured(comparison, row["result"], f"{rounded(row['median'], step)} ({ends})")
        first = row["result"] == comparison.names[0]
        cells.append((text, "" if first else signed(row["shift"]), "" if first else plain(row["width"], 2)))
    return cells


def coloured(comparison: Comparison, name: str, text: str) -> Markup:
    """Text with the colour of a result."""
    return _KEY.format(COLOURS[comparison.names.index(name)], text)


def _row(comparison: Comparison, name: str) -> tuple[Cell, ...]:
    draw = figures.contrast_derived if name in DERIVED else figures.contrast
    described = QUANTITIES[name].description
    picture = drawing(draw(comparison, name), f"{described} in all results")
    image = Markup('<img class="drawn" src="{}" alt="{}" width="{}">').format(
        picture.data, picture.alt, picture.width
    )
    cells = _cells(comparison, name) + list(_fixed(comparison, name))
    columns = (Markup("<br>").join(column) for column in zip(*cells, strict=True))
    label = Markup("{} {}<small>{}</small>").format(
        symbol(name), Markup("[{}]").format(unit(name)) if unit(name) else "", angles(described)
    )
    return (label, image, *columns)


def _fixed(comparison: Comparison, name: str) -> Iterator[tuple[Markup, str, str]]:
    """Values of results that hold the parameter."""
    for one, result in comparison.results.items():
        if name in result.study.prior.fixed:
            value = given(result.study.prior.fixed[name] / PARAMETERS[name].scale)
            yield coloured(comparison, one, f"fixed at {value}"), "", ""


def predictions_section(comparison: Comparison) -> Section:
    """What the results say about driving under one load."""
    pictures = tuple(
        drawing(
            figures.contrast_prediction(comparison, name), f"{known.description} over slip in all results"
        )
        for name, known in PREDICTED.items()
    )
    curve = comparison.curves[comparison.names[0]]
    caption = Markup(
        "Modelled values over slip under {} N, without measurement noise: median and 90 % band, one colour "
        "per result: {}. Dots: readings of that wheel under that load. Where bands lie apart, the choice "
        "matters for driving."
    ).format(given(round(curve.load, 1)), Markup(" ").join(keys(comparison)))
    notes = [
        Text(Markup("Note ({}): {}.").format(n, note))
        for n, p in comparison.points.items()
        for note in p.notes
    ]
    return Section(
        "predictions",
        "Predictions",
        (Gallery("half", pictures, caption), _predicted(comparison), *notes),
    )


def _predicted(comparison: Comparison) -> Table:
    slips = comparison.points[comparison.names[0]].slip
    few = slips[np.unique(np.linspace(0, len(slips) - 1, SLIPS).round().astype(int))]
    table = comparison.predictions
    rows = []
    for slip in few:
        at = table[table["slip"] == slip]
        columns = (_bands(comparison, at, name) for name in PREDICTED)
        rows.append((f"{slip:.3g}", *columns, _unanswered(at)))
    heads = (
        Markup("{} {}").format(symbol(n), Markup("[{}]").format(unit(n)) if unit(n) else "")
        for n in PREDICTED
    )
    caption = "The same at driven slips: median (equal-tailed 90 % interval); draws without an answer."
    return Table(caption, "l" * (len(PREDICTED) + 2), (symbol("slip"), *heads, "no answer"), tuple(rows))


def _bands(comparison: Comparison, table: pd.DataFrame, name: str) -> Markup:
    lines = []
    for row in table[table["quantity"] == name].to_dict("records"):
        low, middle, high = (float(row[f"modelled_q{level}"]) for level in ("05", "50", "95"))
        step = resolution(low, high)
        text = f"{rounded(middle, step)} ({interval(low, high, step)})"
        lines.append(coloured(comparison, row["result"], text))
    return Markup("<br>").join(lines)


def _unanswered(table: pd.DataFrame) -> str:
    """The greatest share of draws without an answer, marked where it is more than one in twenty."""
    worst = max(table.to_dict("records"), key=lambda row: int(row["no_answer"]))
    if not worst["no_answer"]:
        return NOTHING
    share = f"{100 * worst['no_answer'] / worst['draws']:.1f} % of {worst['result']}"
    return f"{share}: unreliable" if worst["marked"] else share
