"""Identifiability of a posterior: all parts, the sentence that sums them up, and the job ``identify``."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from numpy.random import SeedSequence, default_rng

from bayesterra.arrays import FloatArray, spaced
from bayesterra.errors import StudyError, check_kind, check_seed, enumerated
from bayesterra.identifiability.information import ALL, MARGINAL, Coupling, Information, coupling, information
from bayesterra.identifiability.local import Collinearity, LocalAnalysis, collinearity, local_analysis
from bayesterra.identifiability.profiles import Profiles, no_profiles, profiles
from bayesterra.identifiability.structure import DRAWS as STRUCTURE_DRAWS
from bayesterra.identifiability.structure import Structure, structure
from bayesterra.identifiability.verdicts import DETERMINED, STRUCTURAL, WEAK, Identifiability, identifiability, judged
from bayesterra.likelihood.joint import Whole, whole_posterior
from bayesterra.parameters import PARAMETERS, field_values
from bayesterra.report.verdicts import Verdict
from bayesterra.runtime.engines import Engine
from bayesterra.runtime.folders import check_free
from bayesterra.runtime.tables import Count, Record
from bayesterra.sampling.joint import sample_whole
from bayesterra.sampling.sampler import PRIOR_DRAWS, thin
from bayesterra.study.result import AnalysisResult, Result, versions
from bayesterra.study.study import Study

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
    seconds: dict[str, float] = {}

    def timed(part: str, work: Callable[[], T]) -> T:
        """Outcome of a part, of which the name is told as it begins and the wall time kept."""
        report(part)
        started = time.perf_counter()
        result = work()
        seconds[part] = seconds.get(part, 0.0) + time.perf_counter() - started
        return result

    tracing, coupled, informing = (default_rng(stream) for stream in seed.spawn(3))

    def traced() -> Profiles:
        if posterior.grouped:
            return no_profiles(posterior, prior, draws)
        known = {"draws": draws, "prior_draws": prior, "references": mode}
        return profiles(posterior, rng=tracing, engine=engine, **known)

    profiled = timed("profiles", traced)

    def local(x: FloatArray) -> LocalAnalysis:
        return timed("local analysis", lambda: local_analysis(posterior, x, prior, draws))

    best, spread = local(profiled.best["posterior"]), local(spaced(draws, LOCAL_DRAWS))
    subsets = timed("collinearity", lambda: collinearity(spread))
    seen = timed("structure", lambda: structure(posterior, prior[:STRUCTURE_DRAWS]))
    tied = timed("coupling", lambda: coupling(posterior, prior, draws, coupled))
    informed = timed("information", lambda: information(posterior, prior, draws, informing))
    laws = posterior.prior.laws.values()
    ranges, logs = [law.range for law in laws], np.array([law.logarithmic for law in laws])
    stated, structural = posterior.prior.stated, np.isin(posterior.names, seen.determined)
    basis = identifiability(posterior.names, ranges, stated(prior), stated(draws), structural, logs)
    table = basis.table.assign(cut_contraction=informed.parameters["cut_contraction"])
    counts = informed.counts[informed.counts["view"] == MARGINAL].reset_index(drop=True)
    return Analysis(
        posterior.names, seen, best, spread, subsets, profiled, tied, informed,
        judged(table.join(_elsewhere(prior, spread, profiled))), _combinations(informed, seen),
        counts[["scope", "directions", "determined", "effective"]], seconds,
    )  # fmt: skip


def _elsewhere(prior: FloatArray, spread: LocalAnalysis, profiled: Profiles) -> pd.DataFrame:
    """Findings of profiles and bounds; ``prior`` has draws (m, d) of the cut one."""
    each = profiled.found.get("likelihood")
    told = [("", np.nan, np.nan, np.nan)] * len(spread.names)
    if each is not None:
        ends = np.array([profile.interval(95) for profile in each]).T
        excluded = ((prior < ends[0]) | (prior > ends[1])).mean(axis=0)  # share of the cut prior
        told = [(p.shape, *p.crossings(95), float(out)) for p, out in zip(each, excluded, strict=True)]
    table = pd.DataFrame(told, columns=["profile", "lower_95", "upper_95", "excluded"])
    return table.assign(expected=spread.table["expected"], local_sd=spread.table["local_sd"])


def _combinations(informed: Information, seen: Structure) -> pd.DataFrame:
    """Independent combinations and their verdicts, and those that the design cannot see."""
    table = informed.directions
    table = table[(table["scope"] == ALL) & (table["view"] == MARGINAL)]
    rated = judged(table)[["combination", "contraction", "verdict"]]
    nulls = [(null.words, np.nan, STRUCTURAL) for null in seen.nulls]
    if not nulls:
        return rated.reset_index(drop=True)
    return pd.concat([rated, pd.DataFrame(nulls, columns=rated.columns)], ignore_index=True)


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


LENGTHS = ("lower_95", "upper_95", "prior_sd", "local_sd", "posterior_sd")
ENDS = ("lower_95", "lower_68", "best", "upper_68", "upper_95")
SPREADS = ("prior_sd", "cramer_rao", "with_prior", "local_sd", "posterior_sd")
"""Columns that have the unit of their parameter, of verdicts, profiles and local analysis."""


@dataclass(frozen=True)
class Identified(AnalysisResult):
    """The identifiability of a study's parameters.

    Attributes
    ----------
    study : what was analysed.
    found : everything that was measured, SI.
    record : versions, seed, draws, whether they converged, and times.
    """

    MARK = "identifiability.json"
    RECORD = Record.having(
        sentence=str, model=str, drive=str, seed=Count, draws_from=str, draws=Count, converged=bool,
        seconds=dict[str, float],
    )  # fmt: skip
    VIEW = "bayesterra.identifiability.page:identifiability"

    study: Study
    found: Analysis
    record: dict[str, Any]

    @property
    def verdicts(self) -> pd.DataFrame:
        """The table of verdicts in field units, with a column ``unit``."""
        return in_field_units(self.found.verdicts, LENGTHS)

    @property
    def sentence(self) -> str:
        """The finding in a sentence, parameters by their plain symbols."""
        return self.in_words(lambda name: PARAMETERS[name].symbol)

    def in_words(self, symbol: Callable[[str], str]) -> str:
        """The finding in a sentence, parameters written as ``symbol`` says."""
        from bayesterra.report.blocks import records

        verdicts = self.found.verdicts
        words = dict(zip(verdicts["parameter"], verdicts["verdict"], strict=True))
        return in_a_sentence(records(self.found.counts), words, symbol)

    def tables(self) -> dict[str, pd.DataFrame]:
        """Everything that was measured; field units, named in a column ``unit`` or a header."""
        analysis = self.found
        return {
            "verdicts": self.verdicts, "combinations": analysis.combinations, "groups": analysis.information.counts,
            "directions": analysis.information.directions, "information": analysis.information.parameters,
            "coupling": analysis.coupling.pairs, "coupling_of_groups": analysis.coupling.between,
            "profiles": in_field_units(analysis.profiles.table, ENDS), "profile_points": _points(analysis),
            "compensation": analysis.profiles.compensation().rename_axis("profile").reset_index(),
            "local": in_field_units(analysis.spread.table, SPREADS),
            "local_at_best": in_field_units(analysis.best.table, SPREADS),
            "spectrum": pd.DataFrame(analysis.spread.spectra).rename(columns=lambda i: f"eigenvalue_{i + 1}"),
            "collinearity": analysis.collinearity.table, "importance": analysis.collinearity.importance,
            "structure": analysis.structure.table,
        }  # fmt: skip

    def to_record(self) -> dict[str, Any]:
        """Content of the JSON file."""
        return {"sentence": self.sentence, **self.record}


@dataclass(frozen=True)
class Foreseen:
    """Expectations from a design before its readings, over the cut prior; see :class:`Analysis`."""

    study: Study
    structure: Structure
    spread: LocalAnalysis
    collinearity: Collinearity
    record: dict[str, Any]

    @property
    def contraction(self) -> FloatArray:
        """Contraction (d,) to expect of each parameter, from the information averaged over the cut prior."""
        return np.asarray(np.clip(self.spread.table["expected"], 0.0, 1.0))


Report = Callable[[str], None]


def _of_result(result: Result, seed: int, engine: Engine | None, report: Report) -> Identified:
    """Analysis of a finished result, whose draws are used as they are."""
    prior, draws = result.values("prior"), result.values()
    mode = result.summary.set_index("parameter")["mode"]
    scaled = np.array([mode[name] * PARAMETERS[name].scale for name in result.names])
    target = whole_posterior(result.study)
    analysis = analyse(target, prior, draws, SeedSequence(seed), mode=scaled, engine=engine, report=report)
    source = {"draws_from": "the result", "draws": len(draws), "converged": result.converged}
    return Identified(result.study, analysis, _record(result.study, seed, analysis.seconds, source))


def _of_study(study: Study, seed: int, engine: Engine | None, report: Report) -> Identified:
    """Analysis of a study, which is sampled without the other parts of a run."""
    target = whole_posterior(study)
    analysing, sampling, drawing = SeedSequence(seed).spawn(3)
    prior = target.cut_prior(PRIOR_DRAWS, default_rng(drawing))
    samples = sample_whole(target, study.sampling, sampling, lambda progress: report(progress.stage))
    draws = thin(samples.chains).flat
    analysis = analyse(target, prior, draws, analysing, engine=engine, report=report)
    source = {"draws_from": "here", "draws": len(draws), "converged": samples.diagnosis.converged}
    return Identified(study, analysis, _record(study, seed, {**samples.seconds, **analysis.seconds}, source))


def foresee(study: Study, *, seed: int = 1) -> Foreseen:
    """Parameters that the design of a study could determine; its readings, if any, do not count.

    Raises
    ------
    StudyError : every parameter is fixed.
    SupportError : the prior leaves no parameter set that fits the conditions of the table.
    """
    check_kind("bt.foresee", study, Study)
    check_seed(seed)
    target = whole_posterior(study)
    if not target.names:
        raise StudyError("every parameter is fixed: there is nothing to determine")
    prior = target.cut_prior(PRIOR_DRAWS, default_rng(SeedSequence(seed)))
    spread, seen = local_analysis(target, spaced(prior, LOCAL_DRAWS), prior), structure(target, prior[:STRUCTURE_DRAWS])
    return Foreseen(study, seen, spread, collinearity(spread), _record(study, seed, {}, {"draws_from": "the prior"}))


def _record(study: Study, seed: int, seconds: dict[str, float], source: dict[str, Any]) -> dict[str, Any]:
    return {
        "title": study.title, "kind": study.kind, "model": study.model.name if study.wheels else "",
        "drive": study.drive if study.wheels else "", "seed": seed, **source, "seconds": seconds,
        "versions": versions(), "fingerprints": study.fingerprint,
    }  # fmt: skip


def in_field_units(table: pd.DataFrame, columns: Sequence[str], name: str = "parameter") -> pd.DataFrame:
    """A table whose ``columns`` are in the field unit of their row's parameter, with a column ``unit``."""
    parameters = [PARAMETERS[parameter] for parameter in table[name]]
    scale = np.array([parameter.scale for parameter in parameters])[:, None]
    converted = table.assign(**dict(zip(columns, (table[list(columns)].to_numpy() / scale).T, strict=True)))
    converted.insert(list(table).index(name) + 1, "unit", [parameter.unit for parameter in parameters])
    return converted


def _points(analysis: Analysis) -> pd.DataFrame:
    """Every point of every profile, with the path of all parameters."""
    frames, names = [], analysis.names
    for kind, traced in analysis.profiles.found.items():
        for profile in traced:
            columns = zip(names, profile.path.T, strict=True)
            path = {PARAMETERS[name].header: field_values(name, x) for name, x in columns}
            values = {"value": field_values(profile.name, profile.values), "rise": profile.rise}
            head = {"kind": kind, "profile": profile.name, "unit": PARAMETERS[profile.name].unit}
            frames.append(pd.DataFrame({**head, **values, **path}))
    none = pd.DataFrame(columns=["kind", "profile", "unit", "value", "rise"])
    return pd.concat(frames, ignore_index=True) if frames else none


def identify(
    what: Study | Result,
    *,
    seed: int = 1,
    engine: Engine | None = None,
    progress: Callable[[str], None] = lambda part: None,
) -> Identified:
    """Find out what the data of a study determine, and what only repeats the prior.

    Parameters
    ----------
    what : a result, whose draws are used, or a study, which is sampled first.
    seed : same seed, same answer, whatever the engine.
    engine : traces the profiles: ``bt.local_pool()``, ``bt.dask_cluster("tcp://…")``; by default this
        process.
    progress : called with the name of each part as it begins.

    Raises
    ------
    StudyError : every parameter is fixed.
    SupportError : the prior leaves no parameter set that fits the conditions of the data.
    """
    check_seed(seed)
    check_kind("bt.identify", what, Study, Result)
    if isinstance(what, Result):
        return _of_result(what, seed, engine, progress)
    return _of_study(what, seed, engine, progress)


def identify_into(
    what: Study | Result,
    out: Path,
    *,
    seed: int = 1,
    engine: Engine | None = None,
    overwrite: bool = False,
    quiet: bool = False,
) -> Identified:
    """Analyse a result or a study into a new folder, with a word on each part on a terminal."""
    from bayesterra.report.terminal import stages

    check_free(out, overwrite=overwrite, mark=Identified.MARK)
    with stages(show=not quiet) as show:
        result = identify(what, seed=seed, engine=engine, progress=show)
    result.save(out, overwrite=overwrite)
    return result
