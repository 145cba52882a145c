"""Information gained by the data, and coupling of parameters and groups.

Directions are combinations of the parameters' normal scores under the cut prior. Scores do not change with
the scale that a parameter is stated in (K_s or log K_s), so neither does the number of determined directions;
a ridge that bends, as of K_s against n0, is straighter in them than it can be in one chosen scale.

A group is seen in two ways. ``marginal``: its own block of both covariances, all other parameters unknown, as
the posterior has it. ``others known``: both covariances given all parameters outside the group (as for normal
laws), so that what only the coupling between groups hides comes to light.

The figure is the mutual information of the Gaussian copula, in nats: of pairs it is a lower bound, which
misses dependence that is not monotone. The check is the nearest-neighbour estimate, which finds that too but
is noisier. Beside both stand what independent draws would give (the 95 % point under permutation) and the
coupling of the prior after the physical cut, which is none of the data's doing.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np
import pandas as pd
from numpy.random import Generator
from scipy.spatial import cKDTree
from scipy.special import digamma
from scipy.stats import rankdata

from bayesterra.arrays import FloatArray, spaced
from bayesterra.identifiability import verdicts
from bayesterra.likelihood.joint import Whole
from bayesterra.stats.diagnostics import divergence

DRAWS = 12_000
"""Draws, at most, that are compared."""
STATED = 40_000
"""Draws of the stated prior that the cut one is compared with."""
ALL, MARGINAL, OTHERS_KNOWN = "all", "marginal", "others known"


@dataclass(frozen=True)
class Information:
    """Contraction and divergence from the cut prior, and the number of directions that the data determine.

    Attributes
    ----------
    parameters : one row per parameter: parameter, contraction (1 − posterior/prior variance), error,
        divergence (Kullback–Leibler, nats) and divergence_error, of the posterior from the cut prior; and
        cut_contraction, cut_divergence and cut_divergence_error, of the cut prior from the stated one.
    directions : one row per direction: scope (``all`` or a group), view (``marginal`` or ``others known``),
        rank (1 is known best), combination (in words, weights in prior sds), contraction, error, divergence
        and divergence_error (NaN where others are known).
    counts : one row per scope and view: directions (how many there are), determined (contraction of
        ``DETERMINED`` or more), effective (sum of contractions, each between 0 and 1), cut_determined and
        cut_effective (what the physical cut alone does to the stated prior).
    weights : weights (d, d) of the parameters' scores in the directions of the scope ``all``, columns.
    """

    parameters: pd.DataFrame
    directions: pd.DataFrame
    counts: pd.DataFrame
    weights: FloatArray


def information(posterior: Whole, prior: FloatArray, draws: FloatArray, rng: Generator) -> Information:
    """Compare posterior draws (n, d), nearly independent, with draws (m, d) of the cut prior."""
    names, draws = posterior.names, spaced(draws, DRAWS)
    stated = posterior.prior.sample(STATED, rng)
    data, cut = Compared.scores(prior, draws), Compared.scores(stated, prior)
    scopes = list(_scopes(names))
    logs = np.array([law.logarithmic for law in posterior.prior.laws.values()])
    own = [verdicts.own_scale(x, logs) for x in (stated, prior, draws)]
    return Information(
        parameters=_parameters(names, Compared(own[1], own[2]), Compared(own[0], own[1])),
        directions=pd.concat([_directions(names, data, *scope) for scope in scopes], ignore_index=True),
        counts=pd.DataFrame([_count(data, cut, *scope) for scope in scopes]),
        weights=data.directions(range(len(names)), MARGINAL)[1],
    )


def _scopes(names: Sequence[str]) -> Iterator[tuple[str, Sequence[int], str]]:
    """Scope, its columns, and view."""
    yield ALL, range(len(names)), MARGINAL
    for group, columns in verdicts.group_columns(names).items():
        yield group, columns, MARGINAL
        if len(columns) < len(names):
            yield group, columns, OTHERS_KNOWN


@dataclass(frozen=True)
class Compared:
    """Draws (n, d) beside draws (m, d) of what they are compared with."""

    reference: FloatArray
    draws: FloatArray

    @classmethod
    def scores(cls, reference: FloatArray, draws: FloatArray) -> "Compared":
        """In normal scores under the reference."""
        return cls(verdicts.scores_under(reference, reference), verdicts.scores_under(reference, draws))

    @property
    def relative_error(self) -> float:
        """Standard error of a ratio of variances over the ratio, as for normal laws."""
        return float(np.sqrt(2.0 / len(self.draws) + 2.0 / len(self.reference)))

    def directions(self, columns: Sequence[int], view: str) -> tuple[FloatArray, FloatArray]:
        """Contractions (k,), best first, and weights (k, k) of some columns."""
        before, after = (_seen(verdicts.covariance(x), columns, view) for x in (self.reference, self.draws))
        return verdicts.eigen_directions(before, after)

    def divergence(self, columns: Sequence[int], weights: FloatArray) -> tuple[float, float]:
        """Divergence (nats) along a combination, and its error."""
        return divergence(self.draws[:, columns] @ weights, self.reference[:, columns] @ weights)


def _seen(matrix: FloatArray, columns: Sequence[int], view: str) -> FloatArray:
    """Covariance of some columns, the others unknown or known."""
    inside = list(columns)
    if view == MARGINAL:
        return matrix[np.ix_(inside, inside)]
    precision = np.linalg.inv(matrix)[np.ix_(inside, inside)]
    return np.asarray(np.linalg.inv(precision), dtype=np.float64)


def _parameters(names: Sequence[str], data: Compared, cut: Compared) -> pd.DataFrame:
    shares, cut_shares = (c.draws.var(axis=0) / c.reference.var(axis=0) for c in (data, cut))
    single = np.ones(1)
    gains, cut_gains = (np.array([c.divergence([i], single) for i in range(len(names))]) for c in (data, cut))
    return pd.DataFrame(
        {
            "parameter": list(names),
            "contraction": 1.0 - shares,
            "shift": (data.draws.mean(axis=0) - data.reference.mean(axis=0)) / data.reference.std(axis=0),
            "error": shares * data.relative_error,
            "divergence": gains[:, 0],
            "divergence_error": gains[:, 1],
            "cut_contraction": 1.0 - cut_shares,
            "cut_divergence": cut_gains[:, 0],
            "cut_divergence_error": cut_gains[:, 1],
        }
    )


def _directions(names: Sequence[str], data: Compared, scope: str, columns: Sequence[int], view: str) -> pd.DataFrame:
    contractions, weights = data.directions(columns, view)
    inside = [names[i] for i in columns]
    gains = [data.divergence(columns, column) if view == MARGINAL else (np.nan, np.nan) for column in weights.T]
    return pd.DataFrame(
        {
            "scope": scope,
            "view": view,
            "rank": np.arange(len(inside)) + 1,
            "combination": [verdicts.in_words(inside, column) for column in weights.T],
            "contraction": contractions,
            "error": (1.0 - contractions) * data.relative_error,
            "divergence": [gain[0] for gain in gains],
            "divergence_error": [gain[1] for gain in gains],
        }
    )


def _count(data: Compared, cut: Compared, scope: str, columns: Sequence[int], view: str) -> dict[str, object]:
    contractions, by_cut = (compared.directions(columns, view)[0] for compared in (data, cut))
    return {
        "scope": scope,
        "view": view,
        "directions": len(columns),
        "effective": effective(contractions),
        "determined": int((contractions >= verdicts.DETERMINED).sum()),
        "cut_effective": effective(by_cut),
        "cut_determined": int((by_cut >= verdicts.DETERMINED).sum()),
    }


def effective(contractions: FloatArray) -> float:
    """Effective number of determined directions: the sum of contractions, each counted between 0 and 1."""
    return float(np.clip(contractions, 0.0, 1.0).sum())


COUPLING_DRAWS = 4000
"""Draws, at most, behind the copula's figures; the further apart, the more nearly independent."""

NEAREST_DRAWS = 2000
NEIGHBOURS = 4
PERMUTATIONS = 200
NEAREST_PERMUTATIONS = 12
DISAGREEMENT = 0.1
"""Difference of the two estimates, in nats, from which they disagree, if it also exceeds three errors and a
quarter of the greater one. 0.1 nats is a correlation of 0.43."""

Columns = Mapping[str, Sequence[int]]


@dataclass(frozen=True)
class Coupling:
    """Dependence between parameters and between groups.

    Attributes
    ----------
    names : parameters.
    groups : columns of the parameters of each group.
    pairs : one row per pair of parameters: first, second, information (nats; by the copula), null (its 95 %
        point for independent draws), strength (correlation of two normal parameters with the same
        information), nearest (nats; by nearest neighbours), nearest_error, nearest_null, disagree (whether
        the two do), prior_information, prior_strength and prior_nearest (of the cut prior), pearson,
        spearman, prior_pearson, prior_spearman.
    between : one row per pair of groups, as ``pairs`` without correlations.
    copula, prior_copula : normal-score correlations (d, d) under the posterior and the cut prior.
    """

    names: tuple[str, ...]
    groups: Columns
    pairs: pd.DataFrame
    between: pd.DataFrame
    copula: FloatArray
    prior_copula: FloatArray


def coupling(posterior: Whole, prior: FloatArray, draws: FloatArray, rng: Generator) -> Coupling:
    """Compare the coupling in posterior draws (n, d) with that in draws (m, d) of the cut prior.

    Draws must be nearly independent, as kept draws are; thousands of spaced ones are used.
    """
    names, groups = posterior.names, verdicts.group_columns(posterior.names)
    prior, draws = spaced(prior, COUPLING_DRAWS), spaced(draws, COUPLING_DRAWS)
    inner = verdicts.within_groups(posterior).from_physical
    singles = {name: [i] for i, name in enumerate(names)}
    pairs = _compared(singles, prior, draws, rng)
    correlations = {
        f"{prefix}{kind}": _correlation(values)[np.triu_indices(len(names), 1)]
        for prefix, x in (("", draws), ("prior_", prior))
        for kind, values in (("pearson", x), ("spearman", rankdata(x, axis=0)))
    }
    return Coupling(
        names=names, groups=groups, pairs=pairs.assign(**correlations),
        between=_compared(groups, inner(prior), inner(draws), rng), copula=_correlation(verdicts.ranked(draws)),
        prior_copula=_correlation(verdicts.ranked(prior)),
    )  # fmt: skip


def copula_information(first: FloatArray, second: FloatArray) -> float:
    """Mutual information (nats) of normal scores (n, a) and (n, b), were their joint law normal.

    ½ (log|Σ_A| + log|Σ_B| − log|Σ_AB|); for two single columns −½ log(1 − ρ²).
    """
    sets = (first, second, np.column_stack([first, second]))
    log_a, log_b, log_both = (np.linalg.slogdet(_correlation(columns))[1] for columns in sets)
    return float(0.5 * (log_a + log_b - log_both))


def nearest_information(first: FloatArray, second: FloatArray, k: int = NEIGHBOURS) -> tuple[float, float]:
    """Mutual information (nats) of columns (n, a) and (n, b) from k nearest neighbours, and its error.

    Kraskov, Stögbauer and Grassberger (2004), eq. (8), largest-coordinate distances. No two rows may be the
    same. The error is that of a mean of independent terms.
    """
    joint = np.column_stack([first, second])
    radius = cKDTree(joint).query(joint, k + 1, p=np.inf)[0][:, -1] * (1.0 - 1e-12)
    counts = (cKDTree(part).query_ball_point(part, radius, p=np.inf, return_length=True) for part in (first, second))
    terms = digamma(k) + digamma(len(joint)) - sum(digamma(count) for count in counts)
    return float(terms.mean()), float(terms.std() / np.sqrt(len(joint)))


def whitened(draws: FloatArray) -> FloatArray:
    """Normal scores (n, d) turned and stretched until they are uncorrelated with spread 1."""
    scores = verdicts.ranked(draws)
    root = np.linalg.cholesky(np.atleast_2d(np.cov(scores.T)))
    return np.asarray(np.linalg.solve(root, scores.T).T)


def strength(information: float) -> float:
    """Correlation of two normal parameters with this mutual information (nats)."""
    return float(np.sqrt(-np.expm1(-2.0 * max(information, 0.0))))


def _correlation(values: FloatArray) -> FloatArray:
    return np.atleast_2d(np.corrcoef(values.T))


def _compared(sets: Columns, prior: FloatArray, draws: FloatArray, rng: Generator) -> pd.DataFrame:
    """Both estimates for every pair of sets, under the posterior and under the prior, and their nulls."""
    after, before = (_Scored.of(sets, values) for values in (draws, prior))
    # ranks under permutation know nothing of the law: pairs of the same size share their null
    null = cache(lambda a, b: after.null(*after.first_of(a, b), rng))
    rows = [_row(a, b, after, before) | null(len(sets[a]), len(sets[b])) for a, b in combinations(sets, 2)]
    return pd.DataFrame(rows, columns=list(COLUMNS))


COLUMNS = (
    "first", "second", "information", "null", "strength", "nearest", "nearest_error", "nearest_null",
    "disagree", "prior_information", "prior_strength", "prior_nearest",
)  # fmt: skip


def _row(a: str, b: str, after: "_Scored", before: "_Scored") -> dict[str, object]:
    figure, (check, error), prior = after.copula(a, b), after.nearest(a, b), before.copula(a, b)
    return {
        "first": a, "second": b, "information": figure, "strength": strength(figure), "nearest": check,
        "nearest_error": error, "disagree": disagree(figure, check, error), "prior_information": prior,
        "prior_strength": strength(prior), "prior_nearest": before.nearest(a, b)[0],
    }  # fmt: skip


def disagree(figure: float, check: float, error: float) -> bool:
    """True where the two estimates (nats) differ by more than their errors and than matters."""
    return abs(check - figure) > max(DISAGREEMENT, 3.0 * error, 0.25 * max(figure, check))


@dataclass(frozen=True)
class _Scored:
    """Normal scores of draws, and whitened coordinates of fewer draws by set of columns."""

    sets: Columns
    scores: FloatArray
    white: Mapping[str, FloatArray]

    @classmethod
    def of(cls, sets: Columns, draws: FloatArray) -> "_Scored":
        few = spaced(draws, NEAREST_DRAWS)
        few = few[np.sort(np.unique(few, axis=0, return_index=True)[1])]  # a walker may have stood still
        return cls(sets, verdicts.ranked(draws), {name: whitened(few[:, list(held)]) for name, held in sets.items()})

    def copula(self, a: str, b: str) -> float:
        return copula_information(self.scores[:, self.sets[a]], self.scores[:, self.sets[b]])

    def nearest(self, a: str, b: str) -> tuple[float, float]:
        return nearest_information(self.white[a], self.white[b])

    def first_of(self, a: int, b: int) -> tuple[str, str]:
        """The first pair of sets with so many columns."""
        sizes = {name: len(held) for name, held in self.sets.items()}
        return next(pair for pair in combinations(self.sets, 2) if tuple(map(sizes.get, pair)) == (a, b))

    def null(self, a: str, b: str, rng: Generator) -> dict[str, float]:
        """95 % points of both estimates where the rows of b are put into random order."""
        first, second = self.scores[:, self.sets[a]], self.scores[:, self.sets[b]]
        figures = [copula_information(first, rng.permutation(second)) for _ in range(PERMUTATIONS)]
        near, far = self.white[a], self.white[b]
        checks = [nearest_information(near, rng.permutation(far))[0] for _ in range(NEAREST_PERMUTATIONS)]
        return {
            "null": float(np.quantile(figures, 0.95)),
            "nearest_null": float(np.mean(checks) + 1.645 * np.std(checks, ddof=1)),
        }
