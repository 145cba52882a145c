"""The page of an identifiability analysis: the verdicts first, then the figures behind each word."""

from __future__ import annotations

from typing import Any

import pandas as pd
from markupsafe import Markup

from bayesterra import figures
from bayesterra.figures.profiles import profiles_in_words
from bayesterra.identifiability.collinearity import CRITICAL
from bayesterra.identifiability.information import ALL
from bayesterra.identifiability.verdicts import COUPLED, COUPLED_TO_ALL, DETERMINED, EXCLUDED, WEAK
from bayesterra.identified import Identified, in_a_sentence
from bayesterra.parameters import PARAMETERS
from bayesterra.report.blocks import Cell, Gallery, Section, Table, Text, drawing
from bayesterra.report.numbers import NOTHING, plain
from bayesterra.report.pages import VerdictPage
from bayesterra.report.symbols import listed, symbol, symbols, unit
from bayesterra.report.verdicts import Verdict

ORDER = ("determined", "one-sided", "weakly", "coupled", "repeats its prior", "structurally not determined")


def identifiability_page(made: Identified) -> VerdictPage:
    """Put the page together."""
    study = made.study
    facts = (study.model.name, f"drive {study.drive}", f"{made.record['draws']} draws", study.kind)
    return VerdictPage(
        title=study.title or "Soil parameters from wheel tests",
        facts=facts,
        warning=_warning(made),
        verdicts=(_directions_card(made), _parameters_card(made), _agreement_card(made)),
        sections=(
            _verdict_section(made),
            _profile_section(made),
            _coupling_section(made),
            _information_section(made),
            _local_section(made),
            _further_section(made),
            _method_section(made),
        ),
        version=made.record["versions"]["bayesterra"],
    )


def _warning(made: Identified) -> Markup:
    if made.record["converged"]:
        return Markup("")
    return Markup(
        "The draws behind this page come from sampling that did <b>not converge</b>: what rests on draws "
        "(contraction, coupling, cloning) may be wrong. Profiles and structure do not depend on them."
    )


def _directions_card(made: Identified) -> Verdict:
    counts = made.found.counts.set_index("scope")
    row = counts.loc[ALL]
    determined, of = (int(row.to_dict()[name]) for name in ("determined", "directions"))
    grade = "good" if determined == of else "fair" if determined else "poor"
    sentence = Markup("{}").format(in_a_sentence(made.found, lambda name: PARAMETERS[name].symbol))
    return Verdict("Directions", f"{determined} of {of} fixed", grade, sentence)


def _parameters_card(made: Identified) -> Verdict:
    words = made.found.verdicts.groupby("verdict")["parameter"].agg(list).to_dict()
    known = words.get("determined", [])
    parts = [Markup("{}: {}").format(word, symbols(words[word])) for word in ORDER if word in words]
    grade = "good" if len(known) == len(made.found.names) else "fair" if known else "poor"
    return Verdict(
        "Parameters", f"{len(known)} determined", grade, Markup("{}.").format(Markup("; ").join(parts))
    )


def _agreement_card(made: Identified) -> Verdict:
    table = made.found.verdicts
    against = table[table["against"] != ""]
    if against.empty:
        sentence = Markup("Profiles, cloned data and divergences say nothing against any verdict.")
        return Verdict("Methods", "agree", "good", sentence)
    names = symbols(against["parameter"])
    sentence = Markup("Something speaks against the word for {}: see the table.").format(names)
    return Verdict("Methods", f"{len(against)} objections", "fair", sentence)


def _verdict_section(made: Identified) -> Section:
    text = Markup(
        "<b>Determined</b>: variance at most {:.0f} % of the cut prior’s. <b>One-sided</b>: so, but one end "
        "is the prior’s bound; or the likelihood excludes {:.0f} % or more of the prior on one side only. "
        "<b>Coupled</b>: correlation {} or stronger with another open parameter, or {} with all of them. "
        "<b>Weakly</b>: contraction {} or more. Else it <b>repeats its prior</b>; or no data of this design "
        "can determine it."
    ).format(100 * (1 - DETERMINED), 100 * EXCLUDED, COUPLED, COUPLED_TO_ALL, WEAK)
    return Section("verdicts", "Verdicts", (_verdict_table(made), Text(text), _combination_table(made)))


def _verdict_table(made: Identified) -> Table:
    rows = tuple(_verdict_row(row) for row in _records(made.verdicts))
    header = ("", "verdict", "contraction", "coupled with", "r", "R", "profile", "cloned ×16", "objections")
    caption = Markup(
        "Contraction: 1 − variance over the cut prior’s. <i>r</i>: strongest correlation; <i>R</i>: with all "
        "open parameters together. Profile: of the likelihood, with its 95 % interval in the parameter’s "
        "unit."
    )
    return Table(caption, "llrlrrlll", header, rows)


def _records(table: pd.DataFrame) -> list[dict[str, Any]]:
    return [{str(name): value for name, value in row.items()} for row in table.to_dict("records")]


def _verdict_row(row: dict[str, Any]) -> tuple[Cell, ...]:
    name = row["parameter"]
    return (
        symbol(name),
        Markup("<b>{}</b>").format(row["verdict"]),
        f"{max(row['contraction'], 0.0):.2f}",
        symbol(row["partner"]) if row["partner"] != name else NOTHING,
        _signed(row["correlation"]),
        f"{row['multiple']:.2f}",
        Markup("{}{}").format(row["profile"], _ends(row)),
        row["cloned"] or "undecided",
        row["against"] or NOTHING,
    )


def _ends(row: dict[str, Any]) -> Markup:
    low, high = row["lower_95"], row["upper_95"]
    known = Markup("&nbsp;{}").format(unit(row["parameter"]))
    if low == low and high == high:
        return Markup(", {}–{}{}").format(plain(low, 3), plain(high, 3), known)
    if low == low:
        return Markup(", above {}{}").format(plain(low, 3), known)
    return Markup(", below {}{}").format(plain(high, 3), known) if high == high else Markup("")


def _signed(value: float) -> str:
    return f"{value:+.2f}".replace("-", "−")


def _combination_table(made: Identified) -> Table:
    table = made.found.combinations
    rows = tuple(
        (row["verdict"], row["combination"], NOTHING if row["contraction"] != row["contraction"]
         else f"{max(row['contraction'], 0.0):.3f}")
        for row in _records(table)
    )  # fmt: skip
    caption = (
        "Independent combinations of the parameters, best determined first; weights in standard deviations "
        "of the cut prior (of normal scores, so that the scale of a parameter does not matter)."
    )
    return Table(caption, "llr", ("verdict", "combination", "contraction"), rows)


def _profile_section(made: Identified) -> Section:
    panels = drawing(figures.profile_panels(made.found.profiles), profiles_in_words(made.found.profiles))
    caption = (
        "The best that all other parameters can do at each value of one. Where a curve crosses the 95 % line "
        "on both sides the readings bound the parameter; where it stays below, only the prior’s range does."
    )
    table = made.found.profiles.table
    rows = tuple(
        (symbol(row["parameter"]), row["class"], f"{100 * row['trust']:.0f} %", _moves(row["compensated_by"]))
        for row in _records(table[table["kind"] == "likelihood"])
    )
    moves = Table(
        "What compensates what: how far the others move along the 95 % interval, in standard deviations of "
        "their prior. Trust: points that two or more descents agree on.",
        "llrl",
        ("", "class", "trust", "others move by"),
        rows,
    )
    return Section("profiles", "Profiles", (Gallery("whole", (panels,), caption), moves))


def _moves(text: str) -> Cell:
    """Such as ``n0 −0.4, c1 +0.3``, with symbols."""
    parts = [part.rsplit(" ", 1) for part in text.split(", ") if part]
    return listed(Markup("{} {}").format(symbol(name), move) for name, move in parts) if parts else NOTHING


def _coupling_section(made: Identified) -> Section:
    found = made.found.drawn.coupling
    pictures = [drawing(figures.coupling_map(found), "Coupling of every pair of parameters")]
    if len(found.between):
        pictures.append(drawing(figures.group_coupling(found), "Mutual information of the parameter groups"))
    caption = Markup(
        "Left: strength of coupling (the correlation of two normal parameters with the same mutual "
        "information), posterior below the diagonal, cut prior above; a star where a nearest-neighbour "
        "estimate finds more. Right: between the groups, in nats, with what independent draws would give."
    )
    return Section("coupling", "Coupling", (Gallery("half", tuple(pictures), caption),))


def _information_section(made: Identified) -> Section:
    found = made.found.drawn.information
    bars = drawing(
        figures.contraction_bars(found), "Contraction of every parameter by the data and by the cut"
    )
    rows = tuple(
        (
            row["scope"] if row["scope"] == ALL else _group(row["scope"]),
            row["view"],
            f"{row['determined']} of {row['directions']}",
            f"{row['effective']:.2f}",
            f"{row['determined_plain']}, {row['determined_sampling']}",
            f"{row['cut_effective']:.2f}",
        )
        for row in _records(found.counts)
    )
    table = Table(
        "Directions whose variance shrinks tenfold, in normal scores of the cut prior; beside it in plain "
        "and in sampling coordinates. Effective: sum of contractions, for the data and for the physical cut "
        "alone.",
        "llrrrr",
        ("group", "other parameters", "determined", "effective", "plain, sampling", "by the cut"),
        rows,
    )
    caption = (
        "What the data contract of the prior after the physical cut, and what the cut had contracted before: "
        "the latter is no information in the data."
    )
    return Section("information", "Information", (table, Gallery("half", (bars,), caption)))


def _group(name: str) -> Markup:
    return Markup("<i>P</i><sub>{}</sub>").format(name.removeprefix("P_"))


def _local_section(made: Identified) -> Section:
    found = made.found
    picture = drawing(figures.spectrum(found.spread), "Spectrum of the Fisher information")
    decades = found.spread.decades
    largest = symbols(found.collinearity.largest())
    text = Markup(
        "Exact sensitivities of every reading, over the posterior: the information spans {} decades. The "
        "largest set of parameters that can be determined together (collinearity index up to {:g}): {}."
    ).format(f"{decades:.1f}" if decades < 100 else "infinitely many", CRITICAL, largest or "none")
    rows = tuple(
        (symbol(row["parameter"]), *(plain(row[name] / PARAMETERS[row["parameter"]].scale, 3)
         for name in ("prior_sd", "local_sd", "posterior_sd")), unit(row["parameter"]) or NOTHING)
        for row in _records(found.spread.table)
    )  # fmt: skip
    table = Table(
        "Standard deviations: prior after the cut, Cramér–Rao bound with the prior (averaged over the "
        "posterior), posterior. A posterior far below its bound is cut off by an edge.",
        "lrrrl",
        ("", "prior", "bound", "posterior", "unit"),
        rows,
    )
    caption = "Information of the independent directions: dots over the posterior’s median, bars 5 to 95 %."
    return Section("local", "Sensitivities", (Text(text), table, Gallery("half", (picture,), caption)))


def _further_section(made: Identified) -> Section:
    drawn = made.found.drawn
    rows = tuple(
        (
            symbol(name),
            f"{_signed(cloned['late_slope'])} ± {cloned['late_error']:.2f}",
            cloned["word"],
            f"{scaled['own']:.3f}",
            f"{scaled['likelihood']:.3f}",
            scaled["word"],
        )
        for name, cloned, scaled in zip(
            made.found.names, _records(drawn.cloned.parameters), _records(drawn.scaling.table), strict=True
        )
    )
    caption = (
        "Data cloning: how the variance falls as the same readings are counted 4 to 16 times, −1 where they "
        "determine the parameter, 0 where they never will. Power-scaling: how far its law moves as its own "
        "prior, and the likelihood, weigh a little more (0.089 for a normal law that is all one or the "
        "other)."
    )
    header = ("", "slope", "cloning", "own prior", "likelihood", "power-scaling")
    doubt = [] if drawn.cloned.reliable else ["data cloning"]
    doubt += [] if drawn.scaling.reliable else ["power-scaling"]
    note = (
        (Text(Markup("Weights with a heavy tail: do not rely on {}.").format(listed(doubt))),)
        if doubt
        else ()
    )
    return Section(
        "further", "Cloned data and power-scaling", (Table(caption, "lrlrrl", header, rows), *note)
    )


def _method_section(made: Identified) -> Section:
    found, record = made.found, made.record
    nulls = [null.words for null in found.structure.nulls]
    seen = "The design sees every direction." if not nulls else " ".join(f"{words}." for words in nulls)
    text = Markup("{} Rank {} of {} at {} draws of the cut prior.").format(
        seen, found.structure.rank, len(found.names), found.structure.draws
    )
    seconds = ", ".join(f"{part} {value:.1f} s" for part, value in record["seconds"].items())
    rows: tuple[tuple[Cell, ...], ...] = (
        ("draws from", record["draws_from"]),
        ("seed", str(record["seed"])),
        ("wall time", seconds),
        ("versions", ", ".join(f"{name} {value}" for name, value in record["versions"].items())),
        ("fingerprint of the study", Markup("<code>{}</code>").format(record["fingerprints"]["study"])),
    )
    sources = Text(
        "Profiles: Raue et al. 2009; collinearity: Brun et al. 2001; cloning: Lele et al. 2007; "
        "power-scaling: Kallioinen et al. 2024; mutual information: Gaussian copula, and Kraskov et al. 2004 "
        "as the check."
    )
    return Section("method", "Structure and method", (Text(text), sources, Table("", "ll", ("", ""), rows)))
