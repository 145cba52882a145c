"""A study on a page and on a terminal: readings, wheels, model, noise, prior and its physical support."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from markupsafe import Markup

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.correlated import TYPICAL
from bayesterra.likelihood.joint import whole_posterior
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior
from bayesterra.parameters import CHANNELS, PARAMETERS, in_order
from bayesterra.report.blocks import Blocks, Cell, Overview, Table, Text
from bayesterra.report.numbers import NOTHING, column, given, share, signed
from bayesterra.report.sections import Prose
from bayesterra.report.symbols import amount, angles, listed, symbol, symbols, with_unit
from bayesterra.stats.laws import Law
from bayesterra.study.model_errors import Size
from bayesterra.study.page import law_text
from bayesterra.study.priors import Entry, Tie
from bayesterra.study.soil_tests import LEVELS
from bayesterra.study.study import Study

say = Prose("conditions")


def slip_note(target: Posterior, x: FloatArray) -> tuple[Text, ...]:
    """Rows where errors of slip are not what the first order makes of them, at typical draws (n, d)."""
    doubts = target.doubts(x)
    return (Text(Markup("Note: {}.").format(doubts), "bad"),) if doubts else ()


def described(study: Study) -> Overview:
    """Rows, wheels and model."""
    errors = errors_text(study)
    return (_readings(study), _wheels(study), Text(_model(study)), *([Text(errors)] if errors else []))


def conditions(study: Study) -> Blocks:
    """Rows, wheels, model and notes."""
    notes = [Text(Markup("Warning: {}").format(warning), "bad") for warning in study.warnings]
    notes += [Text(Markup("Note: {}").format(note)) for note in study.notes]
    return (*described(study), *notes)


def _readings(study: Study) -> Table:
    rows = study.observations
    columns = {**study.drive.conditioned(rows), **{name: rows.values[name] for name in study.noise}}
    many, again = len(study.wheels) > 1, study.repeats
    last = 2 if again else 1
    table: dict[Cell, list[str]] = {"row": [*map(str, rows.rows), "noise (sd)", "repeats (sd)"][: len(rows) + last]}
    if many:
        table["wheel"] = [*rows.wheel, *[""] * last]
    table[symbol("slip")] = [*column(rows.slip, 4), *[""] * last]
    for name, values in columns.items():
        cells = zip(rows.marks(name), column(values / CHANNELS[name].scale), strict=True)
        noise = noise_text(study, name)
        own = [f"{again[name].sd / CHANNELS[name].scale:.2g}" if name in again else ""] if again else []
        table[with_unit(name)] = [*(f"{mark}{cell}" for mark, cell in cells), noise, *own]
    table["in the fit"] = [*("yes" if use else "no" for use in rows.use), *[""] * last]
    caption = say("readings", study.kind, study.source, bool(again))
    align = "l" + "l" * many + "r" * (len(columns) + 1) + "c"
    return Table(caption, align, tuple(table), tuple(zip(*table.values(), strict=True)))


def noise_text(study: Study, name: str, unit: str = "") -> str:
    """Noise of a channel in its field unit, in a few words; lengths and forces are followed by ``unit``."""
    if name not in study.noise:
        return "given"
    noise, scale = study.noise[name], CHANNELS[name].scale
    tails = noise.tails.words and f", {noise.tails.words}"
    tails += f", read to {noise.resolution / scale:g}{unit}" if noise.resolution else ""
    rows = study.observations.used()
    own = rows.given_sd.get(name, np.full(len(rows), np.nan))[~np.isnan(rows.values[name])] / scale
    by_row = own[~np.isnan(own)]
    if noise.law is not None:
        text = "estimated"
    elif noise.fraction is not None:
        text = f"{100 * noise.fraction:g} %, at least {noise.floor / scale:g}{unit}"
    else:
        text = f"{(noise.sd or 0.0) / scale:g}{unit}"
    if by_row.size:
        ends = " to ".join(dict.fromkeys(f"{end:.3g}" for end in (by_row.min(), by_row.max())))
        text = f"by row, {ends}{unit}" + (f", else {text}" if by_row.size < own.size else "")
    return f"{text}{tails}"


def _wheels(study: Study) -> Table:
    rows = tuple(
        (
            name,
            *(given(length * 1e3) for length in (wheel.radius, wheel.width, wheel.lug_height)),
            str(wheel.lug_count),
            NOTHING if wheel.shearing_radius_coefficient is None else f"{wheel.shearing_radius_coefficient:.3g}",
            f"{float(wheel.shearing_radius()) * 1e3:.4g}",
        )
        for name, wheel in study.wheels.items()
    )
    return say.table("wheels", rows)


def _model(study: Study) -> Markup:
    options = ", ".join(f"{name.replace('_', ' ')} {_option(value)}" for name, value in study.model.options.items())
    return say("model", study.model, options, study.drive.sentence, _law_of_noise(study))


def errors_text(study: Study) -> Markup:
    """Discrepancy, ripple and slip errors in words; "" where there are none."""
    errors = study.errors
    discrepancy = listed(say("discrepancy", e, _size(e.channel, e.size)) for e in errors.discrepancy.values())
    ripple = listed(say("ripple", e, _size(e.channel, e.size)) for e in errors.ripple.values())
    slip = "" if errors.slip is None else _size("slip", errors.slip.size)
    return say("errors", discrepancy, ripple, slip, bool(errors) and study.load_range is not None)


def _size(channel: str, size: Size) -> Markup:
    if size.law is not None:
        return Markup("estimated")
    return amount(channel, given((size.sd or 0.0) / CHANNELS[channel].scale))


def _law_of_noise(study: Study) -> str:
    marks = {noise.tails.name: noise.tails.mark for noise in study.noise.values()}
    if len(marks) == 1:
        return next(iter(marks))
    marked = (f"(where marked {mark}) {name}" for name, mark in marks.items() if mark)
    return " or ".join(["Gaussian"] * ("" in marks.values()) + [*marked])


def _option(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g} N"  # the mean load, the one option that has a unit
    return " and ".join(f"{item:g}" for item in value) if isinstance(value, tuple) else str(value)


def prior_sources(study: Study) -> Blocks:
    """A table of where the prior laws come from; nothing where none says so."""
    rows = tuple((symbols(names), source) for names, source in study.prior.sources.items())
    return (Table("Where the prior laws come from.", "ll", ("", "source"), rows),) if rows else ()


def priors_table(study: Study, caption: Cell, named: Callable[[str], Cell] = symbol) -> Table:
    """Laws of all parameters, ``named`` in the first column, and with groups the role of each."""
    pooling, body = study.pooling, list[tuple[Cell, ...]]()
    shared, separate = (pooling.shared, pooling.separate) if pooling else ((), ())
    roles: dict[str, Cell] = {**dict.fromkeys(shared, "shared"), **dict.fromkeys(separate, "separate")}
    for name, population in (pooling.hierarchical if pooling else {}).items():
        if population.mean and population.spread:
            laws = law_text(name, population.mean), law_text(name, population.spread)
            roles[name] = Markup("hierarchical: mean {}, spread {}").format(*laws)
    for name in in_order(study.prior.entries):
        what = named(name), angles(PARAMETERS[name].description), stated_law(name, study.prior.entries[name])
        body.append((*what, *([roles.get(name, NOTHING)] if pooling else [])))
    header = ("", "parameter", "prior", *(["role"] if pooling else []))
    return Table(caption, "l" * len(header), header, tuple(body))


def stated_law(name: str, entry: Entry) -> Markup:
    """A parameter's law, value or tie as the study states it."""
    if isinstance(entry, Law):
        return law_text(name, entry)
    if isinstance(entry, Tie):
        return Markup("that of {}").format(symbol(entry.to))
    value = float(entry)
    return Markup("fixed at {}").format(amount(name, given(value / PARAMETERS[name].scale)))


def support(record: Mapping[str, Any]) -> Markup:
    """Share of the prior that physics cuts, in words, from the record of the cut."""
    shares = dict(record["shares"])
    inside = shares.pop("inside the support", 0.0)
    cut = listed(Markup("{} ({})").format(angles(reason), share(part)) for reason, part in shares.items())
    return say("support", share(inside), cut, record["tried"])


def estimated_noise(study: Study) -> Markup:
    """Clause on the channels whose noise is estimated."""
    return say("estimated_noise", [name for name, noise in study.noise.items() if noise.law is not None])


def study_overview(study: Study) -> Overview:
    """Title, columns, measurements, wheels, model, priors and notes of a study, as its pages show them.

    SupportError where no parameter set of the prior can explain the conditions.
    """
    whole = whole_posterior(study)
    lines, doubts = [f"{', '.join(names)}: {source}" for names, source in study.prior.sources.items()], []
    for key, mixture in study.prior.mixtures.items():
        lines.append(f"{key}: joined by a mixture of {len(mixture.weights)} normal laws of scores")
    for name, own in whole.groups.items():
        cut = draw_cut_prior(own, 1000, np.random.default_rng(0))
        shares = (f"{100 * share:.3g} % {reason}" for reason, share in cut.shares.items())
        lines.append(f"Of the stated prior{f', {name} alone' if name else ''}: {', '.join(shares)}")
        doubts.append(own.doubts(cut.x[:TYPICAL]) if own.driven else "")
    if study.prior.stretched:
        lines.append(Prose("run")("at_sinkage", f"{1e3 * study.prior.reference:g}"))
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
