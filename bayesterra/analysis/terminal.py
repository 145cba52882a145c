"""A study and a result on a terminal: what was understood, parameters, verdicts."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
from rich.console import Console
from rich.table import Table

from bayesterra.analysis.simulation import Truth
from bayesterra.likelihood.correlated import TYPICAL
from bayesterra.likelihood.joint import whole_posterior
from bayesterra.likelihood.posterior import draw_cut_prior
from bayesterra.parameters import CHANNELS, PARAMETERS, in_order
from bayesterra.report.terminal import PlainConsole
from bayesterra.stats.laws import RANGED, Law
from bayesterra.stats.quantile_law import QuantileLaw
from bayesterra.study.model_errors import Discrepancy, Ripple, SlipError
from bayesterra.study.priors import Entry, Tie
from bayesterra.study.soil_tests import LEVELS
from bayesterra.study.study import Study


def print_overview(study: Study, console: Console | None = None) -> None:
    """Print title, model, wheels, measurements, priors and notes of a study.

    Raises
    ------
    SupportError : no parameter set of the prior can explain the conditions.
    """
    console = console or PlainConsole()
    groups = whole_posterior(study).groups
    cuts = {name: draw_cut_prior(own, 1000, np.random.default_rng(0)) for name, own in groups.items()}
    console.print(_general(study))
    if study.wheels:
        console.print(_columns(study))
        console.print(_measurements(study))
    if study.soil_tests:
        console.print(_soil_tests(study))
    console.print(_priors(study))
    for names, source in study.prior.sources.items():
        console.print(f"{', '.join(names)}: {source}")
    if study.prior.correlated:
        console.print(_correlations(study))
    for key, mixture in study.prior.mixtures.items():
        console.print(f"{key}: joined by a mixture of {len(mixture.weights)} normal laws of scores")
    doubts = []
    for name, own in groups.items():
        shares = (f"{100 * share:.3g} % {reason}" for reason, share in cuts[name].shares.items())
        console.print(f"Of the stated prior{f', {name} alone' if name else ''}: {', '.join(shares)}")
        doubts.append(own.doubts(cuts[name].x[:TYPICAL]) if own.driven else "")
    for warning in study.warnings:
        console.print(f"Warning: {warning}")
    for note in (*study.notes, *filter(None, dict.fromkeys(doubts))):
        console.print(f"Note: {note}")


def print_truth(truth: Truth) -> None:
    """Print the values that data were simulated with, and where each comes from."""
    table = Table("parameter", "value", "from", title="Simulated with")
    for name, value in truth.values.items():
        table.add_row(name, PARAMETERS[name].field_text(value), truth.origins[name])
    PlainConsole().print(table)


def _general(study: Study) -> Table:
    options = ", ".join(f"{name} {value}" for name, value in asdict(study.model).items())
    table = Table(title=study.title or "Study", show_header=False)
    loads = study.load_range
    flat = "" if loads is None else f"; loads flat from {loads[0]:.4g} to {loads[1]:.4g} N"
    if study.wheels:
        table.add_row("model", f"{study.model.name} ({options})")
        table.add_row("drive", study.drive + flat)
    for name, wheel in study.wheels.items():
        table.add_row(
            f"wheel {name}",
            f"r {wheel.radius * 1e3:g} mm, b {wheel.width * 1e3:g} mm, h {wheel.lug_height * 1e3:g} mm,"
            f" {wheel.lug_count} lugs, r_s {float(wheel.shearing_radius()) * 1e3:.5g} mm",
        )
    for error in study.errors:
        table.add_row(*_error(error))
    table.add_row("data", " · ".join(filter(None, (study.kind, *study.described.values(), study.source))))
    for name, value in study.references.items():
        table.add_row(name, f"{value.source or '(no source)'}: {', '.join(value.values)}")
    return table


def _error(error: Discrepancy | Ripple | SlipError) -> tuple[str, str]:
    """A discrepancy, a ripple or the errors of slip in a line."""
    channel = CHANNELS["slip" if isinstance(error, SlipError) else error.channel]
    unit = channel.unit.removesuffix("-")
    size = "estimated" if error.size.sd is None else f"{error.size.sd / channel.scale:g} {unit}".strip()
    if isinstance(error, Discrepancy):
        kind = "" if error.kernel == "smooth" else f" ({error.kernel})"
        shape = f"a curve per wheel over slips of {error.length:g}{kind}"
        return "discrepancy", f"{channel.name}: sd {size}, {shape}"
    if isinstance(error, Ripple):
        crests = "" if np.isinf(error.period) else f", crests {error.period:g} rows apart"
        return "ripple", f"{channel.name}: sd {size}, memory of {error.memory:g} rows{crests}"
    return "slip", f"read with an error of sd {size}"


def _columns(study: Study) -> Table:
    """How the table was understood, column by column."""
    rows = study.observations
    table = Table("column", "is", "in", "readings", title=f"Columns{f' ({rows.form})' if rows.form else ''}")
    for heading in rows.headings:
        table.add_row(heading.header, heading.name or "–", heading.remark, heading.readings)
    return table


def _soil_tests(study: Study) -> Table:
    """Series of soil tests, and what of the study they read."""
    table = Table("tests", "kind", "number", "readings", "levels", "read", title="Soil tests")
    for name, test in study.soil_tests.items():
        of, levels = LEVELS[test.kind], np.unique(test.readings.levels)
        shown = ", ".join(f"{level / of.scale:g}" for level in levels)
        counts = (str(len(test.readings.tests)), str(len(test.readings)))
        table.add_row(name, test.kind, *counts, f"{of.symbol} {shown} {of.unit}", ", ".join(test.soil))
    return table


def _measurements(study: Study) -> Table:
    """All rows in field units, those left out of the fit dimmed; the noise in the last line."""
    from bayesterra.likelihood.page import noise_text

    rows = study.observations
    columns = {**study.drive.conditioned(rows), **{name: rows.values[name] for name in study.noise}}
    table = Table(title=f"{len(rows)} rows, {int(rows.use.sum())} in use; slip on r_s, sinkage from the rim")
    for header in ("row", *(["wheel"] if len(study.wheels) > 1 else []), "slip"):
        table.add_column(header, justify="right")
    for name in columns:
        table.add_column(f"{name} [{CHANNELS[name].unit}]", justify="right")
    for i, row in enumerate(rows.rows):
        wheel = [rows.wheel[i]] if len(study.wheels) > 1 else []
        cells = [
            rows.marks(name)[i] + ("" if np.isnan(column[i]) else f"{column[i] / CHANNELS[name].scale:.5g}")
            for name, column in columns.items()
        ]
        mark, style = (f"{row}", None) if rows.use[i] else (f"({row})", "dim")
        table.add_row(mark, *wheel, f"{rows.slip[i]:.4g}", *cells, style=style)
    table.add_section()
    empty = [""] * (len(table.columns) - 1 - len(columns))
    table.add_row("noise", *empty, *(noise_text(study.noise.get(name)) for name in columns))
    return table


def _priors(study: Study) -> Table:
    whole = len(whole_posterior(study).names)
    table = Table("parameter", "prior", "in words", title=f"Prior: {whole} free parameters")
    populations = study.pooling.hierarchical if study.pooling else {}
    for name in in_order(study.prior.entries):
        words, entry = PARAMETERS[name].description, study.prior.entries[name]
        if study.pooling is not None and name in (*study.pooling.separate, *populations):
            words += f", of each {study.pooling.by}" + (" from a population" if name in populations else "")
        table.add_row(name, _entry(name, entry), words)
        laws = populations[name].laws(study.prior.laws[name]) if name in populations else ()
        for whole_name, law in zip((f"{name}.mean", f"{name}.spread"), laws, strict=False):
            table.add_row(whole_name, _law(whole_name, law), PARAMETERS[whole_name].description)
    return table


def _entry(name: str, entry: Entry) -> str:
    if isinstance(entry, Tie):
        return f"that of {entry.to}"
    return _law(name, entry) if isinstance(entry, Law) else f"fixed at {PARAMETERS[name].field_text(entry)}"


def _correlations(study: Study) -> Table:
    """Correlations of the normal scores of the laws, to two digits; the lower half."""
    prior = study.prior
    names = [prior.names[i] for i in prior.correlated]
    table = Table("", *names[:-1], title="Prior correlations of normal scores")
    matrix = prior.dependence().correlation
    for i in range(1, len(names)):
        cells = (f"{value:+.2f}".replace("-", "−") for value in matrix[i, :i])
        table.add_row(names[i], *cells)
    return table


def _law(name: str, law: Law) -> str:
    """A law in field units; of its arguments ``loc`` and ``scale`` have one."""
    if isinstance(law, QuantileLaw):
        low, middle, high = law.quantile(np.array([0.05, 0.5, 0.95])) / PARAMETERS[name].scale
        unit = PARAMETERS[name].unit.removesuffix("-")
        return f"{law.dist}: median {middle:.4g}, 90 % {low:.4g} to {high:.4g} {unit}".rstrip()
    scaled = ("loc", "scale")
    arguments = [f"{k} {PARAMETERS[name].field_text(v) if k in scaled else f'{v:g}'}" for k, v in law.shape.items()]
    if np.isfinite([law.lower, law.upper]).any():
        cut = "" if law.dist in RANGED else "cut to "
        arguments.append(f"{cut}{law.lower / PARAMETERS[name].scale:.6g} to {PARAMETERS[name].field_text(law.upper)}")
    return f"{law.dist}: {', '.join(arguments)}"
