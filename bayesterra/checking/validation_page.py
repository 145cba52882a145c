"""Validation as blocks and figures of a report: predictive checks, cross-validation, model discrepancy."""

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.checking import predictive_checks, validation
from bayesterra.checking.levels import counts
from bayesterra.checking.loo import DRAWS, EFFECTIVE, EVEN, FEW_ROWS, INDISTINCT, CrossValidation
from bayesterra.checking.predictive_checks import ALARM, CONFLICT, DOUBT, PAIR, Check, PredictiveChecks, PriorCheck
from bayesterra.checking.validation import Missed, Stretch, Validation, fit_verdict, missed
from bayesterra.likelihood.page import estimated_noise
from bayesterra.parameters import CHANNELS, field_values
from bayesterra.report.blocks import Block, Blocks, Cell, Gallery, Table, Text, drawing
from bayesterra.report.figures import DATA, INK, MARKS, POSTERIOR, PRIOR, fan, label, limit_y, one_of, own_axes, styled
from bayesterra.report.numbers import NOTHING, interval, number, plain, probability, resolution, rounded
from bayesterra.report.sections import Prose, Section
from bayesterra.report.symbols import amount, listed, symbol, unit
from bayesterra.report.verdicts import failed
from bayesterra.stats.diagnostics import calibrated, ecdf_band
from bayesterra.stats.mixture import pareto_limit
from bayesterra.study.result import Result

say = Prose("validation")

PRIOR_WORDS = {"mean": "mean", "slope": "slope over slip", "largest": "largest reading"}


def posterior_checks(result: Result) -> Blocks:
    """The alarm, and every statistic of every channel."""
    checks = Validation.from_record(result.record).checks
    if checks is None:
        return (Text(failed(result.record, "predictive_checks"), "bad"),)
    verdict = fit_verdict(checks)
    return Text(verdict.html, verdict.grade if checks.alarm else ""), _statistics(result, checks)


def misfit_warning(words: Markup, check: str, then: str) -> Markup:
    """Warning that opens a page where the model cannot make readings like these."""
    return say("misfit_warning", words, check, then)


def _statistics(result: Result, checks: PredictiveChecks) -> Table:
    cells = {(check.channel, check.statistic): check for check in checks.checks}
    channels = list(result.study.noise)
    rows = tuple(
        (statistic.words, *(_cell(cells.get((channel, name))) for channel in channels))
        for name, statistic in predictive_checks.TEST_STATISTICS.items()
        if any((channel, name) in cells for channel in channels)
    )
    noise, heads = estimated_noise(result.study), map(symbol, channels)
    return say.table("statistics", rows, checks.replicates, PAIR, DOUBT, ALARM, noise, more=heads)


def _cell(check: Check | None) -> Cell:
    if check is None:
        return NOTHING
    text = Markup("<b>{}</b>") if check.calibrated < PAIR else Markup("{}")
    return Markup("{} ({})").format(text.format(probability(check.calibrated)), probability(check.p))


def prior_predictive(result: Result) -> Block:
    """The readings under the prior alone."""
    checks = Validation.from_record(result.record).prior
    if checks is None:
        return Text(failed(result.record, "prior_checks", "prior_predictive"), "bad")
    judged = any(check.channel == "normal_force" for check in checks.checks)
    rows, loads = map(_prior_row, checks.checks), result.study.drive.latent_load
    return say.table("prior_predictive", rows, checks, probability(checks.overall), CONFLICT, loads and not judged)


def _prior_row(check: PriorCheck) -> tuple[Cell, ...]:
    scale = CHANNELS[check.channel].scale
    low, high, value = check.low / scale, check.high / scale, check.value / scale
    step = resolution(low, high)
    per = Markup("{}{}").format(unit(check.channel), " per unit slip" if check.statistic == "slope" else "")
    ends = interval(low, high, step)
    return (symbol(check.channel), PRIOR_WORDS[check.statistic], per, rounded(value, step / 10), ends,
            probability(check.p))  # fmt: skip


def cross_validation_section(result: Result) -> Blocks:
    """Every row predicted by the others."""
    loo = CrossValidation.from_record(result.record["loo"])
    figures = (rounded(value, 0.1) for value in (loo.elpd, loo.se, loo.effective_parameters))
    total = say("cross_validation", len(loo.rows), INDISTINCT, *figures)
    return (*_levels(result), Text(total), _rows(result, loo), *_pit(result, loo))


def _levels(result: Result) -> tuple[Table, ...]:
    """Readings of whole levels, predicted by a fit to the others."""
    found = counts(Validation.from_record(result.record).levels or (), result.study.model.name)
    rows = tuple(
        (count.by, symbol(count.channel), f"{count.inside} of {count.readings}", str(count.levels),
         probability(count.few), plain(count.crps), plain(count.curve), unit(count.channel))
        for count in found
    )  # fmt: skip
    return (say.table("levels", rows),) if rows else ()


def _rows(result: Result, loo: CrossValidation) -> Table:
    slips = dict(zip(result.study.observations.rows, result.study.observations.slip, strict=True))
    rows = tuple(
        (str(row.row), f"{slips[row.row]:.4g}", rounded(row.elpd, 0.01), plain(row.error, 1),
         rounded(before - row.elpd, 0.01), f"{row.k:.2f}", "new sampling" if row.refitted else "weights")
        for row, before in zip(loo.rows, loo.full, strict=True)
    )  # fmt: skip
    return say.table("rows", rows, pareto_limit(DRAWS), FEW_ROWS, EVEN, EFFECTIVE)


def _pit(result: Result, loo: CrossValidation) -> Blocks:
    if not loo.pit:
        return ()
    pictures = tuple(drawing(loo_pit(result, name), f"LOO-PIT of {CHANNELS[name].description}") for name in loo.pit)
    outside = [name for name, values in loo.pit.items() if not calibrated(values)]
    return (Gallery("small", pictures, say("pit", outside)),)


MANY = 100
"""Rows above which marks are small, and dots in a drawing."""


@styled
def loo_pit(result: Result, channel: str, ax: Axes | None = None) -> Axes:
    """Draw the distribution of one channel's LOO-PIT values less the uniform one.

    A LOO-PIT value is the probability of a reading below the measured one, predicted by the other rows. Grey:
    where the whole curve lies with probability 0.95 if the predictions are right.
    """
    ax = own_axes(ax)
    pit = CrossValidation.from_record(result.record["loo"]).pit[channel]
    values = np.sort([p for p in pit if np.isfinite(p)])
    low, high = ecdf_band(len(values))
    points = np.arange(1, len(low) + 1) / len(low)
    share = np.searchsorted(values, points, side="right") / len(values)
    ax.fill_between(points, low - points, high - points, color=PRIOR, alpha=0.25, linewidth=0, step="mid")
    ax.axhline(0, color=INK, linewidth=0.7)
    ax.plot(points, share - points, color=POSTERIOR, drawstyle="steps-mid")
    ax.set(xlabel=f"LOO-PIT of ${CHANNELS[channel].latex}$", ylabel="share below − uniform")
    return ax


@styled
def predictive(result: Result, channel: str, ax: Axes | None = None, *, wheel: str | None = None) -> Axes:
    """Draw one channel of one wheel over slip: readings, predictive bands, least-squares curves.

    Parameters
    ----------
    channel : an outcome of the study's drive, measured or not.
    wheel : its name; the study's first one by default.

    Bands hold 50 and 90 % of new readings (noise included), or of the modelled values where the channel was
    not measured; line: median. Error bars: one standard deviation of noise; hollow rows are not in the fit.
    """
    ax = own_axes(ax)
    wheel = one_of("wheel", wheel or next(iter(result.study.wheels)), result.study.wheels)
    one_of("channel", channel, result.draws["curves"]["outcome"].to_numpy().tolist())
    curves = result.draws["curves"].sel(wheel=wheel)
    slip = curves["slip"].to_numpy()
    kind = "readings" if channel in result.study.noise else "modelled"
    bands = field_values(channel, curves[kind].sel(outcome=channel).to_numpy())
    fan(ax, slip, bands, POSTERIOR, (0.18, 0.32))
    ax.plot(slip, bands[2], color=POSTERIOR)
    for method, outcomes in validation.method_curves(result, wheel).items():
        mark = MARKS[method]
        values = field_values(channel, outcomes[channel][0])
        ax.plot(slip, values, color=mark.colour, dashes=mark.dashes, linewidth=1.2)
    shown = _readings(ax, result, channel, wheel)
    # curves of estimates far away may leave the view
    seen = np.concatenate([bands[[0, 4]].ravel(), shown])
    seen = seen[np.isfinite(seen)]
    limit_y(ax, seen.min(), seen.max(), 0.12)
    ax.set(xlabel="slip ratio $s$ [–]", ylabel=label(CHANNELS[channel]))
    return ax


def _readings(ax: Axes, result: Result, channel: str, wheel: str) -> FloatArray:
    """Draw the readings of a wheel; returns all values that must stay in view."""
    if channel not in result.study.noise:
        return np.empty(0)
    rows = result.study.observations
    mine = np.array([name == wheel for name in rows.wheel])
    values, sd = field_values(channel, rows.values[channel]), field_values(channel, _noise(result, channel))
    many = mine.sum() > MANY
    ax.set_rasterization_zorder(7 if many else None)
    for use, face in ((True, DATA), (False, "white")):
        chosen: BoolArray = mine & (rows.use == use)
        ax.errorbar(
            rows.slip[chosen], values[chosen], yerr=None if many else sd[chosen], fmt="o", color=DATA,
            markerfacecolor=face, markersize=1.0 if many else 4, elinewidth=0.9, zorder=1 if many else 6,
        )  # fmt: skip
    return np.concatenate([(values - sd)[mine], (values + sd)[mine]])


def _noise(result: Result, channel: str) -> FloatArray:
    """Standard deviation of every row's reading, SI; of estimated noise the posterior median."""
    rows, noise = result.study.observations, result.study.noise[channel]
    stated = rows.given_sd.get(channel, np.full(len(rows), np.nan))
    estimated = None
    if noise.parameter:
        estimated = np.full(1, np.median(result.values()[:, result.names.index(noise.parameter)]))
    return np.asarray(noise.scale(rows.values[channel][None], estimated, stated)[0])


@styled
def residuals(result: Result, channel: str, ax: Axes | None = None) -> Axes:
    """Draw the standardised residuals of one channel over slip: (reading − model) / noise.

    Bars: 90 % of the posterior draws, dot: their mean. Marks: least-squares estimates, hollow at the edge
    where they are farther out, beside their row's slip. Grey: ± 2.
    """
    ax = own_axes(ax)
    column = list(result.study.noise).index(one_of("channel", channel, result.study.noise))
    slip = result.study.observations.used().slip
    z = validation.residuals(result)[:, :, column]
    methods = {name: values[:, column] for name, values in validation.method_residuals(result).items()}
    low, high = np.quantile(z, [0.05, 0.95], axis=0)
    farthest = np.nanmax(np.abs([low, high, *methods.values()]))
    reach = float(np.clip(farthest + 0.3, 3.2, 8.0))  # all up to eight standard deviations
    ax.axhspan(-2, 2, color=PRIOR, alpha=0.15, linewidth=0)
    ax.axhline(0, color=INK, linewidth=0.7)
    many = len(slip) > MANY
    ax.set_rasterization_zorder(5 if many else None)
    ax.vlines(slip, low, high, color=POSTERIOR, linewidth=1 if many else 4, alpha=0.45, zorder=3)
    ax.plot(slip, z.mean(axis=0), "o", color=POSTERIOR, markersize=1.5 if many else 5, zorder=3)
    step = 0.014 * float(np.ptp(slip) or 1.0)
    for place, (name, values) in enumerate(methods.items(), start=1):
        _marks(ax, name, slip + (not many) * place * step, values, reach, many=many)
    ax.set(xlabel="slip ratio $s$ [–]", ylabel=f"residual of ${CHANNELS[channel].latex}$ [sd]")
    ax.set_ylim(-1.06 * reach, 1.06 * reach)
    return ax


def _marks(ax: Axes, method: str, slip: FloatArray, values: FloatArray, reach: float, *, many: bool) -> None:
    mark, far = MARKS[method], np.abs(values) > reach
    for chosen, face in ((~far, mark.colour), (far, "none")):
        held = np.clip(values[chosen], -reach, reach)
        ax.plot(
            slip[chosen], held, mark.marker, color=mark.colour, markerfacecolor=face,
            markersize=1.5 if many else 4.5, zorder=2 if many else 4, clip_on=False,
        )  # fmt: skip


def missed_sections(result: Result) -> tuple[Section, ...]:
    """A section where the study states a discrepancy, else none."""
    curves = list(missed(result))
    if not curves:
        return ()
    several = len(result.study.wheels) > 1
    blocks: list[Block] = [Text(_sentence(result, curve, several=several)) for curve in curves]
    pictures = tuple(
        drawing(discrepancy(curve), f"Error of the {CHANNELS[curve.channel].description} over slip") for curve in curves
    )
    wheels = dict.fromkeys(curve.wheel for curve in curves)
    blocks.append(Gallery("small", pictures, say("missed", ", ".join(wheels) if several else "")))
    blocks += [*_trades(curves, several=several), Text(say("missed_use", listed(result.study.wheels)))]
    return (Section("missed", "What the model misses", tuple(blocks)),)


def _sentence(result: Result, curve: Missed, *, several: bool) -> Markup:
    """Sentence on where the model is too low or too high, and by how much."""
    of = Markup(" of wheel {}").format(curve.wheel) if several else Markup("")
    head = Markup("{}’s {}{}").format(result.study.model.name, CHANNELS[curve.channel].description, of)
    if not curve.stretches:
        most = plain(float(np.abs(curve.bands[[0, -1]]).max()) / CHANNELS[curve.channel].scale, 2)
        return say("open_sign", head, amount(curve.channel, most))
    return Markup("{} is {}.").format(head, listed(_part(curve, stretch) for stretch in curve.stretches))


def _part(curve: Missed, stretch: Stretch) -> Markup:
    scale = CHANNELS[curve.channel].scale
    least, most = (plain(abs(value) / scale, 2) for value in (stretch.least, stretch.most))
    size = amount(curve.channel, most if least == most else f"{least} to {most}")
    return say("stretch", size, stretch, stretch.low <= curve.slip[0], stretch.high >= curve.slip[-1])


def _trades(curves: list[Missed], *, several: bool) -> tuple[Text, ...]:
    """Text on shapes where discrepancy and parameters cannot be told apart."""
    shares = [
        say("trade", trade, curve.channel, curve.wheel if several else "", number(trade.correlation, 2))
        for curve in curves
        for trade in curve.trades
    ]
    return (Text(say("trades", shares), "bad"),) if shares else ()


@styled
def discrepancy(curve: Missed, ax: Axes | None = None) -> Axes:
    """Draw a discrepancy over slip: bands of 50 and 90 %, median, and reading less model as dots."""
    ax, channel = own_axes(ax), CHANNELS[curve.channel]
    bands = field_values(curve.channel, curve.bands)
    fan(ax, curve.slip, bands, POSTERIOR, (0.18, 0.32))
    ax.axhline(0, color=INK, linewidth=0.7)
    ax.plot(curve.slip, bands[2], color=POSTERIOR)
    residuals = field_values(curve.channel, curve.residuals)
    ax.plot(curve.rows, residuals, "o", color=DATA, markersize=4)
    shown = np.concatenate([bands.ravel(), residuals, [0.0]])
    margin = 0.08 * float(np.ptp(shown))
    ax.set_ylim(shown.min() - margin, shown.max() + margin)
    ax.set(xlabel="slip ratio $s$ [–]", ylabel=rf"$\delta_{{{channel.latex}}}$ [{channel.unit}]")
    return ax
