"""Pilot runs of an ensemble: proposals fitted to what the walkers find, before any draw is kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import FloatArray
from bayesterra.pooling.conditional import fit_conditional
from bayesterra.pooling.moves import Family, Laws, PooledEnsemble, Walkers
from bayesterra.sampling.unbending import fit_proposal

FITTED = 8192
"""Most draws that laws are fitted to."""
FEWEST, MOST, DRAWS_PER_COMPONENT = 8, 16, 500
"""Components of a law: more of them on few draws have thin tails."""


def fit_laws(family: Family, D: FloatArray, L: FloatArray, rng: Generator) -> Laws:
    """Fit all proposals to draws of drivers (n, k) and locals (groups, n, d)."""
    every = max(1, -(-len(D) // FITTED))
    D, L = D[::every], L[:, ::every]
    components = min(max(FEWEST, len(D) // DRAWS_PER_COMPONENT), MOST)
    drivers = fit_proposal(D, np.ones(len(D)), D.std(axis=0) + 1e-300, components, 0.1, rng)
    following = [
        fit_conditional(D, L[g], family.widths, rng, components=components) for g in range(family.groups)
    ]
    return Laws(drivers, tuple(following))


def piloted(
    family: Family,
    D: FloatArray,
    L: FloatArray,
    walkers: int,
    pilots: Sequence[int],
    rng: Generator,
    watch: Callable[[str], None] = lambda step: None,
) -> PooledEnsemble:
    """An ensemble whose laws are fitted to starting points, then to what each of some pilot runs found.

    Parameters
    ----------
    D, L : starting points (n, k) and (groups, n, d), at least ``walkers`` of them inside the support.
    pilots : sweeps of each pilot run, of which the second half is used.
    watch : told what is at work, step by step.
    """
    watch("first laws")
    inside = np.isfinite(Walkers.at(family, D, L).log_density)
    D, L = D[inside], L[:, inside]
    laws = fit_laws(family, D, L, rng)
    start = rng.choice(len(D), size=walkers, replace=len(D) < walkers)
    ensemble = PooledEnsemble(family, laws, Walkers.at(family, D[start], L[:, start]), rng)
    for sweeps in pilots:
        watch(f"pilot run of {sweeps} sweeps")
        D, L, _ = ensemble.run(sweeps)
        ensemble = refitted(ensemble, D[sweeps // 2 :], L[sweeps // 2 :])
    return ensemble


def refitted(ensemble: PooledEnsemble, D: FloatArray, L: FloatArray) -> PooledEnsemble:
    """The ensemble where it stands, its laws fitted to draws (sweeps, w, k), (sweeps, groups, w, d) of it."""
    flat = D.reshape(-1, D.shape[-1])
    own = np.moveaxis(L, 1, 0).reshape(ensemble.family.groups, len(flat), -1)
    laws = fit_laws(ensemble.family, flat, own, ensemble.rng)
    return PooledEnsemble(ensemble.family, laws, ensemble.walkers, ensemble.rng)
