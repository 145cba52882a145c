"""The stream: a study or an earlier result, then row after row."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator, SeedSequence, default_rng

from bayesterra.arrays import FloatArray
from bayesterra.data import Observations
from bayesterra.errors import StudyError, SupportError
from bayesterra.parameters import PARAMETERS
from bayesterra.posteriors import INSIDE, REASONS, Posterior, draw_cut_prior, likelihood_of
from bayesterra.results import Result
from bayesterra.streaming.cloud import Cloud
from bayesterra.streaming.forecast import Forecast, forecast
from bayesterra.streaming.learning import learn, settled
from bayesterra.streaming.moves import Levels, Rejuvenation, log_likelihoods
from bayesterra.streaming.rows import References, Rows, read_row, table_of
from bayesterra.study import Study

PARTICLES = 2000
FEWEST = 100
BEFORE = 500
"""Draws of the prior that are kept, to know how much the rows have narrowed each coordinate."""
BAND = (0.05, 0.5, 0.95)


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


class Stream:
    """A posterior that learns row by row.

    Parameters
    ----------
    known : a study, of which wheels, model, noise and prior count but not its rows; or a result, whose draws
        are the posterior of its rows, and whose rows stay in.
    seed : same seed, same rows: same particles on one machine.
    particles : number of parameter sets that stand for the posterior.
    slip_reference, sinkage_reference : of the rows that are added; see :class:`bayesterra.study.Study`.

    Raises
    ------
    StudyError : every parameter is fixed, or too few particles.
    """

    def __init__(
        self,
        known: Study | Result,
        *,
        seed: int = 1,
        particles: int = PARTICLES,
        slip_reference: str = "shearing",
        sinkage_reference: str = "rim",
    ) -> None:
        study = known.study if isinstance(known, Result) else known
        if not study.prior.names:
            raise StudyError("every parameter is fixed: there is nothing to learn")
        if particles < FEWEST:
            raise StudyError(f"'particles' must be at least {FEWEST} (got {particles})")
        self.study, self.seed, self.particles = study, seed, particles
        self.references = References(slip_reference, sinkage_reference)
        self.rows = Rows.of(study)
        self.log_evidence, self._variance = 0.0, 0.0
        self._before = np.empty((0, len(study.prior.names)))
        self._cloud: Cloud | None = None
        if isinstance(known, Result):
            self._begin_from(known)

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters, the columns of ``draws``."""
        return self.study.prior.names

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        """Name the stream in a line."""
        return f"<Stream {self.study.title!r}: {len(self)} rows, {self.particles} particles>"

    @property
    def cloud(self) -> Cloud:
        """The weighted particles; before the first row those of the stated prior."""
        if self._cloud is None:
            x = self.study.prior.sample(self.particles, self._rng(0))
            return Cloud.even(x, np.zeros(len(x)))
        return self._cloud

    @property
    def draws(self) -> pd.DataFrame:
        """Particles, one row each, SI and radians, and the weight of each."""
        return pd.DataFrame(self.cloud.x, columns=pd.Index(self.names)).assign(weight=self.cloud.weights)

    @property
    def summary(self) -> pd.DataFrame:
        """Median and 90 % interval of every parameter given all rows so far, in field units."""
        return summary_of(self.names, self.cloud.quantiles(BAND))

    @property
    def log_evidence_error(self) -> float:
        """Monte Carlo standard error of ``log_evidence``."""
        return float(np.sqrt(self._variance + (settled(self._cloud) if self._cloud else 0.0)))

    def add(
        self, row: Mapping[str, object] | pd.Series | pd.DataFrame | None = None, **values: object
    ) -> Update:
        """Learn from one more row.

        Parameters
        ----------
        row : a row of a table, with units in its names, e.g. ``sinkage [mm]``.
        **values : in place of that, or beside it: ``slip``, ``load``, ``sinkage``, ``drawbar_pull``,
            ``resistance_moment``, ``normal_force``, each also with ``_sd``, and ``wheel``; SI numbers or text
            with a unit. What is left out was not measured.

        Raises
        ------
        StudyError : the row cannot be used as it stands.
        SupportError : no soil that the earlier rows leave has an answer in it.

        After an error the stream is as it was before the row.
        """
        number = len(self) + 1
        given = dict(row.iloc[0]) if isinstance(row, pd.DataFrame) and len(row) == 1 else row
        if isinstance(given, pd.DataFrame):
            raise StudyError(f"one row is added at a time (got {len(given)} rows)")
        table = table_of({**(dict(given) if given is not None else {}), **values})
        return self.learn(read_row(self.study, table, number, self.references))

    def learn(self, row: Observations) -> Update:
        """Learn from a row that is checked already; see :meth:`add`."""
        started, number = time.perf_counter(), len(self) + 1
        rng = self._rng(number)
        newest = likelihood_of(self.study, row)
        known = Posterior(self.study.prior, newest)
        if self._cloud is None:
            self._begin(known, rng)
        cloud = self.cloud
        expected = forecast(cloud, known, newest, rng)
        terms = log_likelihoods(known, newest, cloud.x)
        self.rows.append(row)
        try:
            learned = learn(cloud, lambda: Levels.of(self.study, self.rows), terms, self._before, rng)
        except SupportError as error:
            self.rows.drop_last()
            raise SupportError(f"row {number}: {error}") from error
        self._cloud = learned.cloud
        self.log_evidence += learned.log_predictive
        self._variance += learned.variance
        return Update(
            row=number,
            forecast=expected,
            log_predictive=learned.log_predictive,
            log_evidence=self.log_evidence,
            log_evidence_error=self.log_evidence_error,
            names=self.names,
            quantiles=learned.cloud.quantiles(BAND),
            effective=learned.cloud.effective,
            rejuvenations=learned.rejuvenations,
            seconds=time.perf_counter() - started,
        )

    def _rng(self, number: int) -> Generator:
        """Random numbers of a row, the same however the stream came to it."""
        return default_rng(SeedSequence(self.seed, spawn_key=(number,)))

    def _begin(self, known: Posterior, rng: Generator) -> None:
        """Draw particles from the prior, cut to where the first row has an answer."""
        drawn = draw_cut_prior(known, self.particles, rng)
        share = drawn.shares[REASONS[INSIDE]]
        self.log_evidence = float(np.log(share))
        self._variance = (1.0 - share) / (share * drawn.tried)
        self._before = drawn.x[:BEFORE]
        self._cloud = Cloud.even(drawn.x, np.zeros(len(drawn.x)))

    def _begin_from(self, result: Result) -> None:
        """Take the draws of a result, and keep its rows."""
        rows, rng = result.study.observations.used(), self._rng(0)
        self.rows.append(rows)
        draws, prior = result.values(), result.values("prior")
        enough = len(draws) >= self.particles
        chosen = rng.choice(len(draws), size=self.particles, replace=not enough)
        known = Posterior(self.study.prior, likelihood_of(self.study, rows))
        x = draws[chosen]
        self._cloud = Cloud.even(x, log_likelihoods(known, known.likelihood, x))
        self._before = prior[:BEFORE]
        found: Mapping[str, Any] = result.record.get("evidence") or {}
        self.log_evidence = float(found.get("log_z", np.nan))
        self._variance = float(found.get("error", np.nan)) ** 2
