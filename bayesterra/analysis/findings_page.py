"""Findings of a result: the parameter strip, and sentences generated from the figures."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from bayesterra.checking.validation import complete, estimates, held
from bayesterra.identifiability.verdicts import SHIFT, WEAK
from bayesterra.least_squares.results import CONDITIONAL
from bayesterra.likelihood.forward import reference_load
from bayesterra.parameters import PARAMETERS
from bayesterra.report.numbers import given, interval, number, share, signed
from bayesterra.report.sections import Prose
from bayesterra.report.symbols import amount, angles, in_symbols, listed, symbol, symbols
from bayesterra.report.verdicts import failed
from bayesterra.study.page import StripRow, axis, strip_row
from bayesterra.study.result import COUPLED, Result, identifiability_rows, summary_rows

say = Prose("findings")

FAR = 0.99
"""Share of denser draws from which a point counts as improbable."""


@dataclass(frozen=True)
class Finding:
    """A few sentences under a lead-in."""

    lead: str
    text: Markup


def findings(result: Result) -> tuple[Finding, ...]:
    """Everything that can be said, the soil first."""
    statements = (
        ("Determined", determined(result)),
        ("Traded", traded(result)),
        ("From the prior", from_the_prior(result)),
        ("Mode", about_the_mode(result)),
        ("Least squares", about_least_squares(result)),
        ("Noise", about_the_noise(result)),
        ("Next", next_measurement(result)),
    )
    return tuple(Finding(lead, text) for lead, text in statements if text)


def determined(result: Result) -> Markup:
    """Parameters that the data determine on their own, with their intervals."""
    names = [name for name, row in identifiability_rows(result).items() if row.verdict == "determined"]
    rows = summary_rows(result)
    intervals = (Markup("{} ({})").format(symbol(name), amount(name, interval(*rows[name].hdi))) for name in names)
    return say("determined", listed(intervals))


def coupled_pairs(result: Result) -> list[tuple[str, str, float]]:
    """Pairs of parameters with a strong correlation, the strongest first."""
    matrix = np.atleast_2d(np.corrcoef(result.values().T))
    pairs = [
        (result.names[j], result.names[i], float(matrix[i, j]))
        for i, j in zip(*np.tril_indices(len(matrix), -1), strict=True)
        if abs(matrix[i, j]) >= COUPLED
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))


def traded(result: Result) -> Markup:
    """Pairs of parameters that the data leave to be traded against each other."""
    trades = (Markup("{} with {} ({})").format(symbol(a), symbol(b), signed(r)) for a, b, r in coupled_pairs(result))
    return say("traded", listed(trades))


def from_the_prior(result: Result) -> Markup:
    """Parameters that the data hardly narrow, and those that lean on a bound of the prior."""
    rows = identifiability_rows(result)
    moved = [name for name, row in rows.items() if row.verdict == "moved"]
    names = [name for name, row in rows.items() if row.contraction < WEAK and name not in moved]
    ends = [(n, end) for n, end in bounded(result) if n not in (*names, *moved)]  # else where a bounded prior ends
    return say("from_the_prior", moved, names, ends)


def bounded(result: Result) -> list[tuple[str, str]]:
    """Parameters that lean on a bound of their prior, and on which: ``lower``, ``upper`` or both in turn."""
    ends = {"none": (), "both": ("lower", "upper")}
    rows = identifiability_rows(result).items()
    return [(name, end) for name, row in rows for end in ends.get(row.bound, (row.bound,))]


def about_the_mode(result: Result) -> Markup:
    """Warn where the densest point lies apart from most of the probability, or on an edge."""
    outside, at, rows = mode_outside(result), dict[str, list[str]](), summary_rows(result)
    for name in (name for name in result.names if rows[name].mode_at != "inside"):
        at.setdefault(rows[name].mode_at, []).append(name)
    edges = listed(
        Markup("the {} of {}").format(edge, symbols(names)) if edge.endswith("bound") else in_symbols(edge)
        for edge, names in at.items()
    )
    return say("mode", outside, edges)


def about_the_noise(result: Result) -> Markup:
    """Widths with half and double the stated noise, and the parameter that changes most."""
    if set(result.record.get("noise", ())) != {"half", "double"}:
        return Markup("")
    rows = summary_rows(result)
    widths = {
        key: {name: float(np.ptp(rows[name].hdi_with(key)) / np.ptp(rows[name].hdi)) for name in result.names}
        for key in ("half", "double")
    }
    most = max(result.names, key=lambda name: widths["double"][name] / widths["half"][name])
    half, double = (float(np.median(list(each.values()))) for each in widths.values())
    ends = (amount(most, interval(*rows[most].hdi_with(key))) for key in ("half", "double"))
    return say("noise", number(half, 1), number(double, 1), most, *ends)


def about_least_squares(result: Result) -> Markup:
    """Standing of the point estimates in the posterior."""
    standings = result.record["standings"]
    if failed(result.record, "standings"):
        return Markup("")
    points, names = estimates(result), [name for name in complete(result) if name != CONDITIONAL]
    outside = {name: standings[name]["word"] for name in names if standings[name]["log_density"] is None}
    levels = {name: standings[name]["credible_level"] for name in names if name not in outside}
    far = sorted((level, name) for name, level in levels.items() if level >= FAR)
    ends = " to ".join(dict.fromkeys(share(level) for level, _ in (*far[:1], *far[-1:])))
    at_bounds: dict[tuple[str, ...], list[str]] = {}
    for name in names:
        if parameters := tuple(standings[name]["at_bound"]):
            at_bounds.setdefault(parameters, []).append(name)
    return say(
        "least_squares",
        _held(result),
        number(result.record["mode"]["delta_chi2"], 2) if CONDITIONAL in points else "",
        _titles([name for name in points if name not in (*names, CONDITIONAL)]),
        {name: angles(word.removeprefix("outside the prior: ")) for name, word in outside.items()},
        (_titles([name for name in levels if levels[name] >= FAR]), ends),
        {name: share(level) if level else "" for name, level in levels.items() if level < FAR},
        at_bounds,
    )


def _titles(names: list[str]) -> Markup:
    text = listed({"published": "published values", "truth": "true values"}.get(name, name) for name in names)
    return Markup("{}{}").format(text[:1].upper(), text[1:])


def _held(result: Result) -> list[tuple[str, str, list[str]]]:
    """Parameters that methods held, each with its value and those methods."""
    groups: dict[tuple[str, str], list[str]] = {}
    for method, values in estimates(result).items():
        for name in held(result, method) if method != CONDITIONAL else ():
            value = given(float(f"{values[name] / PARAMETERS[name].scale:.6g}"))
            groups.setdefault((name, value), []).append(method)
    return [(name, amount(name, value), methods) for (name, value), methods in groups.items()]


def next_measurement(result: Result) -> Markup:
    """The drive that would tell most, by the quick form of ``design``; nothing where none was judged."""
    drive = result.record.get("next")
    if drive is None:
        return Markup("")
    where = (drive["wheel"], amount("load", given(drive["load"])), number(drive["slip"], 2))
    bits = (number(drive[name], 1) for name in ("bits", "same_load"))
    return say("next", drive["candidates"], where, *bits, amount("load", given(reference_load(result.study))))


def mode_outside(result: Result) -> tuple[str, ...]:
    """Parameters whose posterior mode lies outside their 90 % HDI by more than a twentieth of its width."""
    rows = summary_rows(result)
    return tuple(name for name in result.names if rows[name].mode_outside)


def strip(result: Result) -> Iterator[StripRow]:
    """All free parameters."""
    for name in result.names:
        drawn = (result.column(name, "prior"), result.column(name))
        points = {m: v[name] / PARAMETERS[name].scale for m, v in estimates(result).items() if name in v}
        hollow = [method for method in points if name in held(result, method)]
        along, row = axis(result, name), summary_rows(result)[name]
        yield strip_row(PARAMETERS[name], along, row, drawn, points, _words(result, name), hollow)


def _words(result: Result, name: str) -> tuple[str, Markup]:
    """The identifiability word and what stands beside it in small print."""
    row = identifiability_rows(result)[name]
    word = row.word
    if word == "moved":
        by = f"by {signed(row.shift, 1)} prior sd: " if abs(row.shift) >= SHIFT else ""  # else the spread moved
        return word, Markup("{}prior and data disagree").format(by)
    if word == "one-sided":
        return word, Markup("at its {} bound").format(row.bound)
    if word != "coupled":
        return word, Markup("")
    alone = ", alone like its prior" if row.contraction < WEAK else ""
    partner = symbol(row.coupled_with) if row.coupled_with else Markup("several others")
    return word, Markup("with {}{}").format(partner, alone)
