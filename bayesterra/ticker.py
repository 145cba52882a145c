"""What following a rover shows on a terminal: a line per row, alarms, and what is known at the end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from bayesterra.console import note
from bayesterra.following import FIGURE, Following, Seen
from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.report.numbers import interval, resolution, rounded
from bayesterra.terminal import PlainConsole


def print_row(seen: Seen, *, quiet: bool) -> None:
    """One line: slip, every reading beside what was expected of it, particles, time; alarms in their own."""
    if seen.update is None or seen.row is None:
        note(f"left out: {seen.problem}")
        return
    update = seen.update
    if not quiet:
        readings = "  ".join(filter(None, (_reading(one) for one in update.predictive.to_dict("records"))))
        moved = (
            f", moved {sum(event.sweeps for event in update.rejuvenations)}×" if update.rejuvenated else ""
        )
        PlainConsole().print(
            f"{update.row:>4}  slip {seen.row.slip[0]:.3f}  {readings}"
            f"  ({update.effective:.0f} effective{moved}, {1e3 * update.seconds:.0f} ms)",
            highlight=False,
            soft_wrap=True,
        )
    if update.alarm:
        anew = "; begun anew there" if seen.begun_anew is not None else ""
        PlainConsole().print(f"! {update.alarm.sentence}{anew}", highlight=False, soft_wrap=True)


def _reading(one: dict[object, object]) -> str:
    """A reading and the 90 % interval that was expected; what was not measured says nothing."""
    observed, low, high = (float(str(one[key])) for key in ("observed", "q05", "q95"))
    if np.isnan(observed):
        return ""
    symbol, unit = CHANNELS[str(one["channel"])].symbol, str(one["unit"])
    if np.isnan(low):
        return f"{symbol} {observed:.4g} {unit} (nothing was expected)"
    step = resolution(low, high)
    outside = "" if low <= observed <= high else " *"
    return f"{symbol} {rounded(observed, step)} {unit} {interval(low, high)}{outside}"


def print_end(found: Following, out: Path | None) -> None:
    """Print the parameters, the evidence, the alarms and where the files are."""
    console, stream = PlainConsole(), found.stream
    soil = f", soil {found.soil} since row {stream.offset + 1}" if found.soil > 1 else ""
    table = Table(title=f"{stream.study.title or 'stream'}{soil}", box=SIMPLE_HEAD, padding=(0, 1))
    for header in ("parameter", "unit", "median", "90 % interval"):
        table.add_column(header, justify="left" if header in ("parameter", "unit") else "right", no_wrap=True)
    for one in stream.summary.to_dict("records"):
        low, high = float(one["q05"]), float(one["q95"])
        middle = rounded(float(one["median"]), resolution(low, high))
        table.add_row(PARAMETERS[one["parameter"]].symbol, one["unit"], middle, interval(low, high))
    console.print(table)
    left = f", {found.left_out} left out" if found.left_out else ""
    evidence = f"log evidence {stream.log_evidence:.2f} ± {stream.log_evidence_error:.2f}"
    console.print(f"{len(stream)} rows{left}; {evidence}.", highlight=False)
    if stream.watch.rate is None:
        console.print("Changes of soil were not looked for.", highlight=False)
    elif not found.alarms and stream.alarm is None:
        console.print(
            f"No change of soil was found (at most {stream.watch.rate:g} false alarms per row, on average"
            " over the prior).",
            highlight=False,
        )
    if out is not None:
        console.print(f"Written: {out}   Plot: {out / FIGURE}", highlight=False, soft_wrap=True)
