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


@dataclass(frozen=True)
class Walk:
    """One ensemble, which moves in its own straightened coordinates, and how it got there."""

    target: Target
    adaptation: Adaptation
    ensemble: Ensemble

    @property
    def chain(self) -> FloatArray:
        """Kept draws in physical parameters, (steps, walkers, d)."""
        chain = self.ensemble.chain
        u = self.adaptation.proposal.unbending.bend(chain.reshape(-1, chain.shape[-1]))
        return self.target.coordinates.to_physical(u)[0].reshape(chain.shape)


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
        walks = list(pool.map(lambda stream: _prepare(target, options, stream, plan), streams))
        adapting = time.perf_counter() - started
        chains, diagnosis = _produce(walks, options, pool, report)
    acceptance = np.array([walk.ensemble.acceptance for walk in walks])
    seconds = {"adaptation": adapting, "production": time.perf_counter() - started - adapting}
    adaptations = tuple(walk.adaptation for walk in walks)
    return Samples(posterior.names, chains, acceptance, diagnosis, adaptations, target.coordinates, seconds)


def _prepare(target: Target, options: SamplingOptions, stream: SeedSequence, plan: AdaptationOptions) -> Walk:
    """Adapt one ensemble from its own prior draws and walk it a little, unrecorded."""
    adapting, walking = stream.spawn(2)
    rng = default_rng(adapting)
    prior = draw_cut_prior(target.posterior, max(plan.particles, options.walkers), rng)
    adapted = adapt(target.densities, target.coordinates.from_physical(prior.x), plan, rng)
    chosen = rng.choice(len(adapted.u), size=options.walkers, replace=False)
    straight = adapted.proposal.unbending

    def log_density(v: FloatArray) -> FloatArray:
        return target.log_density(straight.bend(v))

    start = straight.straighten(adapted.u[chosen])
    ensemble = Ensemble(log_density, start, adapted.proposal.mixture, walking)
    ensemble.advance(WARM_UP_STEPS, keep=False)
    return Walk(target, adapted, ensemble)


def _produce(
    walks: list[Walk], options: SamplingOptions, pool: Executor, report: Callable[[Progress], None]
) -> tuple[FloatArray, Diagnosis]:
    """Advance all ensembles round by round until the diagnosis passes or the steps run out."""
    started, steps = time.perf_counter(), 0
    ensembles, names = [walk.ensemble for walk in walks], walks[0].target.posterior.names
    while True:
        length = min(ROUND_STEPS, options.max_steps - steps)
        list(pool.map(Ensemble.advance, ensembles, repeat(length)))
        steps += length
        chains = np.array([walk.chain for walk in walks])
        acceptance = np.array([ensemble.acceptance for ensemble in ensembles])
        diagnosis = diagnose(names, chains, acceptance, options.target_ess)
        done = min(1.0, diagnosis.ess / options.target_ess)
        elapsed = time.perf_counter() - started
        report(Progress("sampling", done, diagnosis, elapsed / max(done, 1e-3) - elapsed))
        if diagnosis.converged or steps >= options.max_steps:
            return chains, diagnosis
