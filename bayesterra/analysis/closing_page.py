"""Closing sections: least squares beside the posterior, what readings add, how to repeat."""

from collections.abc import Mapping
from itertools import combinations

import numpy as np
import pandas as pd
from markupsafe import Markup

from bayesterra.analysis.export import methods_text
from bayesterra.analysis.findings_page import bounded
from bayesterra.checking.validation import complete, estimates, held, spread_draws
from bayesterra.least_squares.fit import fit_from_starts
from bayesterra.least_squares.results import SOLVERS
from bayesterra.likelihood.posterior import posterior
from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.report.blocks import Block, Blocks, Cell, Table, Text, records
from bayesterra.report.figures import MARKS
from bayesterra.report.numbers import (
    NOTHING,
    estimate,
    interval,
    number,
    plain,
    resolution,
    rounded,
    share,
    signed,
    with_error,
)
from bayesterra.report.sections import Prose, Section, in_a_line, origin_rows
from bayesterra.report.symbols import angles, in_symbols, listed, symbol, symbols, unit
from bayesterra.sampling.summary import CREDIBLE
from bayesterra.stats.diagnostics import divergence, hdi
from bayesterra.stats.quantile_law import QuantileLaw
from bayesterra.study.result import Result, SummaryRow, summary_rows

say = Prose("closing")


def methods_section(result: Result) -> Blocks:
    """Least squares side by side."""
    notes: list[Block] = [Text(Markup("{}: {}.").format(name, angles("; ".join(fit["notes"]))))
                          for name, fit in result.record["fits"].items() if fit["notes"]]  # fmt: skip
    refused: list[Block] = [Text(Markup("Not fitted: {}").format(line)) for line in result.record["refused_fits"]]
    return (_values(result), _standing(result), *_starts(result), *notes, *refused)


def _starts(result: Result) -> tuple[Table, ...]:
    """What the paper's solver owes to its start, where it was asked for beside the usual one."""
    table = fit_from_starts(result.study) if set(SOLVERS) <= set(result.study.least_squares.solvers) else pd.DataFrame()
    if table.empty:
        return ()
    rows = []
    for row in records(table):
        name = row["parameter"]
        low, high = summary_rows(result)[name].hdi if name in result.names else (np.nan, np.nan)
        own = " (this study's start)" if row["own"] else ""
        ends = (plain(row[solver], 4) for solver in SOLVERS)
        rows.append((symbol(name), unit(name) or NOTHING, plain(row["start"]) + own, *ends, interval(low, high)))
    return (say.table("starts", rows, table["method"].iloc[0]),)


def _values(result: Result) -> Table:
    points = estimates(result)
    rows = [_value_row(result, name, points) for name in PARAMETERS if any(name in v for v in points.values())]
    return say.table("values", rows, more=(MARKS[name].label for name in points))


def _value_row(result: Result, name: str, points: Mapping[str, Mapping[str, float]]) -> tuple[Cell, ...]:
    scale = PARAMETERS[name].scale
    if name not in result.names:
        fixed = result.study.prior.fixed.get(name, np.nan) / scale
        own: tuple[Cell, ...] = (plain(fixed), plain(fixed), "fixed")
        step = 0.001
    else:
        row = summary_rows(result)[name]
        step = resolution(*row.hdi)
        own = (rounded(row.median, step), rounded(row.mode, step), interval(*row.hdi))
    cells = (
        _flag(result, method, name) + rounded(values.get(name, np.nan) / scale, step)
        for method, values in points.items()
    )
    return symbol(name), unit(name) or NOTHING, *own, *cells


def _flag(result: Result, method: str, name: str) -> str:
    if name in (*result.record["fits"].get(method, {}).get("held", ()), *held(result, method)):
        return "= "
    return "| " if name in result.record["standings"][method]["at_bound"] else ""


def _standing(result: Result) -> Table:
    table = result.least_squares
    errors = table[table["parameter"].str.startswith("error_") & table["value"].notna()]
    judged = set(errors["parameter"].str.removeprefix("error_"))
    channels = [name for name in CHANNELS if name in judged]
    standings, fits = result.record["standings"], result.record["fits"]
    whole = ("mode", *complete(result))
    rows = []
    for name in ("mode", *estimates(result)):
        standing, fit = standings[name], fits.get(name)
        level, word = NOTHING, Markup("not judged: only some of the parameters")
        if name in whole:
            outside = standing["log_density"] is None
            level = NOTHING if outside else share(standing["credible_level"])
            bounds = Markup("; at a bound: {}").format(symbols(at)) if (at := standing["at_bound"]) else Markup("")
            word = Markup("{}{}").format(angles(standing["word"]) if outside else "inside the prior", bounds)
        own = [NOTHING] * (2 + len(channels))
        if fit is not None:
            misfits = (plain(fit["errors_percent"].get(channel), 2) for channel in channels)
            own = ["yes" if fit["converged"] else "no", str(fit["passes"]), *misfits]
        rows.append((MARKS[name].label if name in MARKS else "posterior mode", level, word, *own))
    heads = (Markup("error of {} [%]").format(symbol(name)) for name in channels)
    return say.table("standing", rows, more=heads)


def prior_section(result: Result) -> Blocks:
    """Sensitivity to the prior and to the noise: how far they shape the result."""
    ends = listed(Markup("{} at the {} end").format(symbol(name), end) for name, end in bounded(result))
    own = ((name, row) for name, row in summary_rows(result).items() if name in result.names)
    rows = [(symbol(name), plain(row.sd_ratio, 2), signed(row.shift, 1)) for name, row in own]
    advice = Text(say("prior_advice"))
    return (Text(say("prior", ends)), say.table("widths", rows), advice, *_other_noise(result))


def _other_noise(result: Result) -> Blocks:
    """Intervals with half and double the stated noise; nothing where all noise is estimated."""
    noise = result.record.get("noise", {})
    if not noise:
        return ()
    rows = tuple(
        (symbol(name), unit(name) or NOTHING, interval(*row.hdi), *(interval(*row.hdi_with(key)) for key in noise))
        for name, row in summary_rows(result).items()
        if name in result.names
    )
    how = [
        f"{key}: {'a fit of its own' if of['refitted'] else 'the same draws, weighted'}"
        + ("" if of["reliable"] else ", whose weights are too uneven to be relied on")
        for key, of in noise.items()
    ]
    return (Table(say("other_noise", "; ".join(how)), "llrrr", ("", "unit", "as stated", *noise), rows),)


def reproduce_section(result: Result) -> Blocks:
    """Everything needed to make the result again."""
    record = result.record
    facts = (
        ("command", Markup("<code>bayesterra run STUDY --seed {}</code>").format(record["seed"])),
        ("made", record["made"]),
        ("seed", str(record["seed"])),
        ("settings", in_a_line(record["settings"])),
        *origin_rows(record, "study", "data"),
        ("seconds", in_a_line({name: plain(value) for name, value in record["seconds"].items()})),
    )
    return (say.table("reproduce", facts), say.table("checklist", say.rows("checklist_rows")))


def signing_section(result: Result) -> Blocks:
    """What was done, in words for a manuscript, and room for names."""
    methods = (Text(in_symbols(part)) for part in methods_text(result).strip().split("\n\n"))
    people = tuple((role, "", "", "") for role in ("prepared by", "checked by", "approved by"))
    cited = "References in full: <code>bayesterra export DIR --bibtex</code>; figures, tables and this text likewise."
    return (*methods, Text(Markup(cited)), Table("Sign-off.", "llll", ("", "name", "date", "signature"), people))  # noqa: S704 (a constant)


BIT = float(np.log(2.0))
NARROWED = 0.9
"""Ratio of standard deviations, posterior over prior, below which a parameter counts as narrowed."""
APART = 2.0
"""Shift, in standard deviations of the prior, from which earlier result and readings disagree."""
NOTABLE = 0.2
"""Correlation, before or after, from which a pair is shown."""


def words_section(result: Result) -> Blocks:
    """What the words of the first screen mean."""
    rows = tuple((Markup("<b>{}</b>").format(word), meaning) for word, meaning in say.rows("words"))
    return (Table("The words of the first screen.", "ll", ("word", "meaning"), rows),)


def added_sections(result: Result) -> tuple[Section, ...]:
    """A section where some prior comes from an earlier result, else none."""
    names = [name for name, law in result.study.prior.laws.items() if isinstance(law, QuantileLaw)]
    if not names:
        return ()
    rows = {name: summary_rows(result)[name] for name in names}
    far = [name for name, row in rows.items() if abs(row.shift) > APART]
    warning = [Text(say("disagreement", far, APART), "bad")] if far else []
    words, table, pictures = _in_words(result, rows), _parameters(result, rows), _correlations(result, names)
    return (Section("added", "What the wheel adds", (Text(words), *warning, table, *pictures)),)


def _in_words(result: Result, rows: dict[str, SummaryRow]) -> Markup:
    """One sentence: how much is learnt in all, and about what."""
    ratios = {name: row.sd_ratio for name, row in rows.items()}
    narrowed = sorted((name for name in ratios if ratios[name] < NARROWED), key=ratios.__getitem__)
    rest = [name for name in ratios if name not in narrowed]
    phrases = [Markup("{} to {:.0f} %").format(symbol(name), 100 * ratios[name]) for name in narrowed]
    return say("added", _total(result), phrases, rest)


def _total(result: Result) -> str:
    """Divergence of the posterior from the cut prior: the mean log likelihood less the log evidence."""
    evidence = result.record.get("evidence")
    if evidence is None or not evidence["reliable"]:
        return "an amount of information that this run does not know well"
    if not result.study.errors and not result.study.soil_tests:
        terms = result.draws["log_likelihood"].data_vars.values()
        likelihood = sum(np.nansum(values.to_numpy(), axis=-1) for values in terms)
    else:  # a row's term is given all other rows, soil tests have none
        likelihood = posterior(result.study).log_prior_and_likelihood(spread_draws(result))[1]
    mean, error = float(np.mean(likelihood)), float(np.std(likelihood) / np.sqrt(np.size(likelihood)))
    gain = (mean - evidence["log_z"] + evidence["log_share"]) / BIT
    spread = float(np.sqrt(error**2 + evidence["error"] ** 2 + evidence["log_share_error"] ** 2)) / BIT
    value, off = with_error(gain, spread)
    return f"{value} ± {off} bit"


def _parameters(result: Result, rows: dict[str, SummaryRow]) -> Table:
    body: list[tuple[Cell, ...]] = []
    for name, row in rows.items():
        prior = result.column(name, "prior")
        low, high = hdi(prior, CREDIBLE)
        bits, error = (value / BIT for value in divergence(result.column(name), prior))
        body.append(
            (
                symbol(name),
                unit(name) or NOTHING,
                *estimate(float(np.median(prior)), low, high),
                *estimate(row.median, *row.hdi),
                number(row.sd_ratio, 2),
                Markup("{} ± {}").format(number(bits, 2, least=0.0), number(error, 2)),
            )
        )
    sources = dict.fromkeys(result.study.prior.laws[name].source for name in rows)
    return say.table("parameters", body, listed(list(sources)))


def _correlations(result: Result, names: list[str]) -> Blocks:
    pairs = []
    for a, b in combinations(names, 2):
        columns = ((result.column(a, group), result.column(b, group)) for group in ("prior", "posterior"))
        before, after = (float(np.corrcoef(x, y)[0, 1]) for x, y in columns)
        if max(abs(before), abs(after)) >= NOTABLE:
            pairs.append((symbols((a, b)), before, after))
    if not pairs:
        return ()
    pairs.sort(key=lambda pair: -abs(pair[2] - pair[1]))
    rows = tuple((pair, number(before, 2), number(after, 2)) for pair, before, after in pairs)
    return (say.table("correlations", rows, NOTABLE),)
