"""One emcee ensemble with frozen proposals; the only module that imports emcee."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import emcee
import numpy as np
from numpy.random import MT19937, RandomState, SeedSequence

from bayesterra.arrays import FloatArray
from bayesterra.sampling.mixture import ProposalLaw

LogDensity = Callable[[FloatArray], FloatArray]


class IndependenceMove(emcee.moves.Move):  # type: ignore[misc]  # emcee ships no types
    """Metropolis–Hastings step that proposes every walker afresh from a fixed law."""

    def __init__(self, law: ProposalLaw) -> None:
        self.law = law

    def propose(self, model: Any, state: Any) -> tuple[Any, np.ndarray[Any, Any]]:
        """Propose, weigh by the law's densities and accept; emcee's ``Move`` protocol."""
        n = len(state.coords)
        new = self.law.sample(n, model.random)
        log_prob, _ = model.compute_log_prob_fn(new)
        hastings = self.law.log_density(state.coords) - self.law.log_density(new)
        accepted = np.log(model.random.random(n)) < hastings + log_prob - state.log_prob
        return self.update(state, emcee.State(new, log_prob=log_prob), accepted), accepted


def frozen_moves(law: ProposalLaw) -> list[tuple[Any, float]]:
    """Moves of a production run and their shares: none of them adapts."""
    return [
        (IndependenceMove(law), 0.6),
        (emcee.moves.DEMove(), 0.2),
        (emcee.moves.StretchMove(), 0.2),
    ]


class Ensemble:
    """Walkers of one independent ensemble in sampling coordinates.

    Parameters
    ----------
    log_density : log target (n,) of coordinates (n, d).
    start : starting walkers (walkers, d), all with finite density.
    law : the frozen proposal.
    seed : stream of this ensemble.
    """

    def __init__(
        self, log_density: LogDensity, start: FloatArray, law: ProposalLaw, seed: SeedSequence
    ) -> None:
        self._sampler = emcee.EnsembleSampler(
            *start.shape, log_density, vectorize=True, moves=frozen_moves(law)
        )
        self._state = emcee.State(start.copy(), random_state=RandomState(MT19937(seed)).get_state())

    def advance(self, steps: int, *, keep: bool = True) -> None:
        """Take ``steps`` steps and append them to the chain, unless they are only to be forgotten."""
        self._state = self._sampler.run_mcmc(self._state, steps, store=keep, skip_initial_state_check=True)

    @property
    def chain(self) -> FloatArray:
        """Kept positions, (steps, walkers, d)."""
        return np.asarray(self._sampler.get_chain())

    @property
    def log_density(self) -> FloatArray:
        """Log target at the kept positions, (steps, walkers)."""
        return np.asarray(self._sampler.get_log_prob())

    @property
    def acceptance(self) -> FloatArray:
        """Share of kept steps that each walker accepted, (walkers,)."""
        return np.asarray(self._sampler.backend.accepted / max(self._sampler.iteration, 1))
