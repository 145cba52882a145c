"""Parameters of a soil test on a terminal."""

from __future__ import annotations

from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from bayesterra.report.numbers import interval, resolution, rounded
from bayesterra.report.soiltests import CHECK
from bayesterra.report.validation import misfit_text
from bayesterra.soiltests.analysis import SoilTestResult
from bayesterra.soiltests.quantities import QUANTITIES as SOIL_TEST_QUANTITIES
from bayesterra.terminal import PlainConsole, print_failures


def print_soil_test(found: SoilTestResult, report: Path, console: Console | None = None) -> None:
    """Print the parameters of a soil test, what is against the model, and the name of the report."""
    console = console or PlainConsole()
    table = Table(title=found.record["title"] or None, box=SIMPLE_HEAD, padding=(0, 1))
    for header in ("", "unit", "median", "90 % HDI", "verdict"):
        table.add_column(header, justify="right" if header in ("median", "90 % HDI") else "left")
    words = found.identifiability.set_index("parameter")["verdict"].to_dict()
    for row in found.summary.to_dict("records"):
        known = SOIL_TEST_QUANTITIES.get(row["parameter"])
        low, high = row["hdi90_lo"], row["hdi90_hi"]
        figures = rounded(row["median"], resolution(low, high)), interval(low, high)
        symbol = known.symbol if known else row["parameter"]
        table.add_row(symbol, row["unit"], *figures, words.get(row["parameter"], ""))
    console.print(table)
    for note in (*found.test.notes, *found.record["fits"]["notes"]):
        console.print(f"note: {note}.", highlight=False, soft_wrap=True)
    if found.misfit:
        PlainConsole(stderr=True).print(misfit_text(found.misfit, CHECK), highlight=False, soft_wrap=True)
    if not found.converged:
        console.print("! The sampling did not converge: do not rely on what rests on draws.", highlight=False)
    if found.sentence:
        console.print(found.sentence, highlight=False, soft_wrap=True)
    print_failures(console, found.record)
    console.print(f"Report: {report}", highlight=False, soft_wrap=True)
