"""A study on a terminal: what was understood of it, and the values that readings were simulated with."""

from __future__ import annotations

import numpy as np

from bayesterra.analysis.simulation import Truth
from bayesterra.likelihood.correlated import TYPICAL
from bayesterra.likelihood.joint import whole_posterior
from bayesterra.likelihood.posterior import draw_cut_prior
from bayesterra.parameters import PARAMETERS
from bayesterra.report.blocks import Cell, Overview, Table, Text
from bayesterra.report.numbers import signed
from bayesterra.study.soil_tests import LEVELS
from bayesterra.study.study import Study


def study_overview(study: Study) -> Overview:
    """Title, columns, measurements, wheels, model, priors and notes of a study, as its pages show them.

    Raises
    ------
    SupportError : no parameter set of the prior can explain the conditions.
    """
    from bayesterra.likelihood.page import described, priors_table

    whole = whole_posterior(study)
    lines, doubts = [f"{', '.join(names)}: {source}" for names, source in study.prior.sources.items()], []
    for key, mixture in study.prior.mixtures.items():
        lines.append(f"{key}: joined by a mixture of {len(mixture.weights)} normal laws of scores")
    for name, own in whole.groups.items():
        cut = draw_cut_prior(own, 1000, np.random.default_rng(0))
        shares = (f"{100 * share:.3g} % {reason}" for reason, share in cut.shares.items())
        lines.append(f"Of the stated prior{f', {name} alone' if name else ''}: {', '.join(shares)}")
        doubts.append(own.doubts(cut.x[:TYPICAL]) if own.driven else "")
    lines += [f"Warning: {warning}" for warning in study.warnings]
    lines += [f"Note: {note}" for note in (*study.notes, *filter(None, dict.fromkeys(doubts)))]
    return (
        _general(study),
        *((_columns(study), *described(study)) if study.wheels else ()),
        *([_soil_tests(study)] if study.soil_tests else []),
        priors_table(study, f"Prior: {len(whole.names)} free parameters", str),
        *([_correlations(study)] if study.prior.correlated else []),
        *map(Text, lines),
    )


def truth_overview(truth: Truth) -> Overview:
    """Values that readings were simulated with, and where each comes from."""
    rows = ((name, PARAMETERS[name].field_text(value), truth.origins[name]) for name, value in truth.values.items())
    return (Table("Simulated with", "lll", ("parameter", "value", "from"), tuple(rows)),)


def _general(study: Study) -> Table:
    described = filter(None, (study.kind, *study.described.values(), study.source))
    rows: list[tuple[Cell, ...]] = [("data", " · ".join(described))]
    if study.load_range is not None:
        rows.append(("loads", "flat from {:.4g} to {:.4g} N".format(*study.load_range)))
    for name, value in study.references.items():
        rows.append((name, f"{value.source or '(no source)'}: {', '.join(value.values)}"))
    return Table(study.title or "Study", "ll", ("", ""), tuple(rows))


def _columns(study: Study) -> Table:
    """How the table was understood, column by column."""
    rows = study.observations
    cells = ((each.header, each.name or "–", each.remark, each.readings) for each in rows.headings)
    title = f"Columns{f' ({rows.form})' if rows.form else ''}"
    return Table(title, "llll", ("column", "is", "in", "readings"), tuple(cells))


def _soil_tests(study: Study) -> Table:
    """Series of soil tests, and what of the study they read."""
    rows: list[tuple[Cell, ...]] = []
    for name, test in study.soil_tests.items():
        of, levels = LEVELS[test.kind], np.unique(test.readings.levels)
        shown = ", ".join(f"{level / of.scale:g}" for level in levels)
        counts = (str(len(test.readings.tests)), str(len(test.readings)))
        rows.append((name, test.kind, *counts, f"{of.symbol} {shown} {of.unit}", ", ".join(test.soil)))
    return Table("Soil tests", "llrrll", ("tests", "kind", "number", "readings", "levels", "read"), tuple(rows))


def _correlations(study: Study) -> Table:
    """Correlations of the normal scores of the laws, to two digits; the lower half."""
    names = [study.prior.names[i] for i in study.prior.correlated]
    matrix = study.prior.dependence().correlation
    rows = ((names[i], *map(signed, matrix[i, :i]), *[""] * (len(names) - 1 - i)) for i in range(1, len(names)))
    title = "Prior correlations of normal scores"
    return Table(title, "l" + "r" * (len(names) - 1), ("", *names[:-1]), tuple(rows))
