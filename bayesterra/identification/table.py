"""Fits as a table: for ``least_squares.csv`` and for the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bayesterra.identification.fits import Fit
from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.study import Study

if TYPE_CHECKING:  # rich is loaded only where something is printed
    from rich.console import Console
    from rich.table import Table

COLUMNS = ("method", "parameter", "unit", "value", "published", "credible_level")


def report_table(fits: Mapping[str, Fit], study: Study | None = None) -> pd.DataFrame:
    """One row per method and parameter, then ``error_<channel>`` in percent; values in field units.

    A parameter that a method could not identify has the value NaN. ``published`` comes from the study;
    ``credible_level`` is NaN until a posterior fills it.
    """
    published = study.published.values if study and study.published else {}
    rows = [row for fit in fits.values() for row in _rows(fit, published)]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _rows(fit: Fit, published: Mapping[str, float]) -> Iterator[tuple[str, str, str, float, float, float]]:
    for name, value in fit.values().items():
        if name == "c3" and name in fit.held and value == 0:
            continue  # the wheel leaves the soil at the bottom: nothing to tell
        unit, scale = PARAMETERS[name].unit, PARAMETERS[name].scale
        shown = np.nan if name in fit.missing else value / scale
        yield fit.method, name, unit, shown, published.get(name, np.nan) / scale, np.nan
    for channel, error in fit.errors.items():
        yield fit.method, f"error_{channel}", "%", error, np.nan, np.nan


def print_fits(fits: Mapping[str, Fit], study: Study, console: Console | None = None) -> None:
    """Print the fits side by side, with published values where there are any, and what to know of each."""
    from bayesterra.terminal import PlainConsole

    console = console or PlainConsole()
    console.print(_table(fits, study))
    console.print("= held   | at a bound   – not identified   errors: largest misfit / largest reading, (16)")
    for fit in fits.values():
        console.print(f"{fit.method}: {_sentence(fit)}", highlight=False)


def _table(fits: Mapping[str, Fit], study: Study) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    rows = report_table(fits)
    reference = study.published or study.truth
    title = f"Least squares: {study.title}" if study.title else "Least squares"
    table = Table(title=title, box=SIMPLE_HEAD, padding=(0, 1))
    for header in ("parameter", "unit"):
        table.add_column(header)
    for header in (*fits, *(["truth" if reference is study.truth else "published"] if reference else [])):
        table.add_column(header, justify="right")
    units = rows.drop_duplicates("parameter")
    for name, unit in zip(units["parameter"], units["unit"], strict=True):
        cells = [_cell(fit, name, rows) for fit in fits.values()]
        known = [_known(reference.values, name)] if reference else []
        table.add_row(_label(name), unit, *cells, *known)
    return table


def _label(name: str) -> str:
    channel = name.removeprefix("error_")
    return PARAMETERS[name].symbol if name in PARAMETERS else f"error of {CHANNELS[channel].symbol}"


def _cell(fit: Fit, name: str, rows: pd.DataFrame) -> str:
    value = rows.loc[(rows["method"] == fit.method) & (rows["parameter"] == name), "value"]
    if value.empty or np.isnan(value.iloc[0]):
        return "–"
    mark = "= " if name in fit.held else "| " if name in fit.at_bound else ""
    return f"{mark}{value.iloc[0]:.4g}"


def _known(values: Mapping[str, float], name: str) -> str:
    return f"{values[name] / PARAMETERS[name].scale:.4g}" if name in values else ""


def _sentence(fit: Fit) -> str:
    parts = ["converged" if fit.converged else "did not converge"]
    if fit.passes > 1:
        parts.append(f"{fit.passes} {'rounds of weights' if fit.method == 'joint' else 'passes'}")
    return "; ".join([*parts, f"{fit.seconds:.2f} s", *fit.notes])
