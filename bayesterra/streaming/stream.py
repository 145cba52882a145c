"""The stream: a study or an earlier result, then row after row."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator, SeedSequence, default_rng

from bayesterra.arrays import FloatArray
from bayesterra.checkpoints import Checkpoints, digest
from bayesterra.coordinates import coordinates
from bayesterra.data import Observations
from bayesterra.errors import ResultError, StudyError, SupportError
from bayesterra.folders import whole_folder, write_text
from bayesterra.likelihood import Likelihood
from bayesterra.parameters import PARAMETERS
from bayesterra.posteriors import INSIDE, REASONS, Posterior, draw_cut_prior, likelihood_of
from bayesterra.results import Result
from bayesterra.sampling.journal import pack, unpack
from bayesterra.streaming.changes import FIRST, Basis, Candidates
from bayesterra.streaming.cloud import Cloud
from bayesterra.streaming.forecast import Forecast, forecast
from bayesterra.streaming.learning import learn, settled
from bayesterra.streaming.moves import Levels, Rejuvenation, log_likelihoods
from bayesterra.streaming.rows import References, Rows, read_row, table_of
from bayesterra.study import Study, load_study
from bayesterra.writing import write_study

MARK = "stream.json"
"""File by which folders of this kind are known."""
STATE = "state"
PARTICLES = 2000
FEWEST = 100
FALSE_ALARMS = 1e-4
"""Per row, at most: one in ten thousand rows."""
BEFORE = 500
"""Draws of the prior that are kept, to know how much the rows have narrowed each coordinate."""
BAND = (0.05, 0.5, 0.95)


@dataclass(frozen=True)
class Alarm:
    """The soil seems to have changed.

    Attributes
    ----------
    row : at which this came out.
    since : row from which on the soil is most probably another one.
    first, last : rows between which it changed with 90 % of the evidence.
    log_statistic : log of R, the evidence for a change; see :mod:`bayesterra.streaming.changes`.
    rate : false alarms per row, at most, that were accepted.
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


@dataclass(frozen=True)
class State:
    """All that a stream holds besides its study and its rows; its size does not grow with the rows.

    Attributes
    ----------
    cloud : the particles.
    before : draws of the prior (k, d).
    candidates : rows at which the soil may have changed.
    basis : number of rows behind the coordinates of the candidates; 0 before there are any.
    log_evidence, variance : of all rows; variance settled at resamplings.
    alarm : if there was one.
    """

    cloud: Cloud
    before: FloatArray
    candidates: Candidates
    basis: int
    log_evidence: float
    variance: float
    alarm: Alarm | None


class Stream:
    """A posterior that learns row by row.

    Parameters
    ----------
    known : a study, of which wheels, model, noise and prior count but not its rows; or a result, whose draws
        are the posterior of its rows, and whose rows stay in.
    seed : same seed, same rows: same particles on one machine.
    particles : number of parameter sets that stand for the posterior.
    false_alarms : of a change of soil, per row, at most; None does not look for changes. With the drive
        ``both`` none are looked for.
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
        false_alarms: float | None = FALSE_ALARMS,
        slip_reference: str = "shearing",
        sinkage_reference: str = "rim",
    ) -> None:
        study = known.study if isinstance(known, Result) else known
        if not study.prior.names:
            raise StudyError("every parameter is fixed: there is nothing to learn")
        if particles < FEWEST:
            raise StudyError(f"'particles' must be at least {FEWEST} (got {particles})")
        if false_alarms is not None and not 0 < false_alarms < 1:
            raise StudyError(f"'false_alarms' must lie between 0 and 1 (got {false_alarms:g})")
        self.study, self.seed, self.particles = study, seed, particles
        self.false_alarms = None if study.drive == "both" else false_alarms
        self.alarm: Alarm | None = None
        self.candidates = Candidates.none(len(study.prior.names))  # rows at which the soil may have changed
        self._basis: tuple[int, Basis] | None = None
        self.references = References(slip_reference, sinkage_reference)
        self.offset = 0
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
        number = self.offset + len(self) + 1
        given = dict(row.iloc[0]) if isinstance(row, pd.DataFrame) and len(row) == 1 else row
        if isinstance(given, pd.DataFrame):
            raise StudyError(f"one row is added at a time (got {len(given)} rows)")
        table = table_of({**(dict(given) if given is not None else {}), **values})
        return self.learn(read_row(self.study, table, number, self.references))

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write the state into a new folder, whole or not at all; :func:`load_stream` goes on from there.

        Raises
        ------
        ResultError : there is no row yet; the folder exists (and ``overwrite`` is not given) or cannot be
            written.
        """
        with whole_folder(Path(folder), overwrite=overwrite, mark=MARK) as part:
            self.write(part)
        return Path(folder)

    def write(self, folder: Path) -> None:
        """Write the state into an existing folder: study and rows, particles, a record, the summary."""
        if self._cloud is None:
            raise ResultError(f"'{folder}' is not written: the stream has no row yet")
        study = self.study.with_rows(self.rows.first())
        write_study(study, folder)
        (folder / STATE).mkdir()
        basis = self._basis[0] if self._basis else 0
        state = State(
            self._cloud, self._before, self.candidates, basis, self.log_evidence, self._variance, self.alarm
        )
        Checkpoints.opened(folder / STATE, self._identity()).save(STATE, pack(state))
        write_text(folder / "summary.csv", self.summary.to_csv(index=False, float_format="%.6g"))
        write_text(folder / MARK, json.dumps(self._record(), indent=1, ensure_ascii=False) + "\n")

    def _identity(self) -> dict[str, Any]:
        """What the particles belong to."""
        return {"study": self.study.fingerprint["study"], "rows": self.rows.digest}

    def _record(self) -> dict[str, Any]:
        return {
            "kind": "stream",
            "title": self.study.title,
            "bayesterra": version("bayesterra"),
            "seed": self.seed,
            "particles": self.particles,
            "false_alarms": self.false_alarms,
            "slip_reference": self.references.slip,
            "sinkage_reference": self.references.sinkage,
            "offset": self.offset,
            "rows": len(self),
            "log_evidence": _finite(self.log_evidence),
            "log_evidence_error": _finite(self.log_evidence_error),
            "alarm": self.alarm.sentence if self.alarm else None,
        }

    def _go_on(self, state: State) -> None:
        """Stand where a saved stream stood."""
        self._cloud, self._before, self.candidates = state.cloud, state.before, state.candidates
        self.log_evidence, self._variance, self.alarm = state.log_evidence, state.variance, state.alarm
        if state.basis:
            self._based(state.basis)

    def learn(self, row: Observations) -> Update:
        """Learn from a row that is checked already; see :meth:`add`."""
        started, number = time.perf_counter(), self.offset + len(self) + 1
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
        alarm = self._watch(number, cloud, newest, learned.log_predictive)
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
            log_statistic=self.candidates.log_statistic,
            alarm=alarm,
            seconds=time.perf_counter() - started,
        )

    def restarted(self, since: int) -> Stream:
        """A stream on another soil, from the prior: the rows from number ``since`` on belong to it already.

        Raises
        ------
        StudyError : ``since`` is no row of this stream.
        """
        first = since - self.offset - 1
        if not 0 <= first < len(self):
            rows = f"{self.offset + 1} to {self.offset + len(self)}"
            raise StudyError(f"'since' must be one of the rows {rows} (got {since})")
        other = Stream(
            self.study,
            seed=self.seed,
            particles=self.particles,
            false_alarms=self.false_alarms,
            slip_reference=self.references.slip,
            sinkage_reference=self.references.sinkage,
        )
        other.offset = since - 1
        for index in range(first, len(self)):
            other.learn(self.rows.between(index, index + 1))
        return other

    def _watch(self, number: int, before: Cloud, row: Likelihood, log_predictive: float) -> Alarm | None:
        """Ask whether the soil has changed; an alarm in the row in which it first seems so."""
        if self.false_alarms is None or self.alarm is not None or len(self) < FIRST:
            return None
        basis = self._based(1 << ((len(self) - 1).bit_length() - 1))
        candidates = basis.opened(self.candidates, number, before)
        self.candidates = basis.followed(candidates, row, log_predictive).pruned()
        if self.candidates.log_statistic < -np.log(self.false_alarms):
            return None
        shares, since = self.candidates.shares, self.candidates.since
        likely = np.sort(
            since[np.argsort(-shares)[: 1 + int((np.cumsum(np.sort(shares)[::-1]) < 0.9).sum())]]
        )
        self.alarm = Alarm(
            row=number,
            since=int(since[np.argmax(shares)]),
            first=int(likely[0]),
            last=int(likely[-1]),
            log_statistic=self.candidates.log_statistic,
            rate=self.false_alarms,
        )
        return self.alarm

    def _based(self, rows: int) -> Basis:
        """Coordinates after so many rows, a power of two; candidates are carried over to them."""
        if self._basis is None or self._basis[0] != rows:
            posterior = Posterior(self.study.prior, likelihood_of(self.study, self.rows.first(rows)))
            found = Basis(posterior, coordinates(posterior))
            if self._basis is not None:
                self.candidates = self._basis[1].rebased(self.candidates, found)
            self._basis = rows, found
        return self._basis[1]

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


def load_stream(folder: str | Path) -> Stream:
    """Read a stream that was saved; rows can be added as if it had never been put down.

    Raises
    ------
    ResultError : the folder is missing, incomplete or damaged.
    """
    folder = Path(folder)
    if not (folder / MARK).is_file():
        raise ResultError(f"'{folder}' is not the folder of a stream: it has no {MARK}")
    try:
        record = json.loads((folder / MARK).read_text(encoding="utf-8"))
        study = load_study(folder, prior_only=True)
        settings = ("seed", "particles", "false_alarms", "slip_reference", "sinkage_reference")
        stream = Stream(study, **{name: record[name] for name in settings})
        stream.offset = int(record["offset"])
        stream.rows.append(study.observations)
        segment = Checkpoints(folder / STATE, digest(stream._identity())).load(STATE)
    except StudyError:
        raise
    except ResultError as error:
        raise ResultError(
            f"'{folder}' is damaged: its particles belong to another study or other rows"
        ) from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ResultError(f"'{folder}' is damaged: {str(error).splitlines()[0]}") from error
    if segment is None:
        raise ResultError(f"'{folder}' is damaged: the particles cannot be read")
    stream._go_on(unpack(State, segment))
    return stream


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
