"""What the data determine, how it hangs together, and how that was found: sections and figures."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from bayesterra.arrays import IntArray
from bayesterra.identifiability.analysis import GROUP_WORDS, Analysis, Identified
from bayesterra.identifiability.information import ALL, MARGINAL, Coupling, Information
from bayesterra.identifiability.local import CRITICAL, LocalAnalysis
from bayesterra.identifiability.verdicts import COUPLED_TO_ALL, DETERMINED, MOVED, SHIFT, WEAK, identifiability
from bayesterra.parameters import PARAMETERS
from bayesterra.report.blocks import Blocks, Cell, Gallery, Record, Table, Text, drawing, records
from bayesterra.report.figures import DATA, GRID, INK, POSTERIOR, PRIOR, label, name_cells, own_axes, styled
from bayesterra.report.numbers import NOTHING, number, plain, signed
from bayesterra.report.sections import Prose, origin_rows
from bayesterra.report.symbols import in_symbols, symbol, symbols, unit
from bayesterra.study.result import COUPLED, Result, identifiability_rows

say = Prose("identify")


def marginal(directions: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Directions of each group, and of all parameters, whatever the others are."""
    return [row for row in directions.get("groups", ()) if row["view"] == MARGINAL]


def identifiability_section(result: Result) -> Blocks:
    """Section on what the data determine."""
    bars = drawing(contraction(result), "Contraction of every parameter")
    cells = drawing(combinations(result), "Weights of the parameters in the combinations, best determined first")
    groups = _groups(result.record.get("directions", {}))
    return (
        Text(say("meaning", 100 * DETERMINED, COUPLED, COUPLED_TO_ALL, 100 * WEAK, SHIFT, MOVED)), _verdicts(result),
        *groups, Gallery("half", (bars, cells), say("contraction", WEAK, DETERMINED)), Text(say("more")),
    )  # fmt: skip


def _verdicts(result: Result) -> Table:
    rows = tuple(
        (
            symbol(name),
            row.verdict,
            f"{max(row.contraction, 0.0):.2f}",
            symbol(row.tied_to) if row.tied_to != name else NOTHING,
            signed(row.tie),
            f"{row.multiple:.2f}" if row.multiple == row.multiple else NOTHING,
        )
        for name, row in identifiability_rows(result).items()
    )
    return say.table("verdicts", rows)


def _groups(directions: Mapping[str, Any]) -> Blocks:
    """Counts per group, and what the design cannot see; nothing where an older version did not count."""
    rows = directions.get("groups", ())
    table = (count_table(rows),) if rows else ()
    unseen = directions.get("unseen", ())
    said = (in_symbols(f"{words[:1].upper()}{words[1:]}.") for words in unseen)
    return (*table, *(Text(Markup("By the design: {}").format(words)) for words in said))


def count_table(counts: Iterable[Mapping[str, Any]]) -> Table:
    """What is determined of each group and of all parameters, see :func:`count_row`."""
    return say.table("groups", tuple(map(count_row, counts)))


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


@styled
def contraction(result: Result, ax: Axes | None = None) -> Axes:
    """Draw 1 − posterior/prior variance of every parameter: 0 repeats the prior, 1 is known exactly."""
    ax = own_axes(ax, 4.4, 0.34 * len(result.names) + 0.9)
    rows = dict(reversed(identifiability_rows(result).items()))
    places = np.arange(len(rows))
    values = np.clip([row.contraction for row in rows.values()], 0.0, 1.0)
    ax.barh(places, values, height=0.55, color=POSTERIOR, alpha=0.75)
    return _named_bars(ax, places, rows, "contraction 1 − var(posterior) / var(prior)")


def _named_bars(ax: Axes, places: IntArray, names: Iterable[str], title: str) -> Axes:
    """Name the parameters of bars of contraction, and draw the limits of the verdicts."""
    for limit in (WEAK, DETERMINED):
        ax.axvline(limit, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
    labels = [label(PARAMETERS[name], unit=False) for name in names]
    ax.set(yticks=places, yticklabels=labels, xlim=(0, 1), xlabel=title)
    ax.tick_params(axis="y", length=0)
    return ax


@styled
def combinations(result: Result, ax: Axes | None = None) -> Axes:
    """Draw the independent combinations of parameters, the best determined first, with their contraction.

    Cells: weight of each parameter, in units of its prior standard deviation, the largest of each
    combination ± 1.
    """
    ax = own_axes(ax, 5.4, 0.34 * len(result.names) + 1.0)
    laws = [result.study.prior.laws[name] for name in result.names]
    ranges, logs = [law.range for law in laws], np.array([law.logarithmic for law in laws])
    prior, draws = (result.study.prior.stated(result.values(group)) for group in ("prior", ""))
    basis = identifiability(result.names, ranges, prior, draws, logs=logs)
    rows = basis.directions.T
    weights = rows / rows[np.arange(len(rows)), np.abs(rows).argmax(axis=1)][:, None]
    ax.pcolormesh(weights, cmap="PuOr_r", vmin=-1.7, vmax=1.7, edgecolors=GRID, linewidth=0.4)
    for (i, j), value in np.ndenumerate(weights):
        if abs(value) >= 0.15:
            ax.text(j + 0.5, i + 0.5, signed(value, 1), ha="center", va="center", fontsize=7)
    places = np.arange(len(weights)) + 0.5
    shares = [f"{share:.2f}" for share in np.clip(basis.contractions, 0.0, 1.0)]
    names = [label(PARAMETERS[name], unit=False) for name in result.names]
    ax.set(xticks=places, xticklabels=names, yticks=places, yticklabels=shares)
    ax.set(ylabel="contraction", ylim=(len(weights), 0))
    ax.tick_params(length=0)
    ax.xaxis.tick_top()
    ax.spines[:].set_visible(False)
    return ax


LOWEST = 1e-6
"""Eigenvalues below this are drawn at it: so little is nothing."""
TENTH_LEFT = 9.0
"""Information that leaves a tenth of the prior's variance."""


@styled
def spectrum(local: LocalAnalysis, ax: Axes | None = None) -> Axes:
    """Draw the eigenvalues of the information over the posterior, best informed direction first.

    Dots: medians; bars: 5 to 95 % of the parameter sets. At the broken line the readings know as much as the
    prior; at the dotted one they leave a tenth of its variance.
    """
    ax = own_axes(ax, 4.6, 3.0)
    low, middle, high = np.maximum(np.quantile(local.spectra, [0.05, 0.5, 0.95], axis=0), LOWEST)
    places = np.arange(1, len(middle) + 1)
    ax.vlines(places, low, high, color=POSTERIOR, linewidth=5, alpha=0.3)
    ax.plot(places, middle, "o", color=POSTERIOR)
    for level, dashes in ((1.0, (0, (4, 3))), (TENTH_LEFT, (0, (1, 2)))):
        ax.axhline(level, color=INK, linewidth=0.8, linestyle=dashes)
    ax.set(yscale="log", xticks=places, xlabel="direction", ylabel="information, prior = 1")
    return ax


def coupling_section(coupling: Coupling) -> Blocks:
    """Coupling of parameters and of groups."""
    if len(coupling.names) == 1:
        return (Text("There is a single free parameter: nothing to be coupled with."),)
    pictures = [drawing(coupling_map(coupling), "Normal-score correlations of every pair of parameters")]
    if not len(coupling.between):
        return (Gallery("half", tuple(pictures), say("couplings", False)),)
    pictures.append(drawing(group_coupling(coupling), "Mutual information of the parameter groups"))
    return (Gallery("half", tuple(pictures), say("couplings", True)), _between(coupling))


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
    return say.table("between", rows)


def information_section(information: Information) -> Blocks:
    """Section on what the data contract, of parameters and of directions of the groups."""
    bars = drawing(contraction_bars(information), "Contraction of every parameter by the data and by the cut")
    return (count_table(records(information.counts)), Gallery("half", (bars,), say("information")))


def local_section(analysis: Analysis) -> Blocks:
    """Exact sensitivities, their spectrum and the bounds that follow from them."""
    picture = drawing(spectrum(analysis.spread), "Spectrum of the Fisher information")
    decades = analysis.spread.decades
    largest = analysis.collinearity.largest()
    text = say(
        "sensitivities", f"{decades:.1f}" if decades < 100 else "infinitely many", CRITICAL, symbols(largest) or "none"
    )
    rows = tuple((symbol(row["parameter"]), *_spreads(row)) for row in records(analysis.spread.table))
    table = say.table("spreads", rows)
    return (Text(text), table, Gallery("half", (picture,), say("spectrum")))


def _spreads(row: Record) -> tuple[Cell, ...]:
    scale, names = PARAMETERS[row["parameter"]].scale, ("prior_sd", "local_sd", "posterior_sd")
    return (*(plain(row[name] / scale) for name in names), unit(row["parameter"]) or NOTHING)


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
    sources = Text(say("sources"))
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
    pairs = coupling.pairs[coupling.pairs["disagree"].astype(bool)]
    starred = [{a, b} for a, b in zip(pairs["first"], pairs["second"], strict=True)]
    for i, j in zip(*np.nonzero(~np.eye(count, dtype=bool)), strict=True):
        star = lower[i, j] and {coupling.names[i], coupling.names[j]} in starred
        text = number(values[i, j], 2) + ("*" if star else "")
        ax.text(j + 0.5, i + 0.5, text, ha="center", va="center", fontsize=7.5)
    ax.plot([0, count], [0, count], color=GRID, linewidth=0.7)
    _boxes(ax, coupling.groups)
    name_cells(ax, coupling.names)
    ax.tick_params(labelsize=10)
    ax.xaxis.tick_top()
    ax.text(0.0, count + 0.12, "below: posterior", ha="left", va="top", fontsize=8, color=POSTERIOR)
    ax.text(count, count + 0.12, "above: prior after the cut", ha="right", va="top", fontsize=8, color=PRIOR)
    return ax


def _boxes(ax: Axes, groups: Mapping[str, Sequence[int]]) -> None:
    """Frame the pairs within each group of the paper."""
    for group, columns in groups.items():
        if list(columns) != list(range(columns[0], columns[0] + len(columns))):
            continue  # parameters that do not stand side by side
        corner, size = (columns[0], columns[0]), len(columns)
        ax.add_patch(Rectangle(corner, size, size, fill=False, edgecolor=INK, linewidth=1.3, clip_on=False))
        name = rf"$P_\mathrm{{{group.removeprefix('P_')}}}$" if group.startswith("P_") else group
        ax.text(columns[0] + 0.5, columns[0] + 0.5, name, color=DATA, fontsize=9, ha="center",
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
    names = [f"{GROUP_WORDS[a]} –\n{GROUP_WORDS[b]}" for a, b in zip(table["first"], table["second"], strict=True)]
    ax.set(yticks=places, yticklabels=names, xlabel="mutual information [nat]")
    ax.set_xlim(left=min(0.0, float(table["nearest"].min())) if len(table) else 0.0)
    ax.tick_params(axis="y", length=0, labelsize=9)
    handles = [
        Patch(color=POSTERIOR, alpha=0.75, label="posterior"),
        Patch(color=PRIOR, alpha=0.75, label="prior after the cut"),
        Line2D([], [], color=DATA, marker="o", markerfacecolor="none", linestyle="", label="neighbours"),
    ]
    ax.legend(handles=handles, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    return ax


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
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=1)
    return _named_bars(ax, places, table["parameter"], "contraction 1 − var(after) / var(before)")
