"""What stands behind the verdicts of an identifiability analysis: coupling, information, sensitivities."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from bayesterra import figures
from bayesterra.identifiability.analysis import Analysis
from bayesterra.identifiability.collinearity import CRITICAL
from bayesterra.identifiability.coupling import Coupling
from bayesterra.identifiability.information import Information
from bayesterra.identified import Identified
from bayesterra.parameters import PARAMETERS
from bayesterra.report.blocks import Block, Cell, Gallery, Section, Table, Text, drawing
from bayesterra.report.determined import GROUPS, count_row, signed
from bayesterra.report.numbers import NOTHING, number, plain
from bayesterra.report.symbols import in_symbols, listed, symbol, symbols, unit
from bayesterra.report.tables import records


def coupling_section(found: Coupling) -> Section:
    """Coupling of parameters and of groups."""
    blocks: list[Block] = []
    if len(found.names) > 1:
        blocks.append(_couplings(found))
    if len(found.between):
        blocks.append(_between(found))
    alone = Text("There is a single free parameter: nothing to be coupled with.")
    return Section("coupling", "Coupling", tuple(blocks) or (alone,))


def _couplings(found: Coupling) -> Gallery:
    pictures = [drawing(figures.coupling_map(found), "Normal-score correlations of every pair of parameters")]
    left = (
        "Correlation of normal scores of every pair: posterior below the diagonal, prior after the cut above "
        "it. A star: nearest neighbours find more dependence than that, or less. Framed: the groups bearing "
        "<i>P</i><sub>I</sub>, shearing <i>P</i><sub>II</sub>, contact angles <i>P</i><sub>III</sub>."
    )
    right = ""
    if len(found.between):
        pictures.append(drawing(figures.group_coupling(found), "Mutual information of the parameter groups"))
        right = (
            " Right: mutual information of the groups, from normal scores (bars) and from nearest neighbours "
            "(circles, ± 1 standard error)."
        )
    return Gallery("half", tuple(pictures), Markup(left + right))  # noqa: S704 (constants)


def _between(found: Coupling) -> Table:
    rows = tuple(
        (
            Markup("<i>P</i><sub>{}</sub> and <i>P</i><sub>{}</sub>").format(
                *(str(row[key]).removeprefix("P_") for key in ("first", "second"))
            ),
            number(row["information"], 2),
            f"{number(row['nearest'], 2)} ± {number(row['nearest_error'], 2)}",
            number(row["null"], 2),
            number(row["prior_information"], 2),
        )
        for row in records(found.between)
    )
    header = ("groups", "normal scores", "neighbours", "by chance", "of the prior")
    caption = (
        "Mutual information of the groups in nats; what independent draws would seem to have by chance (95 % "
        "of times less); and that of the prior after the cut, which is none of the data’s doing."
    )
    return Table(caption, "lrrrr", header, rows)


def information_section(found: Information) -> Section:
    """What the data contract, of parameters and of directions of the groups."""
    bars = drawing(
        figures.contraction_bars(found), "Contraction of every parameter by the data and by the cut"
    )
    rows = tuple((*count_row(row), *_elsewhere(row)) for row in records(found.counts))
    header = ("group", "others", "determined", "effective", "by the cut", "plain", "sampling")
    extra = Markup(" Last columns: determined in plain parameters and in sampling coordinates.")
    caption = (
        "What the data contract of the prior after the physical cut, and what the cut had contracted before: "
        "the latter is no information in the data."
    )
    table = Table(GROUPS + extra, "llrrrrr", header, rows)
    return Section("information", "Information", (table, Gallery("half", (bars,), caption)))


def _elsewhere(row: dict[str, object]) -> tuple[str, str]:
    return str(row["determined_plain"]), str(row["determined_sampling"])


def local_section(found: Analysis) -> Section:
    """Exact sensitivities, their spectrum and the bounds that follow from them."""
    picture = drawing(figures.spectrum(found.spread), "Spectrum of the Fisher information")
    decades = found.spread.decades
    largest = found.collinearity.largest()
    text = Markup(
        "Exact sensitivities of every reading, over the posterior: what they know of the directions spans {} "
        "decades. The largest set of parameters that can be determined together (collinearity index up to "
        "{:g}): {}."
    ).format(f"{decades:.1f}" if decades < 100 else "infinitely many", CRITICAL, symbols(largest) or "none")
    rows = tuple((symbol(row["parameter"]), *_spreads(row)) for row in records(found.spread.table))
    table = Table(
        "Standard deviations: prior after the cut, Cramér–Rao bound with the prior (averaged over the "
        "posterior), posterior. A posterior far below its bound is cut off by an edge.",
        "lrrrl",
        ("", "prior", "bound", "posterior", "unit"),
        rows,
    )
    caption = (
        "Information of the independent directions in units of the prior’s: dots at the posterior’s median, "
        "bars 5 to 95 %. Broken line: as much as the prior holds; dotted: a tenth of its variance is left."
    )
    return Section("local", "Sensitivities", (Text(text), table, Gallery("half", (picture,), caption)))


def _spreads(row: dict[str, object]) -> Sequence[Cell]:
    name = str(row["parameter"])
    values = (float(str(row[key])) for key in ("prior_sd", "local_sd", "posterior_sd"))
    return [*(plain(value / PARAMETERS[name].scale) for value in values), unit(name) or NOTHING]


def further_section(found: Analysis) -> Section:
    """Data cloning and power-scaling."""
    drawn = found.drawn
    cloned, scaled = records(drawn.cloned.parameters), records(drawn.scaling.table)
    rows = tuple(
        (
            symbol(name),
            f"{signed(one['late_slope'])} ± {number(one['late_error'], 2)}",
            one["word"],
            number(other["own"], 3),
            number(other["likelihood"], 3),
            other["word"],
        )
        for name, one, other in zip(found.names, cloned, scaled, strict=True)
    )
    caption = (
        "Data cloning: how the variance falls as the same readings are counted 4 to 16 times, −1 where they "
        "determine the parameter, 0 where they never will. Power-scaling: how far its law moves as its own "
        "prior, and the likelihood, weigh a little more (0.089 for a normal law that is all one or the "
        "other)."
    )
    header = ("", "slope", "cloning", "own prior", "likelihood", "power-scaling")
    table = Table(caption, "lrlrrl", header, rows)
    return Section("further", "Cloned data and power-scaling", (table, *_doubts(found)))


def _doubts(found: Analysis) -> tuple[Text, ...]:
    parts = (("data cloning", found.drawn.cloned), ("power-scaling", found.drawn.scaling))
    doubted = [name for name, part in parts if not part.reliable]
    text = Markup("Weights with a heavy tail: do not rely on {}.").format(listed(doubted))
    return (Text(text),) if doubted else ()


def method_section(made: Identified) -> Section:
    """What the design sees, and how the page was made."""
    found, record = made.found, made.record
    nulls = [f"{null.words[:1].upper()}{null.words[1:]}." for null in found.structure.nulls]
    text = Markup("{} Rank {} of {} at {} draws of the prior after the cut.").format(
        in_symbols(" ".join(nulls)) or "The design sees every direction.",
        found.structure.rank,
        len(found.names),
        found.structure.draws,
    )
    seconds = ", ".join(f"{part} {value:.1f} s" for part, value in record["seconds"].items())
    rows: tuple[tuple[Cell, ...], ...] = (
        ("draws from", "this command" if record["draws_from"] == "here" else record["draws_from"]),
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
