"""Reference posteriors by two methods: long runs of our ensembles, and importance sampling of its own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from measures import HERE, PROBABILITIES, Reference, of_ensembles, of_weighted
from problems import DRIVES, Problem, simulated_study
from scipy.special import logsumexp
from threadpoolctl import threadpool_limits

from bayesterra.arrays import FloatArray
from bayesterra.sampling.adaptation import AdaptationOptions, adapt
from bayesterra.sampling.sampler import sample
from bayesterra.stats.diagnostics import array_ess
from bayesterra.stats.mixture import pareto_smoothed
from bayesterra.study.schema import SamplingOptions

RUNS, WALKERS, TARGET = 3, 128, 25_000
PROPOSALS, WEIGHTED = 4, 150_000
DRAWS = 10_000


@dataclass(frozen=True)
class Weighted:
    """Weighted draws (n, d) and Pareto k̂ of their weights."""

    x: FloatArray
    log_weights: FloatArray
    k: float


def long_runs(problem: Problem, seed: int = 1000) -> FloatArray:
    """Chains (ensembles, steps, walkers, d) of several runs, each of four ensembles."""
    options = SamplingOptions(target_ess=TARGET, ensembles=4, walkers=WALKERS)
    plan = AdaptationOptions(particles=2048)
    runs = [
        sample(problem.target.posterior, options, stream, adaptation=plan).chains
        for stream in np.random.SeedSequence(seed).spawn(RUNS)
    ]
    steps = min(run.shape[1] for run in runs)
    return np.concatenate([run[:, :steps] for run in runs])


def weighted_draws(problem: Problem, seed: int = 2000) -> Weighted:
    """Draws of several mixtures, each fitted on its own way from the prior, weighed against them all."""
    target, plan = problem.target, AdaptationOptions(particles=2048)
    parts, laws = [], []
    for stream in np.random.SeedSequence(seed).spawn(PROPOSALS):
        rng = np.random.default_rng(stream)
        start = target.coordinates.from_physical(problem.prior_draws(plan.particles, rng))
        laws.append(adapt(target.densities, start, plan, rng).proposal)
        parts.append(laws[-1].sample(WEIGHTED, rng))
    u = np.concatenate(parts)
    pooled = logsumexp([law.log_density(u) for law in laws], axis=0) - np.log(PROPOSALS)
    weights = target.log_density(u) - pooled
    known = np.isfinite(weights)
    smoothed, k = pareto_smoothed(weights[known])
    return Weighted(target.coordinates.to_physical(u[known])[0], smoothed, k)


def near_independent(chains: FloatArray, rng: np.random.Generator) -> FloatArray:
    """``DRAWS`` draws (n, d), as far apart as the chains allow, in random order."""
    ensembles, steps, walkers, d = chains.shape
    rounds = -(-DRAWS // (ensembles * walkers))
    kept = chains[:, :: steps // rounds][:, :rounds].reshape(-1, d)
    return np.asarray(rng.permutation(kept)[:DRAWS])


def make(drive: str) -> None:
    """Make and store the reference of a drive; print how the two methods agree."""
    problem = Problem(simulated_study(drive))
    with threadpool_limits(limits=1):
        chains, other = long_runs(problem), weighted_draws(problem)
    flat = chains.reshape(-1, chains.shape[-1])
    draws = near_independent(chains, np.random.default_rng(0))
    quantiles = np.quantile(flat, PROBABILITIES, axis=0)
    blank = Reference(draws, flat.mean(axis=0), flat.std(axis=0), quantiles, np.inf)
    long = of_ensembles(chains, blank)
    reference = Reference(draws, blank.mean, blank.sd, quantiles, min(long.bulk, long.tail))
    second = of_weighted(other.x, other.log_weights, reference)
    checks = {
        "long_run_ess": reference.ess,
        "long_run_r_hat": long.r_hat,
        "weighted_ess": second.bulk,
        "pareto_k": other.k,
        "worst_difference": second.worst,
        "lag_1": _lag_1(draws),
        "draws_ess": min(array_ess(column.reshape(4, -1)) for column in draws.T),
    }
    _store(HERE / f"reference-{drive}.npz", reference, checks)
    print(drive, {name: round(value, 4) for name, value in checks.items()}, flush=True)
    print(np.round(second.errors, 2))


def _lag_1(draws: FloatArray) -> float:
    """Largest autocorrelation of draws (n, d) in the order stored."""
    z = (draws - draws.mean(axis=0)) / draws.std(axis=0)
    return float(np.abs((z[1:] * z[:-1]).mean(axis=0)).max())


def _store(path: Path, reference: Reference, checks: dict[str, float]) -> None:
    np.savez_compressed(
        path,
        draws=reference.draws.astype(np.float32),
        mean=reference.mean,
        sd=reference.sd,
        quantiles=reference.quantiles,
        ess=np.array(reference.ess),
        **{name: np.array(value) for name, value in checks.items()},
    )


def main() -> None:
    """Make both."""
    for drive in DRIVES:
        make(drive)
