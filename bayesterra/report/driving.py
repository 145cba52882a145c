"""What the draws mean for the one who drives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from bayesterra.arrays import FloatArray
from bayesterra.derived import DERIVED, SLIP_GRID, reference_load
from bayesterra.figures.rows import summary_rows
from bayesterra.report.blocks import Cell, Table
from bayesterra.report.numbers import given, interval, resolution, rounded
from bayesterra.report.symbols import amount, symbol, with_unit
from bayesterra.results import Result, field_values

FEW = 3


@dataclass(frozen=True)
class Driving:
    """The small tables of the first screen and their remark.

    Attributes
    ----------
    rows : quantity, median and interval of the derived quantities.
    slip_header, slip_rows : pull and sinkage at a few of the driven slips.
    """

    heading: str
    rows: tuple[tuple[Cell, ...], ...]
    slip_header: tuple[Cell, ...]
    slip_rows: tuple[tuple[Cell, ...], ...]
    remark: Markup

    @classmethod
    def unknown(cls) -> Driving:
        """The table where it cannot be made; the head of the page says why."""
        return cls("", (), (), (), Markup("Not known."))


def driving(result: Result) -> Driving:
    """Derived quantities, and pull and sinkage at a few of the driven slips."""
    wheel = next(iter(result.study.wheels))
    slips = driven_slips(result, wheel)
    few = slips[np.unique(np.linspace(0, len(slips) - 1, FEW).round().astype(int))]
    header, rows = _at_slips(result, wheel, ("drawbar_pull", "sinkage"), few)
    load = reference_load(result.study)
    return Driving(
        f"Wheel {wheel}" if np.isnan(load) else f"Wheel {wheel} under {given(round(load, 1))} N",
        tuple(_derived_row(result, name) for name in DERIVED if name in summary_rows(result)),
        header,
        rows,
        _remark(result, slips),
    )


def driven_slips(result: Result, wheel: str) -> FloatArray:
    """Slips of the wheel's rows that are in the fit, each once, ascending."""
    rows = result.study.observations.used()
    mine = np.array([name == wheel for name in rows.wheel])
    return np.unique(rows.slip[mine] if mine.any() else rows.slip)


def _derived_row(result: Result, name: str) -> tuple[Cell, ...]:
    row = summary_rows(result)[name]
    step = resolution(*row.hdi)
    return (
        DERIVED[name].description,
        amount(name, rounded(row.median, step)),
        interval(*row.hdi, step),
    )


def _quantiles(result: Result, wheel: str, channel: str, slip: float) -> FloatArray:
    """5, 50 and 95 % of the modelled value at a slip, field units."""
    curves = result.draws["curves"].sel(wheel=wheel)
    bands = field_values(channel, curves["modelled"].sel(outcome=channel).to_numpy())
    return np.array([np.interp(slip, curves["slip"].to_numpy(), band) for band in bands[[0, 2, 4]]])


def _at_slips(
    result: Result, wheel: str, channels: tuple[str, ...], slips: FloatArray
) -> tuple[tuple[Cell, ...], tuple[tuple[Cell, ...], ...]]:
    """Head and rows of a table of modelled values at slips, of those channels that the drive gives."""
    known = [name for name in channels if name in result.draws["curves"]["outcome"]]
    heads = [head for name in known for head in (with_unit(name), "90 %")]
    rows = []
    for slip in slips:
        cells: list[Cell] = [f"{slip:.3g}"]
        for name in known:
            low, middle, high = _quantiles(result, wheel, name, float(slip))
            step = resolution(low, high)
            cells += [rounded(middle, step), interval(low, high, step)]
        rows.append(tuple(cells))
    return (Markup("at slip {}").format(symbol("slip")), *heads), tuple(rows)


def _remark(result: Result, slips: FloatArray) -> Markup:
    """Say where the numbers leave the driven slips."""
    row = summary_rows(result).get("peak_pull_slip")
    parts = [Markup("Modelled values without measurement noise.")]
    if result.study.errors.discrepancy:
        parts.append(Markup("Those at slips hold the discrepancy, all others are the model’s alone."))
    if row is None:
        return parts[0]
    if row.hdi90_hi >= SLIP_GRID[-1] - 1e-9:
        parts.append(Markup("The greatest pull is searched up to slip {:.2g}.").format(SLIP_GRID[-1]))
    if row.hdi90_hi > slips[-1]:
        parts.append(Markup("Above the last driven slip, {:.2g}, it is extrapolated.").format(slips[-1]))
    return Markup(" ").join(parts)


def slip_table(result: Result, wheel: str) -> Table:
    """All outcomes at every driven slip of a wheel."""
    outcomes = tuple(str(name) for name in result.draws["curves"]["outcome"].to_numpy())
    header, rows = _at_slips(result, wheel, outcomes, driven_slips(result, wheel))
    caption = Markup(
        "Modelled outcomes of wheel {} at the driven slips, without measurement noise: median and "
        "equal-tailed 90 % interval of the draws, read off the curves above."
    ).format(wheel)
    return Table(caption, "l" + "rr" * len(outcomes), header, rows)
