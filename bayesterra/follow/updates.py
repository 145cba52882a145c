"""Updates by one row: its forecast, its effect, and the sentence that a driver is told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.random import Generator
from scipy.special import ndtr

from bayesterra.arrays import FloatArray
from bayesterra.follow.particles import Particles, Rejuvenation
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import Posterior
from bayesterra.parameters import CHANNELS, PARAMETERS, Parameter
from bayesterra.stats.weights import weighted_quantiles
from bayesterra.study.observations import Observations

BAND = (0.05, 0.5, 0.95)
"""Probabilities of the quantiles that are shown of everything."""
BAND_NAMES = ("q05", "q50", "q95")


@dataclass(frozen=True)
class Forecast:
    """One-step-ahead predictive law of a row, channel by channel, and where the readings fell in it.

    Attributes
    ----------
    channels : measured outcomes.
    observed : readings (k,), SI; NaN where not measured, or known by a limit only.
    quantiles : (3, k) 5, 50 and 95 % of the predicted readings, SI; NaN where the model has no answer.
    pit : (k,) probability that the reading would be lower than it is; uniform over rows where all is right.
    no_answer : share of the particles for which the model has no answer at the row's conditions.
    """

    channels: tuple[str, ...]
    observed: FloatArray
    quantiles: FloatArray
    pit: FloatArray
    no_answer: float

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
    return Forecast(
        newest.channels,
        observed,
        weighted_quantiles(readings[answered], share, BAND),
        np.array([share @ ndtr(score) for score in scores]),
        float(1.0 - weights[answered].sum()),
    )


@dataclass(frozen=True)
class Alarm:
    """An alarm: the soil seems to have changed.

    Attributes
    ----------
    row : at which this came out.
    since : row from which on the soil is most probably another one.
    first, last : rows between which it changed with 90 % of the evidence.
    log_statistic : log of R, the evidence for a change; see :mod:`bayesterra.follow.changepoint`.
    rate : false alarms per row, at most, that were accepted; an average over the prior.
    """

    row: int
    since: int
    first: int
    last: int
    log_statistic: float
    rate: float

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
    """Effect of one row.

    Attributes
    ----------
    row : its number in the stream, from 1.
    forecast : what the earlier rows expected of it.
    log_predictive : log density of its readings given the earlier rows, all constants included.
    log_evidence, log_evidence_error : log evidence of all rows so far, and its Monte Carlo error.
    names : parameters, the last axis of ``quantiles``.
    quantiles : 5, 50 and 95 % (3, d) of every parameter given all rows so far, SI.
    effective : effective number of particles.
    rejuvenations : resamplings with moves that the row asked for; mostly none.
    log_statistic : log of the evidence R for a change of soil; −inf while none is looked for.
    alarm : given once, in the row where that evidence passed its limit.
    seconds : wall time.
    """

    row: int
    forecast: Forecast
    log_predictive: float
    log_evidence: float
    log_evidence_error: float
    names: tuple[str, ...]
    quantiles: FloatArray
    effective: float
    rejuvenations: tuple[Rejuvenation, ...]
    log_statistic: float
    alarm: Alarm | None
    seconds: float

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
    line |= {
        "log_predictive": update.log_predictive,
        "log_evidence": update.log_evidence,
        "log_evidence_error": update.log_evidence_error,
        "effective": update.effective,
        "sweeps": update.sweeps,
        "log_statistic": update.log_statistic,
        "alarm": update.alarm.since if update.alarm else None,
        "seconds": update.seconds,
    }
    for name, column in zip(update.names, update.quantiles.T, strict=True):
        parameter = PARAMETERS[name]
        ends = zip(BAND_NAMES, column / parameter.scale, strict=True)
        line |= {column_of(parameter, key): value for key, value in ends}
    return line


def column_of(parameter: Parameter, key: str) -> str:
    """Column of ``updates.csv`` with a quantile of a parameter."""
    unit = "" if parameter.unit == "-" else f" [{parameter.unit}]"
    return f"{parameter.name}_{key}{unit}"
