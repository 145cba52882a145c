"""Test of whether a parameter belongs to the soil or to each wheel: evidence for one value against several.

Three studies are compared that differ in the role of one parameter (or of c and φ together) and in nothing
else: one value for all groups, a value of each group under the parameter's own prior, and values of each
group from one population. The log Bayes factors are differences of their log evidences, each under its prior
cut to the physical support and renormalised.

The population is there because values that differ by less than a wide prior allows would pass for one value
against values of each group's own alone (Lindley 1957). Its laws are those of the study, or the default ones:
the mean has the parameter's prior, the spread is half-normal with half of its standard deviation. A common
value must beat both, and is beaten by either.

Asked of the groups alone, all other parameters are each group's own. That leaves them open, so that what
moves together, such as K and φ, hides differences. Asked as stated, all others have their roles in the study.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import FloatArray
from bayesterra.pooling.degrees import Level, level_of, with_roles
from bayesterra.pooling.joint import JointPosterior
from bayesterra.study.groups import Population

STRONG = 3.0
"""Log Bayes factor (natural units) from which on the data decide: odds of 20 to 1, which Kass and Raftery
(1995, J. Am. Stat. Assoc. 90, 773) call strong."""
CONSTANT, DEPENDENT, OPEN = "soil constant", "dependent", "cannot tell"


@dataclass(frozen=True)
class Sharing:
    """Evidence for common values of one or several parameters.

    Attributes
    ----------
    names : the parameters, judged together.
    common, own, population : log evidence of common values, of values of each group under the stated prior,
        and of values of each group from one population.
    by : what groups the rows, for the wording.
    """

    names: tuple[str, ...]
    common: Level
    own: Level
    population: Level
    by: str

    @property
    def against_own(self) -> float:
        """Log Bayes factor of common values against values of each group under the stated prior."""
        return self.common.log_z - self.own.log_z

    @property
    def against_population(self) -> float:
        """The same against values of each group from one population."""
        return self.common.log_z - self.population.log_z

    @property
    def log_factor(self) -> float:
        """Log Bayes factor of common values against the better of the two alternatives."""
        return min(self.against_own, self.against_population)

    @property
    def error(self) -> float:
        """Monte Carlo standard error of that."""
        better = self.own if self.against_own < self.against_population else self.population
        return float(np.hypot(self.common.error, better.error))

    @property
    def reliable(self) -> bool:
        """True where all three evidences can be relied on."""
        return self.common.reliable and self.own.reliable and self.population.reliable

    @property
    def verdict(self) -> str:
        """``soil constant``, ``wheel-dependent`` (or ``site-``, ``run-``) or ``cannot tell``.

        Two standard errors must lie beyond the threshold, and the evidences must be reliable.
        """
        if self.reliable and self.log_factor - 2 * self.error > STRONG:
            return CONSTANT
        if self.reliable and self.log_factor + 2 * self.error < -STRONG:
            return f"{self.by}-{DEPENDENT}"
        return OPEN


@dataclass(frozen=True)
class Evidences:
    """Log evidences of a study under other roles of its parameters, each computed once.

    Attributes
    ----------
    joint : the study's own.
    chains : draws of each group's posterior alone, physical (ensembles, steps, walkers, parameters).
    rng : of the estimates, each of which has a stream of its own.
    complete, stated, none : of what is known beforehand: all shared, the study's own roles, nothing shared.
    """

    joint: JointPosterior
    chains: Mapping[str, FloatArray]
    rng: Generator
    complete: Level
    stated: Level
    none: Level
    levels: dict[str, Level] = field(default_factory=dict, init=False)

    def of(self, shared: Sequence[str], hierarchical: Mapping[str, Population]) -> Level:
        """Log evidence where these are shared, those have a population, all others are each group's own."""
        joint = with_roles(self.joint, shared, hierarchical)
        if not joint.local:
            return self.complete
        if not joint.shared_and_hyper:
            return self.none
        key = _key(joint)
        if key == _key(self.joint):
            return self.stated
        if key not in self.levels:
            self.levels[key] = level_of(joint, self.chains, *self.rng.spawn(1))
        return self.levels[key]

    def population(self, name: str) -> Population:
        """The laws of a parameter's population: the study's, or the default ones."""
        return self.joint.pooling.hierarchical.get(name, Population())


def _key(joint: JointPosterior) -> str:
    return str((sorted(joint.shared), sorted(joint.hyper.items())))


def judged_alone(evidences: Evidences, names: Sequence[str]) -> Sharing:
    """Judge whether parameters have one value in all groups, all others being each group's own."""
    populations = {name: evidences.population(name) for name in names}
    return Sharing(
        tuple(names),
        evidences.of(names, {}),
        evidences.none,
        evidences.of((), populations),
        evidences.joint.pooling.by,
    )


def judged_as_stated(evidences: Evidences, name: str) -> Sharing:
    """Judge whether a parameter has one value in all groups, all others being as the study states them."""
    pooling = evidences.joint.pooling
    shared = [other for other in evidences.joint.shared if other != name]
    populations = {other: population for other, population in pooling.hierarchical.items() if other != name}
    return Sharing(
        (name,),
        evidences.of([*shared, name], populations),
        evidences.of(shared, populations),
        evidences.of(shared, {**populations, name: evidences.population(name)}),
        pooling.by,
    )
