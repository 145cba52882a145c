"""Degrees of pooling: complete, as stated, none; and evidence that a parameter is one value of the soil.

The posterior of other roles begins with the groups' own: what groups share is drawn from the product of their
laws of it, the rest of each group from its law given that. Laws are fitted to these draws, and fresh draws of
the laws are weighed, which no fit has seen. Groups that agree are done then; where the weights are uneven
walkers move from there, and laws are fitted to where they went.

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

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator
from threadpoolctl import threadpool_limits

from bayesterra.arrays import FloatArray, spaced
from bayesterra.likelihood.joint import JointPosterior
from bayesterra.pooling.evidence import (
    Draws,
    OuterLaws,
    PriorShares,
    Weighed,
    joint_shares,
    outer_laws,
    plain_shares,
    weigh,
    weigh_joint,
    weigh_plain,
)
from bayesterra.sampling.evidence import Evidence
from bayesterra.sampling.family import JointFamily
from bayesterra.sampling.joint import (
    JointDraws,
    JointSamples,
    begun,
    flattened,
    group_coordinates,
    refitted,
    starting_points,
    warmed_up,
)
from bayesterra.sampling.moves import Laws, Walkers, run_together
from bayesterra.sampling.sampler import Samples
from bayesterra.study.groups import Population

WALKERS, STARTS = 128, 2048
"""Walkers of an adaptation, and draws of each group's own posterior, at most, that it begins with."""
WARM_UPS, SWEEPS = (16, 32), (40, 80, 160, 320, 640)
"""Sweeps of each warm-up, and after them of those that laws are fitted to, more while weights are uneven."""
FEW, OUTER, INNER = 512, 2048, 32
"""Weighed draws of what groups share, few at first, and of each group's own for each of them."""
REPEATS = 2
"""Adaptations that have nothing in common but the study."""
FEWEST = 100
"""Points inside the support below which no law is fitted and no evidence estimated."""
SHARE_DRAWS, SHARE_INNER = 2000, 8
"""Draws for the share of a prior inside the physical support."""
SURE = 0.1
"""Largest error of a log evidence that does with the fewest sweeps."""


@dataclass(frozen=True)
class Level:
    """Log evidence under the prior cut to the physical support and renormalised, and its Monte Carlo error.

    In natural units; NaN where no draw says anything. ``reliable`` says whether the error can be relied on.
    """

    log_z: float
    error: float
    reliable: bool


UNKNOWN = Level(np.nan, np.nan, reliable=False)


def with_roles(joint: JointPosterior, shared: Sequence[str], hierarchical: Mapping[str, Population]) -> JointPosterior:
    """The same groups; some parameters are shared, some have a population, all others are separate."""
    names = joint.first.names
    separate = tuple(name for name in names if name not in shared and name not in hierarchical)
    ordered = {name: hierarchical[name] for name in names if name in hierarchical}
    common = tuple(name for name in names if name in shared)
    return replace(joint, pooling=replace(joint.pooling, shared=common, separate=separate, hierarchical=ordered))


def level_of(joint: JointPosterior, chains: Mapping[str, FloatArray], rng: Generator) -> Level:
    """Estimate the evidence of a joint posterior that has something in common and something of each group.

    ``chains`` are draws of each group's own posterior, physical (ensembles, steps, walkers, parameters).
    """
    family, count = JointFamily(joint), len(next(iter(chains.values())))
    starts: list[JointDraws] = []
    alone: list[Draws] = []
    evidence: Evidence | None = None
    with threadpool_limits(limits=1):
        for e in range(REPEATS):
            some = {name: spaced(np.concatenate(x[e % count].swapaxes(0, 1)), STARTS) for name, x in chains.items()}
            D, L = starting_points(family, some, rng)
            inside = np.isfinite(Walkers.at(family, D, L).log_density)
            if inside.sum() < FEWEST:
                return UNKNOWN
            starts.append((D[inside], L[:, inside]))
            alone.append([group_coordinates(family, g, x, rng) for g, x in enumerate(some.values())])
        for found in _found(family, starts, rng):
            laws = [outer_laws(family, own, apart, *at, rng) for apart, (own, at) in zip(alone, found, strict=True)]
            evidence = _evidence(family, laws, FEW, rng)
            evidence = evidence if _is_sure(evidence) else _evidence(family, laws, OUTER, rng)
            if _is_sure(evidence):
                break
        with np.errstate(divide="ignore", invalid="ignore"):  # a share of nothing, which no draw hits
            share = joint_shares(joint, rng, outer=SHARE_DRAWS, inner=SHARE_INNER)
    if evidence is None or not np.isfinite([share.whole, share.error]).all():
        return UNKNOWN
    error = float(np.hypot(evidence.error, share.error))
    return Level(evidence.log_z - share.whole, error, evidence.reliable)


def _found(
    family: JointFamily, starts: Sequence[JointDraws], rng: Generator
) -> Iterator[list[tuple[Laws, JointDraws]]]:
    """Laws of every adaptation and the draws they are fitted to: those to start from, then where walkers went."""
    ensembles = [begun(family, *start, WALKERS, rng) for start in starts]
    yield [(ensemble.laws, start) for ensemble, start in zip(ensembles, starts, strict=True)]
    ensembles = warmed_up(ensembles, WARM_UPS)
    for sweeps in SWEEPS:
        D, L, _ = run_together(ensembles, sweeps)
        ensembles = list(map(refitted, ensembles, D, L))
        yield [(ensemble.laws, flattened(*went)) for ensemble, *went in zip(ensembles, D, L, strict=True)]


def _evidence(family: JointFamily, laws: Sequence[OuterLaws], draws: int, rng: Generator) -> Evidence | None:
    weighed = weigh(family, laws, draws, INNER, rng, rows_out=False)
    inside = np.isfinite(weighed.base + weighed.groups.sum(axis=0))
    return weighed.evidence if inside.sum() >= FEWEST else None


def _is_sure(evidence: Evidence | None) -> bool:
    return evidence is not None and evidence.reliable and evidence.error < SURE


COMPLETE, PARTIAL, NONE = "complete", "as stated", "none"
"""One value for all groups; the study's own roles; every group alone."""
INDISTINCT = 3.0
"""Difference of log evidences below which two degrees of pooling are not told apart; odds of 20 to 1."""

LEFT_OUT_COLUMNS = ("pooling", "what", "label", "elpd", "error", "k", "reliable")
DEGREE_COLUMNS = ("pooling", "converged", "log_evidence", "log_evidence_error", "evidence_reliable")


@dataclass(frozen=True, kw_only=True)
class Degree(Level):
    """One degree of pooling, and its log evidence."""

    name: str  # ``complete``, ``as stated`` or ``none``
    converged: bool  # of its sampling
    left_out: pd.DataFrame  # elpd of every row and group, columns ``pooling, what, label, elpd, error, k, reliable``

    def row(self) -> dict[str, Any]:
        """A row of the table."""
        elpd_columns: dict[str, Any] = {}
        for what in ("row", "group"):
            some = self.left_out[self.left_out["what"] == what]
            spread = float(np.sqrt(len(some)) * some["elpd"].std())
            elpd_columns |= {
                f"elpd_{what}s": float(some["elpd"].sum()),
                f"se_{what}s": spread,
                f"error_{what}s": float(np.sqrt((some["error"] ** 2).sum())),
                f"unreliable_{what}s": int((~some["reliable"]).sum()),
            }
        head = {"pooling": self.name, "converged": self.converged, "log_evidence": self.log_z}
        return {**head, "log_evidence_error": self.error, "evidence_reliable": self.reliable, **elpd_columns}


def degrees_of(
    joint: JointPosterior, samples: JointSamples, complete: Samples, rng: Generator
) -> tuple[Degree, Degree, Degree]:
    """Complete pooling, the study's own roles, none."""
    names = list(joint.groups)
    of_joint = weigh_joint(samples, rng)
    proposals = [adaptation.proposal for adaptation in complete.adaptations]
    of_all = weigh_plain(joint, names, complete.target.coordinates, proposals, rng)
    alone = []
    for name, lone in samples.lone.items():
        proposals = [adaptation.proposal for adaptation in lone.adaptations]
        weighed = weigh_plain(joint, [name], lone.target.coordinates, proposals, rng)
        alone.append((weighed, _own(weighed, lone), plain_shares(joint, [name], rng)))
    every = all(lone.diagnosis.converged for lone in samples.lone.values())
    common = (of_all, _own(of_all, complete), plain_shares(joint, names, rng))
    stated = (of_joint, of_joint.evidence, joint_shares(joint, rng))
    return (
        _degree(joint, COMPLETE, complete.diagnosis.converged, common),
        _degree(joint, PARTIAL, samples.diagnosis.converged, stated),
        _apart(joint, every, alone),
    )


def _own(weighed: Weighed, samples: Samples) -> Evidence:
    """Evidence with what the ensembles found alone."""
    return weighed.evidence.beside([adaptation.log_evidence for adaptation in samples.adaptations])


def _entry(name: str, what: str, label: object, left_out: Any, correction: float = 0.0) -> dict[str, Any]:
    return {
        "pooling": name, "what": what, "label": str(label), "elpd": left_out.elpd + correction,
        "error": left_out.error, "k": left_out.k, "reliable": left_out.reliable,
    }  # fmt: skip


def _degree(
    joint: JointPosterior, name: str, converged: bool, estimates: tuple[Weighed, Evidence, PriorShares]
) -> Degree:
    weighed, evidence, shares = estimates
    entries = []
    for g, (group, own) in enumerate(joint.groups.items()):
        correction = shares.without[g] - shares.whole
        entries.append(_entry(name, "group", group, weighed.left_out(g), correction))
        rows = own.likelihood.observations.rows
        entries += [_entry(name, "row", row, weighed.left_out(g, i)) for i, row in enumerate(rows)]
    error = float(np.hypot(evidence.error, shares.error))
    log_z, table = evidence.log_z - shares.whole, pd.DataFrame(entries)
    return Degree(log_z, error, evidence.reliable, name=name, converged=converged, left_out=table)


def _apart(joint: JointPosterior, converged: bool, alone: Sequence[tuple[Weighed, Evidence, PriorShares]]) -> Degree:
    entries, log_z, variance, reliable = [], 0.0, 0.0, True
    for (group, own), (weighed, evidence, shares) in zip(joint.groups.items(), alone, strict=True):
        log_z += evidence.log_z - shares.whole
        variance += evidence.error**2 + shares.error**2
        reliable &= evidence.reliable
        error = float(np.hypot(evidence.error, shares.error))
        own_group = {"label": group, "elpd": evidence.log_z - shares.whole, "error": error, "k": evidence.k_hat}
        entries.append({"pooling": NONE, "what": "group", **own_group, "reliable": evidence.reliable})
        rows = own.likelihood.observations.rows
        entries += [_entry(NONE, "row", row, weighed.left_out(0, i)) for i, row in enumerate(rows)]
    error, table = float(np.sqrt(variance)), pd.DataFrame(entries)
    return Degree(log_z, error, reliable, name=NONE, converged=converged, left_out=table)


def preferred(degrees: Sequence[Degree]) -> str:
    """Degree of pooling that the evidence prefers, in words."""
    if not degrees:
        return "not known: the degrees of pooling could not be compared"
    best, second = sorted(degrees, key=lambda degree: -degree.log_z)[:2]
    gap = best.log_z - second.log_z
    if not (best.reliable and second.reliable):
        return "not known: the evidence cannot be relied on; compare by leaving rows out"
    if gap - 2 * np.hypot(best.error, second.error) < INDISTINCT:
        return f"not decided between {best.name} and {second.name}"
    return best.name


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
    """Log evidences of a study under other roles of its parameters, each computed once."""

    joint: JointPosterior  # the study's own
    chains: Mapping[str, FloatArray]  # of each group alone, physical (ensembles, steps, walkers, parameters)
    rng: Generator  # of the estimates, each of which has a stream of its own
    complete: Level  # what is known beforehand: all shared
    stated: Level  # known beforehand: the study's own roles
    none: Level  # known beforehand: nothing shared
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
    common = evidences.of(names, {})
    population = evidences.of((), {name: evidences.population(name) for name in names})
    return Sharing(tuple(names), common, evidences.none, population, evidences.joint.pooling.by)


def judged_as_stated(evidences: Evidences, name: str) -> Sharing:
    """Judge whether a parameter has one value in all groups, all others being as the study states them."""
    pooling = evidences.joint.pooling
    shared = [other for other in evidences.joint.shared if other != name]
    populations = {other: population for other, population in pooling.hierarchical.items() if other != name}
    common, own = evidences.of([*shared, name], populations), evidences.of(shared, populations)
    population = evidences.of(shared, {**populations, name: evidences.population(name)})
    return Sharing((name,), common, own, population, pooling.by)
