"""What the readings add to a prior that is the posterior of an earlier result."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from markupsafe import Markup

from bayesterra.adequacy import spread_draws
from bayesterra.arrays import FloatArray
from bayesterra.diagnostics import hdi
from bayesterra.figures.rows import Row, summary_rows
from bayesterra.identifiability.divergence import divergence
from bayesterra.posteriors import posterior
from bayesterra.report.blocks import Block, Cell, Section, Table, Text
from bayesterra.report.numbers import NOTHING, interval, number, resolution, rounded, with_error
from bayesterra.report.symbols import listed, symbol, symbols, unit
from bayesterra.results import Result, field_values
from bayesterra.summary import CREDIBLE
from bayesterra.tabulated import Tabulated

BIT = float(np.log(2.0))
NARROWED = 0.9
"""Ratio of standard deviations, posterior over prior, below which a parameter counts as narrowed."""
APART = 2.0
"""Shift, in standard deviations of the prior, from which earlier result and readings disagree."""
NOTABLE = 0.2
"""Correlation, before or after, from which a pair is shown."""


def added_sections(result: Result) -> tuple[Section, ...]:
    """A section where some prior comes from an earlier result, else none."""
    names = [name for name, law in result.study.prior.laws.items() if isinstance(law, Tabulated)]
    if not names:
        return ()
    rows = {name: summary_rows(result)[name] for name in names}
    blocks: tuple[Block, ...] = (
        Text(_in_words(result, rows)),
        *_disagreement(rows),
        _parameters(result, rows),
        *_correlations(result, names),
    )
    return (Section("added", "What the wheel adds", blocks),)


def _in_words(result: Result, rows: dict[str, Row]) -> Markup:
    """One sentence: how much is learnt in all, and about what."""
    ratios = {name: row.sd / row.prior_sd for name, row in rows.items()}
    narrowed = sorted((name for name in ratios if ratios[name] < NARROWED), key=ratios.__getitem__)
    rest = [name for name in ratios if name not in narrowed]
    parts = [Markup("{} to {:.0f} %").format(symbol(name), 100 * ratios[name]) for name in narrowed]
    learnt = (
        Markup("They narrow {} of the standard deviation before").format(listed(parts))
        if parts
        else Markup("They narrow none of the parameters by a tenth")
    )
    kept = Markup("; {} stay about as wide as before").format(symbols(rest)) if rest and parts else ""
    return Markup("The readings of this study add {} to what was known before. {}{}.").format(
        _total(result), learnt, kept
    )


def _total(result: Result) -> str:
    """Divergence of the posterior from the cut prior: the mean log likelihood less the log evidence."""
    found, terms = result.record.get("evidence"), result.draws["log_likelihood"]
    if found is None or not found["reliable"]:
        return "an amount of information that this run does not know well"
    likelihood = sum(np.nansum(values.to_numpy(), axis=-1) for values in terms.data_vars.values())
    if result.study.errors:  # a row's term is given all other rows
        likelihood = posterior(result.study).log_prior_and_likelihood(spread_draws(result))[1]
    mean, error = float(np.mean(likelihood)), float(np.std(likelihood) / np.sqrt(np.size(likelihood)))
    gain = (mean - found["log_z"] + found["log_share"]) / BIT
    spread = float(np.sqrt(error**2 + found["error"] ** 2 + found["log_share_error"] ** 2)) / BIT
    value, off = with_error(gain, spread)
    return f"{value} ± {off} bit"


def _disagreement(rows: dict[str, Row]) -> tuple[Text, ...]:
    """A warning where a parameter moves far from its prior."""
    shifts = {name: (row.mean - row.prior_mean) / row.prior_sd for name, row in rows.items()}
    far = [name for name, shift in shifts.items() if abs(shift) > APART]
    if not far:
        return ()
    text = Markup(
        "The earlier result and these readings disagree about {}, which moved by more than {:g} standard "
        "deviations of the prior: that the earlier test says something about this soil is an assumption, and "
        "it is doubtful here."
    )
    return (Text(text.format(symbols(far), APART), "bad"),)


def _parameters(result: Result, rows: dict[str, Row]) -> Table:
    prior, draws = (_columns(result, group) for group in ("prior", "posterior"))
    body: list[tuple[Cell, ...]] = []
    for name, row in rows.items():
        low, high = hdi(prior[name], CREDIBLE)
        before, after = resolution(low, high), resolution(*row.hdi)
        bits, error = (value / BIT for value in divergence(draws[name], prior[name]))
        body.append(
            (
                symbol(name),
                unit(name) or NOTHING,
                rounded(float(np.median(prior[name])), before),
                interval(low, high, before),
                rounded(row.median, after),
                interval(*row.hdi, after),
                number(row.sd / row.prior_sd, 2),
                Markup("{} ± {}").format(number(bits, 2, least=0.0), number(error, 2)),
            )
        )
    caption = Markup(
        "Before and after the readings: the prior ({}; after the physical cut) and the posterior, each "
        "with its 90 % HDI, the ratio of the standard deviations (1: nothing learnt), and the "
        "information gained about each parameter alone."
    ).format(listed(_origins(result, rows)))
    header = ("", "unit", "before", "90 % HDI", "after", "90 % HDI", "sd ratio", "gain [bit]")
    return Table(caption, "llrrrrrr", header, tuple(body))


def _origins(result: Result, rows: dict[str, Row]) -> list[str]:
    return list(dict.fromkeys(result.study.prior.laws[name].source for name in rows))


def _correlations(result: Result, names: list[str]) -> tuple[Block, ...]:
    prior, draws = (_columns(result, group) for group in ("prior", "posterior"))
    body: list[tuple[float, tuple[Cell, ...]]] = []
    for a, b in combinations(names, 2):
        before, after = (float(np.corrcoef(x[a], x[b])[0, 1]) for x in (prior, draws))
        if max(abs(before), abs(after)) >= NOTABLE:
            change = abs(after - before)
            cells = (symbols((a, b)), number(before, 2), number(after, 2))
            body.append((-change, cells))
    if not body:
        return ()
    caption = (
        f"Correlations before and after the readings, where one of them is {NOTABLE:g} or more; those that "
        "changed most come first."
    )
    ordered = tuple(cells for _, cells in sorted(body, key=lambda item: item[0]))
    return (Table(caption, "lrr", ("", "before", "after"), ordered),)


def _columns(result: Result, group: str) -> dict[str, FloatArray]:
    """Draws (n,) by parameter, in field units."""
    values = result.values(group)
    return {name: field_values(name, values[:, i]) for i, name in enumerate(result.names)}
