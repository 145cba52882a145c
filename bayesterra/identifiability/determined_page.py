"""Section on what the data of a run determine, with its figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from bayesterra.arrays import FloatArray
from bayesterra.identifiability.analysis import GROUP_WORDS, in_a_sentence
from bayesterra.identifiability.information import ALL, MARGINAL
from bayesterra.identifiability.local import LocalAnalysis
from bayesterra.identifiability.verdicts import (
    COUPLED_TO_ALL,
    DETERMINED,
    MOVED,
    SHIFT,
    WEAK,
    Identifiability,
    identifiability,
)
from bayesterra.parameters import PARAMETERS
from bayesterra.report.blocks import Block, Blocks, Cell, Gallery, Table, Text, drawing
from bayesterra.report.figures import label, own_axes, styled
from bayesterra.report.numbers import MINUS, NOTHING
from bayesterra.report.style import GRID, INK, POSTERIOR
from bayesterra.report.symbols import in_symbols, symbol
from bayesterra.study.result import COUPLED, Result, identifiability_rows

GROUPS = Markup(
    "Directions of each group of parameters whose variance shrinks tenfold or more, in normal scores of the "
    "prior after the cut. Effective: sum of their contractions; by the cut: what the physical cut alone had "
    "contracted of the stated prior, which is no information in the data. Others known: were all parameters "
    "outside the group known."
)


def finding(result: Result) -> Markup:
    """The finding in a sentence; empty for folders of versions that did not count the groups' directions."""
    rows = marginal(result.record.get("directions", {}))
    words = {name: row.verdict for name, row in identifiability_rows(result).items()}
    text = in_a_sentence(rows, words, lambda name: str(symbol(name))) if rows else ""
    return Markup(text)  # noqa: S704 (constants)


def marginal(directions: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Directions of each group, and of all parameters, whatever the others are."""
    return [row for row in directions.get("groups", ()) if row["view"] == MARGINAL]


def identifiability_section(result: Result) -> Blocks:
    """Section on what the data determine."""
    bars = drawing(contraction(result), "Contraction of every parameter")
    cells = drawing(
        combinations(result), "Weights of the parameters in the combinations, best determined first"
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
    return (*blocks, Gallery("half", (bars, cells), caption), more)


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
            f"{row.multiple:.2f}" if row.multiple == row.multiple else NOTHING,
        )
        for name, row in identifiability_rows(result).items()
    )
    header = ("", "verdict", "contraction", "strongest coupling", "correlation", Markup("<i>R</i>"))
    caption = "Verdict of every parameter; couplings with parameters that are not determined."
    return Table(caption, "llrlrr", header, rows)


def signed(value: float) -> str:
    """A correlation with its sign."""
    return f"{value:+.2f}".replace("-", MINUS) if value == value else NOTHING


def _groups(directions: Mapping[str, Any]) -> Blocks:
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


@styled
def contraction(result: Result, ax: Axes | None = None) -> Axes:
    """Draw 1 − posterior/prior variance of every parameter: 0 repeats the prior, 1 is known exactly."""
    ax = own_axes(ax, 4.4, 0.34 * len(result.names) + 0.9)
    rows = dict(reversed(identifiability_rows(result).items()))
    places = np.arange(len(rows))
    values = np.clip([row.contraction for row in rows.values()], 0.0, 1.0)
    ax.barh(places, values, height=0.55, color=POSTERIOR, alpha=0.75)
    for limit in (WEAK, DETERMINED):
        ax.axvline(limit, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
    names = [label(PARAMETERS[name], unit=False) for name in rows]
    ax.set(
        yticks=places, yticklabels=names, xlim=(0, 1), xlabel="contraction 1 − var(posterior) / var(prior)"
    )
    ax.tick_params(axis="y", length=0)
    return ax


@styled
def combinations(result: Result, ax: Axes | None = None) -> Axes:
    """Draw the independent combinations of parameters, the best determined first, with their contraction.

    Cells: weight of each parameter, in units of its prior standard deviation, the largest of each
    combination ± 1.
    """
    ax = own_axes(ax, 5.4, 0.34 * len(result.names) + 1.0)
    basis = _information(result)
    weights = _weights(basis)
    ax.pcolormesh(weights, cmap="PuOr_r", vmin=-1.7, vmax=1.7, edgecolors=GRID, linewidth=0.4)
    for (i, j), value in np.ndenumerate(weights):
        if abs(value) >= 0.15:
            ax.text(j + 0.5, i + 0.5, f"{value:+.1f}".replace("-", "−"), ha="center", va="center", fontsize=7)
    places = np.arange(len(weights)) + 0.5
    names = [label(PARAMETERS[name], unit=False) for name in result.names]
    ax.set(xticks=places, xticklabels=names, yticks=places, yticklabels=[f"{c:.2f}" for c in _clipped(basis)])
    ax.set(ylabel="contraction", ylim=(len(weights), 0))
    ax.tick_params(length=0)
    ax.xaxis.tick_top()
    ax.spines[:].set_visible(False)
    return ax


def _information(result: Result) -> Identifiability:
    laws = [result.study.prior.laws[name] for name in result.names]
    ranges, logs = [law.range for law in laws], np.array([law.logarithmic for law in laws])
    return identifiability(result.names, ranges, result.values("prior"), result.values(), logs=logs)


def _weights(basis: Identifiability) -> FloatArray:
    """Rows: combinations; the weight of greatest size +1."""
    rows = basis.directions.T
    greatest = rows[np.arange(len(rows)), np.abs(rows).argmax(axis=1)]
    return np.asarray(rows / greatest[:, None])


def _clipped(basis: Identifiability) -> FloatArray:
    return np.clip(basis.contractions, 0.0, 1.0)


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
