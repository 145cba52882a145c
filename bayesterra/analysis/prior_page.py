"""Report of a prior before any reading exists, with its figures."""

from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from bayesterra.analysis.result import PriorResult
from bayesterra.likelihood.correlated import TYPICAL
from bayesterra.likelihood.forward import reference_load
from bayesterra.likelihood.page import conditions, prior_sources, slip_note, stated_law, support
from bayesterra.likelihood.posterior import posterior
from bayesterra.parameters import CHANNELS, DERIVED, MODULI, PARAMETERS, field_values
from bayesterra.report.blocks import Blocks, Cell, Gallery, Overview, Table, Text, drawing
from bayesterra.report.figures import INK, PRIOR, fan, label, own_axes, styled
from bayesterra.report.numbers import NOTHING, estimate, given, interval, moments, plain, share
from bayesterra.report.sections import Draft, Prose, Section, VerdictPage, repeated
from bayesterra.report.symbols import angles, listed, symbol, unit, with_unit
from bayesterra.report.terminal import failure_lines
from bayesterra.report.verdicts import Verdict, failed

say = Prose("prior")

FAIR, POOR = 0.5, 0.05
"""Shares of the stated prior that physics leaves, below which the cut shapes the prior, and rules it."""
TEACHING = 2.0
"""Spread of predictions over noise from which a reading narrows them."""


def prior_page(result: PriorResult) -> VerdictPage:
    """Put the page of a prior together."""
    study = result.study
    facts = (
        f"wheels {', '.join(study.wheels)}" if len(study.wheels) > 1 else f"wheel {next(iter(study.wheels))}",
        *study.described.values(),
        f"{int(study.observations.use.sum())} rows to measure",
        f"model {study.model.name}, {study.drive}-driven",
        f"made {str(result.record['made'])[:10]}",
    )
    draft = Draft(result)
    verdicts = (
        draft.verdict("Physics leaves", _support),
        draft.verdict("Readings would teach", _predictions, "curves"),
        draft.verdict("Greatest pull", _pull),
    )
    sections = (
        draft.section("prior", "Prior", _prior_section),
        draft.section("predictions", "What the prior predicts", _predictive_section),
        draft.section("derived", "Derived quantities", _derived_section),
        draft.section("data", "Conditions and model", _conditions),
        Section("reproduce", "Reproduce this", (repeated("run STUDY --prior-only", result.record),)),
    )
    return VerdictPage(
        title=study.title or "Soil parameters from wheel tests",
        facts=tuple(fact for fact in facts if fact), verdicts=verdicts, sections=sections,
        version=result.record["versions"]["bayesterra"], warning=draft.warning(), failures=draft.failures,
        template="before.html",
    )  # fmt: skip


def _support(result: PriorResult) -> Verdict:
    """Share of the stated prior that physics leaves."""
    shares: dict[str, float] = dict(result.record["prior_support"]["shares"])
    inside = shares.pop("inside the support", 0.0)
    worst = max(shares, key=lambda reason: shares[reason], default="")
    sentence = say("support", angles(worst), share(shares.get(worst, 0.0)))
    grade = "good" if inside >= FAIR else "doubtful" if inside >= POOR else "bad"
    return Verdict("Physics leaves", share(inside), grade, sentence)


def _predictions(result: PriorResult) -> Verdict:
    """Width of the predictions beside the noise."""
    outcomes = result.draws["curves"]["outcome"].to_numpy().tolist()
    ratios = {name: _ratio(result, name) for name in result.study.noise if name in outcomes}
    phrases = listed(Markup("{} for {}").format(plain(r, 2), symbol(name)) for name, r in ratios.items())
    sentence = Markup("Spread of what the prior predicts over the noise of a reading: {}.").format(phrases)
    teaching = sum(ratio > TEACHING for ratio in ratios.values())
    grade = "good" if teaching == len(ratios) else "doubtful" if teaching else "bad"
    return Verdict("Readings would teach", f"in {teaching} of {len(ratios)} channels", grade, sentence)


def _ratio(result: PriorResult, channel: str) -> float:
    """Width of 90 % of the modelled values over that of the noise, median over slips."""
    curves = result.draws["curves"].sel(outcome=channel)
    modelled, readings = (
        curves[kind].to_numpy()[:, 4] - curves[kind].to_numpy()[:, 0] for kind in ("modelled", "readings")
    )
    noise = np.sqrt(np.maximum(readings**2 - modelled**2, 1e-6 * modelled**2))
    return float(np.nanmedian(modelled / noise))


def _pull(result: PriorResult) -> Verdict:
    """The range of the greatest pull."""
    rows = {row["parameter"]: row for row in result.summary.to_dict("records")}
    if "peak_pull" not in rows:
        return Verdict("Greatest pull", "unknown", "bad", Markup("No load is known."))
    row = rows["peak_pull"]
    low, high = row["prior_hdi90_lo"], row["prior_hdi90_hi"]
    sentence = Markup("90 % of the prior, under {} N.").format(given(round(reference_load(result.study), 1)))
    return Verdict("Greatest pull", f"{interval(low, high)} N", "good" if low > 0 else "doubtful", sentence)


def _conditions(result: PriorResult) -> Blocks:
    note = slip_note(posterior(result.study), result.values()[:TYPICAL])
    return (*conditions(result.study), *note)


def _prior_section(result: PriorResult) -> Blocks:
    rows = {row["parameter"]: row for row in result.summary.to_dict("records")}
    entries = (prior := result.study.prior).entries
    body = tuple(
        (symbol(name), angles(PARAMETERS[name].description), stated_law(name, entries[name]),
         *_numbers(rows.get(name)))
        for name in PARAMETERS if name in entries
    )  # fmt: skip
    pictures = tuple(
        drawing(prior_density(result, name), f"Prior of {PARAMETERS[name].description}") for name in result.names
    )
    return (
        say.table("laws", body, f"{1e3 * prior.reference:g}" if prior.stretched else ""),
        *prior_sources(result.study),
        Text(support(result.record["prior_support"])),
        Gallery("tiny", pictures, say("densities")),
    )


def _numbers(row: Mapping[Hashable, Any] | None) -> tuple[Cell, ...]:
    if row is None:
        return ("", "", "", "")
    middle, ends = estimate(row["prior_median"], row["prior_hdi90_lo"], row["prior_hdi90_hi"])
    return (middle, *moments(row["prior_mean"], row["prior_sd"]), ends)


def _predictive_section(result: PriorResult) -> Blocks:
    if line := failed(result.record, "curves"):
        return (Text(line, "bad"), _rows(result))
    channels = [str(name) for name in result.draws["curves"]["outcome"].to_numpy()]
    galleries = []
    for wheel in result.study.wheels:
        pictures = tuple(
            drawing(prior_bands(result, n, wheel=wheel), f"{CHANNELS[n].description}, wheel {wheel}") for n in channels
        )
        galleries.append(Gallery("small", pictures, say("bands", wheel)))
    return (*galleries, _rows(result))


def _rows(result: PriorResult) -> Table:
    body = []
    for row in result.predictive.to_dict("records"):
        what = (str(row["row"]), row["wheel"], f"{row['slip']:.4g}", with_unit(row["channel"]))
        body.append((*what, *estimate(row["q50"], row["q05"], row["q95"]), share(row["no_answer"])))
    return say.table("rows", body)


def _derived_section(result: PriorResult) -> Blocks:
    rows = {row["parameter"]: row for row in result.summary.to_dict("records") if row["parameter"] in DERIVED}
    body = tuple(
        (symbol(name), angles(DERIVED[name].description), unit(name) or NOTHING, *_numbers(row))
        for name, row in rows.items()
    )
    return (say.table("derived", body),)


BINS = 40


@styled
def prior_density(result: PriorResult, name: str, ax: Axes | None = None) -> Axes:
    """Draw one parameter's prior: grey what physics leaves of it, line the law as stated, where it is about that."""
    ax = own_axes(ax, 2.6, 1.7)
    values = result.column(name)
    ax.hist(values, bins=BINS, density=True, color=PRIOR, alpha=0.55, linewidth=0)
    grid = np.linspace(values.min(), values.max(), 200)
    scale = PARAMETERS[name].scale
    if not (result.study.prior.stretched and name in MODULI):
        stated = np.exp(result.study.prior.laws[name].log_density(grid * scale)) * scale
        ax.plot(grid, stated, color=INK, linewidth=1.0)
    ax.set(xlabel=label(PARAMETERS[name]), yticks=[], ylim=(0, None))
    ax.spines["left"].set_visible(False)
    return ax


@styled
def prior_bands(result: PriorResult, channel: str, ax: Axes | None = None, *, wheel: str | None = None) -> Axes:
    """Draw what the prior predicts for one channel of one wheel over slip.

    Dark and pale: 50 and 90 % of the modelled values; broken lines: 90 % of readings, noise included; line:
    median; ticks: slips of the table.
    """
    ax = own_axes(ax)
    wheel = wheel or next(iter(result.study.wheels))
    curves = result.draws["curves"].sel(wheel=wheel)
    slip = curves["slip"].to_numpy()
    bands, noisy = (
        field_values(channel, curves[kind].sel(outcome=channel).to_numpy()) for kind in ("modelled", "readings")
    )
    fan(ax, slip, bands, PRIOR, (0.25, 0.45))
    ax.plot(slip, bands[2], color=INK)
    for edge in noisy[[0, 4]]:
        ax.plot(slip, edge, color=INK, linewidth=0.8, dashes=(4, 3))
    rows = result.study.observations
    mine = np.array([name == wheel for name in rows.wheel]) & rows.use
    ax.plot(rows.slip[mine], np.zeros(mine.sum()), "|", color=INK, transform=ax.get_xaxis_transform())
    ax.set(xlabel="slip ratio $s$ [–]", ylabel=label(CHANNELS[channel]))
    return ax


def prior_overview(result: PriorResult) -> Overview:
    """What physics leaves of the prior, quantity by quantity."""
    rows = []
    for row in result.summary.to_dict("records"):
        ends = row["prior_hdi90_lo"], row["prior_hdi90_hi"]
        rows.append((row["parameter"], row["unit"], *estimate(row["prior_median"], *ends)))
    share = result.record["prior_support"]["shares"]["inside the support"]
    return (
        Table(result.study.title, "llrr", ("quantity", "unit", "prior median", "90 % HDI"), tuple(rows)),
        Text(f"Prior only, no readings used: physics leaves {100 * share:.3g} % of it."),
        *failure_lines(result.record),
    )
