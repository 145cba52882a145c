"""Leave-out check as a page, figures and a terminal table."""

from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesterra.arrays import FloatArray
from bayesterra.checking.folds import WAYS, Band, Fold
from bayesterra.checking.holdout import Holdout
from bayesterra.checking.holdout_scores import BASELINES
from bayesterra.checking.validation import prediction_verdict
from bayesterra.parameters import CHANNELS
from bayesterra.report.blocks import Blocks, Cell, Gallery, Overview, Table, Text, drawing
from bayesterra.report.figures import DATA, GRID, INK, POSTERIOR, label, limit_y, literal, new_figure, styled
from bayesterra.report.numbers import NOTHING, number, plain
from bayesterra.report.sections import Prose, Section, VerdictPage, origin_rows
from bayesterra.report.symbols import listed, symbol, with_unit
from bayesterra.report.verdicts import Verdict
from bayesterra.study.observations import Observations

say = Prose("holdout")

PARTS = {"all": "all", "inner": "interpolated", "end": "extrapolated"}
MARKED = 0.05
"""Share of draws without an answer from which a row is named."""


def holdout_page(holdout: Holdout) -> VerdictPage:
    """Put the page together."""
    study, kind = holdout.study, holdout.study.kind
    rows = sum(int(fold.left.sum()) for fold in holdout.levels)
    bands = drawing(bands_without(holdout), "Predictive bands of the fits without each level")
    return VerdictPage(
        title=study.title or "Soil parameters from wheel tests",
        facts=(
            f"{kind} data",
            f"model {study.model.name}, {study.drive}-driven",
            f"{rows} rows left out in {len(holdout.levels)} levels",
        ),
        warning=say("warning", listed(each.level for each in holdout.outcomes if each.status != "converged")),
        verdicts=(_prediction(holdout), _skill(holdout), _refits(holdout)),
        sections=(
            Section("rows", "Left-out readings", _rows_section(holdout)),
            Section("scores", "Scores", _scores_section(holdout)),
            Section("bands", "Fits without each level", (Gallery("whole", (bands,), say("bands")),)),
            Section("method", "Method", _method_section(holdout)),
        ),
        version=holdout.record["versions"]["bayesterra"],
        template="holdout.html",
    )


def _prediction(holdout: Holdout) -> Verdict:
    """Verdict on the left-out readings, as of the levels that every run leaves out."""
    by = holdout.record["by"] if holdout.record["by"] in WAYS else "group"
    rows = [{"by": by, "reliable": True, **row} for outcome in holdout.outcomes for row in outcome.rows]
    return prediction_verdict(rows, holdout.model)


def _skill(holdout: Holdout) -> Verdict:
    """Verdict on whether the model beats the stronger one of the regressions."""
    table = holdout.skills
    if table.empty:
        return Verdict("Skill", "unknown", "bad", Markup("No refit could be scored."))
    rows = table[(table["part"] == "all") & (table["baseline"] != "mean")]
    gains = [say("gain", row, percent(row["skill"]), _between(row)) for row in rows.to_dict("records")]
    better, worse = (rows["skill_lo"] > 0).all(), (rows["skill_hi"] < 0).any()
    word, grade = ("better than regression", "good") if better else ("not clearly better", "doubtful")
    word, grade = ("worse than regression", "bad") if worse else (word, grade)
    return Verdict("Skill", word, grade, say("skill", gains))


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


def _refits(holdout: Holdout) -> Verdict:
    fine = sum(outcome.status == "converged" for outcome in holdout.outcomes)
    grade = "good" if holdout.converged else "bad"
    lost = holdout.table["no_answer"].max()
    text = Markup("Largest share of draws without an answer at a left-out row: {}.").format(percent(lost))
    return Verdict("Fits", f"{fine} of {len(holdout.outcomes)} converged", grade, text)


def _rows_section(holdout: Holdout) -> Blocks:
    picture = drawing(all_left_out(holdout), "Left-out readings and their predictive intervals")
    own = holdout.table[holdout.table["predictor"] == holdout.model]
    marked = own[own["no_answer"] > MARKED].drop_duplicates("row")
    entries = [f"row {r} ({percent(share)})" for r, share in marked[["row", "no_answer"]].to_numpy()]
    sentence = Markup("Draws for which the model has no answer were set aside at {}.").format(listed(entries))
    return (Gallery("whole", (picture,), say("rows")), *((Text(sentence),) if entries else ()))


def _scores_section(holdout: Holdout) -> Blocks:
    rows = tuple(_score_row(row) for row in holdout.summary.to_dict("records"))
    against = tuple(_skill_row(row) for row in holdout.skills.to_dict("records"))
    return (say.table("scores", rows), say.table("skills", against, holdout.model))


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


def _method_section(holdout: Holdout) -> Blocks:
    text = say("method", holdout.study.drive.plan, ", ".join(BASELINES), holdout.record.get("basis", ""))
    refits = tuple(
        (row["level"], row["rows"], row["status"], plain(row["ess"]), plain(row["r_hat"], 4), row["note"])
        for row in holdout.refits.to_dict("records")
    )
    head: tuple[Cell, ...] = ("without", "rows", "sampling", "effective draws", "R-hat", "")
    record = holdout.record
    near = f", nearer than {record['tolerance']:g}" if "tolerance" in record else ""
    origin: tuple[tuple[Cell, ...], ...] = (
        ("grouping", f"{record['by']}{near}"),
        ("seed", str(record["seed"])),
        *origin_rows(record, "study", "data"),
    )
    return (Text(text), Table("", "lllrrl", head, refits), Table("", "ll", ("", ""), origin))


COLOURS = {"polynomial": "#E69F00", "Gaussian process": "#009E73"}
"""Colours of the baselines that are drawn."""
MOST = 12
"""Panels, at most: levels, and wheels that have rows of them."""


def channels(table: pd.DataFrame) -> list[str]:
    """Channels that are scored."""
    return list(dict.fromkeys(table["channel"]))


def _colours(table: pd.DataFrame) -> dict[str, str]:
    """Predictors that are drawn: everything that is no baseline, which is one model, then the baselines."""
    models = [name for name in dict.fromkeys(table["predictor"]) if name not in BASELINES]
    return {**dict.fromkeys(models, POSTERIOR), **COLOURS}


def _left_out(ax: Axes, table: pd.DataFrame, channel: str) -> None:
    table = table[table["channel"] == channel]
    place, colours = _places(table), _colours(table)
    for position, (name, colour) in enumerate(colours.items()):
        own = table[(table["predictor"] == name) & table["crps"].notna()]
        x = own["row"].map(place).to_numpy(np.float64) + 0.24 * (position - 0.5 * (len(colours) - 1))
        ax.vlines(x, own["q05"], own["q95"], color=colour, linewidth=1.3)
        ax.vlines(x, own["q25"], own["q75"], color=colour, linewidth=5)
        ax.plot(x, own["q50"], "_", color="white", markersize=5, markeredgewidth=1.2, zorder=5)
    own = table[table["predictor"] == table["predictor"].iloc[-1]]  # baselines have every row
    x = own["row"].map(place).to_numpy(np.float64)
    ax.hlines(own["observed"], x - 0.4, x + 0.4, color=DATA, linewidth=0.8, zorder=4)
    ax.plot(x, own["observed"], "o", color=DATA, markersize=3.6, zorder=6)
    _ground(ax, own, place)
    _limit(ax, table)
    ax.set(ylabel=label(CHANNELS[channel]), xlim=(-0.7, max(place.values()) + 0.7))


def _places(table: pd.DataFrame) -> dict[int, float]:
    """Place of every row on the axis: rows of a level side by side, a gap between levels, ascending slip."""
    rows = table.drop_duplicates("row").sort_values("slip", kind="stable")
    order = {level: i for i, level in enumerate(rows["level"].unique())}
    rows = rows.sort_values("level", key=lambda names: names.map(order), kind="stable")
    gaps = (rows["level"] != rows["level"].shift()).cumsum() - 1
    return dict(zip(rows["row"], (np.arange(len(rows)) + 0.6 * gaps).astype(float), strict=True))


def _ground(ax: Axes, rows: pd.DataFrame, place: dict[int, float]) -> None:
    """Names of the levels, and grey where they are extrapolated."""
    ticks, names = [], []
    for name, own in rows.groupby("level", sort=False):
        at = own["row"].map(place)
        ticks.append(float(at.mean()))
        names.append(str(name).removeprefix("slip "))
        if own["extrapolated"].any():
            ax.axvspan(at.min() - 0.7, at.max() + 0.7, color=GRID, alpha=0.45, linewidth=0, zorder=0)
    turned: dict[str, Any] = {"rotation": 45, "ha": "right"} if max(map(len, names)) > 8 else {}
    ax.set_xticks(ticks, [literal(str(name)) for name in names], **turned)


def _limit(ax: Axes, table: pd.DataFrame) -> None:
    """Keep readings and most bars in view; wild baselines may leave it."""
    seen = table[table["predictor"] != "mean"]
    values = np.concatenate([seen["observed"], seen["q25"].dropna(), seen["q75"].dropna()])
    reach = float(np.ptp(values)) or 1.0
    low, high = table["observed"].min() - 0.6 * reach, table["observed"].max() + 0.6 * reach
    drawn = np.concatenate([seen["q05"].dropna(), seen["q95"].dropna(), seen["observed"]])
    low, high = max(low, drawn.min()), min(high, drawn.max())
    limit_y(ax, low, high, 0.06)


@styled
def all_left_out(left_out: Holdout | pd.DataFrame) -> FloatArray:
    """Draw left-out readings, one channel below the other, beside predictions that do not know their level.

    One place for every row of a table as of :attr:`bayesterra.checking.holdout.Holdout.table`, levels apart.
    Bars: central 50 and 90 % of the predictive law of a reading, tick: its median; blue the model, orange the
    polynomial, green the Gaussian process. Dots: the readings. Grey ground: slips beyond the training rows'.
    """
    table = left_out.table if isinstance(left_out, Holdout) else left_out
    names = channels(table)
    figure = new_figure(7.2, 2.4 * len(names) + 0.6)
    axes = np.asarray(figure.subplots(len(names), 1, squeeze=False)).ravel()
    for ax, name in zip(axes, names, strict=True):
        _left_out(ax, table, name)
    slips = table["level"].str.startswith("slip ").all()
    axes[-1].set_xlabel("left out: slip level $s$ [–]" if slips else "left out")
    entries: list[Patch | Line2D] = [
        Line2D([], [], color=colour, linewidth=5, label=name) for name, colour in _colours(table).items()
    ]
    entries.append(Line2D([], [], color=DATA, marker="o", markersize=3.6, linewidth=0.8, label="reading"))
    if table["extrapolated"].any():
        entries.append(Patch(color=GRID, alpha=0.6, label="extrapolated"))
    figure.legend(handles=entries, loc="outside lower center", ncols=len(entries), labelcolor=INK)
    return axes


@styled
def bands_without(holdout: Holdout) -> FloatArray:
    """Draw fits without a level: rows are channels, columns (12 at most) levels and wheels.

    Line and band: median and 90 % of the readings that the fit expects over slip, at the median load. Dots:
    the training rows of the wheel; rings: the rows that were left out.
    """
    names, panels = channels(holdout.table), _panels(holdout)
    figure = new_figure(max(1.75 * len(panels), 3.0) + 0.5, 1.75 * len(names) + 0.5)
    axes = np.asarray(figure.subplots(len(names), max(len(panels), 1), squeeze=False, sharex=True, sharey="row"))
    for column, (title, fold, bands) in zip(axes.T, panels, strict=False):
        column[0].set_title(title, fontsize=8.5)
        for ax, name in zip(column, names, strict=True):
            _without(ax, holdout.study.observations, fold, bands[name])
    for row, name in enumerate(names):
        axes[row, 0].set_ylabel(label(CHANNELS[name]))
    figure.supxlabel("slip ratio $s$ [–]", fontsize=9, color=INK)
    return axes


def _panels(holdout: Holdout) -> list[tuple[str, Fold, dict[str, Band]]]:
    """Title, level and bands by channel of every column."""
    panels = []
    for fold, outcome in zip(holdout.levels, holdout.outcomes, strict=True):
        owners = dict.fromkeys((band.group, band.wheel) for band in outcome.bands)
        for owner in owners:
            whose = " ".join(filter(None, dict.fromkeys(owner))) + " " if len(owners) > 1 else ""
            bands = {band.channel: band for band in outcome.bands if (band.group, band.wheel) == owner}
            panels.append((literal(f"{whose}without {fold.name}"), fold, bands))
    return panels[:MOST]


def _without(ax: Axes, rows: Observations, fold: Fold, band: Band) -> None:
    ax.fill_between(band.slip, band.low, band.high, color=POSTERIOR, alpha=0.25, linewidth=0)
    ax.plot(band.slip, band.middle, color=POSTERIOR)
    values = rows.values[band.channel] / CHANNELS[band.channel].scale
    for chosen, face in ((rows.use & ~fold.left, DATA), (fold.left, "white")):
        style: dict[str, Any] = {"color": DATA, "markerfacecolor": face, "markersize": 3.5, "zorder": 6}
        ax.plot(rows.slip[chosen & band.rows], values[chosen & band.rows], "o", **style)


def holdout_overview(holdout: Holdout) -> Overview:
    """Coverage and mean scores of model and baselines."""
    every = holdout.summary[holdout.summary["part"] == "all"] if len(holdout.table) else holdout.table
    rows: list[tuple[str, ...]] = []
    for channel in every["channel"].unique():
        rows += [_scored(row) for row in every[every["channel"] == channel].to_dict("records")]
        rows.append(())
    lines = [holdout.record["basis"]] if "basis" in holdout.record else []
    lines += [
        f"! Without {outcome.level}: {outcome.status}. {outcome.note}".rstrip()
        for outcome in holdout.outcomes
        if outcome.status != "converged"
    ]
    title = f"{len(holdout.levels)} levels left out, one at a time"
    header = ("", "", "rows", "mean CRPS", "in 50 %", "in 90 %")
    return (Table(title, "llrrrr", header, tuple(rows)), *map(Text, lines))


def _scored(row: Mapping[Hashable, Any]) -> tuple[str, ...]:
    shares = (f"{number(100 * row[name], 0)} %" for name in ("covered50", "covered90"))
    score = f"{plain(row['crps'])} ± {plain(row['crps_se'], 2)} {row['unit']}"
    return (CHANNELS[row["channel"]].symbol, row["predictor"], str(row["rows"]), score, *shares)
