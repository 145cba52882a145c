"""The page of a design: which drive next, what it is expected to tell, and how sure that is."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from bayesterra import figures
from bayesterra.design.candidates import Candidate
from bayesterra.design.choosing import BIT, UNANSWERED, Design
from bayesterra.design.gain import Estimate
from bayesterra.parameters import PARAMETERS
from bayesterra.report.blocks import Cell, Gallery, Section, Table, Text, drawing
from bayesterra.report.numbers import NOTHING, given, plain, resolution, rounded, with_error
from bayesterra.report.pages import VerdictPage
from bayesterra.report.symbols import amount, listed, symbol, symbols, with_unit
from bayesterra.report.verdicts import Verdict

SHOWN = 15
"""Rows of the ranking on the page; the table in the folder has all."""


def design_page(design: Design, version: str) -> VerdictPage:
    """Put the page together."""
    study = design.situation.study
    plan = (_plan_section(design),) if len(design.picks) > 1 else ()
    return VerdictPage(
        title=study.title or "Soil parameters from wheel tests",
        facts=(
            study.model.name,
            f"drive {study.drive}",
            f"{len(design.candidates)} candidates",
            Markup("about {}").format(symbols(design.about)),
            f"from {len(design.situation.draws)} draws of the {design.situation.source}",
        ),
        warning=_warning(design),
        verdicts=(_next(design), _promise(design), _certainty(design)),
        sections=(_ranking_section(design), *plan, _method_section(design)),
        version=version,
    )


def _warning(design: Design) -> Markup:
    lost = 1 - design.together[-1].answered
    if lost <= UNANSWERED:
        return Markup("")
    return Markup(
        "The model has <b>no answer</b> for {} % of the draws at what is recommended: figures hold for the "
        "others only, and the wheel may not get through."
    ).format(f"{100 * lost:.0f}")


def words(candidate: Candidate) -> str:
    """Where a candidate drives, in short."""
    return "all rows again" if candidate.repeats else f"slip {candidate.slip[0]:.3g}"


def _next(design: Design) -> Verdict:
    distinct = dict.fromkeys(one.where for one in design.chosen)
    many = len(design.picks) > 1
    word = f"{len(design.picks)} drives" if many else words(design.chosen[0])
    counted = [_times(design, where) for where in distinct]
    channels = listed(symbol(name) for name in design.chosen[0].channels)
    sentence = Markup("{}; read: {}.").format(listed(counted), channels)
    return Verdict("Next", word, "good", sentence)


def _times(design: Design, where: str) -> str:
    times = sum(one.where == where for one in design.chosen)
    return f"{times} × {where}" if times > 1 else where


def _promise(design: Design) -> Verdict:
    """What is expected of the spread of the parameters of interest."""
    last = design.together[-1]
    parts = [_change(design, i, last) for i in range(min(len(design.about), 4))]
    bits = last.values[0] / BIT
    grade = "good" if bits >= 0.5 else "fair" if bits >= 0.1 else "poor"
    sentence = Markup("Standard deviation of {}.").format(listed(parts))
    return Verdict("Expected", f"{plain(bits, 2)} bit", grade, sentence)


def _change(design: Design, column: int, one: Estimate) -> Markup:
    name = design.about[column]
    before, after, _ = figures_of(design, column, one)
    return Markup("{} from {} to {}").format(symbol(name), before, amount(name, after))


def figures_of(design: Design, column: int, one: Estimate) -> tuple[str, str, str]:
    """Standard deviation before, after, and the error of the latter, in field units."""
    scale = PARAMETERS[design.about[column]].scale
    before, after, error = design.before[column], one.values[2 + column], one.errors[2 + column]
    if not np.isfinite(after):
        return plain(before / scale, 2), NOTHING, NOTHING
    step = resolution(0.0, before / scale)
    return rounded(before / scale, step), rounded(after / scale, step), plain(error / scale, 1)


def _certainty(design: Design) -> Verdict:
    """Whether the recommended row is better than the next one by more than chance."""
    order = design.ranking.order
    if len(order) < 2 or not np.isfinite(design.ranking.scores[order[1], 0]):
        return Verdict("Ranking", "one candidate", "fair", Markup("There is nothing to compare with."))
    lag, error = (value / BIT for value in design.ranking.behind(order[1]))
    second = design.candidates[order[1]].where
    text = Markup("As a single addition {} comes second, {} ± {} bit behind.")
    sentence = text.format(second, *with_error(lag, error))
    clear = lag > 2 * error
    return Verdict("Ranking", "clear" if clear else "a tie", "good" if clear else "fair", sentence)


def _ranking_section(design: Design) -> Section:
    picture = drawing(figures.gain_over_slip(design), "Expected information against slip")
    caption = Markup(
        "Expected information of one more drive about {}, with a band of two Monte Carlo errors. Rings: "
        "recommended. Grey ground: slips that were not driven. One bit halves what is plausible."
    ).format(symbols(design.about))
    header: tuple[Cell, ...] = (
        "", "drive", "read", "gain [bit]", "± ", "behind [bit]", "± ",
        *(Markup("sd of {}").format(with_unit(name)) for name in design.about[:4]),
    )  # fmt: skip
    rows = tuple(_row(design, rank, i) for rank, i in enumerate(design.ranking.order[:SHOWN], start=1))
    more = len(design.candidates) - SHOWN
    below = Markup(
        "The best candidates as single additions{}. Now the standard deviations are {}. “!”: no answer for "
        "over {} % of the draws."
    ).format(
        f"; {more} more in design.csv" if more > 0 else "",
        listed(_now(design, i) for i in range(min(len(design.about), 4))),
        f"{100 * UNANSWERED:g}",
    )
    table = Table(below, "rllrrrr" + "r" * len(design.about[:4]), header, rows)
    return Section("ranking", "Ranking", (Gallery("whole", (picture,), caption), table))


def _now(design: Design, column: int) -> Markup:
    name = design.about[column]
    before = figures_of(design, column, design.ranking.estimates[design.ranking.best])[0]
    return Markup("{} of {}").format(amount(name, before), symbol(name))


def _row(design: Design, rank: int, index: int) -> tuple[Cell, ...]:
    candidate, one = design.candidates[index], design.ranking.estimates[index]
    lag, lag_error = (value / BIT for value in design.ranking.behind(index))
    mark = " !" if 1 - one.answered > UNANSWERED else ""
    known = np.isfinite(one.values[0])
    gain = with_error(one.values[0] / BIT, one.errors[0] / BIT) if known else (NOTHING, NOTHING)
    behind = with_error(lag, lag_error) if known and lag > 0 else (NOTHING, NOTHING)
    after = (figures_of(design, i, one)[1] for i in range(min(len(design.about), 4)))
    return (
        str(rank), candidate.where + mark, symbols(candidate.channels), *gain, *behind, *after,
    )  # fmt: skip


def _plan_section(design: Design) -> Section:
    header: tuple[Cell, ...] = (
        "", "drive", "together [bit]", "± ",
        *(Markup("sd of {}").format(with_unit(name)) for name in design.about[:4]),
    )  # fmt: skip
    rows: list[tuple[Cell, ...]] = []
    for number, (index, one) in enumerate(zip(design.picks, design.together, strict=True), start=1):
        gain = with_error(one.values[0] / BIT, one.errors[0] / BIT)
        after = (figures_of(design, i, one)[1] for i in range(min(len(design.about), 4)))
        rows.append((str(number), design.candidates[index].where, *gain, *after))
    bound = " Too few draws remain effective: gains are lower bounds, by regression."
    caption = Markup("All recommended drives; each line with those above it.{}").format(
        bound if design.method == "regression" else ""
    )
    table = Table(caption, "rlrr" + "r" * len(design.about[:4]), header, tuple(rows))
    return Section("plan", "Plan", (table,))


def _method_section(design: Design) -> Section:
    by = {
        "information": "the information about the parameters of interest together",
        "sd": "the mean log shrinking of the standard deviation of each parameter of interest",
    }[design.by]
    known = {
        "posterior": "Everything is averaged over the posterior as it stands",
        "prior": "Everything is averaged over the prior, cut to what physics allows; no readings are used",
    }[design.situation.source]
    how = {
        "mixture": "p(y) is the mean density of a reading over all draws, without the bias of its logarithm",
        "regression": "a reading leaves too few effective draws, so gains are lower bounds, from a "
        "regression of the parameters’ normal scores on readings, their squares and products",
    }[design.ranking.method]
    text = Markup(
        "{}. The expected information is the mutual information between a reading y and the parameters "
        "(Lindley 1956); {}. For some of the parameters, the information that y has about the others once "
        "these are known is taken off. What is maximised is {}. Several drives are chosen one after the "
        "other and then exchanged one at a time. Errors come from leaving out {} groups of draws in turn. A "
        "gain trusts the model: it does not see what the model has wrong at slips that nobody drove."
    ).format(known, how, by, design.ranking.estimates[0].replicates.shape[0] - 1)
    rows: tuple[tuple[Cell, ...], ...] = (
        ("draws", given(len(design.situation.draws))),
        ("seed", given(design.seed)),
        ("parameters of interest", symbols(design.about)),
    )
    return Section("method", "Method", (Text(text), Table("", "lr", ("", ""), rows)))
