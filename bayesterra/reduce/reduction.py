"""Reduction of logs: steady windows of drives become rows, loading branches of plate tests become readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, get_args

import numpy as np
import pandas as pd

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.errors import ResultError, StudyError, counted, errors_in, known
from bayesterra.parameters import OUTCOMES
from bayesterra.reduce.log import LOGGED, Kind, Log, read_log
from bayesterra.runtime.folders import write_new_files
from bayesterra.runtime.tables import Record, csv_text
from bayesterra.stats.diagnostics import STATIONARY, error_of_mean, level_stationarity
from bayesterra.study.result import AnalysisResult
from bayesterra.study.units import quantity

FEWEST = 20
"""Samples in air, at least, that tell the zero of a plate's force."""
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
RESOLVED = 1e-6
"""Resolution of a channel that never changes, as a share of its value."""
SPEEDS = ("travel_speed", "rim_speed")
FORCES = ("load", "normal_force", "drawbar_pull")


@dataclass(frozen=True)
class Settings:
    """What a reduction needs beside the logs.

    Attributes
    ----------
    radius : m, of the wheel: behind ``rim_speed``, or for ``wheel_speed``; None where neither is needed.
    lugs : number; the period of the ripple is that of their passing.
    plate : diameter of the plate, m.
    steady : drift that is taken for steady, as a share of the mean (of forces: of the largest force).
    """

    radius: float | None = None
    lugs: int = 0
    plate: float | None = None
    steady: float = 0.02


@dataclass(frozen=True)
class Window:
    """A stretch of a drive under one commanded state.

    Attributes
    ----------
    log : name of the log.
    start, end : s.
    rejected : why it gives no row; empty: it gives one.
    blocks : number of periods that its means are of.
    period : s, of the ripple; NaN: none is known, blocks are of equal times.
    mean, sd : by channel, SI: mean, and its standard error.
    """

    log: str
    start: float
    end: float
    rejected: str = ""
    blocks: int = 0
    period: float = np.nan
    mean: Mapping[str, float] = field(default_factory=dict)
    sd: Mapping[str, float] = field(default_factory=dict)


def windows_of(log: Log, settings: Settings) -> tuple[Window, ...]:
    """Windows of a drive, one for each commanded state, with rows or with the reason why not.

    Raises
    ------
    StudyError : a channel or the wheel's radius is missing.
    """
    series = drive_series(log, settings)
    time = log.values["time"]
    commanded = [name for name in ("travel_speed", "rim_speed", "slip", "load") if name in series]
    states = _states(np.array([_filled(series[name]) for name in commanded]))
    fastest = max(float(np.nanmax(np.abs(series[name]))) for name in commanded[:2])
    windows = []
    for first, end in states:
        window = _window(log.name, time, series, slice(first, end), fastest, settings)
        windows += _settled(window, Window(log.name, float(time[first]), float(time[end - 1])))
    for i in range(len(windows) - 1, 0, -1):  # starts and stops are told in one line
        before, this = windows[i - 1], windows[i]
        if this.rejected and this.rejected == before.rejected:
            windows[i - 1 : i + 1] = [replace(before, end=this.end)]
    return tuple(windows)


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
        series["travel_speed"] = np.gradient(values["position"], values["time"])
    if "rim_speed" in values:
        series["rim_speed"] = values["rim_speed"]
    elif "wheel_speed" in values:
        if settings.radius is None:
            raise StudyError("'wheel_speed' needs the radius that slip is to be on: --radius \"58 mm\"")
        series["rim_speed"] = values["wheel_speed"] * settings.radius
    for name, others in (("travel_speed", "or 'position [m]'"), ("rim_speed", "or 'wheel_speed [rad/s]'")):
        if name not in series:
            raise StudyError(f"column '{name} [m/s]' {others} is missing: a drive needs it for its slip, (3)")
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


def _settled(window: Window, state: Window) -> list[Window]:
    """The window, and before it what of its commanded state was not steady yet."""
    if window.rejected or window.start <= state.start:
        return [window]
    return [replace(state, end=window.start, rejected="settling: not steady together with what follows"), window]


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
        return replace(whole, rejected=f"speeds change: none lasts {SHORTEST:.0%} of the log")
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
    return Window(name, start, end, "", blocks - first, period, mean, sd)


def _blocks(clock: FloatArray, rim_speed: FloatArray | None, settings: Settings) -> tuple[IntArray, int, float]:
    """Block of every sample, number of whole blocks, and the period of the lugs (s; NaN where none is known).

    A block is a turn of the wheel where there are enough of them, else the passing of a lug (or of a few), by
    the angle that the wheel has turned; without lugs that pass a fortieth of the time.
    """
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
    channel, values = LOGGED[unsteady], means[unsteady][-FEWEST_BLOCKS:]
    ends = " to ".join(f"{value / channel.scale:.4g}" for value in (values[:3].mean(), values[-3:].mean()))
    return 0, f"{channel.description} is not steady up to the end: {ends} {channel.unit} over the last blocks"


def _is_steady(name: str, means: Mapping[str, FloatArray], steady: float) -> bool:
    values = means[name][~np.isnan(means[name])]
    if len(values) < FEWEST_BLOCKS:
        return False
    drift, shown = _drift(values)
    return not shown or abs(drift) <= steady * _scale(name, means)


def _drift(values: FloatArray) -> tuple[float, bool]:
    """Change along the fitted line from the first value to the last; whether the values show that they change.

    They do where a test of a constant level fails at 5 %, or the line's slope is significant, or the line
    tells most of the variation, or there are too few values that do not hang together.
    """
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
    """Means of a window and their standard errors: of the blocks, and of the resolution.

    Where blocks drift, as far as that is tolerated, all of their variation counts as error.
    """
    mean = {name: float(np.nanmean(values)) for name, values in means.items()}
    sd = {}
    for name, values in means.items():
        there = values[~np.isnan(values)]
        error = float(np.std(there, ddof=1)) if _drift(there)[1] else error_of_mean(there)
        steps = np.diff(np.unique(samples[name][~np.isnan(samples[name])]))
        resolution = float(steps.min()) if steps.size else RESOLVED * abs(mean[name])
        sd[name] = float(np.hypot(error, resolution / np.sqrt(12)))
    if "slip" not in mean:
        mean["slip"], (by_travel, by_rim) = slip_of(mean["travel_speed"], mean["rim_speed"])
        sd["slip"] = error_of_mean(by_travel * means["travel_speed"] + by_rim * means["rim_speed"])
    return mean, sd


def slip_of(travel: float, rim: float) -> tuple[float, tuple[float, float]]:
    """Slip ratio by (3) from the speeds of travel and of the rim, and its derivatives by both."""
    if rim >= travel:
        return 1 - travel / rim, (-1 / rim, travel / rim**2)
    return rim / travel - 1, (-rim / travel**2, 1 / travel)


@dataclass(frozen=True)
class Branch:
    """Loading branch of a plate test.

    Attributes
    ----------
    test : its name.
    log : the samples of the test, offsets subtracted.
    stress : ``force`` or ``pressure``, what was measured.
    diameter : of the plate, m.
    zero : reading of the sinkage at which the plate meets the soil, m.
    air : force or pressure in air before it, SI, subtracted from the readings.
    loading : samples (m,) of the branch.
    readings : sinkage, m, and force or pressure, SI, (k, 2): means of neighbours that hang together.
    notes : what was left out, and why.
    """

    test: str
    log: Log
    stress: str
    diameter: float
    zero: float
    air: float
    loading: BoolArray
    readings: FloatArray
    notes: tuple[str, ...]


def branch_of(log: Log, settings: Settings) -> Branch:
    """The loading branch of one plate test; StudyError where a channel or the diameter is missing."""
    values = log.values
    stress = next((name for name in ("force", "pressure", "normal_force", "load") if name in values), "")
    if not stress or "sinkage" not in values:
        raise StudyError("a plate test needs 'sinkage [mm]' and 'force [N]' or 'pressure [kPa]'")
    diameter = float(values["plate_diameter"][0]) if "plate_diameter" in values else settings.plate
    if diameter is None:
        raise StudyError("the plate's diameter is missing: --plate \"100 mm\", or a column 'plate_diameter [mm]'")
    there = ~(np.isnan(values["sinkage"]) | np.isnan(values[stress]))
    sinkage, force = values["sinkage"][there], values[stress][there]
    contact, air, noise = _contact(force)
    smooth = _running_mean(force - air)
    top = int(np.argmax(smooth))
    branch = (np.arange(len(force)) >= contact) & (np.arange(len(force)) <= top)
    loop = branch & _unloaded(smooth, noise)
    loading = branch & ~loop
    zero = float(np.median(sinkage[contact - 2 : contact + 3])) if contact else 0.0
    readings = _independent(sinkage[loading] - zero, force[loading] - air)
    channel, after = LOGGED[stress], len(force) - 1 - top
    begins = f"contact at a reading of {zero * 1e3:.2f} mm; in air {air / channel.scale:.4g} {channel.unit}, subtracted"
    notes = (
        begins if contact else "it begins in contact: zeros are those of the log",
        *([f"{counted(int(loop.sum()), 'sample')} of unloading and reloading left out"] if loop.any() else []),
        *([f"{counted(after, 'sample')} after the greatest load left out"] if after else []),
        f"{counted(int(loading.sum()), 'sample')} thinned to {counted(len(readings), 'reading')}",
    )
    kept = np.zeros(len(there), dtype=np.bool_)
    kept[there] = loading
    named = "pressure" if stress == "pressure" else "force"
    return Branch(log.name, log, named, diameter, zero, air, kept, readings, notes)


def _contact(force: FloatArray) -> tuple[int, float, float]:
    """Sample of contact, mean force in air before it (0, 0 where the test begins in contact), noise of the force.

    In air the force is level, to half a percent of its greatest.
    """
    noise = float(1.4826 * np.median(np.abs(np.diff(force[: max(len(force) // 5, FEWEST)])))) / np.sqrt(2)
    smooth, start = _running_mean(force), float(np.median(force[:10]))
    loaded = int(np.argmax(smooth > start + 0.05 * (smooth.max() - start)))
    low = np.flatnonzero(smooth[:loaded] <= start + 4 * noise)
    contact = int(low[-1]) + 1 if low.size else 0
    if contact < FEWEST:
        return 0, 0.0, noise
    parts = np.array([part.mean() for part in np.array_split(force[: int(0.95 * contact)], 10)])
    level = np.ptp(parts) < 0.005 * (smooth.max() - start)
    return (contact, float(parts.mean()), noise) if level else (0, 0.0, noise)


def _unloaded(smooth: FloatArray, noise: float) -> BoolArray:
    """Samples (m,) between a greatest load so far and its return, where it falls by a tenth and by noise meanwhile."""
    most = np.maximum.accumulate(smooth)
    newest = smooth >= most
    stretch = np.cumsum(newest)
    deep = np.unique(stretch[smooth < 0.9 * most - 4 * noise])
    return np.isin(stretch, deep) & ~newest


def _running_mean(values: FloatArray, width: int = 5) -> FloatArray:
    padded = np.concatenate([np.full(width // 2, values[0]), values, np.full(width // 2, values[-1])])
    return np.convolve(padded, np.full(width, 1 / width), mode="valid")


def _independent(sinkage: FloatArray, stress: FloatArray, apart: float = 1.05) -> FloatArray:
    """Means (k, 2) of neighbours along the branch: as many as hang together, and 5 % of sinkage at least."""
    order = np.argsort(sinkage, kind="stable")
    order = order[sinkage[order] > 0]
    z, p = sinkage[order], stress[order]
    trend = _running_mean(p, 2 * max(len(p) // 40, 2) + 1)
    scatter = p - trend
    power = float(scatter @ scatter)
    correlation = float(np.clip(scatter[1:] @ scatter[:-1] / power, 0, 0.95)) if power > 0 else 0.0
    least = int(np.ceil((1 + correlation) / (1 - correlation)))
    readings, first = [], 0
    for end in range(1, len(z) + 1):
        if end == len(z) or (end - first >= least and z[end] >= apart * z[first]):
            readings.append((z[first:end].mean(), p[first:end].mean()))
            first = end
    return np.array(readings).reshape(-1, 2)


@dataclass(frozen=True)
class Reduction(AnalysisResult):
    """Rows of drives, or readings of plate tests, and how they came about.

    Attributes
    ----------
    logs : as read, offsets subtracted.
    windows : of drives, with rows or rejected.
    branches : of plate tests.
    """

    RECORD: ClassVar[type[Record] | None] = None
    VIEW: ClassVar[str] = "bayesterra.reduce.page:reduced"
    logs: tuple[Log, ...]
    windows: tuple[Window, ...] = ()
    branches: tuple[Branch, ...] = ()

    @property
    def kept(self) -> tuple[Window, ...]:
        """Windows that give a row."""
        return tuple(window for window in self.windows if not window.rejected)

    def tables(self) -> dict[str, pd.DataFrame]:
        """``measurements`` of drives as a study reads them, or ``readings`` of plates as a soil test does."""
        return {"readings": self._readings()} if self.branches else {"measurements": self._measurements()}

    def _measurements(self) -> pd.DataFrame:
        kinds = {log.name: log.kind for log in self.logs}
        columns: dict[str, list[Any]] = {"slip": [round(window.mean["slip"], 6) for window in self.kept]}
        for name in ("load", *OUTCOMES):
            channel = LOGGED[name]
            if any(name in window.mean for window in self.kept):
                for header, of in ((name, "mean"), (f"{name}_sd", "sd")):
                    values = [getattr(window, of).get(name, np.nan) / channel.scale for window in self.kept]
                    columns[f"{header} [{channel.unit}]"] = [float(f"{value:.6g}") for value in values]
        columns["use"] = [int(window.mean["slip"] >= 0) for window in self.kept]
        columns["# slip_sd"] = [float(f"{window.sd['slip']:.3g}") for window in self.kept]
        columns["# log"] = [window.log for window in self.kept]
        columns["# from [s]"] = [round(window.start, 3) for window in self.kept]
        columns["# to [s]"] = [round(window.end, 3) for window in self.kept]
        columns["# kind"] = [kinds[window.log] for window in self.kept]
        return pd.DataFrame(columns)

    def _readings(self) -> pd.DataFrame:
        tables = []
        for branch in self.branches:
            channel = LOGGED[branch.stress]
            tables.append(pd.DataFrame({
                "test": branch.test,
                "plate_diameter [mm]": float(f"{branch.diameter * 1e3:.6g}"),
                "sinkage [mm]": [float(f"{z * 1e3:.6g}") for z in branch.readings[:, 0]],
                f"{branch.stress} [{channel.unit}]": [float(f"{p / channel.scale:.6g}") for p in branch.readings[:, 1]],
                "# kind": branch.log.kind,
            }))  # fmt: skip
        return pd.concat(tables, ignore_index=True)

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write the table, and beside it the page of the same name; both or none, and nothing is replaced.

        Raises
        ------
        ResultError : no row was found, a file is there already, or cannot be written.
        """
        file = Path(folder)
        if overwrite:
            raise ResultError(f"'{file}' is a table, which may be a person's: it is never replaced")
        ((_, table),) = self.tables().items()
        if table.empty:
            reasons = dict.fromkeys(window.rejected for window in self.windows)
            raise ResultError(f"no steady window was found: {'; '.join(reasons)}")
        write_new_files({file.with_suffix(".html"): self.page().html(), file: csv_text(table)})
        return file

    def place(self, folder: Path) -> str:
        """Line on where it was saved."""
        return f"Written: {folder}   Page: {folder.with_suffix('.html')}"


def reduce_logs(
    paths: Sequence[Path],
    *,
    zero: Path | None = None,
    radius: str | None = None,
    plate: str | None = None,
    lugs: int = 0,
    steady: float = 0.02,
    **form: Any,
) -> Reduction:
    """Reduce logs of drives, or of plate tests.

    Parameters
    ----------
    paths : CSV or Excel files.
    zero : record of the unloaded sensors, whose means are subtracted.
    radius : of the wheel, e.g. ``"58 mm"``: behind the rim speed; with ``lugs`` it gives the ripple's period.
    plate : diameter of the plate; logs with it, or with a column of it, are plate tests.
    steady : see :class:`Settings`.
    **form : ``kind``, ``sheet`` and ``decimal`` of :func:`bayesterra.reduce.log.read_log`.

    Raises
    ------
    StudyError : one line that names the file, what is wrong and the mend.
    """
    lengths = {name: None if text is None else quantity(text, "m", name) for name, text in
               (("radius", radius), ("plate", plate))}  # fmt: skip
    for name, length in lengths.items():
        if length is not None and length <= 0:
            raise StudyError(f"'{name}' must be above 0 (got {length:g} m)")
    known("kind", str(form.get("kind", "measured")), get_args(Kind))
    if not 0 <= steady < 1:
        raise StudyError(f"'steady' must lie in [0, 1) (got {steady:g})")
    settings = Settings(lengths["radius"], lugs, lengths["plate"], steady)
    record = read_log(zero, **form) if zero else None
    logs: list[Log] = []
    windows: list[Window] = []
    branches: list[Branch] = []
    for path in paths:
        read = read_log(path, **form)
        with errors_in(path):
            log = read.without_offsets(record) if record else read
            logs.append(log)
            if settings.plate or not {"travel_speed", "position", "rim_speed", "wheel_speed", "slip"} & set(log.values):
                branches += [branch_of(test, settings) for test in log.tests()]
            else:
                windows += windows_of(log, settings)
    if windows and branches:
        raise StudyError("drives and plate tests give different tables: reduce them one after the other")
    return Reduction(tuple(logs), tuple(windows), tuple(branches))
