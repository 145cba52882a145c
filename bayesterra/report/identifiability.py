"""The page of an identifiability analysis: the verdicts first, then the figures behind each word."""

from __future__ import annotations

from markupsafe import Markup

from bayesterra import figures
from bayesterra.figures.profiles import profiles_in_words
from bayesterra.identifiability.information import ALL
from bayesterra.identifiability.verdicts import (
    COUPLED,
    COUPLED_TO_ALL,
    DETERMINED,
    EXCLUDED,
    MOVED,
    SHIFT,
    WEAK,
    WORDS,
)
from bayesterra.identified import Identified
from bayesterra.report.blocks import Block, Cell, Gallery, Section, Table, Text, drawing
from bayesterra.report.determined import signed
from bayesterra.report.evidence import (
    coupling_section,
    further_section,
    information_section,
    local_section,
    method_section,
)
from bayesterra.report.numbers import NOTHING, interval, number, plain
from bayesterra.report.pages import VerdictPage
from bayesterra.report.symbols import amount, in_symbols, listed, symbol, symbols
from bayesterra.report.tables import Record, records
from bayesterra.report.verdicts import Verdict

FEW = 2
"""Objections that find room on a card."""


def identifiability_page(made: Identified) -> VerdictPage:
    """Put the page together."""
    study = made.study
    drawn = f"{made.record['draws']} draws"
    return VerdictPage(
        title=study.title or "Soil parameters from wheel tests",
        facts=(f"{study.kind} data", f"model {study.model.name}, {study.drive}-driven", drawn),
        warning=_warning(made),
        verdicts=(_directions_card(made), _parameters_card(made), _agreement_card(made)),
        sections=(
            _verdict_section(made),
            _profile_section(made),
            coupling_section(made.found.drawn.coupling),
            information_section(made.found.drawn.information),
            local_section(made.found),
            further_section(made.found),
            method_section(made),
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
    determined, of = (int(counts[name].to_dict()[ALL]) for name in ("determined", "directions"))
    grade = "good" if determined == of else "fair" if determined else "poor"
    sentence = Markup(made.in_words(lambda name: str(symbol(name))))  # noqa: S704 (constants)
    return Verdict("Independent directions", f"{determined} of {of} fixed", grade, sentence)


def _parameters_card(made: Identified) -> Verdict:
    words = made.found.verdicts.groupby("verdict")["parameter"].agg(list).to_dict()
    known = words.get("determined", [])
    others = [word for word in WORDS if word in words and word != "determined"]
    parts = [Markup("{}: {}").format(word, symbols(words[word])) for word in others]
    first = Markup("{} on {} own").format(symbols(known), "its" if len(known) == 1 else "their")
    sentence = Markup("; ").join([first if known else Markup("None on its own"), *parts])
    grade = "good" if len(known) == len(made.found.names) else "fair" if known else "poor"
    word = f"{len(known)} of {len(made.found.names)} determined"
    return Verdict("Parameters", word, grade, Markup("{}.").format(sentence))


def _agreement_card(made: Identified) -> Verdict:
    table = made.found.verdicts
    against = table[table["against"] != ""]
    if against.empty:
        sentence = Markup("Profiles, cloned data and divergences say nothing against any verdict.")
        return Verdict("Methods", "agree", "good", sentence)
    said = [Markup("{}: {}").format(symbol(row["parameter"]), row["against"]) for row in records(against)]
    sentence = Markup("Against the word for {}.").format(Markup("; ").join(said))
    if len(said) > FEW:
        sentence = Markup("Against the words for {}: see below.").format(symbols(against["parameter"]))
    count = f"{len(said)} objection{'s' if len(said) > 1 else ''}"
    return Verdict("Methods", count, "fair", sentence)


def _verdict_section(made: Identified) -> Section:
    text = Markup(
        "<b>Determined</b>: variance at most {:.0f} % of the prior’s after the physical cut. "
        "<b>One-sided</b>: so, but one end is the prior’s bound; or the likelihood’s profile excludes "
        "{:.0f} % or more of the prior, on one side only. <b>Coupled</b>: neither, and the data tie it to "
        "others that are not determined either, one of them (correlation {:g} or stronger) or all together "
        "(<i>R</i> {:g} or more). <b>Weakly</b>: contraction {:g} or more. <b>Moved</b>: less, but the mean "
        "shifted by {:g} sd of the prior or more, or its law is {:.3f} nats or more from it: prior and data "
        "disagree. <b>Repeats its prior</b>: none of these. "
        "<b>Structurally not determined</b>: no data of this design can tell it, however many."
    ).format(100 * (1 - DETERMINED), 100 * EXCLUDED, COUPLED, COUPLED_TO_ALL, WEAK, SHIFT, MOVED)
    return Section(
        "verdicts", "Verdicts", (_verdict_table(made), *_objections(made), Text(text), _combinations(made))
    )


def _verdict_table(made: Identified) -> Table:
    rows = tuple(_verdict_row(row) for row in records(made.verdicts))
    header = ("", "verdict", "contraction", "profile, 95 %", "tied to", Markup("<i>r</i>"))
    last = (Markup("<i>R</i>"), "cloned 16 times")
    caption = Markup(
        "Contraction: 1 − variance over that of the prior after the cut, of the logarithm under log laws. "
        "Profile: of the likelihood over the "
        "prior’s range. Tied to: strongest correlation <i>r</i> with a parameter that is not determined; "
        "<i>R</i>: multiple correlation with all of those. Cloned: whether the same readings sixteen times "
        "would narrow it."
    )
    return Table(caption, "llrllrrl", (*header, *last), rows)


def _verdict_row(row: Record) -> tuple[Cell, ...]:
    name = row["parameter"]
    tied = row["tied_to"] != name
    return (
        symbol(name),
        Markup("<b>{}</b>").format(row["verdict"]),
        number(max(row["contraction"], 0.0), 2),
        Markup("{}{}").format(row["profile"], _ends(row)),
        symbol(row["tied_to"]) if tied else NOTHING,
        signed(row["tie"]) if tied else NOTHING,
        number(row["multiple"], 2) if tied else NOTHING,
        {"estimable": "narrows", "not estimable": "stays"}.get(row["cloned"], "undecided"),
    )


def _ends(row: Record) -> Cell:
    """The profile's interval in the parameter's unit; what bounds no side says nothing."""
    name, low, high = row["parameter"], row["lower_95"], row["upper_95"]
    if low == low and high == high:
        return Markup(", {}").format(amount(name, interval(low, high)))
    if low == low:
        return Markup(", above {}").format(amount(name, plain(low)))
    return Markup(", below {}").format(amount(name, plain(high))) if high == high else ""


def _objections(made: Identified) -> tuple[Block, ...]:
    said = tuple(
        Markup("<b>{}</b> ({}): {}").format(symbol(row["parameter"]), row["verdict"], row["against"])
        for row in records(made.verdicts)
        if row["against"]
    )
    return (Text(Markup("What speaks against a word. {}.").format(Markup(". ").join(said))),) if said else ()


def _combinations(made: Identified) -> Table:
    rows = tuple(
        (row["verdict"], number(row["contraction"], 3, least=0.0), in_symbols(row["combination"]))
        for row in records(made.found.combinations)
    )
    caption = (
        "Independent combinations of the parameters, best determined first; weights in standard deviations "
        "of the prior after the cut (of normal scores, so that the scale of a parameter does not matter)."
    )
    return Table(caption, "lrl", ("verdict", "contraction", "combination"), rows)


def _profile_section(made: Identified) -> Section:
    panels = drawing(figures.profile_panels(made.found.profiles), profiles_in_words(made.found.profiles))
    caption = (
        "The best that all other parameters can do at each value of one. Where a curve crosses the 95 % line "
        "on both sides the readings bound the parameter; where it stays below, only the prior’s range does."
    )
    table = made.found.profiles.table
    rows = tuple(
        (
            symbol(row["parameter"]),
            row["class"],
            f"{100 * row['trust']:.0f} %{_lost(row['failed'])}",
            _moves(row["compensated_by"]),
        )
        for row in records(table[table["kind"] == "likelihood"])
    )
    moves = Table(
        "What compensates what: how far the others move along the 95 % interval, in standard deviations of "
        "their prior. Trust: points that two or more descents agree on; points not solved are marked by a "
        "cross in the figure, and nothing is read off them.",
        "llrl",
        ("", "class", "trust", "others move by"),
        rows,
    )
    return Section("profiles", "Profiles", (Gallery("whole", (panels,), caption), moves))


def _lost(failed: int) -> str:
    """How many points of a profile were not solved; nothing where all were."""
    return f", {failed} not solved" if failed else ""


def _moves(text: str) -> Cell:
    """Such as ``n0 −0.4, c1 +0.3``, with symbols."""
    parts = [part.rsplit(" ", 1) for part in text.split(", ") if part]
    return listed(Markup("{} {}").format(symbol(name), move) for name, move in parts) if parts else NOTHING
