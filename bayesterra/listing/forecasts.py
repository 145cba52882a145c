"""Predictions as tables on a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from bayesterra.prediction import PREDICTED, UNANSWERED, Prediction
from bayesterra.report.numbers import interval, resolution, rounded
from bayesterra.terminal import PlainConsole


def print_forecast(points: Sequence[Prediction], folder: Path, console: Console | None = None) -> None:
    """Print the bands at the slips that were asked for, what is doubtful, and where the files are."""
    console = console or PlainConsole()
    for at in points:
        console.print(_bands(at))
        console.print(_derived(at))
        for line in _remarks(at):
            console.print(line, highlight=False, soft_wrap=True)
    console.print(f"Written: {folder}   Plot: {folder / 'prediction.png'}", highlight=False, soft_wrap=True)


def _bands(at: Prediction) -> Table:
    table = Table(title=f"wheel {at.name} under {at.load:.4g} N", box=SIMPLE_HEAD, padding=(0, 1))
    for header in ("slip", "", "median", "90 %", "90 % of readings", "no answer"):
        table.add_column(header, justify="right" if header else "left", no_wrap=True)
    rows = at.table.set_index(["slip", "quantity"])
    for slip, share in zip(at.slip, at.unanswered, strict=True):
        for i, (name, known) in enumerate(PREDICTED.items()):
            unit = "" if known.unit == "-" else f" [{known.unit}]"
            mark = f"{100 * share:.3g} %{' !' if share > UNANSWERED else ''}"
            first, last = ("", "") if i else (f"{slip:.4g}", mark)
            table.add_row(first, f"{known.symbol}{unit}", *_cells(rows.loc[(slip, name)].to_dict()), last)
        table.add_section()
    return table


def _cells(row: Mapping[str, float]) -> tuple[str, str, str]:
    low, high = row["modelled_q05"], row["modelled_q95"]
    step = resolution(low, high)
    readings = row["reading_q05"], row["reading_q95"]
    noisy = "" if np.isnan(readings).any() else interval(*readings)
    return rounded(row["modelled_q50"], step), interval(low, high, step), noisy


def _derived(at: Prediction) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 1))
    for header, side in (("derived", "left"), ("unit", "left"), ("median", "right"), ("90 % HDI", "right")):
        table.add_column(header, justify="right" if side == "right" else "left")
    table.add_column("prior 90 %", justify="right")
    for row in at.derived_table.to_dict("records"):
        step = resolution(row["hdi90_lo"], row["hdi90_hi"])
        table.add_row(
            str(row["quantity"]).replace("_", " "),
            str(row["unit"]),
            rounded(row["median"], step),
            interval(row["hdi90_lo"], row["hdi90_hi"], step),
            interval(row["prior_q05"], row["prior_q95"]),
        )
    return table


def _remarks(at: Prediction) -> list[str]:
    lines = [f"Note: {note}." for note in at.notes]
    rows = at.table.drop_duplicates("slip").set_index("slip")
    for slip in at.marked:
        row = rows.loc[slip]
        lines.append(
            f"! At slip {slip:.4g} the model has no answer for {row['no_answer']} of {row['draws']} draws"
            f" ({row['reason']}): the band holds the others only, do not rely on it."
        )
    return lines
