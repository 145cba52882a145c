"""Calibration as a page, a figure and a terminal table."""

from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.axes import Axes

from bayesterra.checking import ranks
from bayesterra.checking.calibration import AT_SLIP, LOG_LIKELIHOOD, LOG_PRIOR
from bayesterra.checking.ranks import Calibration
from bayesterra.parameters import CHANNELS, PARAMETERS, whole_and_part
from bayesterra.report.blocks import Blocks, Cell, Gallery, Overview, Table, Text, drawing
from bayesterra.report.figures import INK, POSTERIOR, PRIOR, one_of, own_axes, styled
from bayesterra.report.numbers import NOTHING, plain, signed
from bayesterra.report.sections import Prose, Section, VerdictPage, in_a_line, origin_rows
from bayesterra.report.symbols import listed, quantity_of, symbol
from bayesterra.report.verdicts import Verdict

say = Prose("calibration")

HIGH_POWER, SOME_POWER = 0.9, 0.5


def calibration_page(calibration: Calibration) -> VerdictPage:
    """Put the page together."""
    study, tests = calibration.study, calibration.tests
    worst = tests[tests["verdict"] == "not uniform"].sort_values("p_value").head(4).to_dict("records")
    return VerdictPage(
        title=study.title or "Soil parameters from wheel tests",
        facts=(study.model.name, f"drive {study.drive}", f"{len(calibration.table)} replications"),
        warning=say("warning", listed(map(tendency, worst))),
        verdicts=(_posterior(calibration), _sampling(calibration), _power(calibration)),
        sections=(
            Section("ranks", "Ranks", _ranks_section(calibration)),
            Section("coverage", "Coverage", _coverage_section(calibration)),
            Section("power", "Power", _power_section(calibration)),
            Section("replications", "Replications", _replications_section(calibration)),
            Section("reproduce", "Reproduce this", _reproduce_section(calibration)),
        ),
        version=calibration.record["versions"]["bayesterra"],
        template="calibration.html",
    )


def named(quantity: str) -> Markup:
    """A test quantity as in a sentence.

    >>> named("phi"), named("drawbar_pull_at_largest_slip"), named("K[Wh11]")
    (Markup('<i>φ</i>'), Markup('<i>F</i><sub>DP</sub> at the largest slip'), Markup('<i>K</i>[Wh11]'))
    """
    words = {LOG_LIKELIHOOD: "log likelihood", LOG_PRIOR: "log prior"}
    if quantity in words:
        return Markup("{}").format(words[quantity])
    quantity, part = whole_and_part(quantity)
    of = symbol(quantity.removesuffix(AT_SLIP)) + part
    return Markup("{} at the largest slip").format(of) if quantity.endswith(AT_SLIP) else of


def tendency(row: Mapping[Any, Any]) -> Markup:
    """In words, what error the ranks of a quantity look like."""
    doubt = 2.0 / np.sqrt(row["ranks"])
    return say("tendency", named(row["quantity"]), row, abs(row["width"] - 1) > doubt, abs(row["shift"]) > doubt)


def _posterior(calibration: Calibration) -> Verdict:
    tested, failing = len(calibration.tested), calibration.failing
    smallest = p_text(calibration.tests["p_value"].min() if tested else float("nan"))
    sentence = say("posterior", len(failing), tested, smallest, p_text(calibration.threshold), ranks.LEVEL)
    grade = {ranks.CALIBRATED: "good", ranks.MISCALIBRATED: "bad"}.get(calibration.verdict, "doubtful")
    return Verdict("Posterior", calibration.verdict, grade, sentence)


def p_text(p: float) -> str:
    """A p value, also a small one.

    >>> p_text(0.0321), p_text(0.00005), p_text(0.0009)
    ('0.032', '< 0.0001', '0.0009')
    """
    return "< 0.0001" if p < 1e-4 else plain(p, 2) if p >= 0.001 else f"{p:.4f}"


def _sampling(calibration: Calibration) -> Verdict:
    n = len(calibration.table)
    unsettled, failed = calibration.unsettled, n - calibration.ranked
    grade = "good" if not unsettled else "doubtful" if unsettled <= ranks.UNSETTLED * n else "bad"
    sentence = say("sampling", unsettled, n, ranks.UNSETTLED, failed)
    return Verdict("Sampling", f"{n - unsettled} of {n} converged", grade, sentence)


def _power(calibration: Calibration) -> Verdict:
    small = calibration.power["one"].iloc[1]
    word, grade = ("high", "good") if small >= HIGH_POWER else ("moderate", "doubtful")
    word, grade = (word, grade) if small >= SOME_POWER else ("low", "bad")
    rows = calibration.power.to_dict("records")
    sentence = Markup("Chance that so many replications notice, in one parameter alone, a {}.")
    phrases = listed(f"{row['error']}: {percent(row['one'])}" for row in rows)
    return Verdict("Power", word, grade, sentence.format(phrases))


def percent(share: float) -> str:
    """A simulated probability.

    >>> percent(0.0), percent(0.4217), percent(1.0)
    ('< 1 %', '42 %', '> 99 %')
    """
    return "< 1 %" if share < 0.01 else "> 99 %" if share > 0.99 else f"{100 * share:.0f} %"


def _ranks_section(calibration: Calibration) -> Blocks:
    pictures = tuple(
        drawing(rank_ecdf(calibration, name), f"Distribution of the ranks of {name}, less the uniform one")
        for name in calibration.tested
    )
    caption = say("ranks", ranks.DRAWS, f"{1 - calibration.threshold:.4f}", f"{1 - ranks.LEVEL:g}")
    rows = tuple(_test_row(row) for row in calibration.tests.to_dict("records"))
    error = 1 / np.sqrt(max(calibration.ranked, 1))
    doubt, widest = f"{error:.3f}", f"{error / np.sqrt(2):.3f}"
    below = say.table("ranks_below", rows, p_text(calibration.threshold), doubt, widest)
    return (Gallery("small", pictures, caption), below)


def _test_row(row: Mapping[Any, Any]) -> tuple[Cell, ...]:
    if row["verdict"] == "constant":
        return (named(row["quantity"]), "0", NOTHING, "constant", NOTHING, NOTHING)
    verdict = row["verdict"] if row["verdict"] == "uniform" else Markup("<b>not uniform</b>")
    return (
        named(row["quantity"]), str(row["ranks"]), p_text(row["p_value"]), verdict,
        signed(row["shift"]), f"{row['width']:.2f}",
    )  # fmt: skip


def _coverage_section(calibration: Calibration) -> Blocks:
    tests = calibration.tests[calibration.tests["verdict"] != "constant"]
    rows = tuple(_coverage_row(row) for row in tests.to_dict("records"))
    n = max(calibration.ranked, 1)
    errors = listed(f"{100 * np.sqrt(level * (1 - level) / n):.1f}" for level in ranks.COVERAGES)
    return (say.table("coverage", rows, errors, more=(f"{100 * level:.0f} %" for level in ranks.COVERAGES)),)


def _coverage_row(row: Mapping[Any, Any]) -> tuple[Cell, ...]:
    cells = []
    for level in ranks.COVERAGES:
        share = row[f"covered_{100 * level:.0f}"]
        far = abs(share - level) > 3 * np.sqrt(level * (1 - level) / row["ranks"])
        text = f"{100 * share:.1f}"
        cells.append(Markup("<b>{}</b>").format(text) if far else Markup("{}").format(text))
    return (named(row["quantity"]), *cells)


def _power_section(calibration: Calibration) -> Blocks:
    power = calibration.power.to_dict("records")
    rows = tuple((row["error"], percent(row["one"]), percent(row["all"])) for row in power)
    joint = f"in all {len(calibration.parameters)}, at least"
    return (say.table("power", rows, calibration.ranked, more=(joint,)),)


def _replications_section(calibration: Calibration) -> Blocks:
    table = calibration.table
    rows: list[tuple[Cell, ...]] = [
        ("replications", str(len(table))),
        ("not converged", str(int((table["status"] == ranks.UNCONVERGED).sum()))),
        ("failed", str(len(table) - calibration.ranked)),
        ("effective draws: fewest, median", _pair(table["ess"], "min")),
        ("R-hat: largest, median", _pair(table["r_hat"], "max", 4)),
        ("processor seconds: most, median", _pair(table["seconds"], "max")),
    ]
    failed = table[table["status"] == ranks.FAILED].head(5).to_dict("records")
    rows += [(f"failed: number {row['task']}", row["note"]) for row in failed]
    return (say.table("replications", rows, ranks.DRAWS),)


def _pair(values: "pd.Series[float]", extreme: str, digits: int = 3) -> str:
    return f"{plain(float(getattr(values, extreme)()), digits)}, {plain(float(values.median()), digits)}"


def _reproduce_section(calibration: Calibration) -> Blocks:
    record = calibration.record
    command = "bayesterra calibrate STUDY -n {} --seed {}"
    rows: tuple[tuple[Cell, ...], ...] = (
        ("command", Markup("<code>{}</code>").format(command.format(len(calibration.table), record["seed"]))),
        ("settings", in_a_line(record["settings"])),
        *origin_rows(record, "study", "data"),
    )
    return (Text(say("reproduce", ranks.SIMULATIONS)), say.table("repeat", rows))


@styled
def rank_ecdf(calibration: Calibration, quantity: str, ax: Axes | None = None) -> Axes:
    """Draw the share of true values below each rank, less the uniform share.

    Dark grey: where the whole curve of one right quantity lies with probability 0.95. Pale: the same at the
    level of the verdict, which allows for the number of quantities; a curve that leaves it fails.
    """
    ax = own_axes(ax, 2.55, 1.75)
    ranks = calibration.ranks(one_of("quantity", quantity, calibration.tested))
    test = calibration.test(quantity)
    points = np.concatenate([[0.0], test.points, [1.0]])
    for level, alpha in ((calibration.threshold, 0.18), (0.05, 0.28)):
        low, high = (np.concatenate([[0.0], end, [1.0]]) for end in test.band(level))
        ax.fill_between(points, low - points, high - points, color=PRIOR, alpha=alpha, linewidth=0)
    share = np.concatenate([[0.0], test.below(ranks) / len(ranks), [1.0]])
    ax.axhline(0, color=INK, linewidth=0.7)
    failing = quantity in calibration.failing
    ax.plot(points, share - points, color="#D55E00" if failing else POSTERIOR, linewidth=1.6 if failing else 1.3)
    ax.set(xlim=(0, 1), xticks=[0, 0.5, 1], xticklabels=["0", "0.5", "1"])
    ax.set(xlabel="rank among draws", ylabel="share below − uniform")
    ax.set_title(_name(quantity), loc="left")
    return ax


def _name(quantity: str) -> str:
    """A test quantity as the title of its plot."""
    if quantity in (LOG_LIKELIHOOD, LOG_PRIOR):
        return quantity.replace("_", " ")
    quantity, part = whole_and_part(quantity)
    ending = " at the largest slip" if quantity.endswith(AT_SLIP) else ""
    return f"${quantity_of(quantity.removesuffix(AT_SLIP)).latex}${part}{ending}"


def calibration_overview(calibration: Calibration) -> Overview:
    """The ranks of every quantity, the verdict, and what stands behind it."""
    header = ("quantity", "p", "shift", "width", *(f"{100 * q:.0f} %" for q in ranks.COVERAGES))
    rows = tuple(_ranked(row) for row in calibration.tests.to_dict("records"))
    lines = (
        "shift and width in sd of a right posterior; truths inside central intervals in %",
        *calibration_lines(calibration),
    )
    return (Table(calibration.study.title, "l" + "r" * (len(header) - 1), header, rows), *map(Text, lines))


def _ranked(row: Mapping[Hashable, Any]) -> tuple[str, ...]:
    name = _short(str(row["quantity"]))
    if row["verdict"] == "constant":
        return (name, "constant")
    mark = "" if row["verdict"] == "uniform" else " ✕"
    shares = (f"{100 * row[f'covered_{100 * q:.0f}']:.0f}" for q in ranks.COVERAGES)
    return (name, f"{row['p_value']:.4f}{mark}", f"{row['shift']:+.2f}", f"{row['width']:.2f}", *shares)


def _short(quantity: str) -> str:
    """A test quantity in few letters: parameters by their names, channels by their symbols."""
    whole, part = whole_and_part(quantity)
    if (channel := whole.removesuffix(AT_SLIP)) in CHANNELS:
        return f"{CHANNELS[channel].symbol}{part} at largest slip"
    return quantity if whole in PARAMETERS else quantity.replace("_", " ")


def calibration_lines(calibration: Calibration) -> list[str]:
    """The verdict, what did not converge, and what would have been noticed."""
    n, power = len(calibration.table), calibration.power.iloc[1]
    smallest = calibration.tests["p_value"].min() if calibration.tested else np.nan
    word = "NOT calibrated" if calibration.failing else calibration.verdict
    lines = [f"Posterior {word}: smallest p {smallest:.2g}, threshold {calibration.threshold:.2g}."]
    if calibration.unsettled:
        allowed = f"{ranks.UNSETTLED:.0%} allowed"
        lines.append(f"{calibration.unsettled} of {n} replications did not converge ({allowed}).")
    lines.append(
        f"{n} replications notice a {power['error']} with probability {power['one']:.2f} in one parameter,"
        f" {power['all']:.2f} in all."
    )
    return lines
