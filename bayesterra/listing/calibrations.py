"""Ranks of a calibration and their verdict on a terminal."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from bayesterra.calibration import Calibration
from bayesterra.calibration.judging import UNSETTLED
from bayesterra.calibration.quantities import AT_SLIP
from bayesterra.calibration.ranks import COVERAGES
from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.terminal import PlainConsole


def print_calibration(found: Calibration, report: Path, console: Console | None = None) -> None:
    """Print the verdict with what stands behind it, and the name of the report."""
    console = console or PlainConsole()
    table = Table(title=found.study.title or None, box=SIMPLE_HEAD, padding=(0, 1))
    for header in ("quantity", "p", "shift", "width", *(f"{100 * q:.0f} %" for q in COVERAGES)):
        table.add_column(header, justify="left" if header == "quantity" else "right", no_wrap=True)
    for row in found.tests.to_dict("records"):
        table.add_row(*_ranked(row))
    console.print(table)
    console.print("shift and width in sd of a right posterior; truths inside central intervals in %")
    for line in calibration_lines(found):
        console.print(line, highlight=False, soft_wrap=True)
    console.print(f"Report: {report}", highlight=False, soft_wrap=True)


def _ranked(row: Mapping[Hashable, Any]) -> tuple[str, ...]:
    name = _short(str(row["quantity"]))
    if row["verdict"] == "constant":
        return (name, "constant")
    mark = "" if row["verdict"] == "uniform" else " ✕"
    shares = (f"{100 * row[f'covered_{100 * q:.0f}']:.0f}" for q in COVERAGES)
    return (name, f"{row['p_value']:.4f}{mark}", f"{row['shift']:+.2f}", f"{row['width']:.2f}", *shares)


def _short(quantity: str) -> str:
    """A test quantity in few letters: parameters by their names, channels by their symbols."""
    channel = quantity.removesuffix(AT_SLIP)
    if channel in CHANNELS:
        return f"{CHANNELS[channel].symbol} at largest slip"
    return quantity if quantity in PARAMETERS else quantity.replace("_", " ")


def calibration_lines(found: Calibration) -> list[str]:
    """The verdict, what did not converge, and what would have been noticed."""
    n, power = len(found.table), found.power.iloc[1]
    smallest = found.tests["p_value"].min() if found.tested else np.nan
    word = "NOT calibrated" if found.failing else found.verdict
    lines = [f"Posterior {word}: smallest p {smallest:.2g}, threshold {found.threshold:.2g}."]
    if found.unsettled:
        allowed = f"{UNSETTLED:.0%} allowed"
        lines.append(f"{found.unsettled} of {n} replications did not converge ({allowed}).")
    lines.append(
        f"{n} replications notice a {power['error']} with probability {power['one']:.2f} in one parameter,"
        f" {power['all']:.2f} in all."
    )
    return lines
