"""From everything measured to verdicts: on each parameter, on combinations, on groups."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.identifiability.cloning import Cloned
from bayesterra.identifiability.contraction import bound, evidence, own_scale
from bayesterra.identifiability.coupling import Coupling
from bayesterra.identifiability.information import ALL, MARGINAL, Information
from bayesterra.identifiability.local import LocalAnalysis
from bayesterra.identifiability.powerscaling import PowerScaling
from bayesterra.identifiability.profiles import Profile, Profiles
from bayesterra.identifiability.structure import Structure
from bayesterra.identifiability.verdicts import (
    DETERMINED,
    MOVED,
    STRUCTURAL,
    WEAK,
    Correlated,
    disagreements,
    tied_to,
    ties,
    word,
)
from bayesterra.posteriors import Posterior


@dataclass(frozen=True)
class FromDraws:
    """What only draws of the posterior tell."""

    coupling: Coupling
    information: Information
    cloned: Cloned
    scaling: PowerScaling


@dataclass(frozen=True)
class Assessment:
    """What the verdicts are made of; draws are of the cut prior (m, d) and of the posterior (n, d)."""

    posterior: Posterior
    prior: FloatArray
    draws: FloatArray
    structure: Structure
    spread: LocalAnalysis
    profiles: Profiles
    drawn: FromDraws

    def verdicts(self) -> pd.DataFrame:
        """One row per parameter; see :class:`bayesterra.identifiability.analysis.Analysis`."""
        own = self._own()
        figures = pd.concat([own, self._ties(own), self._elsewhere()], axis=1)
        found = evidence(figures)
        words = [word(each) for each in found]
        against = ["; ".join(disagreements(*each)) for each in zip(found, words, strict=True)]
        head = pd.DataFrame({"parameter": list(self.posterior.names), "verdict": words})
        return pd.concat([head, figures], axis=1).assign(against=against)

    def _own(self) -> pd.DataFrame:
        """What the draws of a parameter say by themselves."""
        ends = np.array([law.range for law in self.posterior.prior.laws.values()])
        draws, low, high = (own_scale(x, self._logs) for x in (self.draws, *ends.T))
        leaning = [bound(*each) for each in zip(draws.T, low, high, strict=True)]
        table = self.drawn.information.parameters
        return table[["contraction", "shift", "divergence", "cut_contraction"]].assign(bound=leaning)

    @property
    def _logs(self) -> BoolArray:
        """Parameters whose laws live on a logarithmic scale (d,)."""
        return np.array([law.logarithmic for law in self.posterior.prior.laws.values()])

    def _ties(self, own: pd.DataFrame) -> pd.DataFrame:
        """How the parameters hang together."""
        names, coupling = self.posterior.names, self.drawn.coupling
        plain = np.atleast_2d(np.corrcoef(own_scale(self.draws, self._logs).T))
        others = plain - np.eye(len(plain))
        partners = np.abs(others).argmax(axis=1)
        contraction, bounds = own["contraction"].to_numpy(), own["bound"].tolist()
        correlated = Correlated(plain, coupling.copula, coupling.prior_copula)
        found = ties(contraction, bounds, correlated)
        table = pd.DataFrame(
            {
                "partner": [names[i] for i in partners],
                "tied_to": [names[i] for i in tied_to(contraction, bounds, plain)],
            }
        )
        return table.assign(correlation=others[np.arange(len(plain)), partners], **found)

    def _elsewhere(self) -> pd.DataFrame:
        """What structure, profiles, cloned data, bounds and power-scaling say."""
        each, seen = self.profiles.found["likelihood"], self.structure.determined
        local = self.spread.table
        return pd.DataFrame(
            {
                "structural": [name in seen for name in self.posterior.names],
                "profile": [profile.shape for profile in each],
                "lower_95": [profile.crossings(95)[0] for profile in each],
                "upper_95": [profile.crossings(95)[1] for profile in each],
                "excluded": [_excluded(p, x) for p, x in zip(each, self.prior.T, strict=True)],
                "cloned": _firm(self.drawn.cloned),
                "scaling": self.drawn.scaling.table["word"],
                **{name: local[name] for name in ("expected", "prior_sd", "local_sd", "posterior_sd")},
            }
        )

    def combinations(self) -> pd.DataFrame:
        """Independent combinations and their verdicts, and those that the design cannot see."""
        table = self.drawn.information.directions
        table = table[(table["scope"] == ALL) & (table["view"] == MARGINAL)]
        words = [rated_as(*each) for each in zip(table["contraction"], table["divergence"], strict=True)]
        rated = table[["combination", "contraction"]].assign(verdict=words)
        nulls = [(null.words, np.nan, STRUCTURAL) for null in self.structure.nulls]
        if not nulls:
            return rated.reset_index(drop=True)
        return pd.concat([rated, pd.DataFrame(nulls, columns=rated.columns)], ignore_index=True)

    def counts(self) -> pd.DataFrame:
        """Directions of each group, and of all parameters, and how many are determined."""
        table = self.drawn.information.counts
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


def _firm(found: Cloned) -> list[str]:
    """Words of data cloning; none where its weights cannot be relied on."""
    return [word if word in ("estimable", "not estimable") else "" for word in found.parameters["word"]]
