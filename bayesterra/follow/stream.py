"""Stream: a study or an earlier result, then row after row; and its state on disk."""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pandas as pd
from numpy.random import Generator, SeedSequence, default_rng

from bayesterra.arrays import FloatArray, frozen
from bayesterra.errors import ResultError, StudyError, SupportError, check_kind, check_seed, checked_path
from bayesterra.follow.changepoint import Candidates, ChangeDetector
from bayesterra.follow.particles import Levels, Particles, group_of, learn, log_likelihoods, values_of, whole_of
from bayesterra.follow.rows import BAND, Alarm, Rows, Update, forecast, read_row, summary_of, table_of
from bayesterra.likelihood.joint import JointPosterior, Whole
from bayesterra.likelihood.posterior import INSIDE, REASONS, Posterior, draw_cut_prior, likelihood_of
from bayesterra.runtime.checkpoints import Checkpoints, Identity, digest, pack, unpack
from bayesterra.runtime.folders import make_folder
from bayesterra.runtime.ownership import BEGUN, SEGMENT
from bayesterra.runtime.reading import check_sums, damage, read_json
from bayesterra.runtime.tables import Count, Number, Record
from bayesterra.study.canonical import FORM, write_study
from bayesterra.study.observations import Observations
from bayesterra.study.result import AnalysisResult, Result
from bayesterra.study.schema import know_model
from bayesterra.study.study import STUDY_FILE, Study, load_study, without_wheels

if TYPE_CHECKING:
    from bayesterra.report.blocks import Overview

PARTICLES = 2000
FEWEST = 100
FALSE_ALARMS = 1e-4
"""Per row, at most: one in ten thousand rows."""
BEFORE = 500
"""Draws of the prior that are kept, to know how much the rows have narrowed each coordinate."""


class Stream(AnalysisResult):
    """A posterior that learns row by row.

    Parameters
    ----------
    known : a study, of which wheels, model, noise and prior count but not its rows; or a result, whose draws
        are the posterior of its rows, and whose rows stay in.
    seed : same seed, same rows: same particles on one machine.
    particles : number of parameter sets that stand for the posterior.
    false_alarms : of a change of soil, per row, at most, on average over the prior; None does not look for
        changes. With the drive ``both``, errors of the model or the slips, or groups none are looked for.
    slip_reference, sinkage_reference : of the rows that are added; see :class:`bayesterra.study.study.Study`.

    Raises
    ------
    StudyError : every parameter is fixed, or too few particles.
    """

    MARK = "stream.json"
    RECORD = Record.having(
        kind=Literal["stream"], title=str, bayesterra=str, seed=Count, particles=Count,
        false_alarms=Number | None, slip_reference=str, sinkage_reference=str, offset=Count, rows=Count,
        log_evidence=Number | None, log_evidence_error=Number | None, alarm=str | None,
    )  # fmt: skip
    PAGE = ""
    CALLED = "Written"

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
        check_kind("bt.Stream", known, Study, Result)
        check_seed(seed)
        study = known.study if isinstance(known, Result) else known
        without_wheels(study, "follow")
        if study.errors.ripple:
            raise StudyError("following row by row knows no sweeps, along which [ripple] runs: leave it out")
        if not study.prior.names:
            raise StudyError("every parameter is fixed: there is nothing to learn")
        if particles < FEWEST:
            raise StudyError(f"'particles' must be at least {FEWEST} (got {particles})")
        if false_alarms is not None and not 0 < false_alarms < 1:
            raise StudyError(f"'false_alarms' must lie between 0 and 1 (got {false_alarms:g})")
        self.study, self.seed, self.particles = study, seed, particles
        unwatched = study.drive.latent_load or study.errors or study.pooling
        self.false_alarms = None if unwatched else false_alarms
        self.references = {"slip_reference": slip_reference, "sinkage_reference": sinkage_reference}
        self.offset = 0
        self.rows = Rows.of(study)
        self.watch = ChangeDetector(self.false_alarms, len(study.prior.names), self._posterior_of)
        self.log_evidence, self._variance = 0.0, 0.0
        self._before = np.empty((0, len(study.prior.names)))
        self._cloud: Particles | None = None
        self._joint: JointPosterior | None = None
        if isinstance(known, Result):
            self._begin_from(known)

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters, the columns of ``draws``; a group has its own from its first row on."""
        return self._joint.names if self._joint else self.study.prior.names

    @property
    def _settings(self) -> dict[str, Any]:
        """Keywords that this stream was begun with."""
        own = {"seed": self.seed, "particles": self.particles, "false_alarms": self.false_alarms}
        return {**own, **self.references}

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        """Name the stream in a line."""
        return f"<Stream {self.study.title!r}: {len(self)} rows, {self.particles} particles>"

    @property
    def cloud(self) -> Particles:
        """The weighted particles; before the first row those of the stated prior."""
        if self._cloud is None and self.study.pooling:
            raise StudyError("a stream with groups has parameters from its first row on (it has no row yet)")
        if self._cloud is None:
            x = self.study.prior.sample(self.particles, self._rng(0))
            return Particles.even(x, np.zeros(len(x)))
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
    def alarm(self) -> Alarm | None:
        """The alarm that was raised, if any; none are looked for after it."""
        return self.watch.alarm

    @property
    def log_evidence_error(self) -> float:
        """Monte Carlo standard error of ``log_evidence``."""
        return float(np.sqrt(self._variance + (self._cloud.variance if self._cloud else 0.0)))

    def add(self, row: Mapping[str, object] | pd.Series | pd.DataFrame | None = None, **values: object) -> Update:
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
        content = dict(row.iloc[0]) if isinstance(row, pd.DataFrame) and len(row) == 1 else row
        if isinstance(content, pd.DataFrame):
            raise StudyError(f"one row is added at a time (got {len(content)} rows)")
        table = table_of({**(dict(content) if content is not None else {}), **values})
        return self.learn(read_row(self.study, table, number, self.references))

    def tables(self) -> dict[str, pd.DataFrame]:
        """The summary."""
        return {"summary": self.summary}

    def overview(self) -> "Overview":
        """The parameters, the evidence, and whether the soil has changed."""
        from bayesterra.follow.page import followed_overview
        from bayesterra.follow.session import FollowedStream

        return followed_overview(FollowedStream(self))

    def write_inputs(self, part: Path) -> None:
        """Write the state: study and rows, particles; :func:`load_stream` goes on from there."""
        if self._cloud is None:
            raise ResultError(f"'{part}' is not written: the stream has no row yet")
        state = State(
            self._cloud, self._before, self.watch.candidates, self.watch.basis, self.log_evidence,
            self._variance, self.alarm,
        )  # fmt: skip
        write_study(self.study.with_rows(self.rows.first()), part)
        make_folder(part / STATE, BEGUN)
        Checkpoints.opened(part / STATE, self._identity()).save(STATE, pack(state))

    def _identity(self) -> dict[str, Any]:
        """Identity of the study and the rows that the particles belong to."""
        return {"form": FORM, "study": self.study.fingerprint["study"], "rows": self.rows.digest}

    def to_record(self) -> dict[str, Any]:
        """Content of the JSON file."""
        return {
            "kind": "stream", "title": self.study.title, "bayesterra": version("bayesterra"), **self._settings,
            "offset": self.offset, "rows": len(self), "log_evidence": self.log_evidence,
            "log_evidence_error": self.log_evidence_error, "alarm": self.alarm.sentence if self.alarm else None,
        }  # fmt: skip

    def _go_on(self, rows: Observations, folder: Path, offset: int) -> None:
        """Stand where a saved stream stood."""
        self.offset = offset
        self.rows.append(rows)
        state = read_state(folder, self._identity())
        self._cloud, self._before = state.cloud, state.before
        self.log_evidence, self._variance = state.log_evidence, state.variance
        self.watch.go_on(state.candidates, state.basis, state.alarm)
        self._take_groups(whole_of(self.study, rows))

    def learn(self, row: Observations) -> Update:
        """Learn from a row that is checked already; see :meth:`add`."""
        with self.all_or_nothing():
            return self._learned(row)

    def _learned(self, row: Observations) -> Update:
        started, number = time.perf_counter(), self.offset + len(self) + 1
        rng, group = self._rng(number), group_of(self.study, row)
        newest = likelihood_of(self.study, row)
        posterior = Posterior(self.study.prior, newest)
        self._enter(group, posterior, rng)
        particles = self.cloud
        values = particles.x if self._joint is None else values_of(self._joint, group, particles.x)
        own = replace(particles, x=values)
        if newest.rows_apart:
            expected = forecast(own, posterior, newest, rng)
            terms = log_likelihoods(posterior, newest, values)
        else:
            earlier, pooling, unused = self.rows.first(), self.study.pooling, frozen(np.zeros(1), np.bool_)
            if pooling:
                earlier = earlier.take(np.array(earlier.label(pooling.by), dtype=object) == group)
            ahead = likelihood_of(self.study, earlier.followed_by(replace(row, use=unused)))
            expected = forecast(own, posterior, ahead, rng)
            whole, before = likelihood_of(self.study, earlier.followed_by(row)), particles.log_likelihood
            if self._joint is not None:  # of this group alone
                before = np.zeros(len(values))
                if len(earlier):
                    before = log_likelihoods(posterior, likelihood_of(self.study, earlier), values)
            terms = log_likelihoods(posterior, whole, values) - before
        if self._joint is not None:  # a group's first values may lie outside the physical ranges
            terms = np.where(posterior.log_prior(values) > -np.inf, terms, -np.inf)
        self.rows.append(row)
        try:
            learned = learn(particles, lambda: Levels.of(self.study, self.rows), terms, self._before, rng)
        except SupportError as error:
            raise SupportError(f"row {number}: {error}") from error
        # the watch asks what the readings say, not that there is an answer: candidates do not pay for it
        said = learned.log_predictive - particles.log_share(terms > -np.inf)
        limited = any(row.limited(name).any() for name in row.limits)  # of which a filter knows nothing
        alarm = None if limited else self.watch.see(number, len(self), particles, newest, said)
        self._cloud = learned.particles
        self.log_evidence += learned.log_predictive
        self._variance += learned.variance
        return Update(
            row=number, forecast=expected, log_predictive=learned.log_predictive,
            log_evidence=self.log_evidence, log_evidence_error=self.log_evidence_error, names=self.names,
            quantiles=learned.particles.quantiles(BAND), effective=learned.particles.effective,
            rejuvenations=learned.rejuvenations, log_statistic=self.watch.candidates.log_statistic,
            alarm=alarm, seconds=time.perf_counter() - started,
        )  # fmt: skip

    @contextmanager
    def all_or_nothing(self) -> Iterator[None]:
        """Stand as before after an error; an interruption too must not leave half a row."""
        rows, own, watch = len(self.rows), vars(self).copy(), vars(self.watch).copy()
        try:
            yield
        except BaseException:
            self.rows.cut(rows)
            vars(self).update(own)
            vars(self.watch).update(watch)
            raise

    def restarted(self, since: int) -> "Stream":
        """A stream on another soil, from the prior: the rows from number ``since`` on belong to it already.

        Raises
        ------
        StudyError : ``since`` is no row of this stream.
        """
        first = since - self.offset - 1
        if not 0 <= first < len(self):
            rows = f"{self.offset + 1} to {self.offset + len(self)}"
            raise StudyError(f"'since' must be one of the rows {rows} (got {since})")
        other = Stream(self.study, **self._settings)
        other.offset = since - 1
        for index in range(first, len(self)):
            other.learn(self.rows.between(index, index + 1))
        return other

    def _posterior_of(self, rows: int) -> Posterior:
        """Posterior of the first rows."""
        return Posterior(self.study.prior, likelihood_of(self.study, self.rows.first(rows)))

    def _rng(self, number: int) -> Generator:
        """Random numbers of a row, the same however the stream came to it."""
        return default_rng(SeedSequence(self.seed, spawn_key=(number,)))

    def _take_groups(self, posterior: Whole) -> None:
        """Know the groups of a posterior; its rows do not matter."""
        self._joint = posterior if posterior.grouped else None

    def _enter(self, group: str, posterior: Posterior, rng: Generator) -> None:
        """Draw particles at the first row, and a group's own values, from populations and priors, at its first one."""
        known = {} if self._joint is None else self._joint.groups
        if self._cloud is not None and (self.study.pooling is None or group in known):
            return
        groups = {**known, group: posterior}
        whole = JointPosterior(self.study.pooling, groups) if self.study.pooling else posterior
        if self._cloud is None:
            self._begin(whole, rng)
        elif whole.grouped:
            sets = self._before, self._cloud.x
            shared = len(whole.shared_and_hyper)
            before, x = (np.hstack([x, whole.draw_group(x[:, :shared], rng)]) for x in sets)
            self._before, self._cloud = before, replace(self._cloud, x=x)
        self._take_groups(whole)

    def _begin(self, posterior: Whole, rng: Generator) -> None:
        """Draw particles from the prior, cut to where the first row has an answer."""
        if self.study.soil_tests:
            raise StudyError(
                "following begins from a prior, which knows no soil tests: run the study first and follow its result,"
                " without --restart"
            )
        drawn = draw_cut_prior(posterior, self.particles, rng)
        share = drawn.shares[REASONS[INSIDE]]
        self.log_evidence = float(np.log(share))
        self._variance = (1.0 - share) / (share * drawn.tried)
        self._before = drawn.x[:BEFORE]
        self._cloud = Particles.even(drawn.x, np.zeros(len(drawn.x)))

    def _begin_from(self, result: Result) -> None:
        """Take the draws of a result, and keep its rows."""
        rows, rng = result.study.observations.used(), self._rng(0)
        self.rows.append(rows)
        draws, prior = result.values(), result.values("prior")
        enough = len(draws) >= self.particles
        chosen = rng.choice(len(draws), size=self.particles, replace=not enough)
        posterior, x = whole_of(self.study, rows), draws[chosen]
        groups = zip(posterior.groups.values(), posterior.values_of_groups(x), strict=True)
        levels = [log_likelihoods(own, own.likelihood, values) for own, values in groups]
        self._cloud = Particles.even(x, np.sum(levels, axis=0))
        self._take_groups(posterior)
        self._before = prior[:BEFORE]
        evidence: Mapping[str, Any] = result.record.get("evidence") or {}
        self.log_evidence = float(evidence.get("log_z", np.nan))
        self._variance = float(evidence.get("error", np.nan)) ** 2


def load_stream(folder: str | Path) -> Stream:
    """Read a stream that was saved; rows can be added as if it had never been put down.

    Raises
    ------
    ResultError : the folder is missing, incomplete or damaged.
    """
    folder = checked_path("bt.load_stream", folder, "the folder of a stream")
    if not (folder / Stream.MARK).is_file():
        raise ResultError(f"'{folder}' is not the folder of a stream: it has no {Stream.MARK}")
    check_sums(folder, Stream.MARK, STUDY_FILE, "measurements.csv")
    know_model(folder)
    with damage(ResultError, folder / Stream.MARK):
        record = Stream.RECORD.read(folder / Stream.MARK)
    study = load_study(folder, prior_only=True)
    settings = ("seed", "particles", "false_alarms", "slip_reference", "sinkage_reference")
    with damage(ResultError, folder):
        stream = Stream(study, **{name: record[name] for name in settings})
        stream._go_on(study.observations, folder, int(record["offset"]))
    return stream


STATE = "state"


@dataclass(frozen=True)
class State:
    """All that a stream holds besides its study and its rows; its size does not grow with the rows."""

    cloud: Particles  # the particles
    before: FloatArray  # draws of the prior (k, d)
    candidates: Candidates  # rows at which the soil may have changed
    basis: int  # number of rows behind the coordinates of the candidates; 0 before there are any
    log_evidence: float  # of all rows
    variance: float  # of that, settled at resamplings
    alarm: Alarm | None  # if there was one


def read_state(folder: Path, identity: Identity) -> State:
    """The state of a saved stream.

    ResultError where it is missing or damaged, or belongs to another study or other rows.
    """
    with damage(ResultError, folder / STATE / BEGUN):
        record = read_json(folder / STATE / BEGUN)
        begun: dict[str, Any] = record["identity"]
        if record["run"] != digest(begun):
            raise ValueError("this is not what was written")
        compared = ("study", "rows") if begun.get("form") == identity["form"] else ("rows",)
        if any(begun[name] != identity[name] for name in compared):
            raise ResultError(f"'{folder}' is damaged: its particles belong to another study or other rows")
    segment = Checkpoints(folder / STATE, digest(begun)).load(STATE)
    if segment is None:
        raise ResultError(f"'{folder}' is damaged: the particles cannot be read ({STATE}/{STATE}{SEGMENT})")
    with damage(ResultError, folder):
        return unpack(State, segment)
