"""How the posterior answers to a little more or less weight of its prior and of its likelihood.

Power-scaling (Kallioinen et al. 2024): likelihood or prior to the powers α = 0.99 and 1.01 by importance
weights; the sensitivity is the cumulative Jensen–Shannon distance (Nguyen and Vreeken 2015) by which a
parameter's law moves, per doubling of α. The likelihood is scaled so.

A flat law to any power is the same flat law: ordinary power-scaling of the prior is silent there, whatever
the prior does. So a law is scaled in the parameter's normal score z under it, where every law is the standard
normal one: weights exp(−(α − 1) z²/2), which for α > 1 draw it in around its median and for α < 1 push it out
towards its ends. For a normal law that is ordinary power-scaling; the result does not change with the scale
that a parameter is stated in. Laws that correlate are scaled together, by weights exp(−(α − 1) zᵀR⁻¹z/2). The
physical cut is not scaled: it is no opinion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.random import Generator
from scipy.sparse.csgraph import connected_components

from bayesterra.arrays import FloatArray
from bayesterra.diagnostics import pareto_limit, pareto_smoothed
from bayesterra.identifiability.groups import spaced
from bayesterra.laws import Law
from bayesterra.posteriors import Posterior

ALPHAS = (0.99, 1.01)
SENSITIVE = 0.05
"""Sensitivity from which a law counts as moved (Kallioinen et al. 2024)."""
REPEATED = 0.5
"""Share of the cut prior's own sensitivity to a law from which the posterior follows that law."""
DRAWS = 4000
SHUFFLES = 20


@dataclass(frozen=True)
class PowerScaling:
    """Sensitivity of every parameter to prior and likelihood.

    A normal posterior that is all likelihood, or all prior, has the sensitivity 0.089 to it.

    Attributes
    ----------
    table : one row per parameter: parameter, prior (sensitivity to all laws at once), own (to the
        parameter's own law), cut_own (of the cut prior itself to that law), strongest (whose law moves it
        most), strongest_law (how much), likelihood, noise (95 % point of the likelihood's for a parameter
        that has nothing to do with it), silent (whether ordinary power-scaling cannot see the law because it
        is flat), word.
    by_law : sensitivity of every parameter (rows) to every parameter's law (columns), (d, d).
    k_hat : greatest Pareto shape of the weights.
    limit : greatest shape at which they can be relied on.
    """

    table: pd.DataFrame
    by_law: FloatArray
    k_hat: float
    limit: float

    @property
    def reliable(self) -> bool:
        """Whether the weights have a light tail."""
        return self.k_hat <= self.limit


def power_scaling(posterior: Posterior, prior: FloatArray, draws: FloatArray, rng: Generator) -> PowerScaling:
    """Scale prior and likelihood around nearly independent posterior draws (n, d); the cut prior's (m, d)."""
    draws, prior = spaced(draws, DRAWS), spaced(prior, DRAWS)
    laws = list(posterior.prior.laws.values())
    flat = [bool(np.ptp(law.log_density(x)) < 1e-9) for law, x in zip(laws, draws.T, strict=True)]
    likelihood = Reweighted(posterior.log_prior_and_likelihood(draws)[1])
    joint = posterior.prior.score_correlation
    flat = [one and not others for one, others in zip(flat, (joint != 0).sum(axis=0) > 1, strict=True)]
    stated = Stated(posterior.names, laws, flat, joint)
    return scaled(stated, likelihood, prior, draws, noise=likelihood.noise(rng))


@dataclass(frozen=True)
class Stated:
    """The free parameters, their laws, which of these are flat, and how their normal scores correlate."""

    names: Sequence[str]
    laws: Sequence[Law]
    flat: Sequence[bool]
    correlation: FloatArray | None = None

    def densities(self, x: FloatArray) -> list[Reweighted]:
        """Log densities of the normal scores of parameter sets (n, d), parameter by parameter.

        Parameters that correlate in the prior have one law together, which is scaled as a whole.
        """
        parts = self._parts(x)
        joined = connected_components(self._joint != 0)[1]
        return [Reweighted(parts[:, joined == label].sum(axis=1)) for label in joined]

    def together(self, x: FloatArray) -> Reweighted:
        """Log density of the normal scores of parameter sets (n, d) under all laws at once."""
        return Reweighted(self._parts(x).sum(axis=1))

    def _parts(self, x: FloatArray) -> FloatArray:
        """Terms (n, d) of −½ zᵀR⁻¹z, one for every parameter; those of a joint law belong together."""
        z = np.column_stack([law.score(column) for law, column in zip(self.laws, x.T, strict=True)])
        return np.asarray(-0.5 * z * np.linalg.solve(self._joint, z.T).T)

    @property
    def _joint(self) -> FloatArray:
        return np.eye(len(self.names)) if self.correlation is None else self.correlation


def scaled(
    stated: Stated, likelihood: Reweighted, prior: FloatArray, draws: FloatArray, *, noise: float
) -> PowerScaling:
    """Sensitivities of draws (n, d) whose likelihood is known, beside those of the cut prior's (m, d)."""
    by_law, cut = stated.densities(draws), stated.densities(prior)
    together = stated.together(draws)
    moved = np.array([[each.sensitivity(x) for each in by_law] for x in draws.T])
    strongest = (moved + 1e-12 * np.eye(len(moved))).argmax(axis=1)  # of a joint law, the parameter's own
    table = pd.DataFrame(
        {
            "parameter": list(stated.names),
            "prior": [together.sensitivity(x) for x in draws.T],
            "own": np.diagonal(moved),
            "cut_own": [each.sensitivity(x) for each, x in zip(cut, prior.T, strict=True)],
            "strongest": [stated.names[i] for i in strongest],
            "strongest_law": moved.max(axis=1),
            "likelihood": [likelihood.sensitivity(x) for x in draws.T],
            "noise": noise,
            "silent": list(stated.flat),
        }
    )
    columns = ["own", "cut_own", "strongest_law", "likelihood"]
    table["word"] = [word(*row) for row in table[columns].to_numpy(dtype=np.float64)]
    k_hat = max(each.k_hat for each in (likelihood, together, *by_law, *cut))
    return PowerScaling(table, moved, k_hat, pareto_limit(len(draws)))


def word(own: float, cut_own: float, strongest: float, likelihood: float) -> str:
    """What a parameter follows.

    ``repeats its prior``: it follows its own law at least half as far as the cut prior does, and the
    likelihood does not move it. ``another's prior``: not that, but the law of another parameter moves it
    and the likelihood does not. ``prior and data``: both do. ``data``: the likelihood alone. ``unmoved``:
    nothing does.
    """
    if likelihood >= SENSITIVE:
        return "prior and data" if strongest >= SENSITIVE else "data"
    if own >= max(REPEATED * cut_own, SENSITIVE):
        return "repeats its prior"
    return "another's prior" if strongest >= SENSITIVE else "unmoved"


def log_normal(law: Law, x: FloatArray) -> FloatArray:
    """Log density (n,) of the normal scores of values under their law, up to a constant."""
    return np.asarray(-0.5 * law.score(x) ** 2)


@dataclass(frozen=True)
class Reweighted:
    """Draws reweighted by a log density (n,) to the powers ``ALPHAS`` − 1."""

    log_density: FloatArray

    @cached_property
    def _smoothed(self) -> list[tuple[FloatArray, float]]:
        if np.ptp(self.log_density) == 0.0:  # nothing is reweighted, and there is no tail to smooth
            return [(np.full(len(self.log_density), -np.log(len(self.log_density))), -np.inf)] * len(ALPHAS)
        return [pareto_smoothed((alpha - 1.0) * self.log_density) for alpha in ALPHAS]

    @property
    def k_hat(self) -> float:
        """Greatest Pareto shape of the weights."""
        return max(k for _, k in self._smoothed)

    def sensitivity(self, x: FloatArray) -> float:
        """Distance by which the law of draws (n,) moves per doubling of the power."""
        order = np.argsort(x)
        moved = [distance(x[order], np.exp(log_weights[order])) for log_weights, _ in self._smoothed]
        return float(np.mean(np.array(moved) / np.abs(np.log2(ALPHAS))))

    def noise(self, rng: Generator) -> float:
        """95 % point of the sensitivity of draws that do not depend on the density."""
        strangers = (rng.standard_normal(len(self.log_density)) for _ in range(SHUFFLES))
        return float(np.quantile([self.sensitivity(x) for x in strangers], 0.95))


def distance(x: FloatArray, weights: FloatArray) -> float:
    """Cumulative Jensen–Shannon distance of sorted draws (n,) with weights and without, between 0 and 1.

    Nguyen and Vreeken (2015), normalised as in Kallioinen et al. (2024), eq. (10); the greater one of the
    distances between cumulative and between survival functions.
    """
    gaps = np.diff(x)
    even = np.arange(1, len(x)) / len(x)
    weighted = np.clip(np.cumsum(weights / weights.sum())[:-1], 1e-300, 1.0 - 1e-16)
    return max(_one_sided(even, weighted, gaps), _one_sided(1.0 - even, 1.0 - weighted, gaps))


def _one_sided(p: FloatArray, q: FloatArray, gaps: FloatArray) -> float:
    """Distance between step functions p and q of widths ``gaps``; their linear terms cancel in the sum."""
    middle = np.log2(0.5 * (p + q))
    total = gaps @ (p * (np.log2(p) - middle) + q * (np.log2(q) - middle))
    return float(np.sqrt(max(total, 0.0) / (gaps @ (p + q))))
