"""Comparison as a page, a notebook table and a terminal table."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from bayesterra.analysis.comparison import BARE, MOVED, Comparison
from bayesterra.analysis.contents_page import (
    compared_section,
    driven_by,
    judged_section,
    keys,
    parameters_section,
    predictions_section,
    repeat_section,
    shift,
)
from bayesterra.report.blocks import Overview, Table, Text
from bayesterra.report.numbers import estimate, given, rounded, with_error
from bayesterra.report.sections import Prose, Section, VerdictPage
from bayesterra.report.symbols import listed, symbol, symbols
from bayesterra.report.verdicts import Verdict
from bayesterra.study.study import Study

say = Prose("comparison")


def comparison_page(comparison: Comparison) -> VerdictPage:
    """Put the page together."""
    titles = dict.fromkeys(result.study.title for result in comparison.results.values())
    kinds = dict.fromkeys(result.study.kind for result in comparison.results.values())
    first = next(iter(comparison.results.values()))
    curve = comparison.curves[comparison.names[0]]
    return VerdictPage(
        title=next(iter(titles)) if len(titles) == 1 else f"{len(comparison.names)} results side by side",
        facts=(
            f"{', '.join(kinds)} data",
            *keys(comparison),
            f"{driven_by(comparison)}, {given(round(curve.load, 1))} N",
        ),
        warning=_warning(comparison),
        verdicts=(_readings(comparison), _evidence(comparison), _moves(comparison)),
        sections=(
            Section("parameters", "Parameters", parameters_section(comparison)),
            Section("predictions", "Predictions", predictions_section(comparison)),
            Section("studies", "What is compared", compared_section(comparison)),
            Section("evidence", "Evidence, cross-validation, fit and sampling", judged_section(comparison)),
            Section("repeat", "Reproduce this", repeat_section(comparison)),
        ),
        version=first.record["versions"]["bayesterra"],
        template="contrast.html",
    )


def _warning(comparison: Comparison) -> Markup:
    unfinished = [name for name, result in comparison.results.items() if not result.converged]
    if not unfinished:
        return Markup("")
    return Markup("The sampling of {} has <b>not converged</b>: what follows may be wrong.").format(listed(unfinished))


def _readings(comparison: Comparison) -> Verdict:
    first, *others = comparison.names
    apart = [name for name in others if not comparison.comparable(first, name)]
    if apart:
        studies = ((name, comparison.results[name].study) for name in (first, *apart))
        explained = listed(Markup("{}: {}").format(name, _counted(study)) for name, study in studies)
        sentence = Markup("{}. Parameters and predictions compare; evidence does only for the same readings.")
        return Verdict("Readings explained", "not the same", "doubtful", sentence.format(explained))
    sentence = Markup("All explain the same readings: {}.").format(_counted(comparison.results[first].study))
    return Verdict("Readings explained", "the same", "good", sentence)


def _counted(study: Study) -> Markup:
    rows = study.observations.used()
    counts = [int((~np.isnan(rows.values[name])).sum()) for name in study.noise]
    return Markup("{} of {}").format(sum(counts), symbols(study.noise))


def _evidence(comparison: Comparison) -> Verdict:
    names, evidence = _alike(comparison), comparison.evidence
    if len(names) < 2:
        sentence = Markup("No two results have comparable evidence.")
        return Verdict("Evidence", "not comparable", "doubtful", sentence)
    errors = {name: with_error(evidence[name].value, evidence[name].error) for name in names}
    values = listed(Markup("{} {} ± {}").format(name, *pair) for name, pair in errors.items())
    best, second = sorted(names, key=lambda name: -evidence[name].value)[:2]
    word, grade = comparison.word(second, best), "doubtful"
    if word.startswith("not known"):
        sentence = Markup("Log evidence {}; {}.").format(values, word.removeprefix("not known: "))
        word = "not known"
    elif word == "not distinguishable":
        sentence = Markup("Log evidence {}; below {:.0f}, or two errors, a difference says nothing.")
        sentence = sentence.format(values, BARE)
    else:
        difference = rounded(comparison.difference(second, best)[0], 0.1)
        sentence = Markup("Log evidence {}: {} over {} by {}, {} by Kass and Raftery's words.").format(
            values, best, second, difference, word.partition(" evidence")[0]
        )
        word, grade = f"{best} favoured", "good"
    if comparison.left_out(second, best) is not None:
        sentence += Markup(" Leaving rows out: {}.").format(comparison.left_out_word(second, best))
    return Verdict("Evidence", word, grade, sentence)


def _alike(comparison: Comparison) -> list[str]:
    """The largest group of results with known evidence that explain the same readings."""
    groups: dict[str, list[str]] = {}
    for name, evidence in comparison.evidence.items():
        if np.isfinite(evidence.value):
            groups.setdefault(evidence.outcomes, []).append(name)
    return max(groups.values(), key=len, default=[])


def _moves(comparison: Comparison) -> Verdict:
    """Parameters and derived quantities that move from the first result to the others."""
    table = comparison.parameters
    first = comparison.names[0]
    moved = table[(table["shift"].abs() >= MOVED) & (table["result"] != first)]
    moved = moved.reindex(moved["shift"].abs().sort_values(ascending=False).index)
    count = table[table["result"] == first]["quantity"].nunique()
    if moved.empty:
        sentence = Markup("No mean moves by {:.0f} sd of {} or more.").format(MOVED, first)
        return Verdict("Conclusions", "agree", "good", sentence)
    shifts = [
        Markup("{} ({} in {})").format(symbol(row["quantity"]), shift(row["shift"]), row["result"])
        for row in moved.head(4).to_dict("records")
    ]
    more = "" if len(moved) <= len(shifts) else " and more"
    sentence = Markup("Means moved by {:.0f} sd of {} or more: {}{}.").format(MOVED, first, listed(shifts), more)
    return Verdict("Conclusions", f"{moved['quantity'].nunique()} of {count} move", "doubtful", sentence)


def comparison_overview(comparison: Comparison) -> Overview:
    """Median and 90 % HDI of every quantity in every result, and what the evidence says."""
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for row in comparison.parameters.to_dict("records"):
        middle, ends = estimate(row["median"], row["hdi90_lo"], row["hdi90_hi"])
        key = (str(row["quantity"]).replace("_", " "), str(row["unit"]))
        cells.setdefault(key, {})[str(row["result"])] = f"{middle} ({ends})"
    rows = [(*key, *(entries.get(name, "") for name in comparison.names)) for key, entries in cells.items()]
    header = ("median (90 % HDI)", "unit", *comparison.names)
    table = Table("", "ll" + "r" * len(comparison.names), header, tuple(rows))
    return (table, *map(Text, evidence_lines(comparison)))


def evidence_lines(comparison: Comparison) -> list[str]:
    """Evidence of every result in words, a line each."""
    lines = []
    for row in comparison.evidences.to_dict("records"):
        value = f"{rounded(row['log_evidence'], 0.01)} ± {rounded(row['error'], 0.01)}"
        word = f": {row['word']}" if row["word"] else ""
        loo = f"{rounded(row['elpd'], 0.1)} ± {rounded(row['elpd_se'], 0.1)}"
        left_out = f"; leaving rows out {loo}" if row["result"] in comparison.loo else ""
        says = f": {row['elpd_word']}" if row["elpd_word"] and left_out else ""
        lines.append(f"{row['result']}: log evidence {value}{word}{left_out}{says}")
    return lines
