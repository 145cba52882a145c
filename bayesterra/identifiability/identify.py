"""The job ``identify``: what the data of a study or a result determine, as a folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import SeedSequence, default_rng

from bayesterra.arrays import FloatArray, spaced
from bayesterra.errors import StudyError, check_kind, check_seed
from bayesterra.identifiability.analysis import LOCAL_DRAWS, Analysis, analyse, in_a_sentence
from bayesterra.identifiability.local import Collinearity, LocalAnalysis, collinearity, local_analysis
from bayesterra.identifiability.structure import DRAWS as STRUCTURE_DRAWS
from bayesterra.identifiability.structure import Structure, structure
from bayesterra.likelihood.joint import whole_posterior
from bayesterra.parameters import PARAMETERS, field_values
from bayesterra.report.blocks import records
from bayesterra.runtime.engines import Engine
from bayesterra.runtime.folders import check_free
from bayesterra.runtime.tables import Count, Record
from bayesterra.sampling.joint import sample_whole
from bayesterra.sampling.sampler import PRIOR_DRAWS, thin
from bayesterra.study.result import AnalysisResult, Result, versions
from bayesterra.study.study import Study

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
        verdicts = self.found.verdicts
        words = dict(zip(verdicts["parameter"], verdicts["verdict"], strict=True))
        return in_a_sentence(records(self.found.counts), words, symbol)

    def tables(self) -> dict[str, pd.DataFrame]:
        """Everything that was measured; field units, named in a column ``unit`` or a header."""
        analysis = self.found
        return {
            "verdicts": self.verdicts,
            "combinations": analysis.combinations,
            "groups": analysis.information.counts,
            "directions": analysis.information.directions,
            "information": analysis.information.parameters,
            "coupling": analysis.coupling.pairs,
            "coupling_of_groups": analysis.coupling.between,
            "profiles": in_field_units(analysis.profiles.table, ENDS),
            "profile_points": _points(analysis),
            "compensation": analysis.profiles.compensation().rename_axis("profile").reset_index(),
            "local": in_field_units(analysis.spread.table, SPREADS),
            "local_at_best": in_field_units(analysis.best.table, SPREADS),
            "spectrum": pd.DataFrame(analysis.spread.spectra).rename(columns=lambda i: f"eigenvalue_{i + 1}"),
            "collinearity": analysis.collinearity.table,
            "importance": analysis.collinearity.importance,
            "structure": analysis.structure.table,
        }

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
        "title": study.title,
        "kind": study.kind,
        "model": study.model.name,
        "drive": study.drive,
        "seed": seed,
        **source,
        "seconds": seconds,
        "versions": versions(),
        "fingerprints": study.fingerprint,
    }


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
    for kind, profiles in analysis.profiles.found.items():
        for profile in profiles:
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
