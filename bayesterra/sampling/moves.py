"""Moves of a joint ensemble, and the state that it leaves to go on from.

A state is drivers D (what the groups share, and means and spreads of populations) and locals L of every
group, with density p(D) ∏ p(L_g | D) likelihood_g(S, L_g), S the first of the drivers. emcee's moves evaluate
whole vectors, so these moves are our own:

- the locals of one group anew, from their fitted law given D, or by differences of other walkers
  (differential evolution, ter Braak 2006): one group's likelihood each;
- drivers by differences or from a fitted law, every group's locals carried along in straight coordinates that
  hardly depend on the drivers: a partly non-centred step in the sense of Papaspiliopoulos et al. (2007), its
  degree fitted group by group;
- mean and spread of a population with the groups' standardised values held, the fully non-centred step, which
  is right where the spread is next to nothing;
- shared drivers with the locals held;
- means and spreads given the locals, which needs no likelihood: the centred step of an interweaving pair
  (Yu and Meng 2011).

All laws are frozen while draws are kept. Each half of the walkers moves by differences of the other half.

Ensembles share nothing but the calls of their family: for some tens of walkers a call takes much the same time
as for one, so sweeps of several ensembles stop where they ask, and one call answers them all.
"""

import json
from collections import Counter
from collections.abc import Callable, Sequence
from collections.abc import Generator as Stops
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.random import PCG64, Generator
from numpy.typing import NDArray

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.runtime.checkpoints import CheckpointStore, check_drift, load_or_compute
from bayesterra.runtime.reading import parsed_json
from bayesterra.sampling.family import ConditionalLaw
from bayesterra.stats.transport import Proposal

ANEW, NEAR, HELD_SHARE = 2, 2, 0.25
"""Proposals of shared values in a sweep; one sweep in so many also steps along differences; share that holds locals."""

Locals = Literal["carried", "held", "standardised"]
"""Treatment of the locals in a move of shared values: keep their straight coordinates, their values, or their
distances from the population's mean in units of its spread."""


class Family(Protocol):
    """Density of shared values D (n, k) and locals L of every group (groups, n, d), unbounded coordinates."""

    @property
    def groups(self) -> int:
        """Number of groups."""

    @property
    def blocks(self) -> tuple[tuple[int, ...], ...]:
        """Columns of D that belong together; on the first block the likelihood depends; it may be empty."""

    @property
    def widths(self) -> FloatArray:
        """Standard deviations (d,) of locals before the data."""

    def placed(self, D: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Shared values S (n, k) as the methods below take them, and log density (n,) of D; −inf outside."""

    def log_population(self, group: int, S: FloatArray, L: FloatArray) -> tuple[FloatArray]:
        """Log density (n,) of one group's locals (n, d) given shared values."""

    def terms(self, group: int, S: FloatArray, L: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The same, and the group's log likelihood (n,); the latter −inf outside its support."""

    def rescaled(self, group: int, S: FloatArray, L: FloatArray, new: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Locals at new shared values, (value − mean)/spread of each population as before; log |dL'/dL| (n,).

        NaN where a value would leave its range.
        """

    @property
    def chances(self) -> int:
        """How many random numbers a walker's refreshment takes."""

    def refreshed(self, D: FloatArray, S: FloatArray, L: FloatArray, chance: FloatArray) -> tuple[FloatArray]:
        """Shared values (n, k) after a move of those that the likelihood does not see, given locals (n, groups, d).

        ``chance`` (n, chances) are numbers drawn between 0 and 1.
        """


Answer = tuple[FloatArray, ...]
Question = tuple[Callable[..., Answer], tuple[int, ...], tuple[FloatArray, ...]]
"""A method of a family, the group where it takes one, and arrays with a row for each walker."""
Move = Stops[Question, Answer, None]
"""A move that stops wherever it asks."""


@dataclass(frozen=True)
class Laws:
    """Frozen proposals: of the shared values, and of every group's locals given the shared values."""

    drivers: Proposal
    locals: tuple[ConditionalLaw, ...]


@dataclass
class Walkers:
    """States of w walkers."""

    D: FloatArray  # shared values (w, k)
    L: FloatArray  # locals (groups, w, d)
    prior: FloatArray  # log density of the shared values (w,)
    population: FloatArray  # log density of every group's locals (groups, w)
    likelihood: FloatArray  # of every group (groups, w)

    @classmethod
    def at(cls, family: Family, D: FloatArray, L: FloatArray) -> "Walkers":
        """Evaluate everything once."""
        S, prior = family.placed(D)
        terms = [family.terms(g, S, L[g]) for g in range(family.groups)]
        population, likelihood = (np.array(part) for part in zip(*terms, strict=True))
        return cls(D.copy(), L.copy(), prior, population, likelihood)

    @property
    def log_density(self) -> FloatArray:
        """Log density (w,) of the whole states."""
        return np.asarray(self.prior + self.population.sum(axis=0) + self.likelihood.sum(axis=0))


@dataclass
class Counts:
    """Accepted and tried moves by kind."""

    accepted: Counter[str] = field(default_factory=Counter)
    tried: Counter[str] = field(default_factory=Counter)

    def add(self, kind: str, taken: BoolArray) -> None:
        """Count the moves of some walkers."""
        self.accepted[kind] += int(taken.sum())
        self.tried[kind] += taken.size

    @classmethod
    def of(cls, ensembles: Sequence["PooledEnsemble"]) -> "Counts":
        """Moves of all ensembles."""
        parts = [(ensemble.counts.accepted, ensemble.counts.tried) for ensemble in ensembles]
        return cls(*(sum(part, Counter()) for part in zip(*parts, strict=True)))

    @property
    def shares(self) -> dict[str, float]:
        """Accepted share by kind."""
        return {kind: self.accepted[kind] / tried for kind, tried in self.tried.items()}


@dataclass
class PooledEnsemble:
    """One ensemble of walkers with its laws and its stream of random numbers."""

    family: Family
    laws: Laws
    walkers: Walkers
    rng: Generator
    counts: Counts = field(default_factory=Counts)

    def __post_init__(self) -> None:
        self.moved = np.zeros(len(self.walkers.D))  # moves of groups' locals from their law, by walker
        self._S = self.family.placed(self.walkers.D)[0]  # moves with the walkers

    def sweep(self, *, near: bool) -> Move:
        """Move everything once; with ``near``, also along differences of other walkers."""
        for g in range(self.family.groups):
            yield from self._anew(g)
            for half in self._halves() if near else ():
                yield from self._by_differences(g, *half)
        w = self.walkers
        if len(self.family.blocks) > 1:  # move what the likelihood does not see
            chance = self.rng.random((len(w.D), self.family.chances))
            (w.D,) = yield self.family.refreshed, (), (w.D, self._S, np.moveaxis(w.L, 0, 1), chance)
            self._S, w.prior = yield self.family.placed, (), (w.D,)
            for g in range(self.family.groups):
                (w.population[g],) = yield self.family.log_population, (g,), (self._S, w.L[g])
        law, all_walkers = self.laws.drivers, np.arange(len(w.D))
        for new in [law.sample(len(w.D), self.rng) for _ in range(ANEW)]:  # shared values, the locals carried along
            yield from self._carried(all_walkers, new, law.log_density(w.D) - law.log_density(new), "drivers anew")
        if near:
            yield from self._drivers_by_differences()

    def _drivers_by_differences(self) -> Move:
        """Move shared values along differences: all, those of a block, and with the locals held."""
        k = self.walkers.D.shape[1]
        for half in self._halves():
            yield from self._shared_by_differences(tuple(range(k)), *half)
        blocks = [block for block in self.family.blocks if 0 < len(block) < k]
        if blocks:
            block = blocks[self.rng.integers(len(blocks))]
            for half in self._halves():
                yield from self._shared_by_differences(block, *half)
        populations = self.family.blocks[1:]
        if populations:
            block = populations[self.rng.integers(len(populations))]
            for half in self._halves():
                yield from self._shared_by_differences(block, *half, treatment="standardised")
        if self.family.blocks[0] and self.rng.random() < HELD_SHARE:
            for half in self._halves():
                yield from self._shared_by_differences(self.family.blocks[0], *half, treatment="held")

    def _halves(self) -> tuple[tuple[IntArray, IntArray], tuple[IntArray, IntArray]]:
        order = self.rng.permutation(len(self.walkers.D))
        first, second = order[: len(order) // 2], order[len(order) // 2 :]
        return (first, second), (second, first)

    def _steps(self, other: FloatArray, n: int, dimension: int) -> FloatArray:
        """Differences (n, d) of random pairs among points (m, d), long and short ones."""
        first = self.rng.integers(len(other), size=n)
        second = (first + 1 + self.rng.integers(len(other) - 1, size=n)) % len(other)
        length = 2.38 / np.sqrt(2 * dimension) * self.rng.choice([0.35, 0.7, 1.0], size=n)
        return np.asarray(length[:, None] * (other[first] - other[second]))

    def _accept(self, log_ratio: FloatArray) -> BoolArray:
        return np.asarray(np.log(self.rng.random(len(log_ratio))) < log_ratio)

    def _anew(self, g: int) -> Move:
        """Propose the locals of a group from their law given the shared values."""
        w, law = self.walkers, self.laws.locals[g]
        L, log_new = law.sample(w.D, self.rng)
        population, likelihood = yield self.family.terms, (g,), (self._S, L)
        log_ratio = population + likelihood - w.population[g] - w.likelihood[g]
        taken = self._accept(log_ratio + law.log_density(w.D, w.L[g]) - log_new)
        w.L[g][taken] = L[taken]
        w.population[g][taken], w.likelihood[g][taken] = population[taken], likelihood[taken]
        self.moved += taken
        self.counts.add("locals anew", taken)

    def _by_differences(self, g: int, half: IntArray, other: IntArray) -> Move:
        """Move the locals of a group along differences of other walkers in straight coordinates."""
        w, law = self.walkers, self.laws.locals[g]
        v, log_jacobian = law.inverse(w.D, w.L[g])
        proposed = v[half] + self._steps(v[other], len(half), v.shape[1])
        L, log_new = law.forward(w.D[half], proposed)
        population, likelihood = yield self.family.terms, (g,), (self._S[half], L)
        log_ratio = population + likelihood - w.population[g][half] - w.likelihood[g][half]
        taken = self._accept(log_ratio + log_new - log_jacobian[half])
        chosen = half[taken]
        w.L[g][chosen] = L[taken]
        w.population[g][chosen], w.likelihood[g][chosen] = population[taken], likelihood[taken]
        self.counts.add("locals by differences", taken)

    def _shared_by_differences(
        self, block: Sequence[int], half: IntArray, other: IntArray, *, treatment: Locals = "carried"
    ) -> Move:
        """Move some shared values along differences of other walkers; ``treatment`` is that of the locals."""
        straight, columns = self.laws.drivers.transport_map, list(block)
        v, log_jacobian = straight.inverse(self.walkers.D)
        proposed = v[half]
        proposed[:, columns] += self._steps(v[other][:, columns], len(half), len(columns))
        D, log_new = straight.forward(proposed)
        kind = f"drivers by differences ({len(columns)}), locals {treatment}"
        yield from self._carried(half, D, log_new - log_jacobian[half], kind, treatment)

    def _carried(
        self, chosen: IntArray, D: FloatArray, log_ratio: FloatArray, kind: str, treatment: Locals = "carried"
    ) -> Move:
        """Metropolis step to shared values D of the chosen walkers; ``log_ratio`` of the proposal itself."""
        w = self.walkers
        S, prior = yield self.family.placed, (), (D,)
        alive = np.flatnonzero(np.isfinite(prior))
        level = np.where(np.isfinite(prior), prior + log_ratio - w.prior[chosen], -np.inf)
        L = w.L[:, chosen].copy()
        population, likelihood = np.empty(L.shape[:2]), np.empty(L.shape[:2])
        for g in range(self.family.groups):
            law, now = self.laws.locals[g], chosen[alive]
            if treatment == "carried":
                v, before = law.inverse(w.D[now], w.L[g][now])
                L[g][alive], after = law.forward(D[alive], v)
                level[alive] += after - before
            elif treatment == "standardised":
                rows = (self._S[now], w.L[g][now], S[alive])
                L[g][alive], log_jacobian = yield self.family.rescaled, (g,), rows
                level[alive] += log_jacobian
                alive = alive[np.isfinite(level[alive])]
                now = chosen[alive]
            terms = yield self.family.terms, (g,), (S[alive], L[g][alive])
            population[g][alive], likelihood[g][alive] = terms
            level[alive] += terms[0] + terms[1] - w.population[g][now] - w.likelihood[g][now]
            alive = alive[np.isfinite(level[alive])]
        taken = self._accept(level)
        into = chosen[taken]
        w.D[into], self._S[into], w.prior[into] = D[taken], S[taken], prior[taken]
        w.L[:, into] = L[:, taken]
        w.population[:, into], w.likelihood[:, into] = population[:, taken], likelihood[:, taken]
        self.counts.add(kind, taken)


def run_together(ensembles: Sequence[PooledEnsemble], sweeps: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Take sweeps of ensembles of one family.

    Returns shared values (ensembles, sweeps, w, k), locals (ensembles, sweeps, groups, w, d), and the accepted
    share of the groups' locals (ensembles, w).
    """
    first = ensembles[0].walkers
    D = np.empty((len(ensembles), sweeps, *first.D.shape))
    L = np.empty((len(ensembles), sweeps, *first.L.shape))
    for ensemble in ensembles:
        ensemble.moved[:] = 0.0
    for i in range(sweeps):
        _answer([ensemble.sweep(near=i % NEAR == 0) for ensemble in ensembles])
        for e, ensemble in enumerate(ensembles):
            D[e, i], L[e, i] = ensemble.walkers.D, ensemble.walkers.L
    return D, L, np.array([ensemble.moved for ensemble in ensembles]) / max(sweeps * len(first.L), 1)


def _answer(moves: Sequence[Move]) -> None:
    """Take moves to their ends; those that ask the same are answered by one call."""
    asked = {number: next(move) for number, move in enumerate(moves)}
    while asked:
        method, group, _ = next(iter(asked.values()))
        alike = {number: rows for number, (*what, rows) in asked.items() if what == [method, group]}
        ends = np.cumsum([len(rows[0]) for rows in alike.values()])[:-1]
        answer = method(*group, *map(np.concatenate, zip(*alike.values(), strict=True)))
        for number, own in zip(alike, zip(*(np.split(part, ends) for part in answer), strict=True), strict=True):
            try:
                asked[number] = moves[number].send(own)
            except StopIteration:
                del asked[number]


@dataclass(frozen=True)
class JointState:
    """State of an ensemble: all that its next sweep depends on."""

    laws: Laws
    walkers: Walkers
    record: NDArray[np.uint8]  # JSON of its generator's state and of its counts, as bytes

    @classmethod
    def of(cls, ensemble: PooledEnsemble) -> "JointState":
        """Read off where an ensemble stands."""
        record = {"generator": ensemble.rng.bit_generator.state, **vars(ensemble.counts)}
        return cls(ensemble.laws, ensemble.walkers, np.frombuffer(json.dumps(record).encode(), dtype=np.uint8))

    def ensemble(self, family: Family) -> PooledEnsemble:
        """The ensemble that stands there."""
        record, bits = parsed_json(bytes(self.record).decode()), PCG64()
        bits.state = record["generator"]
        counts = Counts(Counter(record["accepted"]), Counter(record["tried"]))
        walkers = deepcopy(self.walkers)  # the ensemble moves on, this stays
        return PooledEnsemble(family, self.laws, walkers, Generator(bits), counts)


@dataclass(frozen=True)
class JointSegment:
    """Sweeps on end of all ensembles, and where they led."""

    D: FloatArray  # shared values (ensembles, sweeps, w, k)
    L: FloatArray  # locals (ensembles, sweeps, groups, w, d)
    share: FloatArray  # accepted share of each walker (ensembles, w)
    ends: tuple[JointState, ...]  # where the ensembles stand then

    @classmethod
    def of(cls, ensembles: Sequence[PooledEnsemble], sweeps: int) -> "JointSegment":
        """Take sweeps."""
        D, L, share = run_together(ensembles, sweeps)
        return cls(D, L, share, tuple(map(JointState.of, ensembles)))


def load_or_make_segment(
    checkpoint_store: CheckpointStore, name: str, family: Family, make: Callable[[], JointSegment]
) -> tuple[JointSegment, list[PooledEnsemble]]:
    """The segment that the store has under a name, or the one that is made, and its ensembles.

    See :func:`check_densities`.
    """
    saved = checkpoint_store.holds(name)
    segment = load_or_compute(checkpoint_store, name, JointSegment, make)
    ensembles = [end.ensemble(family) for end in segment.ends]
    for ensemble in ensembles if saved else ():
        check_densities(ensemble)
    return segment, ensembles


def check_densities(ensemble: PooledEnsemble) -> None:
    """Make sure that saved walkers have the density here that they had where they were saved."""
    saved = ensemble.walkers.log_density
    here = Walkers.at(ensemble.family, ensemble.walkers.D, ensemble.walkers.L).log_density
    check_drift(float(np.max(np.abs(here - saved) / (1.0 + np.abs(saved)))))
