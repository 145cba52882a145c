"""What an ensemble of a joint posterior leaves behind: enough to go on from there, to the last bit."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from numpy.random import PCG64, Generator
from numpy.typing import NDArray

from bayesterra.arrays import FloatArray
from bayesterra.pooling.moves import Counts, Family, Laws, PooledEnsemble, Walkers
from bayesterra.sampling.journal import Journal, check_drift, noted

_WORD = 2**64


@dataclass(frozen=True)
class Standing:
    """Where an ensemble stands: all that its next sweep depends on.

    Attributes
    ----------
    laws, walkers : see :class:`bayesterra.pooling.moves.PooledEnsemble`.
    words : state and increment of its generator, a PCG64, low word first (4,).
    has_half, half : whether half a word is left over, and which.
    kinds : names of moves, one per line, as bytes.
    accepted, tried : moves of each kind so far.
    """

    laws: Laws
    walkers: Walkers
    words: NDArray[np.uint64]
    has_half: int
    half: int
    kinds: NDArray[np.uint8]
    accepted: FloatArray
    tried: FloatArray

    @classmethod
    def of(cls, ensemble: PooledEnsemble) -> Standing:
        """Read off where an ensemble stands."""
        state = ensemble.rng.bit_generator.state
        numbers = (state["state"]["state"], state["state"]["inc"])
        words = [part for number in numbers for part in (number % _WORD, number // _WORD)]
        tried = ensemble.counts.tried
        return cls(
            ensemble.laws,
            ensemble.walkers,
            np.array(words, dtype=np.uint64),
            int(state["has_uint32"]),
            int(state["uinteger"]),
            np.frombuffer("\n".join(tried).encode(), dtype=np.uint8),
            np.array([ensemble.counts.accepted[kind] for kind in tried], dtype=float),
            np.array(list(tried.values()), dtype=float),
        )

    def ensemble(self, family: Family) -> PooledEnsemble:
        """The ensemble that stands there."""
        low, high, inc_low, inc_high = (int(word) for word in self.words)
        bits = PCG64()
        bits.state = {
            "bit_generator": "PCG64",
            "state": {"state": low + _WORD * high, "inc": inc_low + _WORD * inc_high},
            "has_uint32": self.has_half,
            "uinteger": self.half,
        }
        kinds = bytes(self.kinds).decode().splitlines()
        counts = Counts(
            dict(zip(kinds, map(float, self.accepted), strict=True)),
            dict(zip(kinds, map(float, self.tried), strict=True)),
        )
        walkers = deepcopy(self.walkers)  # the ensemble moves on, this stays
        return PooledEnsemble(family, self.laws, walkers, Generator(bits), counts)


@dataclass(frozen=True)
class Leg:
    """Sweeps on end, and where they led.

    Attributes
    ----------
    D, L : drivers (sweeps, w, k) and locals (sweeps, groups, w, d).
    share : accepted share of each walker (w,).
    end : where the ensemble stands then.
    """

    D: FloatArray
    L: FloatArray
    share: FloatArray
    end: Standing


def begun_or_noted(
    journal: Journal, number: int, family: Family, begin: Callable[[], PooledEnsemble]
) -> PooledEnsemble:
    """The ensemble that is begun, or the one in the journal."""
    name = f"joint-{number}-begun"
    found = journal.holds(name)
    ensemble = noted(journal, name, Standing, lambda: Standing.of(begin())).ensemble(family)
    if found:
        check_densities(ensemble)
    return ensemble


def leg_or_noted(journal: Journal, name: str, ensemble: PooledEnsemble, sweeps: int) -> Leg:
    """Take sweeps, or the leg that the journal has under a name.

    Raises
    ------
    ResultError : walkers in the journal have another density here than where they were noted.
    """

    def taken() -> Leg:
        D, L, share = ensemble.run(sweeps)
        return Leg(D, L, share, Standing.of(ensemble))

    found = journal.holds(name)
    leg = noted(journal, name, Leg, taken)
    if found:
        check_densities(leg.end.ensemble(ensemble.family))
    return leg


def check_densities(ensemble: PooledEnsemble) -> None:
    """Make sure that saved walkers have the density here that they had where they were saved."""
    known = ensemble.walkers.log_density
    here = Walkers.at(ensemble.family, ensemble.walkers.D, ensemble.walkers.L).log_density
    check_drift(float(np.max(np.abs(here - known) / (1.0 + np.abs(known)))))
