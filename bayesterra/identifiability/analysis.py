"""Identifiability analysis of a posterior: all parts, and the sentence that sums them up."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from numpy.random import SeedSequence, default_rng

from bayesterra.arrays import FloatArray, spaced
from bayesterra.errors import enumerated
from bayesterra.identifiability.information import ALL, MARGINAL, Coupling, Information, coupling, information
from bayesterra.identifiability.local import Collinearity, LocalAnalysis, collinearity, local_analysis
from bayesterra.identifiability.profiles import Profile, Profiles, no_profiles, profiles
from bayesterra.identifiability.structure import DRAWS as STRUCTURE_DRAWS
from bayesterra.identifiability.structure import Structure, structure
from bayesterra.identifiability.verdicts import (
    DETERMINED,
    MOVED,
    STRUCTURAL,
    WEAK,
    Identifiability,
    disagreements,
    evidence,
    identifiability,
    word,
)
from bayesterra.likelihood.joint import Whole
from bayesterra.parameters import PARAMETERS
from bayesterra.report.verdicts import Verdict
from bayesterra.runtime.engines import Engine

LOCAL_DRAWS = 400
T = TypeVar("T")


@dataclass(frozen=True)
class Analysis:
    """Analysis of what the data of a study determine.

    Attributes
    ----------
    names : free parameters.
    structure : what no data of this design could determine.
    best, spread : information of the readings at the best point of the profiles, and over the posterior.
    collinearity : of every subset, over the posterior.
    profiles : of likelihood and posterior.
    coupling : of parameters and of groups, from the draws.
    information : contraction of parameters and directions, from the draws.
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
    coupling: Coupling
    information: Information
    verdicts: pd.DataFrame
    combinations: pd.DataFrame
    counts: pd.DataFrame
    seconds: dict[str, float]


def analyse(
    posterior: Whole,
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
    clock = _Clock(report)
    tracing, coupled, informing = (default_rng(stream) for stream in seed.spawn(3))

    def traced() -> Profiles:
        if posterior.grouped:
            return no_profiles(posterior, prior, draws)
        known = {"draws": draws, "prior_draws": prior, "references": mode}
        return profiles(posterior, rng=tracing, engine=engine, **known)

    profiled = clock("profiles", traced)

    def local(x: FloatArray) -> LocalAnalysis:
        return clock("local analysis", lambda: local_analysis(posterior, x, prior, draws))

    best, spread = local(profiled.best["posterior"]), local(spaced(draws, LOCAL_DRAWS))
    subsets = clock("collinearity", lambda: collinearity(spread))
    seen = clock("structure", lambda: structure(posterior, prior[:STRUCTURE_DRAWS]))
    tied = clock("coupling", lambda: coupling(posterior, prior, draws, coupled))
    informed = clock("information", lambda: information(posterior, prior, draws, informing))
    laws = posterior.prior.laws.values()
    ranges, logs = [law.range for law in laws], np.array([law.logarithmic for law in laws])
    basis = identifiability(posterior.names, ranges, prior, draws, np.isin(posterior.names, seen.determined), logs)
    return Analysis(
        posterior.names, seen, best, spread, subsets, profiled, tied, informed,
        _verdicts(basis.table, informed, _elsewhere(prior, spread, profiled)), _combinations(informed, seen),
        _counts(informed), clock.seconds,
    )  # fmt: skip


class _Clock:
    """Wall time of every part, and a word as it begins."""

    def __init__(self, report: Callable[[str], None]) -> None:
        self.seconds: dict[str, float] = {}
        self._report = report

    def __call__(self, part: str, work: Callable[[], T]) -> T:
        self._report(part)
        started = time.perf_counter()
        result = work()
        self.seconds[part] = self.seconds.get(part, 0.0) + time.perf_counter() - started
        return result


def _verdicts(table: pd.DataFrame, informed: Information, elsewhere: pd.DataFrame) -> pd.DataFrame:
    """Verdicts from draws alone, judged anew with what profiles and bounds say; see :class:`Analysis`."""
    table = table.assign(cut_contraction=informed.parameters["cut_contraction"]).join(elsewhere)
    facts = evidence(table)
    words = [word(each) for each in facts]
    against = ["; ".join(disagreements(*each)) for each in zip(facts, words, strict=True)]
    return table.assign(verdict=words, against=against)


def _elsewhere(prior: FloatArray, spread: LocalAnalysis, profiled: Profiles) -> pd.DataFrame:
    """Findings of profiles and bounds; ``prior`` has draws (m, d) of the cut one."""
    each = profiled.found.get("likelihood")
    told = [("", np.nan, np.nan, np.nan)] * len(spread.names)
    if each is not None:
        told = [(p.shape, *p.crossings(95), _excluded(p, x)) for p, x in zip(each, prior.T, strict=True)]
    table = pd.DataFrame(told, columns=["profile", "lower_95", "upper_95", "excluded"])
    return table.assign(expected=spread.table["expected"], local_sd=spread.table["local_sd"])


def _combinations(informed: Information, seen: Structure) -> pd.DataFrame:
    """Independent combinations and their verdicts, and those that the design cannot see."""
    table = informed.directions
    table = table[(table["scope"] == ALL) & (table["view"] == MARGINAL)]
    words = [rated_as(*each) for each in zip(table["contraction"], table["divergence"], strict=True)]
    rated = table[["combination", "contraction"]].assign(verdict=words)
    nulls = [(null.words, np.nan, STRUCTURAL) for null in seen.nulls]
    if not nulls:
        return rated.reset_index(drop=True)
    return pd.concat([rated, pd.DataFrame(nulls, columns=rated.columns)], ignore_index=True)


def _counts(informed: Information) -> pd.DataFrame:
    """Directions of each group, and of all parameters, and how many are determined."""
    table = informed.counts
    chosen = table[table["view"] == MARGINAL][["scope", "directions", "determined", "effective"]]
    return chosen.reset_index(drop=True)


def rated_as(contraction: float, divergence: float) -> str:
    """Verdict on a combination of parameters."""
    if contraction >= DETERMINED:
        return "determined"
    if contraction >= WEAK:
        return "weakly"
    return "moved" if divergence >= MOVED else "repeats its prior"


def _excluded(profile: Profile, prior: FloatArray) -> float:
    """Share of the cut prior outside the 95 % interval."""
    low, high = profile.interval(95)
    return float(((prior < low) | (prior > high)).mean())


GROUP_WORDS = {"P_I": "bearing", "P_II": "shearing", "P_III": "contact-angle", "load effect": "load-effect"}


NOT_FIXED = {
    "coupled": ("{} is known only in combination", "{} are known only in combination"),
    "repeats its prior": ("{} repeats its prior", "{} repeat their priors"),
    "moved": ("{} moved away from its prior", "{} moved away from their priors"),
    STRUCTURAL: ("no data of this design can determine {}",) * 2,
}
"""What is said of one parameter of a verdict, and of several."""


def in_a_sentence(
    counts: Sequence[Mapping[str, Any]], verdicts: Mapping[str, str], symbol: Callable[[str], str] = str
) -> str:
    """Sentence on what is determined on its own, what is fixed in combination, and what is left as it was.

    Parameters
    ----------
    counts : scope (a group, or ``all``), directions and determined, of each scope.
    verdicts : by parameter.
    symbol : how to write a parameter.
    """
    texts, rows = [], [row for row in counts if row["scope"] == ALL] or list(counts)
    fixed, of = (sum(row[key] for row in rows) for key in ("determined", "directions"))
    alone = [name for name, each in verdicts.items() if each == "determined"]
    own = enumerated([symbol(name) for name in alone]) or "no parameter"
    own += f" on {'their' if len(alone) > 1 else 'its'} own"
    texts = [f"{own} and fix {fixed or 'none'} of {of} independent combination{'s' if of > 1 else ''}"]
    if len(alone) > fixed:
        texts.append("those determined are not independent of each other")
    for verdict, forms in NOT_FIXED.items():
        if names := [symbol(name) for name, each in verdicts.items() if each == verdict]:
            texts.append(forms[len(names) > 1].format(enumerated(names)))
    return f"These data determine {'; '.join(texts)}."


def soil_verdict(table: pd.DataFrame, directions: Mapping[str, Any], conflict: bool = False) -> Verdict:
    """Verdict on what a posterior says of the soil.

    Parameters
    ----------
    table : ``parameter`` and ``verdict``.
    directions : record of :func:`of_directions`.
    conflict : whether prior and readings contradict each other.
    """
    words = dict(zip(table["parameter"], table["verdict"], strict=True))
    counts = [row for row in directions.get("groups", ()) if row["view"] == MARGINAL] or [
        {"scope": ALL, "directions": directions["of"], "determined": directions["determined"]}
    ]
    alone = sum(each == "determined" for each in words.values())
    sentence = in_a_sentence(counts, words, lambda name: PARAMETERS[name].symbol)
    grade, claim = "good" if alone == len(words) else "note", ""
    if conflict:
        grade, claim = "doubtful", "prior and readings contradict each other"
        sentence += " Prior and readings contradict each other: see the prior-predictive check."
    whole = next((row for row in counts if row["scope"] == ALL), counts[0])
    figures = {"determined": alone, "of": len(words), "fixed": whole["determined"]}
    thresholds = {"determined": DETERMINED, "weakly": WEAK}
    return Verdict("Soil", f"{alone} of {len(words)} determined", grade, sentence, claim, figures, thresholds)


def of_directions(basis: Identifiability, seen: Structure, added: Information) -> dict[str, Any]:
    """Record of the independent directions that the data determine, by group too, and those it cannot."""
    columns = ["scope", "view", "directions", "determined", "effective", "cut_effective"]
    return {
        "determined": basis.determined,
        "of": len(basis.contractions),
        "contractions": basis.contractions.tolist(),
        "groups": added.counts[columns].to_dict("records"),
        "unseen": [null.words for null in seen.nulls],
    }
