"""What data or a design determine, on a terminal."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console, JustifyMethod
from rich.table import Table

from bayesterra.identified import Foreseen, Identified, expected_contraction
from bayesterra.parameters import PARAMETERS
from bayesterra.terminal import PlainConsole


def print_identified(made: Identified, report: Path, console: Console | None = None) -> None:
    """Print the finding, the verdict on every parameter with its figures, and the name of the page."""
    console = console or PlainConsole()
    table = Table(title=made.study.title or None, box=SIMPLE_HEAD, padding=(0, 1))
    for header in IDENTIFIED:
        side: JustifyMethod = "right" if header == "contraction" else "left"
        table.add_column(header, justify=side, no_wrap=header != "verdict")
    for row in made.found.verdicts.to_dict("records"):
        table.add_row(*_identified(row))
    console.print(table)
    for row in made.found.verdicts.to_dict("records"):
        if row["against"]:
            symbol = PARAMETERS[row["parameter"]].symbol
            console.print(f"! {symbol}: {row['against']}.", highlight=False, soft_wrap=True)
    if not made.record["converged"]:
        console.print("! The sampling did not converge: do not rely on what rests on draws.", highlight=False)
    console.print(made.sentence, highlight=False, soft_wrap=True)
    console.print(f"Report: {report}", highlight=False, soft_wrap=True)


IDENTIFIED = ("", "verdict", "contraction", "tied to", "profile")
PROFILES = {"bounded only by the prior": "prior-bound"}
"""Classes of profiles in fewer letters, so that no row of the table breaks on 80 columns."""


def _identified(row: Mapping[Hashable, Any]) -> tuple[str, ...]:
    tied = row["tied_to"] != row["parameter"]
    tie = f"{PARAMETERS[row['tied_to']].symbol} {row['tie']:+.2f}".replace("-", "−") if tied else ""
    profile = PROFILES.get(row["profile"], row["profile"])
    return (PARAMETERS[row["parameter"]].symbol, row["verdict"], _share(row["contraction"]), tie, profile)


def _share(contraction: float) -> str:
    return f"{max(contraction, 0.0):.2f}"


def print_foreseen(made: Foreseen, console: Console | None = None) -> None:
    """Print what a design could determine, and what contraction to expect."""
    console = console or PlainConsole()
    table = Table(title=made.study.title or None, box=SIMPLE_HEAD, padding=(0, 1))
    for header in ("", "the design could", "contraction to expect"):
        table.add_column(header, justify="right" if header.startswith("contraction") else "left")
    seen = made.found.structure.determined
    for name, expected in zip(made.found.names, expected_contraction(made), strict=True):
        word = "determine it" if name in seen else "NOT determine it"
        table.add_row(PARAMETERS[name].symbol, word, _share(expected))
    console.print(table)
    for null in made.found.structure.nulls:
        console.print(f"{null.words[:1].upper()}{null.words[1:]}.", highlight=False, soft_wrap=True)
    console.print("Expected over the prior after the physical cut, were the readings made.", highlight=False)
