"""Several independent ensembles, run in fixed rounds until the diagnosis is satisfied."""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import repeat
from threading import Lock
from typing import Any

import numpy as np
from numpy.random import SeedSequence, default_rng
from threadpoolctl import threadpool_limits

from bayesterra.arrays import FloatArray, spaced
from bayesterra.errors import StudyError
from bayesterra.likelihood.integrated import Integrated, integrated
from bayesterra.likelihood.posterior import Density, Posterior, draw_cut_prior
from bayesterra.models.kernels.cache import told_of_compiling
from bayesterra.runtime.checkpoints import CheckpointStore, check_drift, load_or_compute
from bayesterra.runtime.engines import usable_processors
from bayesterra.runtime.status import Status
from bayesterra.sampling.adaptation import Adaptation, AdaptationOptions, adapt
from bayesterra.sampling.coordinates import Coordinates, coordinates
from bayesterra.sampling.ensemble import Ensemble, EnsembleState, Segment
from bayesterra.stats.diagnostics import Diagnosis, diagnose, thinning
from bayesterra.stats.transport import TransportMap
from bayesterra.study.schema import SamplingOptions

WARM_UP_STEPS = 50
ROUND_STEPS, SOONEST = 50, 100
"""Steps of a round, and steps before which only short runs are asked whether they have converged."""
BRIEF = 1e-3
"""Seconds of a call for all walkers below which threads wait for each other longer than they work side by side."""
DENSE_ROUNDS = 20
"""Rounds n of which twice as many are all diagnosed, then every second up to 3n, every third up to 4n, and so on."""


def is_diagnosed(number: int) -> bool:
    """Whether the round of that number, from 1, is diagnosed: a diagnosis of all draws is dear by and by."""
    return number % max(1, number // DENSE_ROUNDS) == 0


@dataclass(frozen=True)
class Progress:
    """State of a progress bar: the stage, and once sampling, the latest diagnosis and time left (s).

    ``step`` says what of the stage is at work, ``steps`` how many of them were begun, where that is known.
    """

    stage: str
    done: float
    diagnosis: Diagnosis | None = None
    seconds_left: float | None = None
    step: str = ""
    steps: int | None = None

    def note_in(self, status: Status) -> None:
        """Tell those who poll; steps of a stage at most twice a second."""
        diagnosis = self.diagnosis
        figures = {} if diagnosis is None else {"ess": diagnosis.ess, "r_hat": diagnosis.worst_r_hat}
        steps = self.steps if diagnosis is None else diagnosis.steps
        status.note(self.stage, self.done, self.seconds_left, steps=steps, now=not self.step, **figures)


@dataclass(frozen=True)
class Samples:
    """Draws of all ensembles and how they were made."""

    names: tuple[str, ...]  # free parameters, the last axis of ``chains``
    chains: FloatArray  # physical parameters (ensembles, steps, walkers, d), SI and radians
    acceptance: FloatArray  # share of accepted steps (ensembles, walkers)
    diagnosis: Diagnosis  # the verdict
    adaptations: tuple[Adaptation, ...]  # what each ensemble adapted to before its draws were kept
    target: "Target"  # what the walkers moved in
    seconds: dict[str, float] = field(default_factory=dict)  # wall time by stage, that of earlier processes included
    earlier: float = 0.0  # wall time spent by earlier processes, s


@dataclass(frozen=True)
class Target:
    """A posterior in sampling coordinates.

    ``integrated`` is the posterior where estimated noise was integrated out of it; None where nothing was.
    """

    posterior: Density
    coordinates: Coordinates
    integrated: Integrated | None = None

    @classmethod
    def of(cls, posterior: Posterior, *, fewest: bool = False) -> "Target":
        """A posterior in coordinates of its own; with ``fewest``, noise that can be integrated out of it is."""
        inner = integrated(posterior) if fewest else None
        return cls(inner or posterior, coordinates(inner or posterior), inner)

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters, what is integrated out among them."""
        return self.integrated.whole.names if self.integrated else self.posterior.names

    def completed(self, chains: FloatArray, seed: SeedSequence) -> FloatArray:
        """Chains (..., k) with what was integrated out, (..., d): drawn given the rest."""
        if self.integrated is None:
            return chains
        x = self.integrated.completed(chains.reshape(-1, chains.shape[-1]), default_rng(seed))
        return x.reshape(*chains.shape[:-1], -1)

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

    def straightened(self, transport_map: TransportMap) -> Callable[[FloatArray], FloatArray]:
        """Log density (n,) in straight coordinates (n, d)."""

        def log_density(v: FloatArray) -> FloatArray:
            u, log_jacobian = transport_map.forward(v)
            return self.log_density(u) + log_jacobian

        return log_density


@dataclass(frozen=True)
class RunningEnsemble:
    """One ensemble, which moves in its own straightened coordinates, and how it got there."""

    target: Target
    adaptation: Adaptation
    ensemble: Ensemble

    @property
    def chain(self) -> FloatArray:
        """Kept draws in physical parameters, (steps, walkers, d)."""
        chain = self.ensemble.chain
        u, _ = self.adaptation.proposal.transport_map.forward(chain.reshape(-1, chain.shape[-1]))
        return self.target.coordinates.to_physical(u)[0].reshape(chain.shape)


@dataclass(frozen=True)
class InitialisedEnsemble:
    """Ensemble after its adaptation: the result, its state then, and the wall time so far (s)."""

    adaptation: Adaptation
    stand: EnsembleState
    seconds: float

    def walk(self, target: Target) -> RunningEnsemble:
        """The ensemble that starts there."""
        proposal = self.adaptation.proposal
        straight = target.straightened(proposal.transport_map)
        return RunningEnsemble(target, self.adaptation, Ensemble(straight, self.stand, proposal.mixture))


@dataclass(frozen=True)
class SamplingRound:
    """Segments of all ensembles in one round, and the wall time so far (s)."""

    legs: tuple[Segment, ...]
    seconds: float


class Clock:
    """Wall time since the sampling began, that of earlier processes included."""

    def __init__(self) -> None:
        self.earlier, self._zero = 0.0, time.perf_counter()

    def elapsed(self) -> float:
        """Seconds so far."""
        return self.earlier + time.perf_counter() - self._zero

    def resume(self, seconds: float) -> None:
        """Go on from what an earlier process had come to."""
        self.earlier = max(self.earlier, seconds)


def sample(
    posterior: Posterior | Target,
    options: SamplingOptions,
    seed: SeedSequence,
    report: Callable[[Progress], None] = lambda progress: None,
    adaptation: AdaptationOptions | None = None,
    checkpoint_store: CheckpointStore | None = None,
    enough: Callable[[Diagnosis], bool] | None = None,
    ensembles: int | None = None,
) -> Samples:
    """Sample a posterior with independent ensembles.

    Every ensemble starts from its own draws of the cut prior, adapts alone and then samples with frozen
    proposals. Rounds have a fixed length and threads share nothing, so draws depend on the seed only. Estimated
    noise that can be integrated out is, and drawn at the end.

    Parameters
    ----------
    posterior : what to sample; a target brings coordinates of its own, and nothing of it is integrated out.
    options : effective draws asked for, number of ensembles and walkers, most steps.
    seed : root of all random streams of this call.
    report : called with a :class:`Progress` after each stage and round.
    adaptation : size of the adaptation; default :class:`AdaptationOptions`.
    checkpoint_store : where every finished adaptation and round is saved. What it holds already is taken from
        there, and the draws are the same to the last bit as if nothing had been.
    enough : asked after each diagnosed round whether that will do; by default it goes on until it has converged.
    ensembles : so many in place of those of the options, which are four at least.

    Raises
    ------
    StudyError : every parameter is fixed.
    ResultError : walkers in the checkpoint store have another density here than where they were saved.
    """
    target = posterior if isinstance(posterior, Target) else Target.of(posterior, fewest=True)
    if not target.posterior.names:
        raise StudyError("every parameter is fixed: there is nothing to sample")
    plan, store, clock = adaptation or AdaptationOptions(), checkpoint_store or CheckpointStore(), Clock()
    *streams, last = seed.spawn((ensembles or options.ensembles) + 1)
    task = _Task(target, options, plan, store, clock, Steps(report), last, enough)
    workers = min(len(streams), usable_processors())
    with threadpool_limits(limits=1), ThreadPoolExecutor(workers) as pool:
        report(Progress("adapting", 0.0))
        begun = list((pool.map if workers > 1 else map)(task.begun, range(len(streams)), streams))
        walks = [initialised.walk(target) for initialised in begun]
        adapting = max(initialised.seconds for initialised in begun)
        chains, diagnosis = task.produce(walks, adapting, pool, report)
    acceptance = np.array([walk.ensemble.acceptance for walk in walks])
    seconds = {"adaptation": adapting, "production": clock.elapsed() - adapting}
    made = (tuple(walk.adaptation for walk in walks), target, seconds, clock.earlier)
    return Samples(target.names, chains, acceptance, diagnosis, *made)


class Steps:
    """Reports the steps of ensembles that adapt at the same time, one at a time."""

    def __init__(self, report: Callable[[Progress], None]) -> None:
        self._report, self._lock, self._count = report, Lock(), 0

    def of(self, number: int | None) -> Callable[[str], None]:
        """Function to which ensemble ``number`` tells its steps, or all of them at once."""

        def told(step: str) -> None:
            with self._lock:
                self._count += 1
                named = step if number is None else f"ensemble {number + 1}: {step}"
                self._report(Progress("adapting", 0.0, step=named, steps=self._count))

        return told


@dataclass(frozen=True)
class _Task:
    """Task of sampling: the target, how it is sampled, and what was done of it already."""

    target: Target
    options: SamplingOptions
    plan: AdaptationOptions
    checkpoint_store: CheckpointStore
    clock: Clock
    watch: Steps
    last: SeedSequence  # of what is drawn given the rest
    enough: Callable[[Diagnosis], bool] | None  # None: what has converged

    def begun(self, number: int, stream: SeedSequence) -> InitialisedEnsemble:
        """An adapted ensemble, from the checkpoint store where it is there."""
        adapted = partial(self._adapted, number, stream)
        saved = self.checkpoint_store.holds(name := f"ensemble-{number + 1}")
        begun = load_or_compute(self.checkpoint_store, name, InitialisedEnsemble, adapted)
        if saved:
            self.clock.resume(begun.seconds)
            check_drift(begun.walk(self.target).ensemble.drift())
        return begun

    def _adapted(self, number: int, stream: SeedSequence) -> InitialisedEnsemble:
        """Adapt one ensemble from its own prior draws and walk it a little, unrecorded."""
        adapting, walking = stream.spawn(2)
        rng, watch = default_rng(adapting), self.watch.of(number)
        target, walkers = self.target, self.options.walkers
        prior = draw_cut_prior(target.posterior, max(self.plan.particles, walkers), rng)
        start = target.coordinates.from_physical(prior.x)
        adaptation = adapt(target.densities, start, self.plan, rng, watch)
        chosen = rng.choice(len(adaptation.u), size=walkers, replace=False)
        straight, mixture = adaptation.proposal.transport_map, adaptation.proposal.mixture
        begin, _ = straight.inverse(adaptation.u[chosen])
        ensemble = Ensemble(target.straightened(straight), begin, mixture, walking)
        watch("first steps")
        ensemble.advance(WARM_UP_STEPS, keep=False)
        return InitialisedEnsemble(adaptation, ensemble.state, self.clock.elapsed())

    def produce(
        self, walks: list[RunningEnsemble], since: float, pool: Executor, report: Callable[[Progress], None]
    ) -> tuple[FloatArray, Diagnosis]:
        """Advance all ensembles round by round until the diagnosis passes or the steps run out."""
        steps, number, drawn = 0, 0, list[FloatArray]()
        names, most, target_ess = self.target.names, self.options.max_steps, self.options.target_ess
        while True:
            number += 1
            steps += self._round(number, min(ROUND_STEPS, most - steps), walks, pool)
            if self.checkpoint_store.holds(f"round-{number + 1:04d}"):
                continue  # an earlier process went on from here
            if steps < most and (not is_diagnosed(number) or (self.enough is None and steps < SOONEST)):
                continue
            chains = np.array([walk.chain for walk in walks])
            for begun in range(sum(part.shape[1] for part in drawn), steps, ROUND_STEPS):
                fresh = chains[:, begun : begun + ROUND_STEPS]
                drawn.append(self.target.completed(fresh, *self.last.spawn(1)))
            chains = np.concatenate(drawn, axis=1)
            acceptance = np.array([walk.ensemble.acceptance for walk in walks])
            early = self.enough is None and steps < most
            diagnosis = diagnose(names, chains, acceptance, target_ess, going_on=early)
            done = min(1.0, diagnosis.ess / target_ess)
            elapsed = self.clock.elapsed() - since
            report(Progress("sampling", done, diagnosis, elapsed / max(done, 1e-3) - elapsed))
            if steps >= most or (diagnosis.converged if self.enough is None else self.enough(diagnosis)):
                return chains, diagnosis

    def _round(self, number: int, length: int, walks: list[RunningEnsemble], pool: Executor) -> int:
        """Let all ensembles take a round, or follow the one in the checkpoint store; the steps that it has."""
        ensembles = [walk.ensemble for walk in walks]

        def taken() -> SamplingRound:
            started = time.perf_counter()
            ensembles[0].drift()
            each = map if time.perf_counter() - started < BRIEF else pool.map
            return SamplingRound(tuple(each(Ensemble.segment, ensembles, repeat(length))), self.clock.elapsed())

        saved = self.checkpoint_store.holds(name := f"round-{number:04d}")
        taken_or_saved = load_or_compute(self.checkpoint_store, name, SamplingRound, taken)
        for ensemble, segment in zip(ensembles, taken_or_saved.legs, strict=True):
            ensemble.follow(segment)
        if saved:
            self.clock.resume(taken_or_saved.seconds)
            check_drift(max(ensemble.drift() for ensemble in ensembles))
        return len(taken_or_saved.legs[0].chain)


PRIOR_DRAWS = 4000


@dataclass(frozen=True)
class ThinnedDraws:
    """Near-independent draws of all ensembles."""

    chains: FloatArray  # (ensembles, draws, d), laid walker after walker
    labels: dict[str, FloatArray]  # walker and step of every draw, (ensembles, draws) each
    every: int  # one step in ``every`` is kept

    @property
    def flat(self) -> FloatArray:
        """All draws (n, d)."""
        return self.chains.reshape(-1, self.chains.shape[2])

    def spaced(self, most: int) -> FloatArray:
        """Evenly spaced draws (n, d), ``most`` at most."""
        return spaced(self.flat, most)


def thin(chains: FloatArray) -> ThinnedDraws:
    """Thin chains (ensembles, steps, walkers, d) to near independence and lay them walker after walker."""
    every = thinning(np.ascontiguousarray(np.moveaxis(chains, -1, 0)))
    thinned = chains[:, ::every].swapaxes(1, 2)
    ensembles, walkers, steps, d = thinned.shape
    walker, step = np.divmod(np.arange(walkers * steps), steps)
    labels = {"walker": np.tile(walker, (ensembles, 1)), "step": np.tile(step * every, (ensembles, 1))}
    return ThinnedDraws(thinned.reshape(ensembles, walkers * steps, d), labels, every)


def of_diagnosis(diagnosis: Diagnosis) -> dict[str, Any]:
    """The verdict on the sampling, with every threshold and value."""
    return {
        "converged": diagnosis.converged,
        "ess": diagnosis.ess,
        "r_hat": diagnosis.worst_r_hat,
        "checks": [asdict(check) for check in diagnosis.checks],
    }


def of_samples(samples: Samples, every: int) -> dict[str, Any]:
    """Record of how the draws were made; ``every`` is the step between kept draws."""
    diagnosis, adaptations = samples.diagnosis, samples.adaptations
    return {
        "acceptance": diagnosis.acceptance,
        "steps": diagnosis.steps,
        "kept_one_step_in": every,
        "tau": dict(zip(samples.names, diagnosis.tau.tolist(), strict=True)),
        "temperatures": [len(adaptation.temperatures) - 1 for adaptation in adaptations],
        "proposal_efficiency": [adaptation.efficiency for adaptation in adaptations],
        "log_evidence": [adaptation.log_evidence for adaptation in adaptations],
    }


@contextmanager
def progress_bar(status: Status, *, quiet: bool) -> Iterator[Callable[[Progress], None]]:
    """A progress bar on standard error, on a terminal and unless ``quiet``; what it is told is noted too."""
    from bayesterra.report.terminal import shown_bar

    with shown_bar("reading", show=not quiet) as tell:

        def update(progress: Progress) -> None:
            progress.note_in(status)
            tell(progress.stage, progress.done, _figures(progress))

        with told_of_compiling(lambda name: update(Progress("compiling", 0.0))):
            yield update


def _figures(progress: Progress) -> str:
    """Acceptance, effective draws, R-hat and time left, once they are known."""
    diagnosis = progress.diagnosis
    if diagnosis is None:
        return "the models, once on this machine" if progress.stage == "compiling" else ""
    left = f", {progress.seconds_left:.0f} s left" if progress.seconds_left else ""
    agreement = f", R-hat {diagnosis.worst_r_hat:.3f}" if np.isfinite(diagnosis.worst_r_hat) else ""
    return f"{diagnosis.ess:.0f} effective draws{agreement}, acceptance {diagnosis.acceptance:.2f}{left}"
