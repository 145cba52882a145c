"""What a rover does on slopes and against a tow force, as a table on a terminal."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from bayesterra.prediction import UNANSWERED
from bayesterra.report.numbers import interval, resolution, rounded
from bayesterra.rover.geometry import AXLES
from bayesterra.rover.outlook import RoverOutlook
from bayesterra.terminal import PlainConsole


def print_outlook(outlook: RoverOutlook, folder: Path, console: Console | None = None) -> None:
    """Print what a rover does on every slope, the greatest slope, notes, and where the files are."""
    console = console or PlainConsole()
    title = f"rover {outlook.rover.name}, {outlook.rover.weight:.4g} N"
    table = Table(title=title, box=SIMPLE_HEAD, padding=(0, 1))
    for header in ROVER_COLUMNS:
        table.add_column(header, justify="right", no_wrap=True)
    for (slope, tow), rows in outlook.table.groupby(["slope [deg]", "tow [N]"], sort=False):
        cells = rows.set_index(["quantity", "axle"]).to_dict("index")
        slips, depth = _median_90(cells["slip", "rear"], 0.01), _median_90(cells["sinkage", "rear"], 0.1)
        loads = " / ".join(rounded(cells["load", axle]["q50"], 1.0) for axle in AXLES)
        shares = (float(rows[name].iloc[0]) for name in ("cannot", "unanswered"))
        marks = ", ".join(f"{100 * share:.0f}{'!' if share > UNANSWERED else ''}" for share in shares)
        table.add_row(f"{slope:.4g}", f"{tow:.4g}", slips, depth, loads, f"{marks} %")
    console.print(table)
    for line in outlook_lines(outlook):
        console.print(line, highlight=False, soft_wrap=True)
    console.print(f"Written: {folder}   Plot: {folder / 'rover.png'}", highlight=False, soft_wrap=True)


ROVER_COLUMNS = ("slope\n[°]", "tow\n[N]", "slip", "z rear\n[mm]", "loads\n[N]", "cannot,\nno answer")


def _median_90(row: Mapping[Hashable, Any], least: float) -> str:
    """The median, and 5 and 95 %, to a step of ``least`` or coarser."""
    low, high = row["q05"], row["q95"]
    step = max(resolution(low, high), least)
    return f"{rounded(row['q50'], step)} ({interval(low, high, step)})"


def outlook_lines(outlook: RoverOutlook) -> list[str]:
    """The greatest slope and tow force, then what is doubtful and what is assumed."""
    lines = []
    for row in outlook.greatest_table.to_dict("records"):
        low, high = row["q05"], row["q95"]
        step = resolution(low, high)
        where = "" if row["slips"] == "all" else " at driven slips"
        name, unit = str(row["quantity"]).replace("_", " "), "°" if row["unit"] == "deg" else " N"
        middle, ends = rounded(row["q50"], step), interval(low, high, step)
        lines.append(f"{name.capitalize()}{where}: {middle}{unit}, 90 % {ends}{unit}.")
    return [*lines, *(f"Note: {note}." for note in outlook.notes)]
