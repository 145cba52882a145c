"""Rows as they come in: read and checked, kept in arrays that grow geometrically; forecast and effect of each."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from hashlib import sha256

import numpy as np
import pandas as pd
from numpy.random import Generator
from scipy.special import ndtr

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.errors import StudyError, did_you_mean
from bayesterra.follow.particles import Particles, Rejuvenation
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import Posterior
from bayesterra.parameters import CHANNELS, PARAMETERS, Parameter
from bayesterra.stats.mixture import weighted_quantiles
from bayesterra.study import assembly
from bayesterra.study.observations import LABELS, SD_SUFFIX, Observations, observations
from bayesterra.study.study import Study
from bayesterra.study.units import quantity

FIRST_CAPACITY = 64
SIDES = {"": 0.0, "<": -1.0, ">": 1.0}
"""Side of its limit on which a reading lies that is known by one only."""


def table_of(values: Mapping[str, object]) -> pd.DataFrame:
    """A table of one row from values by column: SI numbers or text with a unit.

    Names with a unit in them, as ``sinkage [mm]``, are columns of a table already and stay as they are.

    Raises
    ------
    StudyError : an unknown name, or a value that is no quantity of its kind.
    """
    cells: dict[str, object] = {}
    for name, value in values.items():
        if "[" in name or name in ("wheel", "use", *LABELS):
            cells[name] = value
        elif isinstance(value, str) and value.strip()[:1] in ("<", ">"):
            mark, limit = value.strip()[0], table_of({name: value.strip()[1:]})
            cells |= {header: f"{mark}{cell}" for header, cell in zip(limit.columns, limit.iloc[0], strict=True)}
        elif value is not None and not (isinstance(value, float) and np.isnan(value)):
            channel = CHANNELS.get(name.removesuffix(SD_SUFFIX))
            if channel is None:
                raise StudyError(f"unknown column '{name}'{did_you_mean(name, [*CHANNELS, 'wheel'])}")
            unit = f" [{channel.dimension}]" if channel.dimension else ""
            cells[name + unit] = quantity(value, channel.dimension, name, bare=True)
    return pd.DataFrame({name: [value] for name, value in cells.items()})


def read_row(study: Study, table: pd.DataFrame, number: int, references: Mapping[str, str]) -> Observations:
    """Check a table of one row and bring it to the form of the study's rows.

    Parameters
    ----------
    study : gives wheels, drive and noise.
    table : one row, columns as in the measurement files.
    number : of the row in the stream; messages name it.
    references : ``slip_reference`` and ``sinkage_reference``; see :class:`bayesterra.study.study.Study`.

    Raises
    ------
    StudyError : naming row, column, what must hold and the value got.
    """
    if len(table) != 1:
        raise StudyError(f"one row is added at a time (got {len(table)} rows)")
    try:
        row = observations(table, study.wheels, **references)
        row, _ = assembly.conditioned(row, study.drive)
        if not len(row) or not row.use[0]:
            raise StudyError("'use' must be 1 in a row that is added (got 0, row 1)")
        _check_noise(study, row)
        assembly.outcome_noise(row, study.noise, study.drive, expected=True)
    except StudyError as error:
        text = str(error).replace("row 1)", f"row {number})")
        raise StudyError(text if f"row {number}" in text else f"row {number}: {text}") from error
    return replace(assembly.awaited(row, study.noise, study.drive), rows=(number,))


def _check_noise(study: Study, row: Observations) -> None:
    for name, values in row.values.items():
        if name not in study.noise and name not in study.drive.idle and not np.isnan(values[0]):
            channels = ", ".join(study.noise)
            raise StudyError(f"[noise] has no entry for the measured channel '{name}' (it has {channels}; row 1)")


@dataclass
class Rows:
    """All rows of a stream. Memory: at most twice what the rows themselves need."""

    wheels: tuple[str, ...]  # names of the study's wheels
    channels: tuple[str, ...]  # measured channels that are kept, besides slip and load
    by: str = ""  # a column of labels that is kept, too, as it says which group a row belongs to; else empty
    _cells: FloatArray = field(init=False)
    _wheel: IntArray = field(init=False)
    _label: list[str] = field(default_factory=list, init=False)
    _length: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._cells = np.empty((FIRST_CAPACITY, 2 + 3 * len(self.channels)))
        self._wheel = np.empty(FIRST_CAPACITY, dtype=np.int64)

    @classmethod
    def of(cls, study: Study) -> "Rows":
        """An empty store for the rows of a study."""
        by = study.pooling.by if study.pooling else ""
        channels = (*(("sinkage",) if study.drive.by_sinkage else ()), *study.noise)
        return cls(tuple(study.wheels), channels, by if by in LABELS else "")

    def __len__(self) -> int:
        return self._length

    def append(self, rows: Observations) -> None:
        """Add one or more rows at the end."""
        end = self._length + len(rows)
        while end > len(self._cells):
            self._cells = np.concatenate([self._cells, np.empty_like(self._cells)])
            self._wheel = np.concatenate([self._wheel, np.empty_like(self._wheel)])
        none = np.full(len(rows), np.nan)
        values = [rows.values.get(name, none) for name in self.channels]
        sd = [rows.given_sd.get(name, none) for name in self.channels]
        sides = [[SIDES[mark] for mark in rows.marks(name)] for name in self.channels]
        self._cells[self._length : end] = np.column_stack([rows.slip, rows.load, *values, *sd, *sides])
        self._label[self._length :] = rows.label(self.by) if self.by else ()
        self._wheel[self._length : end] = [self.wheels.index(name) for name in rows.wheel]
        self._length = end

    @property
    def digest(self) -> str:
        """SHA-256 of all rows."""
        cells, wheel = self._cells[: self._length], self._wheel[: self._length]
        cells, sides = np.split(cells, [2 + 2 * len(self.channels)], axis=1)
        content = np.where(np.isnan(cells), np.nan, cells).tobytes() + wheel.tobytes()
        more = (sides.tobytes() if sides.any() else b"") + "\n".join(self._label[: self._length]).encode()
        return sha256(content + more).hexdigest()

    def cut(self, number: int) -> None:
        """Forget all rows after the first ``number``."""
        self._length = number

    def first(self, number: int | None = None) -> Observations:
        """The first ``number`` rows, by default all; views, not copies."""
        return self.between(0, self._length if number is None else number)

    def between(self, start: int, end: int) -> Observations:
        """Rows ``start`` to ``end``, counted from 0, the last one excluded; their numbers stay."""
        cells = self._cells[start:end].view()
        cells.flags.writeable = False
        k = len(self.channels)
        limits = {}
        for i, name in enumerate(self.channels):
            value, side = cells[:, 2 + i], cells[:, 2 + 2 * k + i]
            if side.any():
                ends = np.where(side < 0, value, -np.inf), np.where(side > 0, value, np.inf)
                limits[name] = np.column_stack(ends)
        return Observations(
            wheel=tuple(self.wheels[code] for code in self._wheel[start:end]), slip=cells[:, 0],
            load=cells[:, 1], values={name: cells[:, 2 + i] for i, name in enumerate(self.channels)},
            given_sd={name: cells[:, 2 + k + i] for i, name in enumerate(self.channels)},
            use=np.ones(end - start, dtype=np.bool_), rows=tuple(range(start + 1, end + 1)),
            labels={self.by: tuple(self._label[start:end])} if self.by else {}, limits=limits,
        )  # fmt: skip


BAND = (0.05, 0.5, 0.95)
"""Probabilities of the quantiles that are shown of everything."""
BAND_NAMES = ("q05", "q50", "q95")


@dataclass(frozen=True)
class Forecast:
    """One-step-ahead predictive law of a row, channel by channel, and where the readings fell in it."""

    channels: tuple[str, ...]  # measured outcomes
    observed: FloatArray  # readings (k,), SI; NaN where not measured, or known by a limit only
    quantiles: FloatArray  # (3, k) 5, 50 and 95 % of the predicted readings, SI; NaN where the model has no answer
    pit: FloatArray  # (k,) probability that the reading would be lower than it is; uniform over rows where all is right
    no_answer: float  # share of the particles for which the model has no answer at the row's conditions

    @property
    def table(self) -> pd.DataFrame:
        """One row per channel, field units."""
        scale = np.array([CHANNELS[name].scale for name in self.channels])
        return pd.DataFrame(
            {
                "channel": self.channels,
                "unit": [CHANNELS[name].unit for name in self.channels],
                "observed": self.observed / scale,
                **dict(zip(BAND_NAMES, self.quantiles / scale, strict=True)),
                "pit": self.pit,
            }
        )


def forecast(particles: Particles, posterior: Posterior, newest: Likelihood, rng: Generator) -> Forecast:
    """Predict a row with the particles of the earlier rows.

    Parameters
    ----------
    posterior : gives soil and noise of the particles.
    newest : likelihood of the row; where rows hang together, of all rows, of which this one is not in use.
    """
    soil, noise = posterior.prior.soil_values(particles.x), posterior.noise_values(particles.x)
    if newest.rows_apart:
        outcomes = newest.imagined(soil, noise, rng)
        readings = newest.draw(outcomes, noise, rng)[:, 0]
        predicted = newest.predicted(outcomes)
        scale = newest.scales(predicted, noise)
    else:
        predicted, scale = newest.ahead(soil, noise, ~newest.observations.use, rng)
        readings = newest.with_noise(predicted, scale, rng)[:, 0]
    answered = np.isfinite(readings).all(axis=1)
    observed, weights, k = newest.measured[-1], particles.weights, len(newest.channels)
    if newest.intervals is not None:
        observed = np.where(newest.intervals.sides(newest.measured)[-1] == 0, observed, np.nan)
    if not answered.any() or weights[answered].sum() <= 0:
        return Forecast(newest.channels, observed, np.full((3, k), np.nan), np.full(k, np.nan), 1.0)
    standard = (observed - predicted[answered]) / scale[answered]
    share = weights[answered] / weights[answered].sum()
    scores = [law.tails.normal_score(standard[:, 0, i]) for i, law in enumerate(newest.noise)]
    quantiles, pit = weighted_quantiles(readings[answered], share, BAND), [share @ ndtr(score) for score in scores]
    return Forecast(newest.channels, observed, quantiles, np.array(pit), float(1.0 - weights[answered].sum()))


@dataclass(frozen=True)
class Alarm:
    """An alarm: the soil seems to have changed."""

    row: int  # at which this came out
    since: int  # row from which on the soil is most probably another one
    first: int  # rows between which it changed with 90 % of the evidence
    last: int  # likewise
    log_statistic: float  # log of R, the evidence for a change; see :mod:`bayesterra.follow.changepoint`
    rate: float  # false alarms per row, at most, that were accepted; an average over the prior

    @property
    def sentence(self) -> str:
        """Sentence that a driver is told."""
        between = f" (rows {self.first} to {self.last})" if self.last > self.first else ""
        return (
            f"row {self.row}: the soil seems to have changed at row {self.since}{between}; what is learned"
            f" from here mixes two soils: begin anew from row {self.since}"
        )


@dataclass(frozen=True)
class Update:
    """Effect of one row."""

    row: int  # its number in the stream, from 1
    forecast: Forecast  # what the earlier rows expected of it
    log_predictive: float  # log density of its readings given the earlier rows, all constants included
    log_evidence: float  # log evidence of all rows so far
    log_evidence_error: float  # its Monte Carlo error
    names: tuple[str, ...]  # parameters, the last axis of ``quantiles``
    quantiles: FloatArray  # 5, 50 and 95 % (3, d) of every parameter given all rows so far, SI
    effective: float  # effective number of particles
    rejuvenations: tuple[Rejuvenation, ...]  # resamplings with moves that the row asked for; mostly none
    log_statistic: float  # log of the evidence R for a change of soil; −inf while none is looked for
    alarm: Alarm | None  # given once, in the row where that evidence passed its limit
    seconds: float  # wall time

    @property
    def predictive(self) -> pd.DataFrame:
        """One row per channel: reading, predictive quantiles and PIT, in field units."""
        return self.forecast.table

    @property
    def pit(self) -> dict[str, float]:
        """By channel, the predictive probability of a lower reading; NaN where not measured."""
        return dict(zip(self.forecast.channels, map(float, self.forecast.pit), strict=True))

    @property
    def sweeps(self) -> int:
        """Moves of every particle that the row asked for."""
        return sum(event.sweeps for event in self.rejuvenations)

    @property
    def rejuvenated(self) -> bool:
        """True where particles were resampled and moved."""
        return bool(self.rejuvenations)

    @property
    def summary(self) -> pd.DataFrame:
        """One row per parameter: median and 90 % interval, in field units."""
        return summary_of(self.names, self.quantiles)


def summary_of(names: tuple[str, ...], quantiles: FloatArray) -> pd.DataFrame:
    """Quantiles (3, d), 5, 50 and 95 %, as a table in field units."""
    scale = np.array([PARAMETERS[name].scale for name in names])
    low, middle, high = quantiles / scale
    units = [PARAMETERS[name].unit for name in names]
    return pd.DataFrame({"parameter": names, "unit": units, "median": middle, "q05": low, "q95": high})


def cells(update: Update, row: Observations) -> dict[str, object]:
    """A row of ``updates.csv``: conditions, readings beside what was expected, parameters; field units."""
    line: dict[str, object] = {"row": update.row, "wheel": row.wheel[0], "slip": float(row.slip[0])}
    if not np.isnan(row.load[0]):
        line["load [N]"] = float(row.load[0])
    for reading in update.predictive.to_dict("records"):
        unit = f" [{reading['unit']}]"
        line[reading["channel"] + unit] = reading["observed"]
        line |= {f"{reading['channel']}_{key}{unit}": reading[key] for key in BAND_NAMES}
        line[f"{reading['channel']}_pit"] = reading["pit"]
    told = ("log_predictive", "log_evidence", "log_evidence_error", "effective", "sweeps", "log_statistic")
    line |= {name: getattr(update, name) for name in told}
    line |= {"alarm": update.alarm.since if update.alarm else None, "seconds": update.seconds}
    for name, column in zip(update.names, update.quantiles.T, strict=True):
        parameter = PARAMETERS[name]
        ends = zip(BAND_NAMES, column / parameter.scale, strict=True)
        line |= {column_of(parameter, key): value for key, value in ends}
    return line


def column_of(parameter: Parameter, key: str) -> str:
    """Column of ``updates.csv`` with a quantile of a parameter."""
    unit = "" if parameter.unit == "-" else f" [{parameter.unit}]"
    return f"{parameter.name}_{key}{unit}"
