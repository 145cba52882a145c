"""Readings against what the model says: bands over slip, and residuals."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from bayesterra import adequacy
from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.figures.style import DATA, INK, MARKS, POSTERIOR, PRIOR, label, one_of, own_axes, styled
from bayesterra.parameters import CHANNELS
from bayesterra.results import Result, field_values


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
    for low, high, alpha in ((0, 4, 0.18), (1, 3, 0.32)):
        ax.fill_between(slip, bands[low], bands[high], color=POSTERIOR, alpha=alpha, linewidth=0)
    ax.plot(slip, bands[2], color=POSTERIOR)
    at = result.draws["curves"]["outcome"].to_numpy().tolist().index(channel)
    for method, values in adequacy.method_curves(result, wheel).items():
        mark = MARKS[method]
        ax.plot(
            slip, field_values(channel, values[:, at]), color=mark.colour, dashes=mark.dashes, linewidth=1.2
        )
    shown = _readings(ax, result, channel, wheel)
    _limit(ax, np.concatenate([bands[[0, 4]].ravel(), shown]))
    ax.set(xlabel="slip ratio $s$ [–]", ylabel=label(CHANNELS[channel]))
    return ax


def _readings(ax: Axes, result: Result, channel: str, wheel: str) -> FloatArray:
    """Draw the readings of a wheel; returns all values that must stay in view."""
    if channel not in result.study.noise:
        return np.empty(0)
    rows = result.study.observations
    mine = np.array([name == wheel for name in rows.wheel])
    values, sd = field_values(channel, rows.values[channel]), field_values(channel, _noise(result, channel))
    for use, face in ((True, DATA), (False, "white")):
        chosen: BoolArray = mine & (rows.use == use)
        ax.errorbar(
            rows.slip[chosen], values[chosen], yerr=sd[chosen], fmt="o", color=DATA, markerfacecolor=face,
            markersize=4, elinewidth=0.9, zorder=6,
        )  # fmt: skip
    return np.concatenate([(values - sd)[mine], (values + sd)[mine]])


def _noise(result: Result, channel: str) -> FloatArray:
    """Standard deviation of every row's reading, SI; of estimated noise the posterior median."""
    rows, noise = result.study.observations, result.study.noise[channel]
    given = rows.given_sd.get(channel, np.full(len(rows), np.nan))
    estimated = None
    if noise.parameter:
        estimated = np.full(1, np.median(result.values()[:, result.names.index(noise.parameter)]))
    return np.asarray(noise.scale(rows.values[channel][None], estimated, given)[0])


def _limit(ax: Axes, values: FloatArray) -> None:
    """Keep bands and readings in view; curves of estimates far away may leave it."""
    known = values[np.isfinite(values)]
    low, high = known.min(), known.max()
    ax.set_ylim(low - 0.12 * (high - low), high + 0.12 * (high - low))


@styled
def residuals(result: Result, channel: str, ax: Axes | None = None) -> Axes:
    """Draw the standardised residuals of one channel over slip: (reading − model) / noise.

    Bars: 90 % of the posterior draws, dot: their mean. Marks: least-squares estimates, hollow at the edge
    where they are farther out, beside their row's slip. Grey: ± 2.
    """
    ax = own_axes(ax)
    column = list(result.study.noise).index(one_of("channel", channel, result.study.noise))
    slip = result.study.observations.used().slip
    z = adequacy.residuals(result)[:, :, column]
    methods = {name: values[:, column] for name, values in adequacy.method_residuals(result).items()}
    low, high = np.quantile(z, [0.05, 0.95], axis=0)
    reach = _reach([low, high, *methods.values()])
    ax.axhspan(-2, 2, color=PRIOR, alpha=0.15, linewidth=0)
    ax.axhline(0, color=INK, linewidth=0.7)
    ax.vlines(slip, low, high, color=POSTERIOR, linewidth=4, alpha=0.45)
    ax.plot(slip, z.mean(axis=0), "o", color=POSTERIOR, markersize=5)
    step = 0.014 * float(np.ptp(slip) or 1.0)
    for place, (name, values) in enumerate(methods.items(), start=1):
        _marks(ax, name, slip + place * step, values, reach)
    ax.set(xlabel="slip ratio $s$ [–]", ylabel=f"residual of ${CHANNELS[channel].latex}$ [sd]")
    ax.set_ylim(-1.06 * reach, 1.06 * reach)
    return ax


def _reach(values: list[FloatArray]) -> float:
    """Half-height of the plot: everything up to eight standard deviations."""
    return float(np.clip(np.nanmax(np.abs(values)) + 0.3, 3.2, 8.0))


def _marks(ax: Axes, method: str, slip: FloatArray, values: FloatArray, reach: float) -> None:
    mark, far = MARKS[method], np.abs(values) > reach
    for chosen, face in ((~far, mark.colour), (far, "none")):
        held = np.clip(values[chosen], -reach, reach)
        ax.plot(
            slip[chosen], held, mark.marker, color=mark.colour, markerfacecolor=face, markersize=4.5,
            zorder=4, clip_on=False,
        )  # fmt: skip
