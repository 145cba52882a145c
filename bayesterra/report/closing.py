"""Least squares beside the posterior, the prior's hold on it, and how to make it again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from bayesterra.adequacy import complete, estimates
from bayesterra.figures.rows import summary_rows
from bayesterra.figures.style import MARKS
from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.report.blocks import Block, Cell, Section, Table, Text
from bayesterra.report.numbers import NOTHING, interval, plain, resolution, rounded, share
from bayesterra.report.symbols import angles, listed, symbol, symbols, unit
from bayesterra.report.words import bounded
from bayesterra.results import Result


def methods_section(result: Result) -> Section:
    """Least squares side by side."""
    notes: list[Block] = [Text(Markup("{}: {}.").format(name, angles("; ".join(fit["notes"]))))
                          for name, fit in result.record["fits"].items() if fit["notes"]]  # fmt: skip
    refused: list[Block] = [
        Text(Markup("Not fitted: {}").format(line)) for line in result.record["refused_fits"]
    ]
    return Section(
        "methods", "Least squares side by side", (_values(result), _standing(result), *notes, *refused)
    )


def _values(result: Result) -> Table:
    points = estimates(result)
    rows = [
        _value_row(result, name, points) for name in PARAMETERS if any(name in v for v in points.values())
    ]
    caption = (
        "Point estimates beside the posterior, with the digits that the posterior's interval supports. "
        "= held at this value; | at a bound."
    )
    header = ("", "unit", "median", "mode", "90 % HDI", *(MARKS[name].label for name in points))
    return Table(caption, "llrrr" + "r" * len(points), header, tuple(rows))


def _value_row(result: Result, name: str, points: Mapping[str, Mapping[str, float]]) -> tuple[Cell, ...]:
    scale = PARAMETERS[name].scale
    if name not in result.names:
        fixed = result.study.prior.fixed.get(name, np.nan) / scale
        own: tuple[Cell, ...] = (plain(fixed), plain(fixed), "fixed")
        step = 0.001
    else:
        row = summary_rows(result)[name]
        step = resolution(*row.hdi)
        own = (rounded(row.median, step), rounded(row.mode, step), interval(*row.hdi))
    cells = (
        _flag(result, method, name) + _shown(values.get(name), scale, step)
        for method, values in points.items()
    )
    return symbol(name), unit(name) or NOTHING, *own, *cells


def _shown(value: float | None, scale: float, step: float) -> str:
    return NOTHING if value is None else rounded(value / scale, step)


def _flag(result: Result, method: str, name: str) -> str:
    if name in result.record["fits"].get(method, {}).get("held", ()):
        return "= "
    return "| " if name in result.record["standings"][method]["at_bound"] else ""


def _standing(result: Result) -> Table:
    channels = _judged(result.least_squares)
    standings, fits = result.record["standings"], result.record["fits"]
    judged = ("mode", *complete(result))
    rows = [
        _standing_row(name, standings[name], fits.get(name), channels, judged=name in judged)
        for name in ("mode", *estimates(result))
    ]
    errors = (Markup("error of {} [%]").format(symbol(name)) for name in channels)
    caption = (
        "Where each estimate stands: the share of draws of higher density (small: a typical good fit; near "
        "100 %: practically no draw is as improbable; the mode's is 0 by definition), and the largest "
        "misfit in percent of the largest reading, (16). IM1, IM2 and IM3 take the measured sinkage as "
        "given, joint and the posterior weight all channels by their noise."
    )
    header = ("estimate", "denser draws", "standing", "converged", "passes", *errors)
    return Table(caption, "lrllr" + "r" * len(channels), header, tuple(rows))


def _judged(table: pd.DataFrame) -> list[str]:
    """Channels for which any method has an error."""
    errors = table[table["parameter"].str.startswith("error_") & table["value"].notna()]
    found = set(errors["parameter"].str.removeprefix("error_"))
    return [name for name in CHANNELS if name in found]


def _standing_row(
    name: str,
    standing: Mapping[str, Any],
    fit: Mapping[str, Any] | None,
    channels: list[str],
    *,
    judged: bool,
) -> tuple[Cell, ...]:
    label = MARKS[name].label if name in MARKS else "posterior mode"
    outside = standing["log_density"] is None
    level = share(standing["credible_level"]) if judged and not outside else NOTHING
    word = _standing_word(standing) if judged else Markup("not judged: only some of the parameters")
    if fit is None:
        return label, level, word, NOTHING, NOTHING, *(NOTHING for _ in channels)
    errors = (plain(fit["errors_percent"].get(channel), 2) for channel in channels)
    return label, level, word, "yes" if fit["converged"] else "no", str(fit["passes"]), *errors


def _standing_word(standing: Mapping[str, Any]) -> Markup:
    at = standing["at_bound"]
    bounds = Markup("; at a bound: {}").format(symbols(at)) if at else Markup("")
    outside = standing["log_density"] is None
    return Markup("{}{}").format(angles(standing["word"]) if outside else "inside the prior", bounds)


def prior_section(result: Result) -> Section:
    """How far the prior shapes the result."""
    ends = listed(Markup("{} at the {} end").format(symbol(name), end) for name, end in bounded(result))
    text = (
        Markup(
            "A bound of the prior cuts off {}: there the interval is as much the prior's as the "
            "data's, and a wider prior would move it."
        ).format(ends)
        if ends
        else Markup("No parameter leans on a bound of its prior.")
    )  # fmt: skip
    advice = (
        "No second prior was run for this report. To see what another one does, change [priors] in the "
        "study, run again and set the two results side by side."
    )
    return Section("prior", "Sensitivity to the prior", (Text(text), _widths(result), Text(advice)))


def _widths(result: Result) -> Table:
    rows = []
    for name, row in summary_rows(result).items():
        if name in result.names:
            moved = (row.mean - row.prior_mean) / row.prior_sd
            rows.append((symbol(name), plain(row.sd / row.prior_sd, 2), f"{moved:+.1f}".replace("-", "−")))
    caption = (
        "Posterior against prior: ratio of the standard deviations (1: nothing learnt), and shift of the "
        "mean in standard deviations of the prior (beyond ± 2: data and prior disagree)."
    )
    return Table(caption, "lrr", ("", "sd ratio", "shift of the mean"), tuple(rows))


def reproduce_section(result: Result) -> Section:
    """Everything needed to make the result again."""
    record = result.record
    facts = (
        ("command", Markup("<code>bayesterra run STUDY --seed {}</code>").format(record["seed"])),
        ("made", record["made"]),
        ("seed", str(record["seed"])),
        ("settings", _pairs(record["settings"])),
        ("versions", _pairs(record["versions"])),
        ("machine", record["machine"]),
        ("fingerprint of the study", Markup("<code>{}</code>").format(record["fingerprints"]["study"])),
        ("fingerprint of the data", Markup("<code>{}</code>").format(record["fingerprints"]["data"])),
        ("seconds", _pairs({name: plain(value) for name, value in record["seconds"].items()})),
    )
    caption = (
        "The same study, data, seed and versions give the same draws on one machine, whatever the number of "
        "cores; fingerprints are SHA-256."
    )
    return Section("reproduce", "Reproduce this", (Table(caption, "ll", ("", ""), facts), _checklist()))


def _pairs(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{str(name).replace('_', ' ')} {value}" for name, value in values.items())


def _checklist() -> Table:
    rows = (
        ("1 Model, data, prior", "Data and model"),
        ("2 Computation: convergence and effective size of every quantity", "Sampling quality"),
        ("3 Posterior, with predictive check", "Posterior; Predictive checks"),
        ("4 Decisions and criteria", "thresholds in Sampling quality, Predictive checks and Identifiability"),
        ("5 Sensitivity to the prior", "Sensitivity to the prior: what one run can tell"),
        ("6 Reproducibility", "this section"),
    )
    caption = "Bayesian analysis reporting guidelines (Kruschke 2021): where each point is met."
    return Table(caption, "ll", ("guideline", "section"), rows)
