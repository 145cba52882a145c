"""What the data added to the prior after the physical cut: per parameter, per direction, and per group.

Directions are combinations of the parameters' normal scores under the cut prior. Scores do not change with
the scale that a parameter is stated in (K_s or log K_s), so neither does the number of determined directions;
a ridge that bends, as of K_s against n0, is straighter in them than it can be in one chosen scale. The counts
in plain parameters and in the sampling coordinates, which straighten the ridges within each group, stand
beside it: where they differ, the number hangs on how the parameters are written.

A group is seen in two ways. ``marginal``: its own block of both covariances, all other parameters unknown, as
the posterior has it. ``others known``: both covariances given all parameters outside the group (as for normal
laws), so that what only the coupling between groups hides comes to light.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.random import Generator

from bayesterra.arrays import FloatArray
from bayesterra.identifiability.contraction import covariance, eigen_directions, own_scale
from bayesterra.identifiability.divergence import divergence
from bayesterra.identifiability.groups import group_columns, in_words, scores_under, spaced, within_groups
from bayesterra.identifiability.verdicts import DETERMINED
from bayesterra.posteriors import Posterior

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
        ``DETERMINED`` or more), effective (sum of contractions, each between 0 and 1), determined_plain and
        determined_sampling (in other coordinates), cut_determined and cut_effective (what the physical cut
        alone does to the stated prior).
    weights : weights (d, d) of the parameters' scores in the directions of the scope ``all``, columns.
    """

    parameters: pd.DataFrame
    directions: pd.DataFrame
    counts: pd.DataFrame
    weights: FloatArray

    def determined(self, scope: str = ALL, view: str = MARGINAL) -> int:
        """Number of determined directions of a scope; 0 where none of its parameters is free."""
        row = self.counts[(self.counts["scope"] == scope) & (self.counts["view"] == view)]
        return int(row["determined"].sum())


def information(posterior: Posterior, prior: FloatArray, draws: FloatArray, rng: Generator) -> Information:
    """Compare posterior draws (n, d), nearly independent, with draws (m, d) of the cut prior."""
    names, draws = posterior.names, spaced(draws, DRAWS)
    stated = posterior.prior.sample(STATED, rng)
    inner = within_groups(posterior).from_physical
    spaces = {
        "": Compared.scores(prior, draws),
        "_plain": Compared(prior / prior.std(axis=0), draws / prior.std(axis=0)),
        "_sampling": Compared.scores(inner(prior), inner(draws)),
    }
    scopes = list(_scopes(names))
    logs = np.array([law.logarithmic for law in posterior.prior.laws.values()])
    own = [own_scale(x, logs) for x in (stated, prior, draws)]
    return Information(
        parameters=_parameters(names, Compared(own[1], own[2]), Compared(own[0], own[1])),
        directions=pd.concat([_directions(names, spaces[""], *scope) for scope in scopes], ignore_index=True),
        counts=pd.DataFrame([_count(spaces, Compared.scores(stated, prior), *scope) for scope in scopes]),
        weights=spaces[""].directions(range(len(names)), MARGINAL)[1],
    )


def _scopes(names: Sequence[str]) -> Iterator[tuple[str, Sequence[int], str]]:
    """Scope, its columns, and view."""
    yield ALL, range(len(names)), MARGINAL
    for group, columns in group_columns(names).items():
        yield group, columns, MARGINAL
        if len(columns) < len(names):
            yield group, columns, OTHERS_KNOWN


@dataclass(frozen=True)
class Compared:
    """Draws (n, d) beside draws (m, d) of what they are compared with."""

    reference: FloatArray
    draws: FloatArray

    @classmethod
    def scores(cls, reference: FloatArray, draws: FloatArray) -> Compared:
        """In normal scores under the reference."""
        return cls(scores_under(reference, reference), scores_under(reference, draws))

    @property
    def relative_error(self) -> float:
        """Standard error of a ratio of variances over the ratio, as for normal laws."""
        return float(np.sqrt(2.0 / len(self.draws) + 2.0 / len(self.reference)))

    def directions(self, columns: Sequence[int], view: str) -> tuple[FloatArray, FloatArray]:
        """Contractions (k,), best first, and weights (k, k) of some columns."""
        before, after = (_seen(covariance(x), columns, view) for x in (self.reference, self.draws))
        return eigen_directions(before, after)

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


def _parameters(names: Sequence[str], found: Compared, cut: Compared) -> pd.DataFrame:
    shares, cut_shares = (c.draws.var(axis=0) / c.reference.var(axis=0) for c in (found, cut))
    single = np.ones(1)
    gains, cut_gains = (
        np.array([c.divergence([i], single) for i in range(len(names))]) for c in (found, cut)
    )
    return pd.DataFrame(
        {
            "parameter": list(names),
            "contraction": 1.0 - shares,
            "shift": (found.draws.mean(axis=0) - found.reference.mean(axis=0)) / found.reference.std(axis=0),
            "error": shares * found.relative_error,
            "divergence": gains[:, 0],
            "divergence_error": gains[:, 1],
            "cut_contraction": 1.0 - cut_shares,
            "cut_divergence": cut_gains[:, 0],
            "cut_divergence_error": cut_gains[:, 1],
        }
    )


def _directions(
    names: Sequence[str], found: Compared, scope: str, columns: Sequence[int], view: str
) -> pd.DataFrame:
    contractions, weights = found.directions(columns, view)
    inside = [names[i] for i in columns]
    gains = [
        found.divergence(columns, column) if view == MARGINAL else (np.nan, np.nan) for column in weights.T
    ]
    return pd.DataFrame(
        {
            "scope": scope,
            "view": view,
            "rank": np.arange(len(inside)) + 1,
            "combination": [in_words(inside, column) for column in weights.T],
            "contraction": contractions,
            "error": (1.0 - contractions) * found.relative_error,
            "divergence": [gain[0] for gain in gains],
            "divergence_error": [gain[1] for gain in gains],
        }
    )


def _count(
    spaces: dict[str, Compared], cut: Compared, scope: str, columns: Sequence[int], view: str
) -> dict[str, object]:
    contractions = {key: space.directions(columns, view)[0] for key, space in spaces.items()}
    by_cut = cut.directions(columns, view)[0]
    return {
        "scope": scope,
        "view": view,
        "directions": len(columns),
        "effective": effective(contractions[""]),
        **{f"determined{key}": int((values >= DETERMINED).sum()) for key, values in contractions.items()},
        "cut_effective": effective(by_cut),
        "cut_determined": int((by_cut >= DETERMINED).sum()),
    }


def effective(contractions: FloatArray) -> float:
    """Effective number of determined directions: the sum of contractions, each counted between 0 and 1."""
    return float(np.clip(contractions, 0.0, 1.0).sum())
