"""What the data of a run determine: verdicts, directions of each group, contraction and combinations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

from bayesterra import figures
from bayesterra.figures.rows import Found, found_rows
from bayesterra.identifiability import COUPLED, COUPLED_TO_ALL, DETERMINED, SHIFT, WEAK
from bayesterra.identifiability.information import ALL, MARGINAL
from bayesterra.identifiability.verdicts import MOVED
from bayesterra.identifiability.wording import GROUP_WORDS, in_a_sentence
from bayesterra.report.blocks import Block, Cell, Gallery, Section, Table, Text, drawing
from bayesterra.report.numbers import MINUS, NOTHING
from bayesterra.report.symbols import in_symbols, symbol
from bayesterra.results import Result

GROUPS = Markup(
    "Directions of each group of parameters whose variance shrinks tenfold or more, in normal scores of the "
    "prior after the cut. Effective: sum of their contractions; by the cut: what the physical cut alone had "
    "contracted of the stated prior, which is no information in the data. Others known: were all parameters "
    "outside the group known."
)


def finding(result: Result) -> Markup:
    """The finding in a sentence; empty for folders of versions that did not count the groups' directions."""
    rows = marginal(result.record.get("directions", {}))
    words = {name: row.verdict for name, row in found_rows(result).items()}
    text = in_a_sentence(rows, words, lambda name: str(symbol(name))) if rows else ""
    return Markup(text)  # noqa: S704 (constants)


def marginal(directions: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Directions of each group, and of all parameters, whatever the others are."""
    return [row for row in directions.get("groups", ()) if row["view"] == MARGINAL]


def identifiability_section(result: Result) -> Section:
    """What the data determine."""
    bars = drawing(figures.contraction(result), "Contraction of every parameter")
    cells = drawing(
        figures.combinations(result), "Weights of the parameters in the combinations, best determined first"
    )
    caption = Markup(
        "Left: contraction 1 − var(posterior)/var(prior) of each parameter, of its logarithm where the prior "
        "is a law of that, with the limits {:.1f} and "
        "{:.1f}. Right: the independent combinations of parameters, best determined first, with their own "
        "contraction; weights in units of the prior's sd. Combinations at the bottom are what a next "
        "measurement should aim at."
    ).format(WEAK, DETERMINED)
    groups = _groups(result.record.get("directions", {}))
    blocks: tuple[Block, ...] = (Text(_meaning()), _verdicts(result), *groups)
    more = Text(
        Markup(
            "<code>bayesterra identify DIR</code>, with the folder of this report for DIR, shows the rest: "
            "profiles of the likelihood, what compensates what, coupling of the groups, cloned data, and "
            "where these methods disagree with a verdict."
        )
    )
    return Section(
        "identifiability", "Identifiability", (*blocks, Gallery("half", (bars, cells), caption), more)
    )


def _meaning() -> Markup:
    return Markup(
        "A parameter is <b>determined</b> where its variance shrinks by {:.0f} % or more (sd below a third "
        "of the prior's), but <b>one-sided</b> where it then leans on a bound of its prior: that end is not "
        "from the data. Otherwise it is <b>coupled</b> where the data tie it to others that are not "
        "determined either: correlation {:g} or stronger with one of them, or multiple correlation <i>R</i> "
        "of {:g} or more with all of them together. Else it is <b>weakly</b> determined from {:.0f} % on. "
        "Below that it has <b>moved</b> where its law is another one than the prior's (mean shifted by {:g} "
        "sd or more, or {:.3f} nats between the laws): prior and data disagree. Else it "
        "<b>repeats its prior</b>. It is <b>structurally not determined</b> where no readings of this design "
        "could tell it, however many and good: none depends on it, or others make up for any change of it."
    ).format(100 * DETERMINED, COUPLED, COUPLED_TO_ALL, 100 * WEAK, SHIFT, MOVED)


def _verdicts(result: Result) -> Table:
    rows = tuple(
        (
            symbol(name),
            row.verdict,
            f"{max(row.contraction, 0.0):.2f}",
            symbol(row.tied_to) if row.tied_to != name else NOTHING,
            signed(row.tie),
            _multiple(row),
        )
        for name, row in found_rows(result).items()
    )
    header = ("", "verdict", "contraction", "strongest coupling", "correlation", Markup("<i>R</i>"))
    caption = "Verdict of every parameter; couplings with parameters that are not determined."
    return Table(caption, "llrlrr", header, rows)


def signed(value: float) -> str:
    """A correlation with its sign."""
    return f"{value:+.2f}".replace("-", MINUS) if value == value else NOTHING


def _multiple(row: Found) -> str:
    return f"{row.multiple:.2f}" if row.multiple == row.multiple else NOTHING


def _groups(directions: Mapping[str, Any]) -> tuple[Block, ...]:
    """Counts per group, and what the design cannot see; nothing where an older version did not count."""
    rows = tuple(count_row(row) for row in directions.get("groups", ()))
    header = ("group", "others", "determined", "effective", "by the cut")
    table = (Table(GROUPS, "llrrr", header, rows),) if rows else ()
    unseen = directions.get("unseen", ())
    said = (in_symbols(f"{words[:1].upper()}{words[1:]}.") for words in unseen)
    return (*table, *(Text(Markup("By the design: {}").format(words)) for words in said))


def count_row(row: Mapping[str, Any]) -> tuple[Cell, ...]:
    """Group, view, determined of all directions, effective number for the data and for the cut."""
    counted = f"{row['determined']} of {row['directions']}"
    view = "unknown" if row["view"] == MARGINAL else "known"
    return (group(row["scope"]), view, counted, f"{row['effective']:.2f}", f"{row['cut_effective']:.2f}")


def group(scope: str) -> Cell:
    """A group by its word and symbol."""
    if scope == ALL:
        return "all parameters"
    if not scope.startswith("P_"):
        return scope
    return Markup("{} <i>P</i><sub>{}</sub>").format(GROUP_WORDS[scope], scope.removeprefix("P_"))
