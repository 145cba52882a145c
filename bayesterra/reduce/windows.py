"""Windows of drives: stretches under one commanded state, from where all channels are steady to the end."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.errors import StudyError
from bayesterra.parameters import OUTCOMES
from bayesterra.reduce.log import LOGGED, Log
from bayesterra.stats.diagnostics import STATIONARY, error_of_mean, level_stationarity

FEWEST_BLOCKS = 8
"""Periods, at least, of a window: fewer tell no error of their mean."""
FINE = 400
"""Parts of a log in which changes of speed are looked for, at most."""
STEP = 0.02
"""Least change of a speed, as a share of the fastest, that is a new state."""
SAMPLES = 5
"""Samples, at least, of a block."""
SHORTEST = 0.04
"""Least length of a window, as a share of its log."""
CLEAR = 8.0
"""Standard errors, at least, of a step of speed."""
SLOPING = 2.5
"""Standard errors, at least, of a slope that is one."""
HANGING = 0.75
"""Error of a mean, as a share of the spread, beyond which values hang together too long to tell a level."""
SETTLING = 4.0
"""Spreads of the second half, at least, by which a beginning that still settles is away from it."""
MOST_SLIP = 1.05
"""Slip, either way, beyond which it is none; a locked wheel is at −1 but for noise."""
ANY_DRIFT = 1e9
"""Share of the mean by which nothing drifts."""
RESOLVED = 1e-6
"""Resolution of a channel that never changes, as a share of its value."""
SPEEDS = ("travel_speed", "rim_speed")
FORCES = ("load", "normal_force", "drawbar_pull")


@dataclass(frozen=True)
class Settings:
    """What the reduction of a drive needs beside its log."""

    radius: float | None = None  # of the wheel, m: behind ``rim_speed``, or for ``wheel_speed``; None where not needed
    lugs: int = 0  # number; the period of the ripple is that of their passing
    steady: float = 0.02  # drift that is taken for steady, as a share of the mean (of forces: of the largest force)


@dataclass(frozen=True)
class Window:
    """A stretch of a drive under one commanded state."""

    log: str  # name of the log
    start: float  # s
    end: float  # s
    rejected: str = ""  # why it gives no row; empty: it gives one
    blocks: int = 0  # number of periods that its means are of
    period: float = np.nan  # s, of the ripple; NaN: none is known, blocks are of equal times
    mean: Mapping[str, float] = field(default_factory=dict)  # by channel, SI
    sd: Mapping[str, float] = field(default_factory=dict)  # its standard error


def windows_of(log: Log, settings: Settings) -> tuple[Window, ...]:
    """Windows of a drive, one for each commanded state, with rows or with the reason why not.

    StudyError where a channel or the wheel's radius is missing.
    """
    series = drive_series(log, settings)
    time = log.values["time"]
    commanded = [name for name in ("travel_speed", "rim_speed", "slip", "load") if name in series]
    states = _states(np.array([_filled(series[name]) for name in commanded]))
    fastest = max(float(np.nanmax(np.abs(series[name]))) for name in commanded[:2])
    windows = []
    for first, end in states:
        window = _window(log.name, time, series, slice(first, end), fastest, settings)
        state = Window(log.name, float(time[first]), float(time[end - 1]))
        if not window.rejected and window.start > state.start:  # what of a commanded state was not steady yet
            why = "settling: not steady together with what follows"
            windows.append(replace(state, end=window.start, rejected=why))
        windows.append(window)
    for i in range(len(windows) - 1, 0, -1):  # starts and stops are told in one line
        before, this = windows[i - 1], windows[i]
        if this.rejected and this.rejected == before.rejected:
            windows[i - 1 : i + 1] = [replace(before, end=this.end)]
    return tuple(windows)


def window_at(log: Log, settings: Settings, start: float, end: float) -> Window:
    """The window between two times (s) that a person chose: as it is, with what it drifts by in its standard errors."""
    series, time = drive_series(log, settings), log.values["time"]
    fastest = max(float(np.nanmax(np.abs(series[name]))) for name in (*SPEEDS, "slip") if name in series)
    stretch = slice(int(np.searchsorted(time, start)), int(np.searchsorted(time, end, "right")))
    if stretch.stop - stretch.start < SAMPLES:
        return Window(log.name, start, end, f"too short: {max(stretch.stop - stretch.start, 0)} samples")
    return _window(log.name, time, series, stretch, fastest, replace(settings, steady=ANY_DRIFT))


def drive_series(log: Log, settings: Settings) -> dict[str, FloatArray]:
    """Channels of a drive that rows are made of: speeds, of the rim at the wheel's radius, and outcomes."""
    values = log.values
    if "time" not in values or len(np.unique(values["time"])) < 2:
        raise StudyError("column 'time [s]' is missing: a drive is a series over time")
    series = {name: values[name] for name in ("slip", "load", *OUTCOMES) if name in values}
    if "slip" in series:
        return series
    if "travel_speed" in values:
        series["travel_speed"] = values["travel_speed"]
    elif "position" in values:
        there = ~np.isnan(values["position"])
        times, first, back = np.unique(values["time"][there], return_index=True, return_inverse=True)
        if len(times) < 2:
            raise StudyError("'position' has readings at one time only: a drive needs its speed")
        series["travel_speed"] = np.full(len(there), np.nan)
        series["travel_speed"][there] = np.gradient(values["position"][there][first], times)[back]
    if "rim_speed" in values:
        series["rim_speed"] = values["rim_speed"]
    elif "wheel_speed" in values:
        if settings.radius is None:
            raise StudyError("'wheel_speed' needs the radius that slip is to be on: --radius \"58 mm\"")
        series["rim_speed"] = values["wheel_speed"] * settings.radius
    for name, others in (("travel_speed", "or 'position [m]'"), ("rim_speed", "or 'wheel_speed [rad/s]'")):
        if name not in series:
            raise StudyError(f"column '{name} [m/s]' {others} is missing or empty: a drive needs it for its slip, (3)")
    return series


def _filled(column: FloatArray) -> FloatArray:
    """The column with its gaps bridged."""
    there = ~np.isnan(column)
    if not there.any():
        raise StudyError("a speed, slip or load has no reading at all")
    return np.interp(np.arange(len(column)), np.flatnonzero(there), column[there])


def _states(commanded: FloatArray) -> list[tuple[int, int]]:
    """First sample and end of every stretch over which no commanded channel (c, m) steps."""
    edges = np.linspace(0, commanded.shape[1], min(FINE, commanded.shape[1] // SAMPLES) + 1).astype(int)
    means = np.array([np.median(commanded[:, first:end], axis=1) for first, end in pairwise(edges)]).T  # minds spikes
    noise = 1.4826 * np.median(np.abs(np.diff(means)), axis=1) / np.sqrt(2)
    fastest = np.array([*[np.abs(means[:2]).max()] * min(2, len(means)), *np.abs(means[2:]).max(axis=1)])
    cuts, open_pieces = [0, means.shape[1]], [(0, means.shape[1])]
    while open_pieces:
        first, end = open_pieces.pop()
        cut = _step(means[:, first:end], np.maximum(noise, 1e-3 * fastest), STEP * fastest)
        if cut:
            cuts.append(first + cut)
            open_pieces += [(first, first + cut), (first + cut, end)]
    cuts = sorted(cuts)
    for i in range(len(cuts) - 2, 0, -1):  # a first cut may have become needless by later ones
        left, right = (means[:, cuts[j] : cuts[j + 1]].mean(axis=1) for j in (i - 1, i))
        if (np.abs(left - right) <= STEP * fastest).all():
            del cuts[i]
    return [(int(edges[first]), int(edges[end])) for first, end in pairwise(cuts)]


def _step(means: FloatArray, noise: FloatArray, least: FloatArray, shortest: int = 3) -> int:
    """Where the clearest step of some channel (c, n) is; 0 where none is beyond noise and least step."""
    n = means.shape[1]
    k = np.arange(shortest, n - shortest + 1)
    if not k.size:
        return 0
    sums = np.cumsum(means, axis=1)
    left, right = sums[:, k - 1] / k, (sums[:, -1:] - sums[:, k - 1]) / (n - k)
    size = np.abs(left - right)
    clear = size * np.sqrt(k * (n - k) / n) / noise[:, None]
    clear[size <= least[:, None]] = 0.0
    return int(k[clear.max(axis=0).argmax()]) if clear.max() > CLEAR else 0


def _window(
    name: str, time: FloatArray, series: Mapping[str, FloatArray], state: slice, fastest: float, settings: Settings
) -> Window:
    """The window of one commanded state: from where all channels are steady to its end."""
    clock = time[state]
    own = {channel: column[state] for channel, column in series.items() if not np.isnan(column[state]).all()}
    whole = Window(name, float(clock[0]), float(clock[-1]))
    speeds = [float(np.nanmean(own[channel])) for channel in SPEEDS if channel in own]
    if speeds and max(map(abs, speeds)) < STEP * fastest:
        return replace(whole, rejected="wheel and carriage stand still")
    if whole.end - whole.start < SHORTEST * (time[-1] - time[0]):
        return replace(whole, rejected=f"too short: speeds change again before {SHORTEST:.0%} of the log are over")
    index, blocks, period = _blocks(clock, own.get("rim_speed"), settings)
    if blocks < FEWEST_BLOCKS:
        each = f"passing lugs, {period:.2g} s each" if period > 0 else f"blocks of {SAMPLES} samples"
        return replace(whole, rejected=f"too short: {blocks} {each}, and {FEWEST_BLOCKS} are needed", period=period)
    means = {channel: _block_means(column, index, blocks) for channel, column in own.items()}
    first, why = _steady_from(means, settings.steady)
    if why:
        return replace(whole, rejected=why, period=period)
    start, end = (float(clock[min(int(np.searchsorted(index, block)), len(clock) - 1)]) for block in (first, blocks))
    samples = {channel: column[(index >= first) & (index < blocks)] for channel, column in own.items()}
    mean, sd = _moments({channel: values[first:] for channel, values in means.items()}, samples)
    turned = "" if abs(mean["slip"]) < MOST_SLIP else f"slip {mean['slip']:.3g}: wheel and carriage go opposite ways"
    return Window(name, start, end, turned, blocks - first, period, mean, sd)


def _blocks(clock: FloatArray, rim_speed: FloatArray | None, settings: Settings) -> tuple[IntArray, int, float]:
    """Block of every sample (a turn, the passing of lugs, or a fortieth), their number, and the lugs' period."""
    angle = np.zeros(len(clock))
    if rim_speed is not None and settings.lugs and settings.radius:
        rate = _filled(rim_speed) * settings.lugs / (2 * np.pi * settings.radius)
        angle[1:] = np.maximum.accumulate(np.abs(np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(clock))))
    if (passed := float(angle[-1])) >= 1:
        few = int(np.ceil(SAMPLES * passed / len(clock)))
        step = settings.lugs if passed >= FEWEST_BLOCKS * settings.lugs else few
        return (angle / step).astype(np.int64), int(passed / step), float(clock[-1] - clock[0]) / passed
    number = min(40, len(clock) // SAMPLES)
    span = float(clock[-1] - clock[0]) * (1 + 1e-9) or 1.0
    return (number * (clock - clock[0]) / span).astype(np.int64), number, np.nan


def _block_means(samples: FloatArray, index: IntArray, blocks: int) -> FloatArray:
    """Means of the samples that are there by block, NaN in a block without any."""
    there = ~np.isnan(samples) & (index < blocks)
    count = np.bincount(index[there], minlength=blocks)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.bincount(index[there], samples[there], minlength=blocks) / count)


def _steady_from(means: Mapping[str, FloatArray], steady: float) -> tuple[int, str]:
    """The first block from which all channels are steady to the end; or what is never, in words."""
    blocks = len(next(iter(means.values())))
    unsteady = ""
    for first in np.unique(np.linspace(0, blocks - FEWEST_BLOCKS, 40).astype(int)):
        kept = {name: values[first:] for name, values in means.items()}
        unsteady = next((name for name in kept if not _is_steady(name, kept, steady)), "")
        if not unsteady:
            return int(first), ""
    channel, values = LOGGED[unsteady], means[unsteady][~np.isnan(means[unsteady])][-FEWEST_BLOCKS:]
    if len(values) < FEWEST_BLOCKS:
        return 0, f"{channel.description} has readings in {len(values)} periods, and {FEWEST_BLOCKS} are needed"
    change = f"{abs(_drift(values)[0]) / channel.scale:.2g} {channel.unit}"
    return 0, f"{channel.description} is not steady up to the end: it changes by {change} over its last periods"


def _is_steady(name: str, means: Mapping[str, FloatArray], steady: float) -> bool:
    values = means[name][~np.isnan(means[name])]
    if len(values) < FEWEST_BLOCKS:
        return False
    tolerated, (drift, shown) = steady * _scale(name, means), _drift(values)
    early, late = values[: len(values) // FEWEST_BLOCKS].mean(), values[len(values) // 2 :]
    settling = abs(early - late.mean()) > max(tolerated, SETTLING * float(late.std(ddof=1)))
    return not settling and (not shown or abs(drift) <= tolerated)


def _drift(values: FloatArray) -> tuple[float, bool]:
    """Change along the fitted line from the first value to the last; whether the values show that they change."""
    places = np.arange(len(values)) - (len(values) - 1) / 2
    slope = float(places @ values / (places @ places))
    centred = values - values.mean()
    rest = centred - slope * places
    sloping = abs(slope) * len(values) > SLOPING * np.sqrt(12) * error_of_mean(rest)
    mostly = rest @ rest < 0.5 * (centred @ centred)
    spread = float(np.sqrt(centred @ centred / (len(values) - 1)))
    bound = error_of_mean(values) > HANGING * spread
    return slope * len(values), bool(sloping or mostly or bound or level_stationarity(values) > STATIONARY)


def _scale(name: str, means: Mapping[str, FloatArray]) -> float:
    """What a drift of a channel is measured by: its mean; of speeds and forces the largest mean of them."""
    alike = next((group for group in (SPEEDS, FORCES) if name in group), (name,))
    return max(abs(float(np.nanmean(means[each]))) for each in alike if each in means)


def _moments(
    means: Mapping[str, FloatArray], samples: Mapping[str, FloatArray]
) -> tuple[dict[str, float], dict[str, float]]:
    """Means of a window and standard errors: of the blocks, with what they drift by, and of the resolution."""
    mean = {name: float(np.nanmean(values)) for name, values in means.items()}
    sd = {}
    for name, values in means.items():
        there = values[~np.isnan(values)]
        error = float(np.std(there, ddof=1)) if _drift(there)[1] else error_of_mean(there)
        steps = np.diff(np.unique(samples[name][~np.isnan(samples[name])]))
        resolution = float(steps.min()) if steps.size else RESOLVED * abs(mean[name])
        sd[name] = float(np.hypot(error, resolution / np.sqrt(12))) or np.nan  # a channel of zeros tells none
    if "slip" not in mean:
        mean["slip"], (by_travel, by_rim) = slip_of(mean["travel_speed"], mean["rim_speed"])
        both = by_travel * means["travel_speed"] + by_rim * means["rim_speed"]
        sd["slip"] = error_of_mean(both[~np.isnan(both)])
    return mean, sd


def slip_of(travel: float, rim: float) -> tuple[float, tuple[float, float]]:
    """Slip ratio by (3) from the speeds of travel and of the rim, forwards or backwards; its derivatives by both."""
    if abs(rim) >= abs(travel):
        return 1 - travel / rim, (-1 / rim, travel / rim**2)
    return rim / travel - 1, (-rim / travel**2, 1 / travel)
