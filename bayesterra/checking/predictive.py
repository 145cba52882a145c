"""Predictions of readings by the draws: at the measured rows, as bands over slip, and as replicated tables.

Replicated tables have a posterior each, by importance weights from one common pool.
The pool is modelled once; a replicate costs arithmetic only. With a latent load (drive ``both``) the outcomes
are taken as linear in the load around the value that explains the row as measured.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import pandas as pd
from numpy.random import Generator, SeedSequence, default_rng
from threadpoolctl import threadpool_limits

from bayesterra.arrays import FloatArray, IntArray, answered_quantiles
from bayesterra.likelihood.condition_errors import load_slopes, told_loads
from bayesterra.likelihood.covariance import TableLaw
from bayesterra.likelihood.forward import Forward, Outcomes
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import Posterior, likelihood_of
from bayesterra.likelihood.sites import Intervals
from bayesterra.models import Conditions
from bayesterra.parameters import CHANNELS
from bayesterra.runtime.engines import usable_processors
from bayesterra.sampling.evidence import PosteriorProposal, Proposed
from bayesterra.stats.mixture import ProposalLaw, effective_number, normalised, systematic
from bayesterra.study.study import Study

GRID = 41
FORCE = "normal_force"
FEWEST_DRAWS, MOST_DRAWS, VALUES = 250, 2000, 800_000
"""Draws kept of each row: so many numbers in all, within these ends."""
LEAST_TOLD = 1e-12
"""Precision, 1/N², of a load on which a row has no number."""


@dataclass(frozen=True)
class RowPredictions:
    """Predictions at every row of the table, used or not."""

    channels: tuple[str, ...]  # measured outcomes, the last axis
    modelled: FloatArray  # (n, rows, channels) without noise, NaN where the model has no answer
    readings: FloatArray  # (n, rows, channels) with noise


def predict_rows(
    study: Study, posterior: Posterior, draws: FloatArray, rng: Generator, *, before: bool = False
) -> RowPredictions:
    """Model all rows of the table for parameter sets (n, d) and draw a reading for each.

    Rows are modelled one by one, so that a row which a soil cannot answer takes no other with it. A latent
    load is drawn given the parameter set and the row's readings, or from its prior where these predictions
    are made ``before`` the readings; so are discrepancy, ripple and slip errors, given the rows in the fit.
    """
    likelihood = likelihood_of(study, study.observations)
    noise, soil = posterior.noise_values(draws), posterior.prior.soil_values(draws)
    outcomes = likelihood.imagined(soil, noise, rng) if before else likelihood.explained(soil, noise, rng)
    return RowPredictions(likelihood.channels, likelihood.predicted(outcomes), likelihood.draw(outcomes, noise, rng))


def predict_at_read_loads(study: Study, posterior: Posterior, draws: FloatArray, rng: Generator) -> RowPredictions:
    """Predictions before any reading but that of the normal force, drive ``both``.

    A load is drawn given its row's normal force alone. That law, unlike the flat one, does not hang on how
    wide the range of loads is, which serves the integral over loads and says nothing that is believed.
    """
    rows = study.observations
    blank = np.full(len(rows), np.nan)
    values = {name: column if name == FORCE else blank for name, column in rows.values.items()}
    told = likelihood_of(study, replace(rows, values=values))
    noise = posterior.noise_values(draws)
    outcomes = told.explained(posterior.prior.soil_values(draws), noise, rng)
    return RowPredictions(told.channels, told.predicted(outcomes), told.draw(outcomes, noise, rng))


def no_rows(study: Study, n: int) -> RowPredictions:
    """Predictions of ``n`` parameter sets without an answer for any row."""
    channels = tuple(study.noise)
    empty = np.full((n, len(study.observations), len(channels)), np.nan)
    return RowPredictions(channels, empty, empty)


def one_in(rows: int, draws: int) -> int:
    """Number of draws of which one is kept, where something is kept of each row."""
    return max(1, -(-draws // max(FEWEST_DRAWS, min(MOST_DRAWS, VALUES // max(1, rows)))))


def predictive_table(study: Study, predictions: RowPredictions) -> pd.DataFrame:
    """Predictive mean, 5, 50 and 95 % of every row and channel beside the reading, in field units."""
    records = []
    for index, row in enumerate(study.observations.rows):
        for column, name in enumerate(predictions.channels):
            scale, readings = CHANNELS[name].scale, predictions.readings[:, index, column]
            answered = readings[np.isfinite(readings)] / scale
            low, middle, high = answered_quantiles(answered, (0.05, 0.5, 0.95))
            records.append(
                {
                    "row": row,
                    "wheel": study.observations.wheel[index],
                    "slip": study.observations.slip[index],
                    "channel": name,
                    "unit": CHANNELS[name].unit,
                    "used": bool(study.observations.use[index]),
                    "observed": study.observations.values[name][index] / scale,
                    "mean": answered.mean() if answered.size else np.nan,
                    "q05": low,
                    "q50": middle,
                    "q95": high,
                    "no_answer": float(np.mean(~np.isfinite(readings))),
                }
            )
    return pd.DataFrame(records)


@dataclass(frozen=True)
class Curves:
    """Modelled outcomes of one wheel over slip."""

    wheel: str  # its name
    slip: FloatArray  # (g,) grid
    outcomes: tuple[str, ...]  # names of the last axis of ``modelled``
    modelled: FloatArray  # (n, g, outcomes) without noise, NaN where the model has no answer
    readings: FloatArray  # the same with noise; outcomes that were not measured have none (NaN)
    given: FloatArray  # load (N) or sinkage (m) along the grid, (g,)


def predict_curves(study: Study, posterior: Posterior, draws: FloatArray, rng: Generator) -> tuple[Curves, ...]:
    """Model every wheel over the slips it was driven at, at its median load.

    In the sinkage drive the measured sinkages are joined by straight lines over slip. Sinkages are as read,
    with the zero error of the readings. A discrepancy, drawn given the readings, is part of what is modelled;
    ripple and slip errors are those of another sweep.
    """
    return tuple(_curves(study, posterior, draws, wheel, rng) for wheel in study.wheels)


def _curves(study: Study, posterior: Posterior, draws: FloatArray, wheel: str, rng: Generator) -> Curves:
    forward = curve_forward(study, wheel)
    outcomes = forward(posterior.prior.soil_values(draws), every_row=True)
    readings = posterior.drive(forward, outcomes, draws, wheel, rng)
    slip, given = forward.conditions.slip, forward.given
    return Curves(wheel, slip, outcomes.names, outcomes.values, readings.values, given)


def curve_forward(study: Study, wheel: str) -> Forward:
    """The study's model on a slip grid for one wheel (see :func:`predict_curves`)."""
    observations = study.observations
    mine = np.array([name == wheel for name in observations.wheel]) & observations.use
    mine = mine if mine.any() else observations.use
    slips = observations.slip[mine]
    slip = np.linspace(min(0.02, slips.min()), min(0.95, slips.max() + 0.05), GRID)
    if study.drive.by_sinkage:
        order = np.argsort(slips, kind="stable")
        slip = np.linspace(slips.min(), slips.max(), GRID)
        driven = np.interp(slip, slips[order], observations.values["sinkage"][mine][order])
    else:
        load = float(np.median(observations.known_loads[mine]))
        driven = np.full(GRID, study.middle_load if np.isnan(load) else load)
    return Forward(study.model, study.drive.with_load, Conditions.of(study.wheels[wheel], slip), driven, as_read=True)


T = TypeVar("T")


@dataclass(frozen=True)
class Modelled:
    """Readings that parameter sets predict at every row in the fit.

    Attributes
    ----------
    mean, scale : modelled readings and their noise (n, m, channels).
    slope : growth of ``mean`` with a latent load (n, m, channels), per N; None where the load is known.
    joint : law of the whole table where rows hang together; ``mean`` then holds discrepancy, ripple and
        slip errors as they were drawn.
    bare : noise before readings are rounded, where they stand for intervals; else None.
    limits : readings known by a limit under latent loads; None without.
    """

    mean: FloatArray
    scale: FloatArray
    slope: FloatArray | None
    joint: TableLaw | None = None
    bare: FloatArray | None = None
    limits: Intervals | None = None

    @classmethod
    def of(cls, posterior: Posterior, x: FloatArray, outcomes: Outcomes) -> "Modelled":
        """Readings behind ``outcomes`` of parameter sets (n, d)."""
        likelihood = posterior.likelihood
        mean = likelihood.predicted(outcomes)
        noise, bare = posterior.noise_values(x), None
        if not likelihood.widened:
            bare = likelihood.scales(mean, noise, rounded=False)
        scale = likelihood.scales(mean, noise)
        joint = likelihood.joint_law(posterior.prior.soil_values(x), noise)
        slope = _slope(posterior, x, outcomes) if joint is None else None
        limits = likelihood.intervals if joint is None and bare is None else None
        return cls(mean, scale, slope, joint, bare, limits)

    def take(self, chosen: IntArray) -> "Modelled":
        """Those of the sets, also repeatedly."""
        slope = None if self.slope is None else self.slope[chosen]
        joint = None if self.joint is None else self.joint.take(chosen)
        bare = None if self.bare is None else self.bare[chosen]
        return Modelled(self.mean[chosen], self.scale[chosen], slope, joint, bare, self.limits)

    def log_likelihood(self, likelihood: Likelihood, readings: FloatArray) -> FloatArray:
        """Log likelihood (n,) of readings (m, channels), NaN where there is none, but for a constant."""
        if self.joint is not None:
            return likelihood.reading(self.joint, readings).log_density(readings)
        if self.bare is not None:
            return np.asarray(likelihood.log_readings(readings, self.mean, self.bare).sum(axis=(1, 2)))
        numbers, mean, scale = self._numbers(readings), self.mean, self.scale
        z = (numbers - mean) / scale
        present = ~np.isnan(numbers)
        total = -np.log(scale).sum(axis=(1, 2), where=present)
        for i, noise in enumerate(likelihood.noise):
            total += noise.tails.log_density(z[:, :, i]).sum(axis=1, where=present[:, i])
        if self.slope is not None:
            curvature, pull = self._told(numbers, self.slope)
            total += (0.5 * pull**2 / curvature - 0.5 * np.log(curvature)).sum(axis=1)
            mean = mean + self.slope * (pull / curvature)[:, :, None]
            scale = np.hypot(scale, self.slope / np.sqrt(curvature)[:, :, None])
        if self.limits is not None:  # each as the numbers of its row leave the load
            beyond = np.zeros(mean.shape)
            self.limits.replace_densities(beyond, readings, mean, scale)
            total += beyond.sum(axis=(1, 2))
        return np.asarray(total)

    def _numbers(self, readings: FloatArray) -> FloatArray:
        """Readings (m, channels) without those known by a limit."""
        return readings if self.limits is None else np.where(self.limits.limited(readings), np.nan, readings)

    def _told(self, numbers: FloatArray, slope: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Precision of latent loads (n, m), above 0, and what pulls at them."""
        curvature, pull = told_loads(numbers - self.mean, slope, self.scale)
        return np.maximum(curvature, LEAST_TOLD), pull

    def explaining(self, likelihood: Likelihood, readings: FloatArray, rng: Generator) -> "Modelled":
        """The same with every latent quantity drawn as these readings (m, channels) tell it."""
        if self.joint is not None:
            told = likelihood.reading(self.joint, readings).draw(readings, rng)
            return replace(self, mean=self.joint.mean + told.at_rows)
        if self.slope is None:
            return self
        curvature, pull = self._told(self._numbers(readings), self.slope)
        shift = pull / curvature + rng.standard_normal(pull.shape) / np.sqrt(curvature)
        return replace(self, mean=self.mean + self.slope * shift[:, :, None])


def _slope(posterior: Posterior, x: FloatArray, outcomes: Outcomes) -> FloatArray | None:
    likelihood = posterior.likelihood
    if likelihood.load_range is None:
        return None
    at = likelihood.forward.at_load(outcomes["normal_force"])
    return load_slopes(at, posterior.prior.soil_values(x), likelihood.channels, outcomes)


@dataclass(frozen=True)
class ReplicateOptions:
    """Settings by which replicates and their posteriors are made."""

    number: int = 200  # replicated tables
    pool: int = 8192  # parameter sets that all posteriors are weighed from
    widening: float = 1.5  # how much wider than the posterior they are spread
    draws: int = 200  # draws of each posterior
    fewest: float = 50.0  # effective draws below which a posterior is looked for around its own centre
    local: tuple[int, ...] = (384, 1024, 1024)  # parameter sets drawn there, search by search


TOLD = 0.9
"""Share of proposed sets from which those of which nodes tell all rows stand for all."""


@dataclass(frozen=True)
class _Pool:
    """Proposed sets with all that they say; ``modelled`` is None where the ``outcomes`` are those of nodes."""

    posterior: Posterior
    sets: Proposed
    modelled: Modelled | None
    outcomes: Outcomes

    @classmethod
    def of(
        cls, near: PosteriorProposal[Posterior], mixture: ProposalLaw, n: int, rng: Generator,
        loads: FloatArray | None = None,
    ) -> "_Pool":  # fmt: skip
        """``n`` sets; latent loads count to first order about ``loads`` (m,), or about some drawn for each set."""
        posterior, likelihood = near.posterior, near.posterior.likelihood
        if (nodes := likelihood.forward.nodes) is not None and likelihood.squares is not None:
            sets = near.propose(mixture, n, rng)
            outcomes, told = likelihood.forward.at_nodes(nodes, posterior.prior.soil_values(sets.x))
            if told.mean() > TOLD:
                kept = np.flatnonzero(told)
                return cls(posterior, sets.take(kept), None, outcomes.take(kept))
        sets = near.propose(mixture, min(n, likelihood.at_once), rng)
        about = None
        if loads is not None:
            about = likelihood.forward.at_load(loads)(posterior.prior.soil_values(sets.x), every_row=True)
        if about is None or (about.status == 0).mean() < TOLD:
            about = posterior.explained(sets.x, rng)
        kept = np.flatnonzero(about.status == 0)
        sets, outcomes = sets.take(kept), about.take(kept)
        return cls(posterior, sets, Modelled.of(posterior, sets.x, outcomes), outcomes)

    def log_weights(self, likelihood: Likelihood, readings: FloatArray) -> FloatArray:
        """Log weights (n,) of the sets for a table of readings (m, channels), but for a constant."""
        if self.modelled is not None:
            return self.sets.log_base + self.modelled.log_likelihood(likelihood, readings)
        squares = [own.anew(column) for own, column in zip(likelihood.squares or (), readings.T, strict=True)]
        noise = self.posterior.noise_values(self.sets.x)
        return self.sets.log_base + likelihood.log_told(squares, self.outcomes, noise)

    def explained(self, chosen: IntArray) -> Outcomes:
        """Outcomes of all rows for some of the sets."""
        outcomes, nodes = self.outcomes.take(chosen), self.posterior.likelihood.forward.nodes
        if self.modelled is not None or nodes is None:
            return outcomes
        return replace(outcomes, values=nodes.at_rows(outcomes.values))

    def take(self, chosen: IntArray) -> Modelled:
        """What some of the sets say of all rows."""
        if self.modelled is not None:
            return self.modelled.take(chosen)
        return Modelled.of(self.posterior, self.sets.x[chosen], self.explained(chosen))


@dataclass(frozen=True)
class Replicate:
    """A replicated table."""

    readings: FloatArray  # (m, channels), NaN where the measured table has none
    modelled: Modelled  # draws of its posterior
    effective: float  # effective number of draws behind them


def replicates(
    posterior: Posterior,
    draws: FloatArray,
    seed: SeedSequence,
    options: ReplicateOptions,
    judge: Callable[[Replicate], T],
) -> list[T]:
    """Draw tables from the posterior predictive law of draws (n, d), and judge each by its own posterior."""
    own, *streams = seed.spawn(1 + options.number)
    rng, near, likelihood = default_rng(own), PosteriorProposal.of(posterior, draws), posterior.likelihood
    pool = _Pool.of(near, near.mixture(rng, options.widening), options.pool, rng)
    measured = pool.log_weights(likelihood, likelihood.measured)
    chosen = systematic(normalised(measured), options.number, rng)
    tables = likelihood.draw(pool.explained(chosen), posterior.noise_values(pool.sets.x[chosen]), rng)
    tables[:, np.isnan(likelihood.measured)] = np.nan

    def judged(table: FloatArray, stream: SeedSequence) -> T:
        return judge(_settled(near, pool, measured, table, default_rng(stream), options))

    with threadpool_limits(limits=1), ThreadPoolExecutor(usable_processors()) as workers:
        return list(workers.map(judged, tables, streams))


def _settled(
    near: PosteriorProposal[Posterior], pool: _Pool, measured: FloatArray, readings: FloatArray, rng: Generator,
    options: ReplicateOptions,
) -> Replicate:  # fmt: skip
    """The posterior of a table, from the pool or, where too few draws fit it, from around its centre.

    The ``measured`` table has log weights (n,) in the pool. Where log likelihoods of two tables differ linearly over a
    Gaussian posterior, its mean moves from the one to the other by its covariance with that difference. Elsewhere that
    goes too far, and the mean of the few draws that fit not far enough: the search begins between them.
    """
    likelihood, u = near.posterior.likelihood, pool.sets.u
    log_weights, loads = pool.log_weights(likelihood, readings), likelihood.loads_near(readings)
    weights, own = normalised(log_weights), normalised(measured)
    further = np.subtract(log_weights, measured, out=np.zeros(len(own)), where=(own > 0) & np.isfinite(log_weights))
    centre = 0.5 * (weights @ u + own @ u + own @ ((u - own @ u) * (further - own @ further)[:, None]))
    for n in options.local:
        if effective_number(weights) >= options.fewest:
            break
        local = _Pool.of(near, near.shifted(centre), n, rng, loads)
        local_weights = normalised(local.log_weights(likelihood, readings))
        if effective_number(local_weights) > effective_number(weights):
            pool, weights = local, local_weights
        centre = weights @ pool.sets.u
    draws = pool.take(systematic(weights, options.draws, rng)).explaining(likelihood, readings, rng)
    return Replicate(readings, draws, effective_number(weights))
