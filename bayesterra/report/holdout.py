"""The page of a leave-out check: coverage and skill first, then every row, scores and how it was made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from markupsafe import Markup

from bayesterra import figures
from bayesterra.holdout import Holdout
from bayesterra.holdout.baselines import baseline_names
from bayesterra.report.blocks import Cell, Gallery, Section, Table, Text, drawing
from bayesterra.report.numbers import NOTHING, number, plain
from bayesterra.report.pages import VerdictPage
from bayesterra.report.symbols import listed, symbol, with_unit
from bayesterra.report.verdicts import Verdict

WIDE = 2.0
"""Standard errors by which a coverage may miss its level before it is called off."""
PARTS = {"all": "all", "inner": "interpolated", "end": "extrapolated"}
MARKED = 0.05
"""Share of draws without an answer from which a row is named."""


def holdout_page(found: Holdout, version: str) -> VerdictPage:
    """Put the page together."""
    study, kind = found.study, found.study.kind
    rows = sum(int(level.left.sum()) for level in found.levels)
    return VerdictPage(
        title=study.title or "Soil parameters from wheel tests",
        facts=(
            f"{kind} data",
            f"model {study.model.name}, {study.drive}-driven",
            f"{rows} rows left out in {len(found.levels)} levels",
        ),
        warning=_warning(found),
        verdicts=(_coverage(found), _skill(found), _refits(found)),
        sections=(
            _rows_section(found),
            _scores_section(found),
            _bands_section(found),
            _method_section(found),
        ),
        version=version,
    )


def _warning(found: Holdout) -> Markup:
    wrong = [
        level.name
        for level, outcome in zip(found.levels, found.outcomes, strict=True)
        if outcome.status != "converged"
    ]
    if not wrong:
        return Markup("")
    return Markup("The fit has <b>not converged</b> without {}: do not rely on its predictions.").format(
        listed(wrong)
    )


def _own(found: Holdout) -> list[dict[Any, Any]]:
    """The model's scores by channel, all rows."""
    table = found.summary
    return table[(table["predictor"] == found.model) & (table["part"] == "all")].to_dict("records")


def _coverage(found: Holdout) -> Verdict:
    """Whether nine in ten readings lie where nine in ten should."""
    parts, low, high = [], False, False
    for row in _own(found):
        share, rows = row["covered90"], row["rows"]
        error = max(np.nan_to_num(row["covered90_se"]), float(np.sqrt(0.09 / rows)))
        low, high = low or share < 0.9 - WIDE * error, high or share > 0.9 + WIDE * error
        counted = Markup("{} of {} of {}").format(round(share * rows), rows, symbol(row["channel"]))
        parts.append(counted)
    sentence = Markup("The 90 % intervals hold {}.").format(listed(parts))
    if not parts:
        return Verdict("Coverage", "unknown", "poor", Markup("No refit could be scored."))
    word, grade = (
        ("too narrow", "poor") if low else ("too wide", "fair") if high else ("not contradicted", "good")
    )
    return Verdict("Coverage", word, grade, sentence)


def _skill(found: Holdout) -> Verdict:
    """Whether the model beats the stronger one of the regressions."""
    table = found.skills
    if table.empty:
        return Verdict("Skill", "unknown", "poor", Markup("No refit could be scored."))
    rows = table[(table["part"] == "all") & (table["baseline"] != "mean")]
    parts = [
        Markup("{}: {} against {} ({})").format(symbol(row["channel"]), *_gain(row))
        for row in rows.to_dict("records")
    ]
    better, worse = (rows["skill_lo"] > 0).all(), (rows["skill_hi"] < 0).any()
    word, grade = ("better than regression", "good") if better else ("not clearly better", "fair")
    word, grade = ("worse than regression", "poor") if worse else (word, grade)
    return Verdict("Skill", word, grade, Markup("Share of the CRPS saved: {}.").format(listed(parts)))


def _gain(row: Mapping[Any, Any]) -> tuple[str, str, str]:
    return percent(row["skill"]), str(row["baseline"]), _between(row)


def _between(row: Mapping[Any, Any]) -> str:
    if not np.isfinite(row["skill_lo"]):
        return "one level"
    return f"{percent(row['skill_lo'])} to {percent(row['skill_hi'])}"


def percent(share: float) -> str:
    """A share in whole percent.

    >>> percent(-0.123), percent(0.5)
    ('−12 %', '50 %')
    """
    return f"{number(100 * share, 0)} %" if np.isfinite(share) else NOTHING


def _refits(found: Holdout) -> Verdict:
    fine = sum(outcome.status == "converged" for outcome in found.outcomes)
    grade = "good" if found.converged else "poor"
    lost = found.table["no_answer"].max()
    text = Markup("Largest share of draws without an answer at a left-out row: {}.").format(percent(lost))
    return Verdict("Fits", f"{fine} of {len(found.outcomes)} converged", grade, text)


def _rows_section(found: Holdout) -> Section:
    picture = drawing(figures.all_left_out(found.table), "Left-out readings and their predictive intervals")
    caption = Markup(
        "Every left-out reading (dot) with the central 50 and 90 % of what was predicted for it by fits that "
        "have not seen its level: model, polynomial, Gaussian process. Grey ground: slips beyond those of "
        "the training rows."
    )
    own = found.table[found.table["predictor"] == found.model]
    marked = own[own["no_answer"] > MARKED].drop_duplicates("row")
    blocks: tuple[Any, ...] = (Gallery("whole", (picture,), caption),)
    if len(marked):
        parts = (f"row {r} ({percent(share)})" for r, share in marked[["row", "no_answer"]].to_numpy())
        sentence = Markup("Draws for which the model has no answer were set aside at {}.").format(
            listed(parts)
        )
        blocks = (*blocks, Text(sentence))
    return Section("rows", "Left-out readings", blocks)


def _scores_section(found: Holdout) -> Section:
    header: tuple[Cell, ...] = (
        "", "rows", "", "rows, levels", "mean CRPS", "±", "in 50 % [%]", "±", "in 90 % [%]", "±",
        "not scored",
    )  # fmt: skip
    rows = tuple(_score_row(row) for row in found.summary.to_dict("records"))
    caption = Markup(
        "Mean scores in the unit of the channel (the smaller the better; the absolute error of a law without "
        "width) and shares of readings inside the central intervals. Standard errors are from the spread "
        "between levels, as rows of one level are not independent; with few levels they are rough, and 0 "
        "says no more than that all agree. A reading without a prediction counts as not covered."
    )
    against = tuple(_skill_row(row) for row in found.skills.to_dict("records"))
    head: tuple[Cell, ...] = ("against", "", "rows", "skill", "90 %", "levels won")
    below = Markup(
        "Skill: 1 − mean CRPS of {} / mean CRPS of the baseline, with the central 90 % when levels are drawn "
        "again with replacement. Positive: the model is better."
    ).format(found.model)
    return Section(
        "scores",
        "Scores",
        (Table(caption, "lllrrrrrrrr", header, rows), Table(below, "lllrrr", head, against)),
    )


def _score_row(row: Mapping[Any, Any]) -> tuple[Cell, ...]:
    shares = (
        text
        for name in ("covered50", "covered90")
        for text in (number(100 * row[name], 0), number(100 * row[f"{name}_se"], 0))
    )
    return (
        row["predictor"], PARTS[row["part"]], with_unit(row["channel"]), f"{row['rows']}, {row['levels']}",
        plain(row["crps"]), plain(row["crps_se"], 2), *shares, str(row["unscored"]),
    )  # fmt: skip


def _skill_row(row: Mapping[Any, Any]) -> tuple[Cell, ...]:
    won = f"{row['levels_won']} of {row['levels']}"
    head = (row["baseline"], symbol(row["channel"]), PARTS[row["part"]])
    return (*head, percent(row["skill"]), _between(row), won)


def _bands_section(found: Holdout) -> Section:
    picture = drawing(figures.bands_without(found), "Predictive bands of the fits without each level")
    caption = Markup(
        "The model fitted without each level: median and 90 % of readings over slip at the median load. "
        "Dots: training rows; rings: the rows left out."
    )
    return Section("bands", "Fits without each level", (Gallery("whole", (picture,), caption),))


KNOWN = {
    "load": "slip, wheel and load",
    "both": "slip, wheel and the reading of the normal force, from which each draw’s load is inferred",
    "sinkage": "slip, wheel and sinkage",
}


def _method_section(found: Holdout) -> Section:
    text = Markup(
        "One level at a time is left out and the posterior of all other rows is sampled. Of a left-out row "
        "{} stay known; everything else that was read is predicted, noise included. The predictive law is "
        "the mixture of the laws of a reading over posterior draws; its CRPS is exact (Grimit et al. 2006). "
        "Draws without an answer are set aside, as the drive was made. Baselines ({}) are fitted to the "
        "same training rows and conditions and find the noise there themselves; the model is told the noise "
        "of the study. The polynomial’s degree, 1 to 3, predicts left-out training levels best."
    ).format(KNOWN[found.study.drive], ", ".join(baseline_names()))
    refits = tuple(
        (row["level"], row["rows"], row["status"], plain(row["ess"]), plain(row["r_hat"], 4), row["note"])
        for row in found.refits.to_dict("records")
    )
    head: tuple[Cell, ...] = ("without", "rows", "sampling", "effective draws", "R-hat", "")
    record = found.record
    origin: tuple[tuple[Cell, ...], ...] = (
        ("grouping", f"{record['by']}{_tolerance(record)}"),
        ("seed", str(record["seed"])),
        ("versions", ", ".join(f"{name} {value}" for name, value in record["versions"].items())),
        ("fingerprint of the study", Markup("<code>{}</code>").format(record["fingerprints"]["study"])),
        ("fingerprint of the data", Markup("<code>{}</code>").format(record["fingerprints"]["data"])),
    )
    blocks = (Text(text), Table("", "lllrrl", head, refits), Table("", "ll", ("", ""), origin))
    return Section("method", "Method", blocks)


def _tolerance(record: Mapping[str, Any]) -> str:
    return f", nearer than {record['tolerance']:g}" if "tolerance" in record else ""
