"""Fits of least squares, as objects and as a table for ``least_squares.csv`` and the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray
from bayesterra.models import Soil
from bayesterra.parameters import CHANNELS, MODEL_PARAMETERS, PARAMETERS
from bayesterra.study.study import Study

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table as RichTable


FORCES = ("normal_force", "drawbar_pull", "resistance_moment")
"""The channels that IM1, IM2 and IM3 fit."""

METHODS = ("IM1", "IM2", "IM3", "joint")


@dataclass(frozen=True)
class Fit:
    """Soil parameters found by one method, and how it went.

    Attributes
    ----------
    method : ``IM1``, ``IM2``, ``IM3`` or ``joint``.
    soil : the parameters, SI and radians. Those in ``missing`` stand at their start values.
    errors : fit error (16) in percent of each channel, NaN where it was not measured or not fitted. IM1 and
        joint are judged by their model, IM2 and IM3 by their equations with the measured F_N and M_DR put in.
    converged : the passes met the criterion and every inner fit ended at a minimum.
    passes : passes of IM1, rounds of noise weights of joint, else 1.
    path : the parameters after each pass.
    held : parameters that were not free.
    at_bound : free parameters within 1e-4 of their range from a bound.
    missing : parameters that could not be identified; ``notes`` say why.
    clipped : at some slip, θm/θ1 (or N) was clipped to the model's range; with joint, it is at its edge.
    notes : in words, one line each.
    seconds : time taken.
    noise : typical standard deviation of each channel behind the weights of joint, SI; else empty.
    """

    method: str
    soil: Soil
    errors: Mapping[str, float]
    converged: bool
    passes: int
    path: tuple[Soil, ...]
    held: tuple[str, ...]
    at_bound: tuple[str, ...]
    missing: tuple[str, ...]
    clipped: bool
    notes: tuple[str, ...]
    seconds: float
    noise: Mapping[str, float]

    def values(self) -> dict[str, float]:
        """Soil parameters by name, SI and radians."""
        return {
            name: float(getattr(self.soil, name)) for name in MODEL_PARAMETERS if hasattr(self.soil, name)
        }

    def identified(self) -> dict[str, float]:
        """Soil parameters by name without those that the data could not tell."""
        return {name: value for name, value in self.values().items() if name not in self.missing}


def error_figure(measured: FloatArray, predicted: FloatArray) -> float:
    """Largest misfit in percent of the largest reading, Ding et al. 2015, eq. (16).

    Readings that are NaN count for nothing; NaN where there is no reading or every reading is 0.
    """
    read = ~np.isnan(measured)
    if not np.any(measured[read]):
        return float("nan")
    return float(100 * np.max(np.abs(measured - predicted)[read]) / np.max(np.abs(measured[read])))


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
    from bayesterra.report.terminal import PlainConsole

    console = console or PlainConsole()
    console.print(_table(fits, study))
    console.print("= held   | at a bound   – not identified   errors: largest misfit / largest reading, (16)")
    for fit in fits.values():
        console.print(f"{fit.method}: {_sentence(fit)}", highlight=False)


def _table(fits: Mapping[str, Fit], study: Study) -> RichTable:
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
        reference_cell = [_known(reference.values, name)] if reference else []
        table.add_row(_label(name), unit, *cells, *reference_cell)
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
    clauses = ["converged" if fit.converged else "did not converge"]
    if fit.passes > 1:
        clauses.append(f"{fit.passes} {'rounds of weights' if fit.method == 'joint' else 'passes'}")
    return "; ".join([*clauses, f"{fit.seconds:.2f} s", *fit.notes])


def of_fit(fitted: Fit) -> dict[str, Any]:
    """End of a least-squares fit in words."""
    return {
        "converged": fitted.converged,
        "passes": fitted.passes,
        "errors_percent": dict(fitted.errors),
        "held": list(fitted.held),
        "at_bound": list(fitted.at_bound),
        "missing": list(fitted.missing),
        "notes": list(fitted.notes),
    }
