"""Design as a page, a figure and a terminal table."""

from collections import Counter
from importlib.metadata import version
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from bayesterra.design.candidates import Candidate
from bayesterra.design.choosing import BIT, UNANSWERED, Design
from bayesterra.design.gain import Estimate
from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.report.blocks import Blocks, Cell, Gallery, Overview, Table, Text, drawing
from bayesterra.report.figures import DATA, GRID, figure_of, literal, own_axes, styled
from bayesterra.report.numbers import NOTHING, given, plain, resolution, rounded, with_error
from bayesterra.report.sections import Prose, Section, VerdictPage
from bayesterra.report.symbols import amount, listed, symbol, symbols, with_unit
from bayesterra.report.verdicts import Verdict

say = Prose("design")

SHOWN = 15
"""Rows of the ranking on the page; the table in the folder has all."""
FEW = 4
"""Parameters of interest whose spread the page shows."""


def design_page(design: Design) -> VerdictPage:
    """Put the page together."""
    study = design.situation.study
    plan = (Section("plan", "Plan", _plan_section(design)),) if len(design.picks) > 1 else ()
    return VerdictPage(
        title=study.title or "Soil parameters from wheel tests",
        facts=(
            study.model.name,
            f"drive {study.drive}",
            f"{len(design.candidates)} candidates",
            Markup("about {}").format(symbols(design.about)),
            f"from {len(design.situation.draws)} draws of the {design.situation.source}",
            *([design.situation.basis] if design.situation.basis else []),
        ),
        warning=say("warning", 1 - design.together[-1].answered, UNANSWERED),
        verdicts=(_next(design), _promise(design), _certainty(design)),
        sections=(
            Section("ranking", "Ranking", _ranking_section(design)),
            *plan,
            Section("method", "Method", _method_section(design)),
        ),
        version=version("bayesterra"),
        template="design.html",
    )


def words(candidate: Candidate) -> str:
    """Place of a candidate, in short."""
    return "all rows again" if candidate.repeats else f"slip {candidate.slip[0]:.3g}"


def _next(design: Design) -> Verdict:
    places = Counter(candidate.where for candidate in design.chosen)
    many = len(design.picks) > 1
    word = f"{len(design.picks)} drives" if many else words(design.chosen[0])
    counted = [f"{times} × {where}" if times > 1 else where for where, times in places.items()]
    channels = listed(symbol(name) for name in design.chosen[0].channels)
    sentence = Markup("{}; read: {}.").format(listed(counted), channels)
    return Verdict("Next", word, "good", sentence)


def _promise(design: Design) -> Verdict:
    """Verdict on the expected spread of the parameters of interest."""
    last, changes = design.together[-1], []
    for i, name in enumerate(design.about[:FEW]):
        before, after, _ = figures_of(design, i, last)
        changes.append(Markup("{} from {} to {}").format(symbol(name), before, amount(name, after)))
    bits = last.values[0] / BIT
    grade = "good" if bits >= 0.5 else "doubtful" if bits >= 0.1 else "bad"
    sentence = Markup("Standard deviation of {}.").format(listed(changes))
    return Verdict("Expected", f"{plain(bits, 2)} bit", grade, sentence)


def figures_of(design: Design, column: int, estimate: Estimate) -> tuple[str, str, str]:
    """Standard deviation before, after, and the error of the latter, in field units."""
    scale = PARAMETERS[design.about[column]].scale
    before, after, error = design.before[column], estimate.values[2 + column], estimate.errors[2 + column]
    if not np.isfinite(after):
        return plain(before / scale, 2), NOTHING, NOTHING
    step = resolution(0.0, before / scale)
    return rounded(before / scale, step), rounded(after / scale, step), plain(error / scale, 1)


def _certainty(design: Design) -> Verdict:
    """Verdict on whether the recommended row is better than the next one by more than chance."""
    order = design.ranking.order
    if len(order) < 2 or not np.isfinite(design.ranking.scores[order[1], 0]):
        return Verdict("Ranking", "one candidate", "doubtful", Markup("There is nothing to compare with."))
    lag, error = (value / BIT for value in design.ranking.behind(order[1]))
    second = design.candidates[order[1]].where
    text = Markup("As a single addition {} comes second, {} ± {} bit behind.")
    sentence = text.format(second, *with_error(lag, error))
    clear = lag > 2 * error
    return Verdict("Ranking", "clear" if clear else "a tie", "good" if clear else "doubtful", sentence)


def _ranking_section(design: Design) -> Blocks:
    picture = drawing(gain_over_slip(design), "Expected information against slip")
    rows = tuple(_row(design, rank, i) for rank, i in enumerate(design.ranking.order[:SHOWN], start=1))
    now = listed(_now(design, i) for i in range(len(design.about[:FEW])))
    more = len(design.candidates) - SHOWN
    table = say.table("ranking_below", rows, more, now, f"{100 * UNANSWERED:g}", more=_heads(design))
    return (Gallery("whole", (picture,), say("ranking", symbols(design.about))), table)


def _now(design: Design, column: int) -> Markup:
    name = design.about[column]
    before = figures_of(design, column, design.ranking.estimates[design.ranking.best])[0]
    return Markup("{} of {}").format(amount(name, before), symbol(name))


def _row(design: Design, rank: int, index: int) -> tuple[Cell, ...]:
    candidate, estimate = design.candidates[index], design.ranking.estimates[index]
    lag, lag_error = (value / BIT for value in design.ranking.behind(index))
    mark = " !" if 1 - estimate.answered > UNANSWERED else ""
    behind = with_error(lag, lag_error) if lag > 0 else (NOTHING, NOTHING)
    where, after = candidate.where + mark, _after(design, estimate)
    return (str(rank), where, symbols(candidate.channels), *_gain(estimate), *behind, *after)


def _gain(estimate: Estimate) -> tuple[str, str]:
    """Gain in bits with its error; nothing where too few draws have an answer."""
    return with_error(estimate.values[0] / BIT, estimate.errors[0] / BIT)


def _plan_section(design: Design) -> Blocks:
    rows = tuple(
        (str(number), candidate.where, *_gain(estimate), *_after(design, estimate))
        for number, (candidate, estimate) in enumerate(zip(design.chosen, design.together, strict=True), 1)
    )
    return (say.table("plan", rows, design.method, more=_heads(design)),)


def _heads(design: Design) -> list[Cell]:
    return [Markup("sd of {}").format(with_unit(name)) for name in design.about[:FEW]]


def _after(design: Design, estimate: Estimate) -> list[str]:
    """Standard deviations to expect of the first parameters of interest."""
    return [figures_of(design, i, estimate)[1] for i in range(len(design.about[:FEW]))]


def _method_section(design: Design) -> Blocks:
    groups = design.ranking.estimates[0].replicates.shape[0] - 1
    text = say("method", design.situation.source, design.ranking.method, design.by, groups)
    rows: tuple[tuple[Cell, ...], ...] = (
        ("draws", given(len(design.situation.draws))),
        ("seed", given(design.seed)),
        ("parameters of interest", symbols(design.about)),
    )
    return (Text(text), Table("", "lr", ("", ""), rows))


COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
DASHES: tuple[tuple[float, ...], ...] = ((), (5.0, 2.0), (1.5, 1.5))


@styled
def gain_over_slip(design: Design, ax: Axes | None = None) -> Axes:
    """Draw the gain about the parameters of interest, bits, with a band of two Monte Carlo errors.

    One line for every wheel, load and set of channels; level, the study's rows driven again with new sensors.
    Rings: the rows that are recommended. Grey ground: slips that were not driven.
    """
    ax = own_axes(ax, 6.4, 3.4)
    lines: dict[str, list[int]] = {}
    for index, candidate in enumerate(design.candidates):
        lines.setdefault(_line(design, candidate), []).append(index)
    for number, (label, members) in enumerate(lines.items()):
        style: dict[str, Any] = {"color": COLOURS[number % 6], "dashes": DASHES[number // 6 % 3]}
        _draw(ax, design, members, label, style)
    _ground(ax, design)
    _rings(ax, design)
    ax.set(xlabel="slip ratio $s$ [–]", ylabel="expected information [bit]", ylim=(0, None))
    if len(lines) > 1:
        figure_of(ax).legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return ax


def _line(design: Design, candidate: Candidate) -> str:
    """Label that tells a line from the others."""
    if candidate.repeats:
        return f"all rows again, only {_channels(candidate)}"
    others = [row for row in design.candidates if not row.repeats]
    texts = [f"wheel {literal(candidate.wheel[0])}"] if len({row.wheel for row in others}) > 1 else []
    texts += [f"{candidate.load[0]:.4g} N"] if len({float(row.load[0]) for row in others}) > 1 else []
    texts += [_channels(candidate)] if len({row.channels for row in others}) > 1 else []
    return ", ".join(texts)


def _channels(candidate: Candidate) -> str:
    return ", ".join(name.replace("_", " ") for name in candidate.channels)


def _draw(ax: Axes, design: Design, members: list[int], label: str, style: dict[str, Any]) -> None:
    gain = np.array([design.ranking.estimates[i].values[0] for i in members]) / BIT
    error = 2 * np.array([design.ranking.estimates[i].errors[0] for i in members]) / BIT
    slip = np.array([design.candidates[i].slip[0] for i in members])
    if design.candidates[members[0]].repeats:
        ends = np.array([float(row.slip[0]) for row in design.candidates if not row.repeats])
        slip, gain, error = np.array([ends.min(), ends.max()]), np.repeat(gain, 2), np.repeat(error, 2)
    marker = "o" if len(slip) < 3 or np.isnan(gain).any() else ""
    ax.fill_between(slip, gain - error, gain + error, color=style["color"], alpha=0.2, linewidth=0)
    ax.plot(slip, gain, label=label, marker=marker, markersize=3.5, **style)


def _ground(ax: Axes, design: Design) -> None:
    driven = design.situation.study.observations.used().slip
    low, high = ax.get_xlim()
    for first, last in ((low, driven.min()), (driven.max(), high)):
        if last > first:
            ax.axvspan(first, last, color=GRID, alpha=0.45, linewidth=0, zorder=0)
    ax.set_xlim(low, high)


def _rings(ax: Axes, design: Design) -> None:
    for index in dict.fromkeys(design.picks):
        candidate = design.candidates[index]
        if candidate.repeats:
            continue
        height = design.ranking.estimates[index].values[0] / BIT
        ax.plot(
            candidate.slip[0], height, "o", markersize=9, fillstyle="none", color=DATA, zorder=5,
            clip_on=False,
        )  # fmt: skip
        times = design.picks.count(index)
        if times > 1:
            ax.annotate(f"{times} ×", (candidate.slip[0], height), (-8, 2), textcoords="offset points",
                        ha="right", fontsize=8)  # fmt: skip


PRINTED = 15
"""Candidates in the table on a terminal; design.csv has all."""


def design_overview(design: Design) -> Overview:
    """The ranking with its Monte Carlo errors, and what is recommended; it fits a terminal of 80 columns."""
    about, several = design.about[:2], len({candidate.channels for candidate in design.candidates}) > 1
    deviations = [f"sd {PARAMETERS[name].symbol} [{PARAMETERS[name].unit}]" for name in about]
    header = ("", "drive", *["channels"] * several, "gain [bit]", "behind best", *deviations)
    ranked = enumerate(design.ranking.order[:PRINTED], start=1)
    rows = tuple((str(rank), *_candidate(design, index, len(about), several)) for rank, index in ranked)
    title = f"one more drive, about {', '.join(design.about)}"
    return (
        Table(title, "ll" + "l" * several + "rr" + "r" * len(about), header, rows),
        *map(Text, design_lines(design)),
    )


def _candidate(design: Design, index: int, deviations: int, several: bool) -> tuple[str, ...]:
    candidate, estimate = design.candidates[index], design.ranking.estimates[index]
    lag, lag_error = (value / BIT for value in design.ranking.behind(index))
    symbols = " ".join(CHANNELS[name].symbol for name in candidate.channels)
    mark = " !" if 1 - estimate.answered > UNANSWERED else ""
    gain = _gain(estimate) if np.isfinite(estimate.values[0]) else (NOTHING,)
    behind = " ± ".join(with_error(lag, lag_error)) if lag > 0 else ""
    changes = (" → ".join(figures_of(design, i, estimate)[:2]) for i in range(deviations))
    return (candidate.where + mark, *[symbols] * several, " ± ".join(gain), behind, *changes)


def design_lines(design: Design) -> list[str]:
    """Lines on the recommendation, the gain to expect, and the cautions."""
    last = design.together[-1]
    gain, error = _gain(last)
    drives = "; ".join(candidate.where for candidate in design.chosen)
    lines = [f"Recommended: {drives}: {gain} ± {error} bit about {', '.join(design.about)}."]
    for i, name in enumerate(design.about):
        before, after, off = figures_of(design, i, last)
        unit = "" if PARAMETERS[name].unit == "-" else f" {PARAMETERS[name].unit}"
        lines.append(f"  sd of {PARAMETERS[name].symbol} from {before} to {after} ± {off}{unit}")
    if "regression" in (design.method, design.ranking.method):
        lines.append("Few draws remain effective after such readings: gains are lower bounds, by regression.")
    if design.situation.basis:
        lines.append(f"Note: {design.situation.basis}.")
    if design.situation.source == "prior":
        lines.append("From the prior alone, no readings used; a result folder in place of the study builds on them.")
    marked = sum(1 - estimate.answered > UNANSWERED for estimate in design.ranking.estimates)
    if marked:
        lines.append(f"! At {marked} candidates the model has no answer for over {UNANSWERED:.0%} of the draws.")
    return lines
