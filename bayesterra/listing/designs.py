"""Candidates of a design on a terminal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from bayesterra.design.choosing import BIT, Design
from bayesterra.design.choosing import UNANSWERED as LOST
from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.report.design import figures_of
from bayesterra.report.numbers import NOTHING, with_error
from bayesterra.terminal import PlainConsole

PRINTED = 15
"""Candidates in the table on a terminal; design.csv has all."""


def print_design(design: Design, folder: Path, console: Console | None = None) -> None:
    """Print the ranking with its Monte Carlo errors, what is recommended, and where the files are."""
    console = console or PlainConsole()
    console.print(_ranking(design))
    for line in design_lines(design):
        console.print(line, highlight=False, soft_wrap=True)
    console.print(
        f"Page: {folder / 'report.html'}   Plot: {folder / 'design.png'}", highlight=False, soft_wrap=True
    )


def _ranking(design: Design) -> Table:
    about = design.about[:3]
    table = Table(title=f"one more drive, about {', '.join(design.about)}", box=SIMPLE_HEAD, padding=(0, 1))
    for header in ("", "drive", "channels"):
        table.add_column(header)
    deviations = [f"sd {PARAMETERS[name].symbol} [{PARAMETERS[name].unit}]" for name in about]
    for header in ("gain [bit]", "behind the best", *deviations):
        table.add_column(header, justify="right", no_wrap=True)
    for rank, index in enumerate(design.ranking.order[:PRINTED], start=1):
        table.add_row(str(rank), *_candidate(design, index, len(about)))
    return table


def _candidate(design: Design, index: int, deviations: int) -> tuple[str, ...]:
    candidate, one = design.candidates[index], design.ranking.estimates[index]
    lag, lag_error = (value / BIT for value in design.ranking.behind(index))
    symbols = " ".join(CHANNELS[name].symbol for name in candidate.channels)
    mark = " !" if 1 - one.answered > LOST else ""
    known = with_error(one.values[0] / BIT, one.errors[0] / BIT) if np.isfinite(one.values[0]) else (NOTHING,)
    behind = " ± ".join(with_error(lag, lag_error)) if lag > 0 else ""
    changes = (" → ".join(figures_of(design, i, one)[:2]) for i in range(deviations))
    return (candidate.where + mark, symbols, " ± ".join(known), behind, *changes)


def design_lines(design: Design) -> list[str]:
    """What is recommended and expected, and what to keep in mind."""
    last = design.together[-1]
    gain, error = with_error(last.values[0] / BIT, last.errors[0] / BIT)
    drives = "; ".join(one.where for one in design.chosen)
    lines = [f"Recommended: {drives}: {gain} ± {error} bit about {', '.join(design.about)}."]
    for i, name in enumerate(design.about):
        before, after, off = figures_of(design, i, last)
        unit = "" if PARAMETERS[name].unit == "-" else f" {PARAMETERS[name].unit}"
        lines.append(f"  sd of {PARAMETERS[name].symbol} from {before} to {after} ± {off}{unit}")
    if "regression" in (design.method, design.ranking.method):
        lines.append("Few draws remain effective after such readings: gains are lower bounds, by regression.")
    if design.situation.source == "prior":
        lines.append(
            "From the prior alone, no readings used; a result folder in place of the study builds on them."
        )
    marked = sum(1 - one.answered > LOST for one in design.ranking.estimates)
    if marked:
        lines.append(f"! At {marked} candidates the model has no answer for over {LOST:.0%} of the draws.")
    return lines
