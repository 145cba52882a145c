"""Directions of the parameters that no data of this design can determine, however many and however good.

A design is what a study measures where: the slips, wheels and loads (or sinkages) of its rows, and the
channels that are read. A direction is beyond it if it changes no reading anywhere in the prior. So the rank
of the exact sensitivity matrix (Jacquez & Greif 1985, Math. Biosci. 77, 201; Cole 2020, Parameter Redundancy
and Identifiability) is found at many draws of the cut prior: the models are analytic in their parameters, so
the rank is the same almost everywhere, and a lower one in single draws is an accident of the place.

A null space that is the same everywhere is a redundancy of the parameters as they stand, e.g. of k_c and k_φ
under wheels of one width, or of n0 and n1 at one slip; one that turns from draw to draw is a curve.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray
from bayesterra.identifiability._design import Design, design_of
from bayesterra.identifiability._directions import combination, listed
from bayesterra.identifiability._ranks import Ranks, ranks, soil_columns
from bayesterra.identifiability.sensitivities import has_own_sd, read_where
from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.posteriors import Posterior

DRAWS = 300
"""Draws of the cut prior that are plenty."""


@dataclass(frozen=True)
class Null:
    """Directions that change no reading and have parameters in common.

    Attributes
    ----------
    parameters : those that take part, in the package's order.
    directions : (count, d), SI, each with one parameter to itself, which moves by its prior standard
        deviation; at one draw of the prior where bent.
    straight : whether they are the same everywhere.
    words : what is determined instead, and why no more.
    """

    parameters: tuple[str, ...]
    directions: FloatArray
    straight: bool
    words: str


@dataclass(frozen=True)
class Structure:
    """What the design of a study can determine.

    Attributes
    ----------
    names : the d free parameters.
    design : rows and channels of the study.
    rank : number of directions that the design sees, d if it sees all.
    nulls : the others.
    table : one row per parameter: parameter, determined (bool), because (words, empty where it is).
    accidents : share of the prior's draws at which the rank is lower still.
    least_seen, most_unseen : singular values on both sides of ``RANK_TOLERANCE``: the median of the weakest
        direction seen, the largest of one unseen (0 where all are seen).
    draws : number of draws behind it.
    """

    names: tuple[str, ...]
    design: Design
    rank: int
    nulls: tuple[Null, ...]
    table: pd.DataFrame
    accidents: float
    least_seen: float
    most_unseen: float
    draws: int

    @property
    def determined(self) -> tuple[str, ...]:
        """Parameters that the design can determine."""
        lost = {name for null in self.nulls for name in null.parameters}
        return tuple(name for name in self.names if name not in lost)


def structure(posterior: Posterior, prior: FloatArray) -> Structure:
    """Find what no data of this design can determine.

    Parameters
    ----------
    posterior : of the study; only where there are readings counts, not what they are. A channel that has
        noise but no reading at all counts as read in every row: a study made before its measurements.
    prior : draws (n, d) of the cut prior, a few hundred.

    Raises
    ------
    ValueError : the model has no answer for any of the draws.
    """
    found = ranks(posterior, prior, posterior.likelihood.channels)
    if not len(found.matrices):
        raise ValueError("the model has no answer in some row for every draw of the prior")
    nulls = (*_soil_nulls(posterior, prior, found), *_noise_nulls(posterior))
    seen = found.values[:, : found.rank]
    return Structure(
        names=posterior.names,
        design=design_of(posterior),
        rank=len(posterior.names) - sum(len(null.directions) for null in nulls),
        nulls=nulls,
        table=_table(posterior.names, nulls),
        accidents=float((found.of_sets < found.rank).mean()),
        least_seen=float(np.median(seen.min(axis=1))) if found.rank else 0.0,
        most_unseen=float(found.values[:, found.rank :].max(initial=0.0)),
        draws=len(found.matrices),
    )


def _soil_nulls(posterior: Posterior, prior: FloatArray, found: Ranks) -> list[Null]:
    """Unseen directions of all but the noise."""
    columns = soil_columns(posterior)
    names = [posterior.names[i] for i in columns]
    unseen, design = found.unseen(), design_of(posterior)
    remedies = _remedies(posterior, prior) if unseen else {}
    nulls = []
    for each in unseen:
        parts = [i for i in range(len(names)) if each.directions[:, i].any()]
        parameters = tuple(names[i] for i in parts)
        directions = np.zeros((len(each.directions), len(posterior.names)))
        directions[:, columns] = each.directions * prior[:, columns].std(axis=0)
        words = _words(parameters, directions[:, [columns[i] for i in parts]], each.straight)
        counted = None if each.straight else len(names)
        reasons = [*design.reasons(parameters, counted), *_helped(parameters, remedies)]
        if len(parameters) == len(directions) and not len(design.given):
            words += ", or only in the way that it depends on the unknown load"
        nulls.append(Null(parameters, directions, each.straight, "; ".join([words, *reasons])))
    return nulls


def _noise_nulls(posterior: Posterior) -> list[Null]:
    """Estimated noise of channels whose every reading has a standard deviation of its own."""
    likelihood, nulls = posterior.likelihood, []
    read = read_where(posterior, likelihood.channels)
    for noise, where in zip(likelihood.noise, read.T, strict=True):
        if noise.parameter is not None and not (where & ~has_own_sd(likelihood, noise)).any():
            direction = np.zeros((1, len(posterior.names)))
            direction[0, posterior.names.index(noise.parameter)] = 1.0
            words = "every reading has a standard deviation of its own"
            nulls.append(Null((noise.parameter,), direction, True, words))
    return nulls


def _words(parameters: tuple[str, ...], directions: FloatArray, straight: bool) -> str:
    """What is determined in place of each of ``parameters``; ``directions`` (count, parameters), SI."""
    known, all_of = len(parameters) - len(directions), len(parameters)
    if known == 0:
        return f"no reading depends on {listed(parameters)}"
    if straight and all_of == 2:
        first, second = (PARAMETERS[name].scale for name in parameters)
        weight = -directions[0, 0] / directions[0, 1] * second / first
        inside = combination(parameters, np.array([1.0, weight]), least=0.0, digits=3)
        units = [PARAMETERS[name].unit for name in parameters]
        return f"only {inside} is determined" + (f" ({' and '.join(units)})" if set(units) != {"-"} else "")
    seen = f"{known} of {all_of} directions {'is' if known == 1 else 'are'} determined"
    bent = (
        ""
        if straight
        else ", which differs from soil to soil"
        if known == 1
        else ", which differ from soil to soil"
    )
    return f"of {listed(parameters)} only {seen}{bent}"


def _remedies(posterior: Posterior, prior: FloatArray) -> dict[tuple[str, ...], set[str]]:
    """What every channel that is not read would determine, and all of them together."""
    names = [posterior.names[i] for i in soil_columns(posterior)]
    missing, determined = design_of(posterior).missing, {}
    for added in dict.fromkeys([*((name,) for name in missing), missing] if missing else []):
        unseen = ranks(posterior, prior, (*posterior.likelihood.channels, *added)).unseen()
        lost = {names[i] for each in unseen for i in np.flatnonzero(each.directions.any(axis=0))}
        determined[added] = set(names) - lost
    return determined


def _helped(parameters: tuple[str, ...], remedies: Mapping[tuple[str, ...], set[str]]) -> list[str]:
    """Which further channels would determine some of ``parameters``; several only where one is too few."""
    choices: dict[tuple[str, ...], list[str]] = {}
    for channels, determined in remedies.items():
        new = tuple(name for name in parameters if name in determined)
        if new and not (len(channels) > 1 and any(set(new) <= set(one) for one in choices)):
            words = " and ".join(CHANNELS[name].description for name in channels)
            choices.setdefault(new, []).append(words)
    return [
        f"readings of {' or '.join(words)} would determine"
        f" {'them' if new == parameters and len(new) > 1 else listed(new)}"
        for new, words in choices.items()
    ]


def _table(names: tuple[str, ...], nulls: Sequence[Null]) -> pd.DataFrame:
    because = {name: [null.words for null in nulls if name in null.parameters] for name in names}
    return pd.DataFrame(
        {
            "parameter": list(names),
            "determined": [not because[name] for name in names],
            "because": ["; ".join(because[name]) for name in names],
        }
    )
