"""What the data say about each parameter beyond the prior, measured on the draws.

The reference is the prior after the physical cut, never the stated box.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import pandas as pd

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.diagnostics import rank_scores
from bayesterra.identifiability.divergence import divergence
from bayesterra.identifiability.verdicts import (
    DETERMINED,
    Correlated,
    Evidence,
    tied_to,
    ties,
    word,
)

UNKNOWN = "not known"
"""The verdict where none could be computed."""
BOUNDS = ("none", "lower", "upper", "both")
"""Which bounds of its prior a parameter leans on."""


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
    scores = Correlated(correlation + np.eye(len(names)), *(_scores_correlation(x) for x in (draws, prior)))
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
    words = [word(found) for found in evidence(table)]
    table.insert(0, "parameter", list(names))
    table.insert(1, "verdict", words)
    table.insert(3, "partner", [names[i] for i in partners])
    table = table.assign(prior_sd=spreads[0], posterior_sd=spreads[1])
    shares, directions = eigen_directions(covariance(prior / prior_sd), covariance(draws / prior_sd))
    return Identifiability(table, shares, directions)


def undetermined(names: Sequence[str], prior: FloatArray, draws: FloatArray) -> pd.DataFrame:
    """Table of an :class:`Identifiability` that could not be computed: every verdict is ``not known``."""
    rows = [
        {
            "parameter": name, "verdict": UNKNOWN, "contraction": np.nan, "partner": name,
            "correlation": np.nan, "tied_to": name, "tie": np.nan, "multiple": np.nan,
            "given_others": np.nan, "bound": "none", "structural": True,
            "shift": np.nan, "divergence": np.nan,
        }
        for name in names
    ]  # fmt: skip
    return pd.DataFrame(rows).assign(prior_sd=prior.std(axis=0), posterior_sd=draws.std(axis=0))


def own_scale(x: FloatArray, logs: BoolArray) -> FloatArray:
    """Values (n, d) on the scales of their laws; ``logs`` (d,) says which are logarithmic."""
    positive = np.where(logs, np.maximum(x, 0.0), 1.0)
    with np.errstate(divide="ignore"):
        return np.where(logs, np.log(positive), x)


def evidence(table: pd.DataFrame) -> list[Evidence]:
    """What the columns of a table say of each parameter, for its verdict."""
    known = [field.name for field in fields(Evidence) if field.name in table]
    return [Evidence(**dict(zip(known, row, strict=True))) for row in table[known].itertuples(index=False)]


def bound(draws: FloatArray, low: float, high: float) -> str:
    """Which bounds of its prior the draws (n,) of a parameter lean on, one of ``BOUNDS``.

    They lean on a bound if the outermost twentieth of them is at least half as dense, up to there, as the
    nine tenths in the middle: without the bound the law would go on beyond it.
    """
    inner = np.quantile(draws, [0.05, 0.95])
    typical = 0.9 / max(inner[1] - inner[0], 1e-300)
    leans = [0.05 / max(gap, 1e-300) >= 0.5 * typical for gap in (inner[0] - low, high - inner[1])]
    return BOUNDS[leans[0] + 2 * leans[1]]


def _scores_correlation(draws: FloatArray) -> FloatArray:
    return np.atleast_2d(np.corrcoef([rank_scores(column) for column in draws.T]))


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
