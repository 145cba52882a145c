"""What one row did, and what a driver is told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray
from bayesterra.data import Observations
from bayesterra.parameters import PARAMETERS
from bayesterra.streaming.forecast import Forecast
from bayesterra.streaming.moves import Rejuvenation

BAND = (0.05, 0.5, 0.95)
"""Probabilities of the quantiles that are shown of everything."""
BAND_NAMES = ("q05", "q50", "q95")


@dataclass(frozen=True)
class Alarm:
    """The soil seems to have changed.

    Attributes
    ----------
    row : at which this came out.
    since : row from which on the soil is most probably another one.
    first, last : rows between which it changed with 90 % of the evidence.
    log_statistic : log of R, the evidence for a change; see :mod:`bayesterra.streaming.changes`.
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
        """What a driver is told."""
        between = f" (rows {self.first} to {self.last})" if self.last > self.first else ""
        return (
            f"row {self.row}: the soil seems to have changed at row {self.since}{between}; what is learned"
            f" from here mixes two soils: begin anew from row {self.since}"
        )


@dataclass(frozen=True)
class Update:
    """What one row did.

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
    def rejuvenated(self) -> bool:
        """Whether particles were resampled and moved."""
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
    found: dict[str, object] = {"row": update.row, "wheel": row.wheel[0], "slip": float(row.slip[0])}
    if not np.isnan(row.load[0]):
        found["load [N]"] = float(row.load[0])
    for one in update.predictive.to_dict("records"):
        unit = f" [{one['unit']}]"
        found[one["channel"] + unit] = one["observed"]
        found |= {f"{one['channel']}_{key}{unit}": one[key] for key in BAND_NAMES}
        found[f"{one['channel']}_pit"] = one["pit"]
    found |= {
        "log_predictive": update.log_predictive,
        "log_evidence": update.log_evidence,
        "log_evidence_error": update.log_evidence_error,
        "effective": update.effective,
        "sweeps": sum(event.sweeps for event in update.rejuvenations),
        "log_statistic": update.log_statistic,
        "alarm": update.alarm.since if update.alarm else None,
        "seconds": update.seconds,
    }
    for name, column in zip(update.names, update.quantiles.T, strict=True):
        known = PARAMETERS[name]
        unit = "" if known.unit == "-" else f" [{known.unit}]"
        found |= {f"{name}_{key}{unit}": v / known.scale for key, v in zip(BAND_NAMES, column, strict=True)}
    return found
