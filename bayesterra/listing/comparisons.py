"""Results side by side on a terminal."""

from __future__ import annotations

from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from bayesterra.notebook import evidence_lines
from bayesterra.report.numbers import interval, resolution, rounded
from bayesterra.side_by_side import Comparison
from bayesterra.terminal import PlainConsole


def print_comparison(comparison: Comparison, folder: Path, console: Console | None = None) -> None:
    """Print medians and intervals side by side, what the evidence says, and the name of the page."""
    console = console or PlainConsole()
    console.print(_side_by_side(comparison))
    for line in evidence_lines(comparison):
        console.print(line, highlight=False)
    console.print(f"Page: {folder / 'comparison.html'}", highlight=False, soft_wrap=True)


def _side_by_side(comparison: Comparison) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 1))
    table.add_column("median (90 % HDI)")
    table.add_column("unit")
    for name in comparison.names:
        table.add_column(name, justify="right")
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for row in comparison.parameters.to_dict("records"):
        step = resolution(row["hdi90_lo"], row["hdi90_hi"])
        ends = interval(row["hdi90_lo"], row["hdi90_hi"], step)
        key = (str(row["quantity"]).replace("_", " "), str(row["unit"]))
        cells.setdefault(key, {})[str(row["result"])] = f"{rounded(row['median'], step)} ({ends})"
    for (quantity, unit), found in cells.items():
        table.add_row(quantity, unit, *(found.get(name, "") for name in comparison.names))
    return table
