"""Sampler of a joint posterior: groups alone, warm-up runs, then all together."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng
from scipy.optimize import brentq
from scipy.special import logsumexp
from threadpoolctl import threadpool_limits

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.joint import JointPosterior, Whole
from bayesterra.runtime.checkpoints import CheckpointStore, Segment
from bayesterra.runtime.engines import usable_processors
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.sampling.family import ConditionalLaw, JointFamily, fit_conditional
from bayesterra.sampling.moves import (
    Counts,
    Family,
    JointSegment,
    Laws,
    PooledEnsemble,
    Walkers,
    load_or_make_segment,
    run_together,
)
from bayesterra.sampling.sampler import Progress, Samples, Steps, Target, is_diagnosed, sample
from bayesterra.stats.diagnostics import STEPS_PER_TAU, Diagnosis, diagnose
from bayesterra.stats.transport import fit_proposal
from bayesterra.study.schema import SamplingOptions

ROUND_SWEEPS = 100
STARTS = 2048
"""Points that every ensemble fits its first laws to."""
START_SHARE = 0.05
"""Effective share of candidates that the first draws of shared parameters keep; weights are tempered."""
PATIENCE, REFITS, NEARLY = 600, 3, 0.5
"""Sweeps without convergence after which laws are fitted anew, twice as many each time, and how often; share of the
draws and sweeps asked for from which on the run goes on instead."""
LONE_ESS, LONE_STEPS = 4000, 4000
"""Effective draws asked of each group alone, and steps that it may take, at most; not more than of all."""


@dataclass(frozen=True)
class PoolingOptions:
    """Sweeps of each warm-up, after which all laws are fitted anew, and adaptation of each group alone."""

    warm_ups: tuple[int, ...] = (30, 60, 120, 240)
    lone: AdaptationOptions = field(default_factory=AdaptationOptions)


@dataclass(frozen=True)
class JointSamples:
    """Draws of all ensembles and how they were made."""

    joint: JointPosterior  # what was sampled
    chains: FloatArray  # physical parameters (ensembles, steps, walkers, d), SI and radians
    acceptance: FloatArray  # share of accepted proposals of groups' locals (ensembles, walkers)
    diagnosis: Diagnosis  # the verdict
    lone: Mapping[str, Samples]  # samples of each group alone under the stated prior, by group
    laws: tuple[Laws, ...]  # each ensemble's frozen laws, of shared values and of every group's locals
    moves: Mapping[str, float]  # accepted share of each kind of move, over all ensembles
    seconds: Mapping[str, float]  # wall time by stage; ``processor`` is the processor time of all


@dataclass(frozen=True)
class _Named(CheckpointStore):
    """Checkpoint store under names of its own."""

    checkpoint_store: CheckpointStore
    prefix: str

    def holds(self, name: str) -> bool:
        return self.checkpoint_store.holds(f"{self.prefix}-{name}")

    def load(self, name: str) -> Segment | None:
        return self.checkpoint_store.load(f"{self.prefix}-{name}")

    def save(self, name: str, segment: Segment) -> None:
        self.checkpoint_store.save(f"{self.prefix}-{name}", segment)


def sample_groups(
    joint: JointPosterior,
    options: SamplingOptions,
    seed: SeedSequence,
    report: Callable[[Progress], None] = lambda progress: None,
    adaptation: AdaptationOptions | None = None,
    checkpoint_store: CheckpointStore | None = None,
) -> dict[str, Samples]:
    """Sample each group's posterior alone, under the stated prior: no pooling."""
    asked = replace(options, target_ess=min(options.target_ess, LONE_ESS), max_steps=min(options.max_steps, LONE_STEPS))
    samples = {}
    for number, (stream, (group, posterior)) in enumerate(
        zip(seed.spawn(len(joint.groups)), joint.groups.items(), strict=True)
    ):
        own = _Named(checkpoint_store or CheckpointStore(), f"group-{number + 1}")
        samples[group] = sample(Target.of(posterior), asked, stream, report, adaptation, own)
        report(Progress(f"group {group} alone", (number + 1) / len(joint.groups)))
    return samples


def sample_joint(
    joint: JointPosterior,
    options: SamplingOptions,
    seed: SeedSequence,
    report: Callable[[Progress], None] = lambda progress: None,
    plan: PoolingOptions | None = None,
    checkpoint_store: CheckpointStore | None = None,
) -> JointSamples:
    """Sample a joint posterior with independent ensembles; see :mod:`bayesterra.sampling.moves`.

    Ensemble e begins with what ensemble e of every group alone found; ensembles share the length of warm-ups alone.

    Parameters
    ----------
    options, report : as for :func:`bayesterra.sampling.sampler.sample`.
    seed : root of all random streams; the draws depend on nothing else, whatever the number of cores.
    plan : size of the adaptation.
    checkpoint_store : where every finished adaptation and round is saved. What it holds already is taken from
        there, and the draws are the same to the last bit as if nothing had been.

    Raises
    ------
    ResultError : walkers in the checkpoint store have another density here than where they were saved.
    """
    plan, checkpoint_store = plan or PoolingOptions(), checkpoint_store or CheckpointStore()
    started, processor = time.perf_counter(), time.process_time()
    alone, *streams = seed.spawn(1 + options.ensembles)
    lone = sample_groups(joint, options, alone, report, plan.lone, checkpoint_store)
    apart = time.perf_counter()
    family = JointFamily(joint)
    _ = family.widths  # before threads ask for it

    watch = Steps(report)

    def begun_by(number: int) -> PooledEnsemble:
        rng = default_rng(streams[number])
        chains = {group: samples.chains[number] for group, samples in lone.items()}
        watch.of(number)("first laws")
        return begun(family, *starting_points(family, chains, rng), options.walkers, rng)

    with threadpool_limits(limits=1), ThreadPoolExecutor(min(options.ensembles, usable_processors())) as pool:

        def adapting() -> JointSegment:
            report(Progress("adapting", 0.0))
            starts = list(pool.map(begun_by, range(options.ensembles)))
            return JointSegment.of(warmed_up(starts, plan.warm_ups, watch.of(None), pool.map), 0)

        _, ensembles = load_or_make_segment(checkpoint_store, "joint-begun", family, adapting)
        adapted = time.perf_counter()
        chains, acceptance, diagnosis, ensembles = _produced(family, ensembles, options, pool, report, checkpoint_store)
    moves = Counts.of(ensembles).shares
    seconds = {
        "groups alone": apart - started,
        "adaptation": adapted - apart,
        "production": time.perf_counter() - adapted,
        "processor": time.process_time() - processor,
    }
    laws = tuple(ensemble.laws for ensemble in ensembles)
    return JointSamples(joint, chains, acceptance, diagnosis, lone, laws, moves, seconds)


def sample_whole(
    target: Whole, options: SamplingOptions, seed: SeedSequence, report: Callable[[Progress], None]
) -> Samples | JointSamples:
    """Sample the posterior of a study, with or without groups."""
    if target.grouped:
        return sample_joint(target, options, seed, report)
    return sample(target, options, seed, report)


def _produced(
    family: JointFamily,
    ensembles: list[PooledEnsemble],
    options: SamplingOptions,
    pool: ThreadPoolExecutor,
    report: Callable[[Progress], None],
    checkpoint_store: CheckpointStore,
) -> tuple[FloatArray, FloatArray, Diagnosis, list[PooledEnsemble]]:
    """Rounds of sweeps until the diagnosis passes; walkers in far tails have laws fitted anew after ``PATIENCE``."""
    kept, since, number, refits, steps = list[JointSegment](), time.perf_counter(), 0, 0, 0
    while True:
        number += 1
        length = min(ROUND_SWEEPS, options.max_steps - steps)
        segment, ensembles = load_or_make_segment(
            checkpoint_store, f"joint-round-{number:04d}", family, partial(JointSegment.of, ensembles, length)
        )
        kept.append(segment)
        steps += segment.D.shape[1]
        going_on = steps < options.max_steps
        refitting = refits < REFITS and steps >= PATIENCE * 2**refits
        if going_on and not refitting and not is_diagnosed(number):
            continue
        chains = np.concatenate([_physical(family, each) for each in kept], axis=1)
        accepted = np.average([each.share for each in kept], axis=0, weights=[each.D.shape[1] for each in kept])
        diagnosis = diagnose(family.joint.names, chains, accepted, options.target_ess, going_on=going_on)
        done = min(1.0, diagnosis.ess / options.target_ess)
        elapsed = time.perf_counter() - since
        report(Progress("sampling", done, diagnosis, elapsed / max(done, 1e-3) - elapsed))
        if diagnosis.converged or not going_on:
            return chains, accepted, diagnosis, ensembles
        refits += refitting
        if refitting and min(done, steps / (STEPS_PER_TAU * diagnosis.tau.max())) < NEARLY:
            report(Progress("sampling", done, diagnosis, step="fitting laws anew"))
            D, L = (np.concatenate(of, axis=1) for of in zip(*((each.D, each.L) for each in kept), strict=True))
            ensembles, kept, steps = list(pool.map(refitted, ensembles, D, L)), [], 0


def _physical(family: JointFamily, segment: JointSegment) -> FloatArray:
    """Physical parameters (ensembles, sweeps, w, d) of a segment."""
    D, L = segment.D, segment.L
    shared = family.shared_to_physical(D.reshape(-1, D.shape[-1]))[0].reshape(D.shape)
    each = [family.group_to_physical(g, L[:, :, g].reshape(-1, L.shape[-1]))[0] for g in range(family.groups)]
    return family.joint.joined(shared, np.stack(each, axis=1).reshape(*D.shape[:3], family.groups, -1))


def starting_points(
    family: JointFamily, chains: Mapping[str, FloatArray], rng: Generator
) -> tuple[FloatArray, FloatArray]:
    """Shared values (n, k) and locals (groups, n, d) spread roughly like the joint posterior.

    Shared parameters are drawn from the product of the groups' posteriors of them, tempered where these
    hardly overlap; locals from each group's law given them; populations from the locals. ``chains`` are one
    ensemble's draws of each group alone, physical (steps, walkers, d).
    """
    joint, k = family.joint, len(family.joint.shared)
    draws = [group_coordinates(family, g, chain, rng) for g, chain in enumerate(chains.values())]
    if k:
        laws = [fit_conditional(S, L, family.widths, rng) for S, L in draws]
        S = _common(family, laws, np.concatenate([S for S, _ in draws]), rng)
        L = np.stack([law.sample(S, rng)[0] for law in laws])
    else:
        S = np.empty((STARTS, 0))
        L = np.stack([own[rng.integers(len(own), size=STARTS)] for _, own in draws])
    shared = np.concatenate([S, np.zeros((STARTS, 2 * len(joint.populations)))], axis=1)
    if joint.populations:
        physical = [np.empty((STARTS, 0))]
        own = np.stack([family.group_to_physical(g, L[g])[0] for g in range(family.groups)])
        for name, (mean, spread) in joint.hyper.items():
            values = own[:, :, joint.local.index(name)]
            low, high = mean.quantile(np.array([0.005, 0.995]))
            least, most = spread.quantile(np.array([0.02, 0.98]))
            physical.append(np.clip(values.mean(axis=0), low, high)[:, None])
            physical.append(np.clip(values.std(axis=0), least, most)[:, None])
        shared[:, k:] = family._hyper.from_physical(np.concatenate(physical, axis=1))
        for _ in range(5):
            chance = rng.random((STARTS, family.chances))
            (shared,) = family.refreshed(shared, family.placed(shared)[0], np.moveaxis(L, 0, 1), chance)
    return shared, L


def group_coordinates(
    family: JointFamily, group: int, chain: FloatArray, rng: Generator
) -> tuple[FloatArray, FloatArray]:
    """Coordinates of shared (n, k) and own (n, d) parameters in ``FITTED`` draws of a group alone."""
    x = chain.reshape(-1, chain.shape[-1])
    x = x[rng.choice(len(x), size=min(FITTED, len(x)), replace=False)]
    shared, local = family.joint._columns
    return family._shared.from_physical(x[:, shared]), family.group_from_physical(group, x[:, local])


def _common(family: JointFamily, laws: list[ConditionalLaw], candidates: FloatArray, rng: Generator) -> FloatArray:
    """Shared coordinates (n, k) drawn from the candidates by the product of the groups' densities."""
    joint, k = family.joint, len(family.joint.shared)
    x, log_jacobian = family._shared.to_physical(candidates)
    prior = log_jacobian.copy()
    for i, name in enumerate(joint.shared):
        prior += joint.laws[name].log_density(x[:, i])
    inside = np.isfinite(prior)
    prior[inside] += joint.log_dependence_of_shared(x[inside])
    candidates, prior = candidates[inside], prior[inside]
    each = np.array([law.log_given(candidates) for law in laws])
    level = each.sum(axis=0) - (len(laws) - 1) * prior - logsumexp(each, axis=0)

    def excess(power: float) -> float:
        weights = power * (level - level.max())
        share = 2 * logsumexp(weights) - logsumexp(2 * weights) - np.log(len(weights))
        return float(np.exp(share) - START_SHARE)

    power = 1.0 if excess(1.0) >= 0 else float(brentq(excess, 0.0, 1.0, rtol=1e-3))
    weights = np.exp(power * (level - level.max()))
    chosen = rng.choice(len(candidates), size=STARTS, p=weights / weights.sum())
    jitter = 0.2 * candidates[chosen].std(axis=0)
    return np.asarray(candidates[chosen] + jitter * rng.standard_normal((STARTS, k)))


JointDraws = tuple[FloatArray, FloatArray]
"""Shared values (n, k) and locals (groups, n, d)."""


def flattened(D: FloatArray, L: FloatArray) -> JointDraws:
    """Draws of sweeps, (sweeps, w, k) and (sweeps, groups, w, d), walker after walker: so some of them are of all."""
    flat = D.swapaxes(0, 1).reshape(-1, D.shape[-1])
    return flat, np.moveaxis(L, 0, 2).reshape(L.shape[1], len(flat), -1)


LOST, ENOUGH = 10, 0.3
"""Sweeps of a warm-up that no law is fitted to; accepted share of values proposed anew that makes laws good enough."""
FITTED = 8192
"""Most draws that laws are fitted to."""
FEWEST, MOST, DRAWS_PER_COMPONENT = 8, 16, 500
"""Components of a law: more of them on few draws have thin tails."""


def fit_laws(family: Family, D: FloatArray, L: FloatArray, rng: Generator) -> Laws:
    """Fit all proposals to draws of shared values (n, k) and locals (groups, n, d)."""
    every = max(1, -(-len(D) // FITTED))
    D, L = D[::every], L[:, ::every]
    components = min(max(FEWEST, len(D) // DRAWS_PER_COMPONENT), MOST)
    proposal = fit_proposal(D, np.ones(len(D)), D.std(axis=0) + 1e-300, components, 0.1, rng)
    following = [fit_conditional(D, L[g], family.widths, rng, components=components) for g in range(family.groups)]
    return Laws(proposal, tuple(following))


def begun(family: Family, D: FloatArray, L: FloatArray, walkers: int, rng: Generator) -> PooledEnsemble:
    """An ensemble whose laws are fitted to starting points (n, k) and (groups, n, d), some of them in the support."""
    inside = np.isfinite(Walkers.at(family, D, L).log_density)
    D, L = D[inside], L[:, inside]
    laws = fit_laws(family, D, L, rng)
    start = rng.choice(len(D), size=walkers, replace=len(D) < walkers)
    return PooledEnsemble(family, laws, Walkers.at(family, D[start], L[:, start]), rng)


def warmed_up(
    ensembles: Sequence[PooledEnsemble],
    warm_ups: Sequence[int],
    watch: Callable[[str], None] = lambda step: None,
    each: Callable[..., Iterable[PooledEnsemble]] = map,
) -> list[PooledEnsemble]:
    """Ensembles of one family whose laws are fitted to what each of some warm-ups found.

    Parameters
    ----------
    warm_ups : sweeps of each warm-up, of which the first ``LOST`` tell of the start. Those that are left are not
        taken once every ensemble accepts ``ENOUGH`` of what is proposed anew.
    watch : told what is at work, step by step.
    each : ``map``, or that of some threads.
    """
    for sweeps in warm_ups:
        watch(f"pilot run of {sweeps} sweeps")
        D, L, _ = run_together(ensembles, sweeps)
        shares, lost = [ensemble.counts.shares for ensemble in ensembles], min(LOST, sweeps // 2)
        ensembles = list(each(refitted, ensembles, D[:, lost:], L[:, lost:]))
        if min(each[kind] for each in shares for kind in ("locals anew", "drivers anew")) >= ENOUGH:
            break
    return list(ensembles)


def refitted(ensemble: PooledEnsemble, D: FloatArray, L: FloatArray) -> PooledEnsemble:
    """The ensemble where it stands, its laws fitted to draws (sweeps, w, k), (sweeps, groups, w, d) of it."""
    laws = fit_laws(ensemble.family, *flattened(D, L), ensemble.rng)
    return PooledEnsemble(ensemble.family, laws, ensemble.walkers, ensemble.rng)
