"""Verdicts on parameters: contraction beyond the cut prior, ties between parameters, parameter groups.

===========================  ===========================================================================
structurally not determined  no data of this design can tell it
determined                   its variance shrinks to a tenth or less of the cut prior's, away from its bounds
coupled                      not on its own, but in combination with others that are not known either
one-sided                    one end is its prior's bound, or the data exclude one side only
weakly                       its variance shrinks by ``WEAK`` or more
moved                        hardly narrowed, but its law is another one than the cut prior: they disagree
repeats its prior            none of these
===========================  ===========================================================================

The reference is the prior after the physical cut, never the stated box.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np
import pandas as pd
from scipy.special import ndtr, ndtri

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.identifiability.structure import combination
from bayesterra.likelihood.joint import Whole
from bayesterra.parameters import MODULI, PARAMETERS, whole_and_part
from bayesterra.sampling.coordinates import Bearing, Block, Contact, Coordinates, Moduli, coordinates
from bayesterra.stats.diagnostics import divergence, rank_scores
from bayesterra.study.result import COUPLED

DETERMINED = 0.9
"""Contraction from which a parameter or direction counts as determined: sd below a third of the prior's."""
WEAK = 0.3
"""Contraction below which a parameter repeats its prior, unless it is coupled or one-sided."""

COUPLED_TO_ALL = 0.9
"""Multiple correlation, of normal scores, from which a parameter is coupled to several others together."""
EXCLUDED = 0.1
"""Share of the cut prior outside the 95 % interval of a profile from which one side is excluded."""
SOME = 0.1
"""Divergence from the prior (nats) that a parameter which repeats its prior should not exceed."""
SHIFT = 0.5
"""Shift of the mean, in standard deviations of the cut prior, from which a parameter has moved."""
MOVED = 0.5 * SHIFT**2
"""Divergence from the cut prior (nats) from which it has moved too: that of a normal law so shifted."""
STRUCTURAL = "structurally not determined"
WORDS = ("determined", "one-sided", "weakly", "coupled", "moved", "repeats its prior", STRUCTURAL)


@dataclass(frozen=True)
class Evidence:
    """Figures measured about a parameter; those not measured keep their defaults."""

    contraction: float  # 1 − posterior variance over the cut prior's, on the scale of the prior's law
    tie: float = 0.0  # the strongest correlation with another parameter that is not determined
    multiple: float = 0.0  # correlation of its normal score with the best combination of those of all such parameters
    given_others: float = 1.0  # contraction were these others known, as for normal laws
    bound: str = "none"  # bound of its prior that it leans on, one of ``contraction.BOUNDS``
    structural: bool = True  # whether data of this design could determine it
    profile: str = ""  # class of the likelihood's profile, one of ``profiles.CLASSES``
    excluded: float = np.nan  # share of the cut prior outside the profile's 95 % interval
    divergence: float = np.nan  # from the cut prior, nats
    shift: float = 0.0  # of the mean from the cut prior's, in its standard deviations, on the scale of the prior's law


def word(facts: Evidence) -> str:
    """The verdict, one of ``WORDS``."""
    if not facts.structural:
        return STRUCTURAL
    if facts.contraction >= DETERMINED and facts.bound == "none":
        return "determined"
    tied = abs(facts.tie) >= COUPLED or facts.multiple >= COUPLED_TO_ALL
    if tied and facts.given_others >= WEAK:  # what only the prior ties is no finding
        return "coupled"
    if _one_sided(facts):
        return "one-sided"
    if facts.contraction >= WEAK:
        return "weakly"
    moved = abs(facts.shift) >= SHIFT or facts.divergence >= MOVED
    return "moved" if moved else "repeats its prior"


def _one_sided(facts: Evidence) -> bool:
    if facts.contraction >= DETERMINED:
        return True
    if facts.profile:
        return facts.profile == "one-sided" and facts.excluded >= EXCLUDED
    return facts.bound in ("lower", "upper") and facts.contraction >= WEAK


def disagreements(facts: Evidence, verdict: str) -> Iterator[str]:
    """Objections to a verdict, in words."""
    if verdict == "determined" and facts.profile not in ("", "two-sided"):
        yield f"the likelihood's profile is {facts.profile}"
    if verdict == STRUCTURAL and facts.profile == "two-sided":
        yield "the likelihood's profile is two-sided within the prior's range"
    if verdict == "repeats its prior" and facts.profile == "two-sided" and facts.excluded >= EXCLUDED:
        yield f"the likelihood alone excludes {100 * facts.excluded:.0f} % of its prior"
    if verdict == "repeats its prior" and facts.divergence >= SOME:
        yield f"its law differs from the prior's by {facts.divergence:.2f} nats"


def multiple_correlation(correlation: FloatArray) -> FloatArray:
    """Correlation (d,) of every variable with the best combination of all others, from a matrix (d, d)."""
    if len(correlation) == 1:
        return np.zeros(1)
    steadied = correlation + 1e-12 * np.eye(len(correlation))
    return np.asarray(np.sqrt(np.clip(1.0 - 1.0 / np.diagonal(np.linalg.inv(steadied)), 0.0, 1.0)))


@dataclass(frozen=True)
class Correlated:
    """Correlations of the posterior's draws, and those of normal scores after and before the data, (d, d)."""

    plain: FloatArray
    scores: FloatArray
    prior_scores: FloatArray


def tied_to(contraction: FloatArray, bounds: Sequence[str], correlation: FloatArray) -> IntArray:
    """For each parameter (d,) the other, not determined, that it is tied to most; itself where there is none.

    Parameters
    ----------
    bounds : of the prior that the parameters lean on, as in :class:`Evidence`.
    correlation : of the posterior's draws (d, d).
    """
    strength = np.abs(correlation) * _unknown(contraction, bounds)
    np.fill_diagonal(strength, 1e-300)
    return np.asarray(strength.argmax(axis=1))


def _unknown(contraction: FloatArray, bounds: Sequence[str]) -> BoolArray:
    """True where the data leave a parameter (d,) open; one that leans on its prior's end is held by that."""
    return np.asarray((contraction < DETERMINED) | (np.array(bounds) != "none"))


def ties(contraction: FloatArray, bounds: Sequence[str], correlations: Correlated) -> dict[str, FloatArray]:
    """Ties of each parameter to the others that are not determined.

    A parameter that is determined leaves its partner's uncertainty with the partner, so it ties nothing. One
    that leans on a bound of its prior (``bounds``, as in :class:`Evidence`) is held there by the prior alone.

    Returns
    -------
    ``tie``, ``multiple`` and ``given_others`` of :class:`Evidence`, (d,) each.
    """
    numbers, unknown = np.arange(len(contraction)), _unknown(contraction, bounds)
    rows = [_tied(int(i), np.flatnonzero(unknown | (numbers == i)), correlations) for i in numbers]
    tie, multiple, before = np.array(rows).T
    left = (1.0 - multiple**2) / np.maximum(1.0 - before**2, 1e-12)
    return {"tie": tie, "multiple": multiple, "given_others": 1.0 - (1.0 - contraction) * left}


def _tied(own: int, chosen: IntArray, correlations: Correlated) -> tuple[float, float, float]:
    """Strongest and multiple correlation with the other chosen parameters, and the latter before the data."""
    others = chosen[chosen != own]
    if not len(others):
        return 0.0, 0.0, 0.0
    block, place = np.ix_(chosen, chosen), int(np.flatnonzero(chosen == own)[0])
    pairs = correlations.plain[own, others]
    after, before = (
        multiple_correlation(matrix[block])[place] for matrix in (correlations.scores, correlations.prior_scores)
    )
    return float(pairs[np.abs(pairs).argmax()]), float(after), float(before)


GROUPS = ("P_I", "P_II", "P_III", "load effect")
"""Bearing, shearing, contact angles; the load effect of M2L."""
KNOTS = 65
"""Points at which the normal score of a law is taken from its draws; straight lines in between."""
TAIL = 10
"""Pieces, about one unit of the score, whose slope goes on beyond the last knot. That of one piece hangs
on the gap between two draws, which may be no gap at all."""


def group_columns(names: Sequence[str]) -> dict[str, list[int]]:
    """Columns of the free parameters of each group; k_c and k_φ stand in the place of K_s, in P_I."""
    of = {name: "P_I" if whole_and_part(name)[0] in MODULI else PARAMETERS[name].group for name in names}
    columns = {group: [i for i, name in enumerate(names) if of[name] == group] for group in GROUPS}
    return {group: held for group, held in columns.items() if held}


def within_groups(posterior: Whole) -> Coordinates:
    """The sampling coordinates, but none that mixes groups: the stress is taken at θm = θ1/2 throughout.

    They straighten the ridges within a group and leave the dependence between groups as it is.
    """
    blocks: list[tuple[tuple[int, ...], Block]] = []
    for columns, block in coordinates(posterior).blocks:
        contact = block.inner if isinstance(block, Moduli) else block
        if not isinstance(contact, Contact):
            blocks.append((columns, block))
            continue
        bearing: Block = Bearing(contact.stress)
        if isinstance(block, Moduli):
            bearing = Moduli(block.score, block.width, bearing)
        blocks += [(columns[:-2], bearing), (columns[-2:], contact.angles)]
    return Coordinates(tuple(blocks))


def ranked(draws: FloatArray) -> FloatArray:
    """Normal scores of every column's ranks (n, d)."""
    return np.column_stack([rank_scores(column) for column in draws.T])


def scores_under(reference: FloatArray, draws: FloatArray) -> FloatArray:
    """Normal scores (n, d) of draws under the marginal laws of ``reference`` (m, d), column by column.

    Scores do not depend on the unit or scale, such as K_s or log K_s, that a parameter is stated in.
    """
    farthest = ndtri(1.0 - 2.0 / len(reference))
    scores = np.linspace(-farthest, farthest, KNOTS)
    knots = np.quantile(reference, ndtr(scores), axis=0)
    return np.column_stack([_broken_line(draws[:, i], knots[:, i], scores) for i in range(draws.shape[1])])


def _broken_line(x: FloatArray, knots: FloatArray, values: FloatArray) -> FloatArray:
    """Linear interpolation, continued beyond both ends along the chord of the outermost ``TAIL`` pieces."""
    knots, first = np.unique(knots, return_index=True)
    values = values[first]
    inner = min(TAIL, len(knots) - 1)
    below = (values[inner] - values[0]) / (knots[inner] - knots[0])
    above = (values[-1] - values[-1 - inner]) / (knots[-1] - knots[-1 - inner])
    beyond = below * np.minimum(x - knots[0], 0.0) + above * np.maximum(x - knots[-1], 0.0)
    return np.asarray(np.interp(x, knots, values) + beyond)


def in_words(names: Sequence[str], weights: FloatArray, least: float = 0.1) -> str:
    """A combination of parameters as text, such as ``K_s + 0.62 n0 − 0.35 n1``.

    The heaviest parameter comes first and has the weight 1; weights below ``least`` of it are left out.
    """
    relative = weights / weights[np.abs(weights).argmax()]
    return combination(names, relative, least=least, terms=len(names))


UNKNOWN = "not known"
"""The verdict where none could be computed."""
BOUNDS = ("none", "lower", "upper", "both")
"""Bounds of its prior that a parameter leans on."""


@dataclass(frozen=True)
class Identifiability:
    """Contraction of parameters and of directions.

    Attributes
    ----------
    table : one row per parameter: parameter, verdict, contraction, partner (of the strongest correlation),
        correlation, tied_to (the strongest correlation among those not determined; itself if there is none),
        tie, multiple, given_others, bound (one of ``BOUNDS``), structural, shift, divergence, prior_sd,
        posterior_sd (SI); contraction, shift and the like on the scale of the prior's law; see
        :class:`bayesterra.identifiability.verdicts.Evidence`.
    contractions : 1 − posterior/prior variance of the independent directions, best first (d,).
    directions : those directions in units of the prior's standard deviations, columns (d, d).
    """

    table: pd.DataFrame
    contractions: FloatArray
    directions: FloatArray

    @property
    def determined(self) -> int:
        """Number of directions that the data determine."""
        return int((self.contractions >= DETERMINED).sum())


def identifiability(
    names: Sequence[str],
    ranges: Sequence[tuple[float, float]],
    prior: FloatArray,
    draws: FloatArray,
    structural: BoolArray | None = None,
    logs: BoolArray | None = None,
) -> Identifiability:
    """Compare draws (n, d) of the posterior with draws (m, d) of the cut prior; its laws have ``ranges``.

    ``structural`` (d,) says what data of this design could determine; by default everything. ``logs`` (d,)
    says whose law lives on a logarithmic scale, and everything but the standard deviations is counted there;
    by default none.
    """
    spreads = prior.std(axis=0), draws.std(axis=0)
    logs = np.zeros(len(names), dtype=bool) if logs is None else logs
    prior, draws = own_scale(prior, logs), own_scale(draws, logs)
    low, high = own_scale(np.array(ranges, dtype=np.float64).T, logs)
    prior_sd, sd = prior.std(axis=0), draws.std(axis=0)
    correlation = np.atleast_2d(np.corrcoef(draws.T)) - np.eye(len(names))
    partners = np.abs(correlation).argmax(axis=1)
    contraction = 1.0 - (sd / prior_sd) ** 2
    ranked = (np.atleast_2d(np.corrcoef([rank_scores(x) for x in drawn.T])) for drawn in (draws, prior))
    scores = Correlated(correlation + np.eye(len(names)), *ranked)
    bounds = [bound(*each) for each in zip(draws.T, low, high, strict=True)]
    table = pd.DataFrame(
        {
            "contraction": contraction,
            "shift": (draws.mean(axis=0) - prior.mean(axis=0)) / prior_sd,
            "divergence": [divergence(x, y)[0] for x, y in zip(draws.T, prior.T, strict=True)],
            "correlation": correlation[np.arange(len(names)), partners],
            "tied_to": [names[i] for i in tied_to(contraction, bounds, correlation)],
            **ties(contraction, bounds, scores),
            "bound": bounds,
            "structural": np.ones(len(names), dtype=bool) if structural is None else structural,
        }
    )
    words = [word(facts) for facts in evidence(table)]
    table.insert(0, "parameter", list(names))
    table.insert(1, "verdict", words)
    table.insert(3, "partner", [names[i] for i in partners])
    table = table.assign(prior_sd=spreads[0], posterior_sd=spreads[1])
    shares, directions = eigen_directions(covariance(prior / prior_sd), covariance(draws / prior_sd))
    return Identifiability(table, shares, directions)


def undetermined(names: Sequence[str], prior: FloatArray, draws: FloatArray) -> pd.DataFrame:
    """Table of an :class:`Identifiability` that could not be computed: every verdict is ``not known``."""
    own, none = list(names), np.nan
    return pd.DataFrame({"parameter": own}).assign(
        verdict=UNKNOWN, contraction=none, partner=own, correlation=none, tied_to=own, tie=none,
        multiple=none, given_others=none, bound="none", structural=True, shift=none, divergence=none,
        prior_sd=prior.std(axis=0), posterior_sd=draws.std(axis=0),
    )  # fmt: skip


def own_scale(x: FloatArray, logs: BoolArray) -> FloatArray:
    """Values (n, d) on the scales of their laws; ``logs`` (d,) says which are logarithmic."""
    positive = np.where(logs, np.maximum(x, 0.0), 1.0)
    with np.errstate(divide="ignore"):
        return np.where(logs, np.log(positive), x)


def evidence(table: pd.DataFrame) -> list[Evidence]:
    """Evidence on each parameter, for its verdict, from the columns of a table."""
    names = [field.name for field in fields(Evidence) if field.name in table]
    return [Evidence(**dict(zip(names, row, strict=True))) for row in table[names].itertuples(index=False)]


def judged(table: pd.DataFrame) -> pd.DataFrame:
    """The table with the verdict on each row's evidence, and ``against``: what speaks against it."""
    facts = evidence(table)
    words = [word(each) for each in facts]
    against = ["; ".join(disagreements(*each)) for each in zip(facts, words, strict=True)]
    return table.assign(verdict=words, against=against)


def bound(draws: FloatArray, low: float, high: float) -> str:
    """Bounds of its prior that the draws (n,) of a parameter lean on, one of ``BOUNDS``.

    They lean on a bound if the outermost twentieth of them is at least half as dense, up to there, as the
    nine tenths in the middle: without the bound the law would go on beyond it.
    """
    inner = np.quantile(draws, [0.05, 0.95])
    typical = 0.9 / max(inner[1] - inner[0], 1e-300)
    leans = [0.05 / max(gap, 1e-300) >= 0.5 * typical for gap in (inner[0] - low, high - inner[1])]
    return BOUNDS[leans[0] + 2 * leans[1]]


def eigen_directions(prior: FloatArray, posterior: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvectors (d, d) of posterior against prior covariance (d, d), best first, and their contractions.

    Columns are weights of the parameters; along each the prior has variance 1.
    """
    inverse = np.linalg.inv(np.linalg.cholesky(prior))
    values, vectors = np.linalg.eigh(inverse @ posterior @ inverse.T)
    return 1.0 - values, inverse.T @ vectors


def covariance(draws: FloatArray) -> FloatArray:
    """Covariance (d, d) of draws (n, d)."""
    return np.atleast_2d(np.cov(draws.T))
