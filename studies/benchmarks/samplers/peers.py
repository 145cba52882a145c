"""Samplers of other packages on the same posterior, each within a budget of processor seconds."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from measures import Measured, Reference, of_chains, of_ensembles, of_weighted
from problems import Problem, Space, Unbounded

from bayesterra.arrays import FloatArray
from bayesterra.sampling.sampler import sample
from bayesterra.stats.diagnostics import autocorrelation_time
from bayesterra.study.schema import SamplingOptions

ENSEMBLES, WALKERS = 4, 128
BURN_IN = 10
"""Autocorrelation times that an ensemble of a peer is given to forget its start, at most half its steps."""
TARGET = 20_000
TUNE = 500
"""Steps in which NUTS adapts, per chain."""
DRAWS = {"raw": 500, "ours": 2000}
"""Draws of NUTS, per chain."""


@dataclass(frozen=True)
class Run:
    """What a sampler did: its worth, processor seconds, and a word on how it ended."""

    measured: Measured
    seconds: float
    note: str


@dataclass(frozen=True)
class Job:
    """One sampler's task: parameters, seed, budget (processor seconds) and what to hold its draws against."""

    space: Space
    seed: int
    budget: float
    reference: Reference

    def physical(self, draws: FloatArray) -> FloatArray:
        """Draws (..., d) as physical parameters."""
        return self.space.to_physical(draws.reshape(-1, draws.shape[-1])).reshape(draws.shape)

    def streams(self, n: int) -> list[np.random.Generator]:
        """Independent generators."""
        return [np.random.default_rng(seed) for seed in np.random.SeedSequence(self.seed).spawn(n)]


def bayesterra(job: Job) -> Run:
    """Ours: everything from prior draws to the verdict counts."""
    posterior = job.space.problem.target.posterior
    options = SamplingOptions(target_ess=TARGET)
    started = time.process_time()
    samples = sample(posterior, options, np.random.SeedSequence(job.seed))
    seconds = time.process_time() - started
    note = f"{samples.chains.shape[1]} steps, {'' if samples.diagnosis.converged else 'not '}converged"
    return Run(of_ensembles(samples.chains, job.reference), seconds, note)


def _walked(job: Job, build: Callable[[int], tuple[Any, Callable[[int], FloatArray]]], chunk: int) -> Run:
    """Ensembles advanced in turn, ``chunk`` steps at a time, until the budget is spent."""
    started, walks, kept = (time.process_time(), [build(i) for i in range(ENSEMBLES)], [[] for _ in range(ENSEMBLES)])
    while time.process_time() - started < job.budget:
        for (_, advance), chain in zip(walks, kept, strict=True):
            chain.append(advance(chunk))
    seconds = time.process_time() - started
    chains = job.physical(np.array([np.concatenate(chain) for chain in kept]))
    half = chains[:, chains.shape[1] // 2 :]
    tau = max(float(autocorrelation_time(column).max()) for column in np.moveaxis(half, -1, 0))
    first = int(min(BURN_IN * tau, chains.shape[1] / 2))
    note = f"{chains.shape[1]} steps, {first} of them forgotten, tau {tau:.3g}"
    return Run(of_ensembles(chains[:, first:], job.reference), seconds, note)


def emcee(job: Job) -> Run:
    """The stretch move of emcee, its default."""
    import emcee as library

    streams = job.streams(ENSEMBLES)

    def build(i: int) -> tuple[Any, Callable[[int], FloatArray]]:
        start = job.space.start(WALKERS, streams[i])
        sampler = library.EnsembleSampler(*start.shape, job.space.densities.many, vectorize=True)
        sampler.random_state = np.random.RandomState(job.seed * 100 + i).get_state()
        state = [library.State(start)]

        def advance(steps: int) -> FloatArray:
            sampler.reset()
            state[0] = sampler.run_mcmc(state[0], steps, skip_initial_state_check=True)
            return np.array(sampler.get_chain())

        return sampler, advance

    return _walked(job, build, 200)


def zeus(job: Job) -> Run:
    """The slices of zeus with its default move, which tunes its length scale at the start of every chunk."""
    import zeus as library

    np.random.seed(job.seed)  # noqa: NPY002  zeus knows no other source
    streams = job.streams(ENSEMBLES)

    def build(i: int) -> tuple[Any, Callable[[int], FloatArray]]:
        start = [job.space.start(WALKERS, streams[i])]
        sampler = library.EnsembleSampler(
            *start[0].shape, job.space.densities.many, vectorize=True, verbose=False, maxiter=100_000
        )

        def advance(steps: int) -> FloatArray:
            sampler.reset()
            sampler.run_mcmc(start[0], steps, progress=False)
            start[0] = sampler.get_last_sample()
            return np.array(sampler.get_chain())

        return sampler, advance

    return _walked(job, build, 100)


def _transform(job: Job) -> Callable[[FloatArray], FloatArray]:
    low, high = job.space.limits
    return lambda q: low + q * (high - low)


def dynesty(job: Job, sample: str = "auto") -> Run:
    """The NestedSampler of dynesty: 500 live points, its own choice of moves, until it stops."""
    import dynesty as library

    one = job.space.densities.one
    started = time.process_time()
    sampler = library.NestedSampler(
        lambda u: max(one(u), -1e300), _transform(job), 8, sample=sample, rstate=job.streams(1)[0]
    )
    how = "stopped by itself"
    for step in sampler.sample(dlogz=1e-3 * 499 + 0.01):
        if time.process_time() - started > job.budget:
            how = f"cut, {step.delta_logz:.3g} of log evidence left"
            break
    for _ in sampler.add_live_points():
        pass
    seconds, found = time.process_time() - started, sampler.results
    x = job.physical(found.samples)
    note = f"{how}, {int(np.sum(found.ncall))} calls, {len(x)} points"
    return Run(of_weighted(x, found.logwt, job.reference), seconds, note)


def dynesty_walks(job: Job) -> Run:
    """The same with random walks for moves, which dynesty leaves to more than ten dimensions."""
    return dynesty(job, "rwalk")


def nautilus(job: Job) -> Run:
    """Nested sampling by nautilus as it comes: 2000 live points, 10 000 effective draws, no exploration."""
    import nautilus as library

    many, started = job.space.densities.many, time.process_time()
    sampler = library.Sampler(
        _transform(job), lambda u: np.maximum(many(u), -1e300), n_dim=8, vectorized=True, pass_dict=False, seed=job.seed
    )
    how = "cut"
    while time.process_time() - started < job.budget:
        if sampler.run(timeout=6, discard_exploration=True):
            how = "stopped by itself"
            break
    u, log_weights, _ = sampler.posterior()
    seconds = time.process_time() - started
    return Run(of_weighted(job.physical(u), log_weights, job.reference), seconds, f"{how}, {sampler.n_like} calls")


def nuts(job: Job) -> Run:
    """NUTS by nutpie with exact slopes of the forces: four chains from prior draws, 500 steps to adapt."""
    import nutpie
    from nutpie.compiled_pyfunc import from_pyfunc

    target, starts = Unbounded(job.space), iter(job.streams(64))
    model = from_pyfunc(
        8,
        lambda: target.gradient,
        lambda *_: lambda v: {"u": v},
        [np.dtype("float64")],
        [(8,)],
        ["u"],
        make_initial_point_fn=lambda _: target.start(next(starts)),
    )
    started = time.process_time()
    trace = nutpie.sample(
        model, draws=DRAWS[job.space.name], tune=TUNE, chains=4, cores=1, seed=job.seed, progress_bar=False
    )
    seconds = time.process_time() - started
    chains = np.asarray(trace.posterior["u"])
    divergent = int(np.asarray(trace.sample_stats["diverging"]).sum())
    note = f"{chains.shape[1]} draws a chain, {divergent} divergent"
    return Run(of_chains(job.physical(target.to_space(chains)), job.reference), seconds, note)


PEERS: dict[str, Callable[[Job], Run]] = {
    "emcee": emcee,
    "zeus": zeus,
    "dynesty": dynesty,
    "dynesty-rwalk": dynesty_walks,
    "nautilus": nautilus,
    "nuts": nuts,
}


def run(name: str, problem: Problem, space: str, seed: int, budget: float) -> Run:
    """Run one sampler on one posterior."""
    drive = problem.study.drive
    job = Job(problem.space(space), seed, budget, Reference.load(drive))
    draws = job.space.start(8, np.random.default_rng(0))
    job.space.densities.many(draws)  # compiled by now, like the scalar forms
    job.space.densities.one(draws[0])
    job.space.densities.gradient(draws[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bayesterra(job) if name == "bayesterra" else PEERS[name](job)
