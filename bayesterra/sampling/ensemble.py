"""One emcee ensemble with frozen proposals; the only module that imports emcee."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import emcee
import numpy as np
from numpy.random import MT19937, RandomState, SeedSequence
from numpy.typing import NDArray

from bayesterra.arrays import FloatArray
from bayesterra.stats.mixture import ProposalLaw

LogDensity = Callable[[FloatArray], FloatArray]


AT_ONCE = 16
"""Steps that are proposed together: a call for many sets costs little more than one for those of a step."""


class IndependenceMove(emcee.moves.Move):  # type: ignore[misc]  # emcee ships no types
    """Metropolis–Hastings step that proposes every walker afresh from a fixed law.

    Where walkers stand does not matter to what is proposed, so ``AT_ONCE`` steps are proposed and weighed in
    one call. What is left of them when a segment ends is forgotten, lest the next one depend on more than its state.
    """

    def __init__(self, law: ProposalLaw) -> None:
        self.law = law
        self.steps: list[tuple[FloatArray, FloatArray, FloatArray]] = []  # points, and log densities of target and law

    def propose(self, model: Any, state: Any) -> tuple[Any, np.ndarray[Any, Any]]:
        """Propose, weigh by the law's densities and accept; emcee's ``Move`` protocol."""
        if not self.steps:
            u = self.law.sample(AT_ONCE * len(state.coords), model.random)
            parts = (u, model.compute_log_prob_fn(u)[0], self.law.log_density(u))
            self.steps = list(zip(*(np.split(part, AT_ONCE) for part in parts), strict=True))
        new, log_prob, level = self.steps.pop()
        hastings = self.law.log_density(state.coords) - level
        accepted = np.log(model.random.random(len(new))) < hastings + log_prob - state.log_prob
        return self.update(state, emcee.State(new, log_prob=log_prob), accepted), accepted


def frozen_moves(law: ProposalLaw) -> list[tuple[Any, float]]:
    """Moves of a production run and their shares: none of them adapts, and a fifth does not trust the law."""
    return [(IndependenceMove(law), 0.8), (emcee.moves.DEMove(), 0.1), (emcee.moves.StretchMove(), 0.1)]


@dataclass(frozen=True)
class EnsembleState:
    """State of an ensemble: all that its next step depends on."""

    u: FloatArray  # positions (walkers, d)
    log_density: FloatArray  # log target there (walkers,)
    words: NDArray[np.uint32]  # state of emcee's generator, a Mersenne Twister of 624 words
    position: int  # the next of these
    has_gauss: int  # whether a normal draw is left over
    gauss: float  # the one left over

    @classmethod
    def of(cls, state: Any) -> "EnsembleState":
        """Read emcee's state off."""
        return cls(state.coords, state.log_prob, *state.random_state[1:])

    def state(self) -> Any:
        """The same as emcee's state."""
        random = RandomState(MT19937())  # complains of what emcee would silently ignore
        random.set_state(("MT19937", self.words, self.position, self.has_gauss, self.gauss))
        return emcee.State(self.u, log_prob=self.log_density, random_state=random.get_state(), copy=True)


@dataclass(frozen=True)
class Segment:
    """Steps on end, and where they led."""

    chain: FloatArray  # positions (steps, walkers, d)
    log_density: FloatArray  # log target there (steps, walkers)
    accepted: FloatArray  # number of steps that each walker accepted (walkers,)
    end: EnsembleState  # where the ensemble stands then


class Ensemble:
    """Walkers of one independent ensemble in sampling coordinates.

    Parameters
    ----------
    log_density : log target (n,) of coordinates (n, d).
    start : starting walkers (walkers, d), all with finite density; or where an ensemble stood.
    law : the frozen proposal.
    seed : stream of this ensemble; not needed to go on from where one stood.
    """

    def __init__(
        self,
        log_density: LogDensity,
        start: FloatArray | EnsembleState,
        law: ProposalLaw,
        seed: SeedSequence | None = None,
    ) -> None:
        if isinstance(start, EnsembleState):
            self._state = start.state()
        else:
            self._state = emcee.State(start.copy(), random_state=RandomState(MT19937(seed)).get_state())
        shape = self._state.coords.shape
        self._density = log_density
        moves = frozen_moves(law)
        self._sampler = emcee.EnsembleSampler(*shape, log_density, vectorize=True, moves=moves)
        self._sampler.log_prob_fn = log_density  # emcee's wrapper of it prints a traceback of Ctrl-C
        self._anew = [move for move, _ in moves if isinstance(move, IndependenceMove)]
        self._segments: list[Segment] = []

    def advance(self, steps: int, *, keep: bool = True) -> None:
        """Take ``steps`` steps and append them to the chain, unless they are only to be forgotten."""
        if keep:
            self.follow(self.segment(steps))
        else:
            self._state = self._run(steps, keep=False)

    def segment(self, steps: int) -> Segment:
        """The next ``steps`` steps; the ensemble itself stays until it is told to follow."""
        self._sampler.reset()
        end = EnsembleState.of(self._run(steps, keep=True))
        backend = self._sampler.backend
        return Segment(backend.get_chain(), backend.get_log_prob(), backend.accepted, end)

    def follow(self, segment: Segment) -> None:
        """Append steps to the chain and stand at their end."""
        self._segments.append(segment)
        self._state = segment.end.state()

    def _run(self, steps: int, *, keep: bool) -> Any:
        for move in self._anew:
            move.steps.clear()
        return self._sampler.run_mcmc(self._state, steps, store=keep, skip_initial_state_check=True)

    @property
    def state(self) -> EnsembleState:
        """State of the ensemble, once it took a step."""
        return EnsembleState.of(self._state)

    def drift(self) -> float:
        """Largest relative difference of the walkers' log densities from what they are when computed anew."""
        before, now = self._state.log_prob, self._density(self._state.coords)
        return float((np.abs(now - before) / np.maximum(np.abs(before), 1.0)).max())

    @property
    def chain(self) -> FloatArray:
        """Kept positions, (steps, walkers, d)."""
        return np.concatenate([segment.chain for segment in self._segments])

    @property
    def log_density(self) -> FloatArray:
        """Log target at the kept positions, (steps, walkers)."""
        return np.concatenate([segment.log_density for segment in self._segments])

    @property
    def acceptance(self) -> FloatArray:
        """Share of kept steps that each walker accepted, (walkers,)."""
        steps = sum(len(segment.chain) for segment in self._segments)
        return np.asarray(sum(segment.accepted for segment in self._segments) / max(steps, 1))
