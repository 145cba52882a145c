"""Several independent ensembles, run in fixed rounds until the diagnosis is satisfied."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import repeat

import numpy as np
from numpy.random import SeedSequence, default_rng
from threadpoolctl import threadpool_limits

from bayesterra.arrays import FloatArray
from bayesterra.coordinates import Coordinates, coordinates
from bayesterra.diagnostics import Diagnosis, diagnose
from bayesterra.errors import StudyError
from bayesterra.posteriors import Posterior, draw_cut_prior
from bayesterra.sampling.adaptation import Adaptation, AdaptationOptions, adapt
from bayesterra.sampling.ensemble import Ensemble
from bayesterra.study import SamplingOptions

WARM_UP_STEPS = 50
ROUND_STEPS = 200


@dataclass(frozen=True)
class Progress:
    """What a progress bar shows: the stage, and once sampling, the latest diagnosis and time left (s)."""

    stage: str
    done: float
    diagnosis: Diagnosis | None = None
    seconds_left: float | None = None


@dataclass(frozen=True)
class Samples:
    """Draws of all ensembles and how they were made.

    Attributes
    ----------
    names : free parameters, the last axis of ``chains``.
    chains : physical parameters (ensembles, steps, walkers, d), SI and radians.
    acceptance : share of accepted steps (ensembles, walkers).
    diagnosis : the verdict.
    adaptations : what each ensemble adapted to before its draws were kept.
    coordinates : the map that the walkers moved in.
    seconds : wall time by stage.
    """

    names: tuple[str, ...]
    chains: FloatArray
    acceptance: FloatArray
    diagnosis: Diagnosis
    adaptations: tuple[Adaptation, ...]
    coordinates: Coordinates
    seconds: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Target:
    """A posterior in sampling coordinates."""

    posterior: Posterior
    coordinates: Coordinates

    def densities(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log prior (with Jacobian) and log likelihood, (n,) each, −inf outside the support."""
        x, log_jacobian = self.coordinates.to_physical(u)
        prior, likelihood = self.posterior.log_prior_and_likelihood(x)
        inside = (prior > -np.inf) & np.isfinite(log_jacobian)  # coordinates of 1e5 have no digits left
        return np.where(inside, prior + np.where(inside, log_jacobian, 0.0), -np.inf), likelihood

    def log_density(self, u: FloatArray) -> FloatArray:
        """Log density (n,) in sampling coordinates."""
        prior, likelihood = self.densities(u)
        return np.where(np.isneginf(prior), -np.inf, prior + likelihood)

    def physical(self, u: FloatArray) -> FloatArray:
        """Physical parameters of any (..., d) array of coordinates."""
        return self.coordinates.to_physical(u.reshape(-1, u.shape[-1]))[0].reshape(u.shape)


def sample(
    posterior: Posterior,
    options: SamplingOptions,
    seed: SeedSequence,
    report: Callable[[Progress], None] = lambda progress: None,
    adaptation: AdaptationOptions | None = None,
) -> Samples:
    """Sample a posterior with independent ensembles.

    Every ensemble starts from its own draws of the cut prior, adapts alone and then samples with frozen
    proposals. Rounds have a fixed length and threads share nothing, so draws depend on the seed only.

    Parameters
    ----------
    posterior : what to sample.
    options : effective draws asked for, number of ensembles and walkers, most steps.
    seed : root of all random streams of this call.
    report : called with a :class:`Progress` after each stage and round.
    adaptation : size of the adaptation; default :class:`AdaptationOptions`.

    Raises
    ------
    StudyError : every parameter is fixed.
    """
    if not posterior.names:
        raise StudyError("every parameter is fixed: there is nothing to sample")
    target = Target(posterior, coordinates(posterior))
    plan = adaptation or AdaptationOptions()
    streams = seed.spawn(options.ensembles)
    workers = min(options.ensembles, os.cpu_count() or 1)
    with threadpool_limits(limits=1), ThreadPoolExecutor(workers) as pool:
        started = time.perf_counter()
        report(Progress("adapting", 0.0))
        adapted = list(pool.map(lambda stream: _prepare(target, options, stream, plan), streams))
        ensembles = [ensemble for ensemble, _ in adapted]
        adapting = time.perf_counter() - started
        chains, diagnosis = _produce(target, ensembles, options, pool, report)
    acceptance = np.array([ensemble.acceptance for ensemble in ensembles])
    seconds = {"adaptation": adapting, "production": time.perf_counter() - started - adapting}
    adaptations = tuple(adaptation for _, adaptation in adapted)
    return Samples(posterior.names, chains, acceptance, diagnosis, adaptations, target.coordinates, seconds)


def _prepare(
    target: Target, options: SamplingOptions, stream: SeedSequence, plan: AdaptationOptions
) -> tuple[Ensemble, Adaptation]:
    """Adapt one ensemble from its own prior draws and walk it a little, unrecorded."""
    adapting, walking = stream.spawn(2)
    rng = default_rng(adapting)
    prior = draw_cut_prior(target.posterior, max(plan.particles, options.walkers), rng)
    adapted = adapt(target.densities, target.coordinates.from_physical(prior.x), plan, rng)
    chosen = rng.choice(len(adapted.u), size=options.walkers, replace=False)
    ensemble = Ensemble(target.log_density, adapted.u[chosen], adapted.mixture, walking)
    ensemble.advance(WARM_UP_STEPS, keep=False)
    return ensemble, adapted


def _produce(
    target: Target,
    ensembles: list[Ensemble],
    options: SamplingOptions,
    pool: Executor,
    report: Callable[[Progress], None],
) -> tuple[FloatArray, Diagnosis]:
    """Advance all ensembles round by round until the diagnosis passes or the steps run out."""
    started, steps = time.perf_counter(), 0
    while True:
        length = min(ROUND_STEPS, options.max_steps - steps)
        list(pool.map(Ensemble.advance, ensembles, repeat(length)))
        steps += length
        chains = target.physical(np.array([ensemble.chain for ensemble in ensembles]))
        acceptance = np.array([ensemble.acceptance for ensemble in ensembles])
        diagnosis = diagnose(target.posterior.names, chains, acceptance, options.target_ess)
        done = min(1.0, diagnosis.ess / options.target_ess)
        elapsed = time.perf_counter() - started
        report(Progress("sampling", done, diagnosis, elapsed / max(done, 1e-3) - elapsed))
        if diagnosis.converged or steps >= options.max_steps:
            return chains, diagnosis
