"""Findings of a result: the parameter strip, and sentences generated from the figures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from bayesterra.checking.validation import complete, estimates, held
from bayesterra.identifiability.verdicts import SHIFT, WEAK
from bayesterra.least_squares.results import CONDITIONAL
from bayesterra.parameters import PARAMETERS
from bayesterra.report.numbers import given, interval, number, share, signed
from bayesterra.report.symbols import amount, angles, in_symbols, listed, symbol, symbols
from bayesterra.report.verdicts import failed
from bayesterra.study.page import StripRow, axis, strip_row
from bayesterra.study.result import COUPLED, Result, identifiability_rows, summary_rows

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
    if not names:
        return Markup("No parameter on its own; see the combinations below.")
    rows = summary_rows(result)
    intervals = (Markup("{} ({})").format(symbol(name), amount(name, interval(*rows[name].hdi))) for name in names)
    return Markup("{}; 90 % HDI in brackets.").format(listed(intervals))


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
    pairs = coupled_pairs(result)
    if not pairs:
        return Markup("")
    trades = (Markup("{} with {} ({})").format(symbol(a), symbol(b), signed(r)) for a, b, r in pairs)
    return Markup("{}. The data fix these combinations better than either member; correlation in brackets.").format(
        listed(trades)
    )


def from_the_prior(result: Result) -> Markup:
    """Parameters that the data hardly narrow, and those that lean on a bound of the prior."""
    rows = identifiability_rows(result)
    moved = [name for name, row in rows.items() if row.verdict == "moved"]
    names = [name for name, row in rows.items() if row.contraction < WEAK and name not in moved]
    ends = Markup("; ").join(
        Markup("{} at its {} bound").format(symbol(n), end)
        for n, end in bounded(result)
        if n not in (*names, *moved)  # what repeats a bounded prior ends where the prior does
    )
    sentences = []
    if moved:
        text = Markup("{} hardly narrowed but moved: prior and data disagree.")
        sentences.append(text.format(symbols(moved)))
    if names:
        text = Markup("{} alone {} hardly better known than before the test: the prior speaks, not the data.")
        sentences.append(text.format(symbols(names), "is" if len(names) == 1 else "are"))
    if ends:
        sentences.append(Markup("Cut off by a bound of the prior: {}.").format(ends))
    return Markup(" ").join(sentences)


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
    sentences = []
    if outside:
        text = (
            "The densest single point lies outside the 90 % HDI of {} (*): a narrow corner that holds little "
            "probability. Medians and intervals describe this soil better than the mode does."
        )
        sentences.append(Markup(text).format(symbols(outside)))  # noqa: S704 (a constant)
    if at:
        edges = listed(
            Markup("the {} of {}").format(edge, symbols(names)) if edge.endswith("bound") else in_symbols(edge)
            for edge, names in at.items()
        )
        sentences.append(Markup("It lies on an edge (†), not on a summit: {}.").format(edges))
    return Markup(" ").join(sentences)


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
    return Markup(
        "Stated, not estimated: half of it makes intervals {} times as wide, double {} times; most of all {}, {} or {}."
    ).format(
        number(half, 1), number(double, 1), symbol(most),
        *(amount(most, interval(*rows[most].hdi_with(key))) for key in ("half", "double")),
    )  # fmt: skip


def about_least_squares(result: Result) -> Markup:
    """Standing of the point estimates in the posterior."""
    standings = result.record["standings"]
    if failed(result.record, "standings"):
        return Markup("")
    names = [name for name in complete(result) if name != CONDITIONAL]
    outside = [name for name in names if standings[name]["log_density"] is None]
    far = [n for n in names if n not in outside and standings[n]["credible_level"] >= FAR]
    near = [name for name in names if name not in (*outside, *far)]
    sentences = [
        *_held(result),
        *_open(result, names),
        *_outside(result, outside),
        *_far(result, far),
        *_near(result, near),
        *_at_bounds(result, names),
    ]
    return Markup(" ").join(sentences)


def _held(result: Result) -> Iterator[Markup]:
    """Parameters that methods held, the same value together."""
    groups: dict[tuple[str, str], list[str]] = {}
    for method, values in estimates(result).items():
        for name in held(result, method) if method != CONDITIONAL else ():
            value = given(float(f"{values[name] / PARAMETERS[name].scale:.6g}"))
            groups.setdefault((name, value), []).append(method)
    for (name, value), methods in groups.items():
        yield Markup("{} held {} at {} (hollow marks).").format(listed(methods), symbol(name), amount(name, value))
    if CONDITIONAL in estimates(result):
        further = "The posterior’s mode at the held value is marked ▼; the free mode is denser by Δχ² {}."
        yield Markup(further).format(number(result.record["mode"]["delta_chi2"], 2))  # noqa: S704 (a constant)


def _open(result: Result, judged: list[str]) -> Iterator[Markup]:
    """Estimates that leave parameters open have no density of their own."""
    names = [name for name in estimates(result) if name not in (*judged, CONDITIONAL)]
    if names:
        yield Markup("{}: only some of the parameters, not judged.").format(_titles(names))


def _outside(result: Result, names: list[str]) -> Iterator[Markup]:
    for name in names:
        word = result.record["standings"][name]["word"].removeprefix("outside the prior: ")
        reason = Markup("") if word == "outside the prior" else Markup(" ({})").format(angles(word))
        yield Markup("{} outside the prior{}.").format(_estimate(name), reason)


def _estimate(name: str) -> str:
    return {"published": "The published values lie", "truth": "The true values lie"}.get(name, f"{name} lies")


def _far(result: Result, names: list[str]) -> Iterator[Markup]:
    if names:
        levels = sorted(result.record["standings"][name]["credible_level"] for name in names)
        ends = " to ".join(dict.fromkeys((share(levels[0]), share(levels[-1]))))
        yield Markup("{}: improbable, {} of the draws are denser.").format(_titles(names), ends)


def _titles(names: list[str]) -> Markup:
    text = listed({"published": "published values", "truth": "true values"}.get(name, name) for name in names)
    return Markup("{}{}").format(text[:1].upper(), text[1:])


def _near(result: Result, names: list[str]) -> Iterator[Markup]:
    for name in names:
        level = result.record["standings"][name]["credible_level"]
        denser = f": {share(level)} of the draws are denser" if level else ", denser than every draw"
        yield Markup("{} inside{}.").format(_estimate(name), denser)


def _at_bounds(result: Result, names: list[str]) -> Iterator[Markup]:
    groups: dict[tuple[str, ...], list[str]] = {}
    for name in names:
        parameters = tuple(result.record["standings"][name]["at_bound"])
        if parameters:
            groups.setdefault(parameters, []).append(name)
    if groups:
        cases = (
            Markup("{} in {}").format(symbols(parameters), listed(methods)) for parameters, methods in groups.items()
        )
        yield Markup("At a bound of the prior: {}.").format(Markup("; ").join(cases))


ADVICE = (
    ({"c", "phi"}, "runs under a second load, or a shear test at another normal stress, would help to part {}"),
    ({"phi", "K"}, "readings at small slip, where the shear stress still builds up, would help to part {}"),
    ({"c", "K"}, "readings at small slip, where the shear stress still builds up, would help to part {}"),
    ({"Ks", "n0"}, "a plate-sinkage test, or a wheel of another width or load, would help to part {}"),
    ({"n0", "n1"}, "sinkage over a wider range of slip would help to part {}"),
    ({"n1", "c2"}, "sinkage over a wider range of slip would help to part {}"),
    ({"c1", "c2"}, "a wider range of slip, or stress sensors on the rim, would help to part {}"),
)
"""For a coupled pair, the measurement in which its members act differently."""


def next_measurement(result: Result) -> Markup:
    """Cautious advice from the strongest couplings; nothing where there is none to give."""
    advice: dict[str, list[Markup]] = {}
    for a, b, _ in coupled_pairs(result):
        for pair, text in ADVICE:
            if pair == {a, b}:
                advice.setdefault(text, []).append(symbols([a, b]))
    hints = [Markup(text).format(listed(pairs, "or")) for text, pairs in advice.items()]  # noqa: S704 (constants)
    text = Markup("; ").join(hints[:3])
    return Markup("By the couplings above, {}.").format(text) if hints else Markup("")


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
        return word, Markup("{}prior and data disagree").format(moved_by(row.shift))
    if word == "one-sided":
        return word, Markup("at its {} bound").format(row.bound)
    if word != "coupled":
        return word, Markup("")
    alone = ", alone like its prior" if row.contraction < WEAK else ""
    partner = symbol(row.coupled_with) if row.coupled_with else Markup("several others")
    return word, Markup("with {}{}").format(partner, alone)


def moved_by(shift: float) -> str:
    """Shift of the mean, in words before others; nothing where it is not the mean that moved."""
    return f"by {signed(shift, 1)} prior sd: " if abs(shift) >= SHIFT else ""
