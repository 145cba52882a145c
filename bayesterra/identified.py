"""What the data of a study determine, found from a saved result or from the study itself."""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import SeedSequence, default_rng

from bayesterra.arrays import FloatArray
from bayesterra.identifiability.analysis import Analysis, Outlook, analyse, outlook
from bayesterra.identifiability.information import ALL
from bayesterra.inference import PRIOR_DRAWS, keep
from bayesterra.parameters import PARAMETERS
from bayesterra.posteriors import draw_cut_prior, posterior
from bayesterra.record import PACKAGES
from bayesterra.results import Result
from bayesterra.sampling.sampler import Progress, sample
from bayesterra.study import Study

GROUP_WORDS = {"P_I": "bearing", "P_II": "shearing", "P_III": "contact-angle"}
NUMBERS = ("none", "one", "two", "three")
LENGTHS = ("lower_95", "upper_95", "prior_sd", "local_sd", "posterior_sd")
"""Columns of the verdicts that have the unit of their parameter."""


@dataclass(frozen=True)
class Identified:
    """The identifiability of a study's parameters.

    Attributes
    ----------
    study : what was analysed.
    found : everything that was measured, SI.
    record : versions, seed, draws, whether they converged, and times.
    """

    study: Study
    found: Analysis
    record: dict[str, Any]

    @property
    def verdicts(self) -> pd.DataFrame:
        """The table of verdicts in field units, with a column ``unit``."""
        table = self.found.verdicts.copy()
        parameters = [PARAMETERS[name] for name in table["parameter"]]
        scale = np.array([parameter.scale for parameter in parameters])
        table[list(LENGTHS)] = table[list(LENGTHS)].to_numpy() / scale[:, None]
        table.insert(1, "unit", [parameter.unit for parameter in parameters])
        return table

    @property
    def sentence(self) -> str:
        """The finding in a sentence, parameters by their plain symbols."""
        return in_a_sentence(self.found, lambda name: PARAMETERS[name].symbol)


@dataclass(frozen=True)
class Foreseen:
    """What a design lets expect before its readings; see :class:`Identified`."""

    study: Study
    found: Outlook
    record: dict[str, Any]


def in_a_sentence(found: Analysis, symbol: Callable[[str], str]) -> str:
    """How many directions of each group are fixed, and which parameters only repeat their prior."""
    counts = found.counts[found.counts["scope"] != ALL].to_dict("records")
    parts = [_count(row["scope"], row["determined"], row["directions"]) for row in counts]
    if not parts:
        (row,) = found.counts.to_dict("records")
        parts = [f"{row['determined']} of {row['directions']} directions"]
    fixed = f"These data fix {_listed(parts)}"
    words = found.verdicts.groupby("verdict", sort=False)["parameter"].agg(list).to_dict()
    rest = []
    if names := words.get("repeats its prior"):
        rest.append(f"{_listed([symbol(n) for n in names])} {_repeats(len(names))}")
    if names := words.get("structurally not determined"):
        rest.append(f"no data of this design can determine {_listed([symbol(n) for n in names])}")
    return "; ".join([fixed, *rest]) + "."


def _repeats(count: int) -> str:
    return "repeats its prior" if count == 1 else "repeat their priors"


def _count(group: str, determined: int, of: int) -> str:
    """Such as ``two of the three bearing directions``."""
    many = f"of the {NUMBERS[of]} {GROUP_WORDS[group]} directions" if of in (2, 3) else ""
    if of == 1:
        return (
            f"the one {GROUP_WORDS[group]} parameter" if determined else f"no {GROUP_WORDS[group]} parameter"
        )
    if determined == of:
        return f"{'both' if of == 2 else f'all {NUMBERS[of]}'} {GROUP_WORDS[group]} directions"
    return f"{NUMBERS[determined]} {many}"


def _listed(parts: list[str]) -> str:
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)


def identify_result(
    result: Result, *, seed: int = 1, report: Callable[[str], None] = lambda part: None
) -> Identified:
    """Analyse a finished result; its draws are used as they are."""
    prior, draws = result.values("prior"), result.values()
    mode = result.summary.set_index("parameter")["mode"]
    scaled = np.array([mode[name] * PARAMETERS[name].scale for name in result.names])
    found = analyse(posterior(result.study), prior, draws, SeedSequence(seed), mode=scaled, report=report)
    source = {"draws_from": "the result", "draws": len(draws), "converged": result.converged}
    return Identified(result.study, found, _record(result.study, seed, found.seconds, source))


def identify_study(
    study: Study, *, seed: int = 1, report: Callable[[str], None] = lambda part: None
) -> Identified:
    """Sample a study and analyse it, without the other parts of a run.

    Raises
    ------
    StudyError : every parameter is fixed.
    SupportError : the prior leaves no parameter set that fits the conditions of the data.
    """
    target = posterior(study)
    analysing, sampling, drawing = SeedSequence(seed).spawn(3)
    prior = draw_cut_prior(target, PRIOR_DRAWS, default_rng(drawing)).x

    def update(progress: Progress) -> None:
        report(progress.stage)

    samples = sample(target, study.sampling, sampling, update)
    draws = keep(samples.chains).flat
    found = analyse(target, prior, draws, analysing, report=report)
    source = {"draws_from": "here", "draws": len(draws), "converged": samples.diagnosis.converged}
    return Identified(study, found, _record(study, seed, {**samples.seconds, **found.seconds}, source))


def foresee(study: Study, *, seed: int = 1) -> Foreseen:
    """What the design of a study could determine; its readings, where there are any, do not count.

    Raises
    ------
    SupportError : the prior leaves no parameter set that fits the conditions of the table.
    """
    target = posterior(study)
    prior = draw_cut_prior(target, PRIOR_DRAWS, default_rng(SeedSequence(seed))).x
    return Foreseen(study, outlook(target, prior), _record(study, seed, {}, {"draws_from": "the prior"}))


def _record(study: Study, seed: int, seconds: dict[str, float], source: dict[str, Any]) -> dict[str, Any]:
    return {
        "title": study.title,
        "kind": study.kind,
        "model": study.model.name,
        "drive": study.drive,
        "seed": seed,
        **source,
        "seconds": seconds,
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
        "fingerprints": study.fingerprint,
    }


def tables(made: Identified) -> dict[str, pd.DataFrame]:
    """Everything that was measured, by file name; SI where a column ``unit`` does not say otherwise."""
    found, drawn = made.found, made.found.drawn
    return {
        "verdicts": made.verdicts,
        "combinations": found.combinations,
        "groups": drawn.information.counts,
        "directions": drawn.information.directions,
        "information": drawn.information.parameters,
        "coupling": drawn.coupling.pairs,
        "coupling_of_groups": drawn.coupling.between,
        "profiles": found.profiles.table,
        "profile_points": _points(found),
        "compensation": found.profiles.compensation().rename_axis("profile").reset_index(),
        "local": found.spread.table,
        "local_at_best": found.best.table,
        "spectrum": pd.DataFrame(found.spread.spectra, columns=_numbered(len(found.names))),
        "collinearity": found.collinearity.table,
        "importance": found.collinearity.importance,
        "structure": found.structure.table,
        "cloning": drawn.cloned.parameters,
        "cloning_directions": drawn.cloned.directions,
        "power_scaling": drawn.scaling.table,
    }


def _numbered(count: int) -> list[str]:
    return [f"eigenvalue_{i + 1}" for i in range(count)]


def _points(found: Analysis) -> pd.DataFrame:
    """Every point of every profile, with the path of all parameters."""
    parts = []
    for kind, profiles in found.profiles.found.items():
        for profile in profiles:
            path = pd.DataFrame(profile.path, columns=list(found.names))
            head = {"kind": kind, "profile": profile.name, "value": profile.values, "rise": profile.rise}
            parts.append(pd.DataFrame(head).join(path))
    return pd.concat(parts, ignore_index=True)


def expected_contraction(made: Foreseen) -> FloatArray:
    """Contraction (d,) to expect of each parameter, from the information averaged over the cut prior."""
    return np.asarray(np.clip(made.found.spread.table["expected"], 0.0, 1.0))
