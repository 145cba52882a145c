"""Coupling, information and collinearity as sections and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from bayesterra.identifiability import determined_page
from bayesterra.identifiability.analysis import GROUP_WORDS as WORDS
from bayesterra.identifiability.analysis import Analysis
from bayesterra.identifiability.determined_page import GROUPS, count_row, signed
from bayesterra.identifiability.identify import Identified
from bayesterra.identifiability.information import Coupling, Information
from bayesterra.identifiability.local import CRITICAL
from bayesterra.identifiability.verdicts import DETERMINED, WEAK
from bayesterra.parameters import PARAMETERS
from bayesterra.report.blocks import Block, Blocks, Cell, Gallery, Table, Text, drawing, records
from bayesterra.report.figures import label, name_cells, own_axes, styled
from bayesterra.report.numbers import NOTHING, number, plain
from bayesterra.report.sections import origin_rows
from bayesterra.report.style import DATA, GRID, INK, POSTERIOR, PRIOR
from bayesterra.report.symbols import in_symbols, listed, symbol, symbols, unit


def coupling_section(coupling: Coupling) -> Blocks:
    """Coupling of parameters and of groups."""
    blocks: list[Block] = []
    if len(coupling.names) > 1:
        blocks.append(_couplings(coupling))
    if len(coupling.between):
        blocks.append(_between(coupling))
    alone = Text("There is a single free parameter: nothing to be coupled with.")
    return tuple(blocks) or (alone,)


def _couplings(coupling: Coupling) -> Gallery:
    pictures = [drawing(coupling_map(coupling), "Normal-score correlations of every pair of parameters")]
    left = (
        "Correlation of normal scores of every pair: posterior below the diagonal, prior after the cut above "
        "it. A star: nearest neighbours find more dependence than that, or less. Framed: the groups bearing "
        "<i>P</i><sub>I</sub>, shearing <i>P</i><sub>II</sub>, contact angles <i>P</i><sub>III</sub>."
    )
    right = ""
    if len(coupling.between):
        pictures.append(drawing(group_coupling(coupling), "Mutual information of the parameter groups"))
        right = (
            " Right: mutual information of the groups, from normal scores (bars) and from nearest neighbours "
            "(circles, ± 1 standard error)."
        )
    return Gallery("half", tuple(pictures), Markup(left + right))  # noqa: S704 (constants)


def _between(coupling: Coupling) -> Table:
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
        for row in records(coupling.between)
    )
    header = ("groups", "normal scores", "neighbours", "by chance", "of the prior")
    caption = (
        "Mutual information of the groups in nats; what independent draws would seem to have by chance (95 % "
        "of times less); and that of the prior after the cut, which is none of the data’s doing."
    )
    return Table(caption, "lrrrr", header, rows)


def information_section(information: Information) -> Blocks:
    """Section on what the data contract, of parameters and of directions of the groups."""
    bars = drawing(contraction_bars(information), "Contraction of every parameter by the data and by the cut")
    rows = tuple((*count_row(row), *_elsewhere(row)) for row in records(information.counts))
    header = ("group", "others", "determined", "effective", "by the cut", "plain", "sampling")
    extra = Markup(" Last columns: determined in plain parameters and in sampling coordinates.")
    caption = (
        "What the data contract of the prior after the physical cut, and what the cut had contracted before: "
        "the latter is no information in the data."
    )
    table = Table(GROUPS + extra, "llrrrrr", header, rows)
    return (table, Gallery("half", (bars,), caption))


def _elsewhere(row: dict[str, object]) -> tuple[str, str]:
    return str(row["determined_plain"]), str(row["determined_sampling"])


def local_section(analysis: Analysis) -> Blocks:
    """Exact sensitivities, their spectrum and the bounds that follow from them."""
    picture = drawing(determined_page.spectrum(analysis.spread), "Spectrum of the Fisher information")
    decades = analysis.spread.decades
    largest = analysis.collinearity.largest()
    text = Markup(
        "Exact sensitivities of every reading, over the posterior: what they know of the directions spans {} "
        "decades. The largest set of parameters that can be determined together (collinearity index up to "
        "{:g}): {}."
    ).format(f"{decades:.1f}" if decades < 100 else "infinitely many", CRITICAL, symbols(largest) or "none")
    rows = tuple((symbol(row["parameter"]), *_spreads(row)) for row in records(analysis.spread.table))
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
    return (Text(text), table, Gallery("half", (picture,), caption))


def _spreads(row: dict[str, object]) -> Sequence[Cell]:
    name = str(row["parameter"])
    values = (float(str(row[key])) for key in ("prior_sd", "local_sd", "posterior_sd"))
    return [*(plain(value / PARAMETERS[name].scale) for value in values), unit(name) or NOTHING]


def further_section(analysis: Analysis) -> Blocks:
    """Data cloning and power-scaling."""
    drawn = analysis.drawn
    cloned, scaled = records(drawn.cloned.parameters), records(drawn.scaling.table)
    rows = tuple(
        (
            symbol(name),
            f"{signed(clone['late_slope'])} ± {number(clone['late_error'], 2)}",
            clone["word"],
            number(other["own"], 3),
            number(other["likelihood"], 3),
            other["word"],
        )
        for name, clone, other in zip(analysis.names, cloned, scaled, strict=True)
    )
    caption = (
        "Data cloning: how the variance falls as the same readings are counted 4 to 16 times, −1 where they "
        "determine the parameter, 0 where they never will. Power-scaling: how far its law moves as its own "
        "prior, and the likelihood, weigh a little more (0.089 for a normal law that is all one or the "
        "other)."
    )
    header = ("", "slope", "cloning", "own prior", "likelihood", "power-scaling")
    table = Table(caption, "lrlrrl", header, rows)
    return (table, *_doubts(analysis))


def _doubts(analysis: Analysis) -> tuple[Text, ...]:
    checks = (("data cloning", analysis.drawn.cloned), ("power-scaling", analysis.drawn.scaling))
    doubted = [name for name, check in checks if not check.reliable]
    text = Markup("Weights with a heavy tail: do not rely on {}.").format(listed(doubted))
    return (Text(text),) if doubted else ()


def method_section(made: Identified) -> Blocks:
    """Section on what the design sees, and how the page was made."""
    analysis, record = made.found, made.record
    nulls = [f"{null.words[:1].upper()}{null.words[1:]}." for null in analysis.structure.nulls]
    text = Markup("{} Rank {} of {} at {} draws of the prior after the cut.").format(
        in_symbols(" ".join(nulls)) or "The design sees every direction.",
        analysis.structure.rank,
        len(analysis.names),
        analysis.structure.draws,
    )
    seconds = ", ".join(f"{part} {value:.1f} s" for part, value in record["seconds"].items())
    rows: tuple[tuple[Cell, ...], ...] = (
        ("draws from", "this command" if record["draws_from"] == "here" else record["draws_from"]),
        ("seed", str(record["seed"])),
        ("wall time", seconds),
        *origin_rows(record, "study"),
    )
    sources = Text(
        "Profiles: Raue et al. 2009; collinearity: Brun et al. 2001; cloning: Lele et al. 2007; "
        "power-scaling: Kallioinen et al. 2024; mutual information: Gaussian copula, and Kraskov et al. 2004 "
        "as the check."
    )
    return (Text(text), sources, Table("", "ll", ("", ""), rows))


@styled
def coupling_map(coupling: Coupling, ax: Axes | None = None) -> Axes:
    """Draw normal-score correlations: posterior below the diagonal, cut prior above, the groups boxed.

    A star marks pairs in which nearest neighbours find more dependence, or less, than the correlation says.
    """
    count = len(coupling.names)
    ax = own_axes(ax, 0.52 * count + 1.2, 0.48 * count + 1.2)
    lower = np.tri(count, k=-1, dtype=bool)
    values = np.where(lower, coupling.copula, coupling.prior_copula)
    np.fill_diagonal(values, np.nan)
    ax.pcolormesh(np.ma.masked_invalid(values), cmap="PuOr_r", vmin=-1.6, vmax=1.6, edgecolors="none")
    starred = _starred(coupling)
    for i, j in zip(*np.nonzero(~np.eye(count, dtype=bool)), strict=True):
        text = _number(values[i, j]) + ("*" if lower[i, j] and {i, j} in starred else "")
        ax.text(j + 0.5, i + 0.5, text, ha="center", va="center", fontsize=7.5)
    ax.plot([0, count], [0, count], color=GRID, linewidth=0.7)
    _boxes(ax, coupling.groups)
    name_cells(ax, coupling.names)
    ax.tick_params(labelsize=10)
    ax.xaxis.tick_top()
    ax.text(0.0, count + 0.12, "below: posterior", ha="left", va="top", fontsize=8, color=POSTERIOR)
    ax.text(count, count + 0.12, "above: prior after the cut", ha="right", va="top", fontsize=8, color=PRIOR)
    return ax


def _starred(coupling: Coupling) -> list[set[int]]:
    rows = coupling.pairs[coupling.pairs["disagree"].astype(bool)]
    places = {name: i for i, name in enumerate(coupling.names)}
    return [{places[a], places[b]} for a, b in zip(rows["first"], rows["second"], strict=True)]


def _number(value: float) -> str:
    return f"{round(value, 2) + 0.0:.2f}".replace("-", "−")


def _boxes(ax: Axes, groups: Mapping[str, Sequence[int]]) -> None:
    """Frame the pairs within each group of the paper."""
    for group, columns in groups.items():
        if list(columns) != list(range(columns[0], columns[0] + len(columns))):
            continue  # parameters that do not stand side by side
        corner, size = (columns[0], columns[0]), len(columns)
        ax.add_patch(Rectangle(corner, size, size, fill=False, edgecolor=INK, linewidth=1.3, clip_on=False))
        ax.text(columns[0] + 0.5, columns[0] + 0.5, _group(group), color=DATA, fontsize=9, ha="center",
                va="center", bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0})  # fmt: skip


@styled
def group_coupling(coupling: Coupling, ax: Axes | None = None) -> Axes:
    """Draw the mutual information of every pair of groups: copula (bar), nearest neighbours (mark), prior."""
    table = coupling.between
    ax = own_axes(ax, 4.4, 0.5 * len(table) + 1.1)
    places = np.arange(len(table))[::-1]
    ax.barh(places + 0.14, table["information"], height=0.28, color=POSTERIOR, alpha=0.75)
    ax.barh(places - 0.14, table["prior_information"], height=0.28, color=PRIOR, alpha=0.75)
    ax.errorbar(
        table["nearest"], places + 0.14, xerr=table["nearest_error"], fmt="o", color=DATA, markersize=4,
        markerfacecolor="none",
    )  # fmt: skip
    names = [f"{WORDS[a]} –\n{WORDS[b]}" for a, b in zip(table["first"], table["second"], strict=True)]
    ax.set(yticks=places, yticklabels=names, xlabel="mutual information [nat]")
    ax.set_xlim(left=min(0.0, float(table["nearest"].min())) if len(table) else 0.0)
    ax.tick_params(axis="y", length=0, labelsize=9)
    near = Line2D(
        [], [], color=DATA, marker="o", markerfacecolor="none", linestyle="none", label="neighbours"
    )
    bars = [
        Patch(color=POSTERIOR, alpha=0.75, label="posterior"),
        Patch(color=PRIOR, alpha=0.75, label="prior after the cut"),
    ]
    ax.legend(handles=[*bars, near], loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    return ax


def _group(name: str) -> str:
    return rf"$P_\mathrm{{{name.removeprefix('P_')}}}$" if name.startswith("P_") else name


@styled
def contraction_bars(information: Information, ax: Axes | None = None) -> Axes:
    """Draw what the data contract of the cut prior, and what the cut has contracted of the stated one."""
    table = information.parameters
    ax = own_axes(ax, 4.6, 0.42 * len(table) + 1.1)
    places = np.arange(len(table))[::-1]
    bars = (
        ("contraction", 0.16, POSTERIOR, "data, of the prior after the cut"),
        ("cut_contraction", -0.16, PRIOR, "physical cut, of the stated prior"),
    )
    for column, shift, colour, said in bars:
        shares = np.clip(table[column].to_numpy(dtype=np.float64), 0.0, 1.0)
        ax.barh(places + shift, shares, height=0.32, color=colour, alpha=0.75, label=said)
    for limit in (WEAK, DETERMINED):
        ax.axvline(limit, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
    names = [label(PARAMETERS[name], unit=False) for name in table["parameter"]]
    ax.set(yticks=places, yticklabels=names, xlim=(0, 1), xlabel="contraction 1 − var(after) / var(before)")
    ax.tick_params(axis="y", length=0)
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=1)
    return ax
