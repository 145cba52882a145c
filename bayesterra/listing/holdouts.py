"""Scores of levels that were left out, on a terminal."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from bayesterra.holdout import Holdout
from bayesterra.parameters import CHANNELS
from bayesterra.report.numbers import number, plain
from bayesterra.terminal import PlainConsole


def print_holdout(found: Holdout, folder: Path, console: Console | None = None) -> None:
    """Print coverage and mean scores of model and baselines, and where the files are."""
    console = console or PlainConsole()
    title = f"{len(found.levels)} levels left out, one at a time"
    table = Table(title=title, box=SIMPLE_HEAD, padding=(0, 1))
    for header in ("", "", "rows", "mean CRPS", "in 50 %", "in 90 %"):
        table.add_column(header, justify="right" if header else "left", no_wrap=True)
    rows = found.summary[found.summary["part"] == "all"] if len(found.table) else found.table
    for channel in rows["channel"].unique():
        for row in rows[rows["channel"] == channel].to_dict("records"):
            table.add_row(*_scored(row))
        table.add_section()
    console.print(table)
    for outcome in found.outcomes:
        if outcome.status != "converged":
            line = f"! Without {outcome.level}: {outcome.status}. {outcome.note}".rstrip()
            console.print(line, highlight=False, soft_wrap=True)
    console.print(
        f"Page: {folder / 'report.html'}   Plot: {folder / 'holdout.png'}", highlight=False, soft_wrap=True
    )


def _scored(row: Mapping[Hashable, Any]) -> tuple[str, ...]:
    shares = (f"{number(100 * row[name], 0)} %" for name in ("covered50", "covered90"))
    score = f"{plain(row['crps'])} ± {plain(row['crps_se'], 2)} {row['unit']}"
    return (CHANNELS[row["channel"]].symbol, row["predictor"], str(row["rows"]), score, *shares)
