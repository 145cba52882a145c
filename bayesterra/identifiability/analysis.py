"""Everything about the identifiability of one posterior; and of a design before anything is measured."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import pandas as pd
from numpy.random import Generator, SeedSequence, default_rng

from bayesterra.arrays import FloatArray
from bayesterra.engines import Engine
from bayesterra.identifiability.assessment import Assessment, FromDraws
from bayesterra.identifiability.cloning import cloning
from bayesterra.identifiability.collinearity import Collinearity, collinearity
from bayesterra.identifiability.coupling import coupling
from bayesterra.identifiability.information import information
from bayesterra.identifiability.local import LocalAnalysis, local_analysis
from bayesterra.identifiability.powerscaling import power_scaling
from bayesterra.identifiability.profiles import Profiles, profiles
from bayesterra.identifiability.structure import DRAWS as STRUCTURE_DRAWS
from bayesterra.identifiability.structure import Structure, structure
from bayesterra.posteriors import Posterior

LOCAL_DRAWS = 400
CLONES = (1, 2, 4, 8, 16)
"""Up to sixteen times the readings: what that many do not narrow, a campaign will not."""
T = TypeVar("T")


@dataclass(frozen=True)
class Analysis:
    """What the data of a study determine.

    Attributes
    ----------
    names : free parameters.
    structure : what no data of this design could determine.
    best, spread : information of the readings at the best point of the profiles, and over the posterior.
    collinearity : of every subset, over the posterior.
    profiles : of likelihood and posterior.
    drawn : what the draws of the posterior tell.
    verdicts : one row per parameter: parameter, verdict, the figures behind it, and ``against``: what speaks
        against it; see :class:`bayesterra.identifiability.verdicts.Evidence`.
    combinations : one row per independent combination, best determined first: combination, contraction,
        verdict; then what no data of this design could determine.
    counts : one row per group, and ``all``: scope, directions, determined, effective (sum of contractions).
    seconds : wall time by part.
    """

    names: tuple[str, ...]
    structure: Structure
    best: LocalAnalysis
    spread: LocalAnalysis
    collinearity: Collinearity
    profiles: Profiles
    drawn: FromDraws
    verdicts: pd.DataFrame
    combinations: pd.DataFrame
    counts: pd.DataFrame
    seconds: dict[str, float]


@dataclass(frozen=True)
class Outlook:
    """What a design lets expect before it is measured, over the cut prior; see :class:`Analysis`."""

    names: tuple[str, ...]
    structure: Structure
    spread: LocalAnalysis
    collinearity: Collinearity


def outlook(posterior: Posterior, prior: FloatArray) -> Outlook:
    """Find out what a design could determine, from draws (m, d) of the cut prior; readings do not count."""
    spread = local_analysis(posterior, _some(prior, LOCAL_DRAWS), prior)
    found = structure(posterior, prior[:STRUCTURE_DRAWS])
    return Outlook(posterior.names, found, spread, collinearity(spread))


def analyse(
    posterior: Posterior,
    prior: FloatArray,
    draws: FloatArray,
    seed: SeedSequence,
    *,
    mode: FloatArray | None = None,
    engine: Engine | None = None,
    report: Callable[[str], None] = lambda part: None,
) -> Analysis:
    """Find out what the data determine.

    Parameters
    ----------
    posterior : of the study.
    prior, draws : of the cut prior (m, d) and nearly independent ones of the posterior (n, d).
    seed : root of all random numbers.
    mode : the posterior mode (d,), where it is known.
    engine : traces the profiles; by default this process.
    report : called with the name of each part as it begins.
    """
    clock, (tracing, *streams) = _Clock(report), [default_rng(stream) for stream in seed.spawn(5)]
    profiled = clock("profiles", lambda: _profiled(posterior, prior, draws, mode, tracing, engine))
    best = clock(
        "local analysis", lambda: local_analysis(posterior, profiled.best["posterior"], prior, draws)
    )
    spread = clock(
        "local analysis", lambda: local_analysis(posterior, _some(draws, LOCAL_DRAWS), prior, draws)
    )
    subsets = clock("collinearity", lambda: collinearity(spread))
    seen = clock("structure", lambda: structure(posterior, prior[:STRUCTURE_DRAWS]))
    drawn = _from_draws(posterior, prior, draws, streams, clock)
    found = Assessment(posterior, prior, draws, seen, spread, profiled, drawn)
    return Analysis(
        posterior.names, seen, best, spread, subsets, profiled, drawn,
        found.verdicts(), found.combinations(), found.counts(), clock.seconds,
    )  # fmt: skip


class _Clock:
    """Wall time of every part, and a word as it begins."""

    def __init__(self, report: Callable[[str], None]) -> None:
        self.seconds: dict[str, float] = {}
        self._report = report

    def __call__(self, part: str, work: Callable[[], T]) -> T:
        self._report(part)
        started = time.perf_counter()
        found = work()
        self.seconds[part] = self.seconds.get(part, 0.0) + time.perf_counter() - started
        return found


def _some(draws: FloatArray, most: int) -> FloatArray:
    return draws[:: max(1, -(-len(draws) // most))]


def _profiled(
    posterior: Posterior,
    prior: FloatArray,
    draws: FloatArray,
    mode: FloatArray | None,
    rng: Generator,
    engine: Engine | None,
) -> Profiles:
    return profiles(posterior, rng=rng, draws=draws, prior_draws=prior, known=mode, engine=engine)


def _from_draws(
    posterior: Posterior, prior: FloatArray, draws: FloatArray, streams: Sequence[Generator], clock: _Clock
) -> FromDraws:
    first, second, third, fourth = streams
    return FromDraws(
        clock("coupling", lambda: coupling(posterior, prior, draws, first)),
        clock("information", lambda: information(posterior, prior, draws, second)),
        clock("data cloning", lambda: cloning(posterior, prior, draws, third, powers=CLONES)),
        clock("power-scaling", lambda: power_scaling(posterior, prior, draws, fourth)),
    )
