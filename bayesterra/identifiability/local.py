"""Local information over a posterior: spectra of directions, and collinearity of parameters.

The Fisher information, in units of the cut prior's standard deviations, at one parameter set or averaged over
many. Its eigenvalues say how much is known along each eigenvector, in units of what the prior knows: 1 halves
its variance, 9 leaves a tenth of it. Spread evenly over many decades they make a model
"sloppy" (Gutenkunst et al. 2007, PLoS Comput. Biol. 3, e189).

Two averages over parameter sets answer two questions. The mean information, with the prior's, bounds the mean
squared error of any estimator from below (van Trees' inequality; Gill & Levit 1995, Bernoulli 1, 59), but a
few sets at which readings are touchy can make it so large that the bound says nothing: K_s where it is small.
The mean of the bounds at each set is what normal approximations promise on average, and comes near posteriors
that are bent but not broken. Neither follows a ridge around its bends.

Information is held as roots R, RᵀR = information, found by orthogonal triangularisation, so that eigenvalues
keep their digits over thirty decades and not fifteen.

Brun, Reichert & Künsch 2001, Water Resour. Res. 37, 1015. With sensitivities s_j in units of the noise and of
the prior's standard deviations, and s̃_j = s_j / |s_j|, the collinearity index of a subset K of the parameters
is γ_K = 1 / √(smallest eigenvalue of S̃_Kᵀ S̃_K): what a change of one parameter does to the readings can be
made up for by the others but for a fraction 1 / γ_K. The importance of a parameter by itself is
δ_msqr = √(Σ s_j² / readings). Over several parameter sets the median of each figure is taken.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from math import comb

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.identifiability.structure import NEGLIGIBLE
from bayesterra.likelihood.joint import Whole
from bayesterra.likelihood.sensitivities import read_where, weighted_sensitivities

SINGULAR = 1e-11
"""Singular value, relative to columns of unit length, below which a direction carries no information."""
_BATCH = 100


@dataclass(frozen=True)
class LocalAnalysis:
    """Fisher information about the free parameters, at one set or averaged.

    Attributes
    ----------
    names : the d free parameters.
    readings : number of readings.
    roots : R (n, d, d) at every parameter set, RᵀR the information in units of the cut prior's sds.
    prior_sd : those (d,), SI.
    table : one row per parameter, SI: parameter, prior_sd; from the mean information: cramer_rao (bound on
        the sd of unbiased estimators from the readings alone, inf where they leave it open), with_prior (the
        same with the information of a normal law that has the cut prior's covariance); local_sd (root mean
        square of that bound over the sets; the posterior sd of a linear model with normal prior),
        posterior_sd (NaN without draws), expected (1 − local_sd² / prior_sd², the contraction to expect).
    """

    names: tuple[str, ...]
    readings: int
    roots: FloatArray
    prior_sd: FloatArray
    table: pd.DataFrame

    @cached_property
    def root(self) -> FloatArray:
        """Root (d, d) of the mean information."""
        d = len(self.names)
        stacked = self.roots.reshape(-1, d) / np.sqrt(len(self.roots))
        return np.asarray(np.linalg.qr(stacked, mode="r"), dtype=np.float64)

    @cached_property
    def spectra(self) -> FloatArray:
        """Spectra (n, d) of the information at every parameter set, largest first."""
        return np.asarray(np.linalg.svd(self.roots, compute_uv=False) ** 2)

    @property
    def decades(self) -> float:
        """Decades that the median of the spectra spans; inf where a direction carries no information."""
        values = np.sqrt(np.median(self.spectra, axis=0))
        if values[-1] <= SINGULAR * values[0]:
            return np.inf
        return float(2.0 * np.log10(values[0] / values[-1]))


def local_analysis(
    posterior: Whole, x: FloatArray, prior: FloatArray, draws: FloatArray | None = None
) -> LocalAnalysis:
    """Analyse the information of the readings at a parameter set or averaged over several.

    Parameters
    ----------
    x : the mode (d,), or posterior draws (n, d), or draws of the cut prior where there are none. Sets for
        which the model has no answer in a row that is read are left out.
    prior : draws (m, d) of the cut prior, the unit of everything.
    draws : posterior draws (n, d), for their standard deviations beside the bounds.

    Raises
    ------
    ValueError : no set of ``x`` has an answer in every row that is read.
    """
    prior_sd, correlation = prior.std(axis=0), np.atleast_2d(np.corrcoef(prior.T))
    roots = information_roots(posterior, np.atleast_2d(x), prior_sd)
    readings = sum(int(read.sum()) for read in read_where(posterior))
    none = pd.DataFrame(index=range(len(prior_sd)))
    plain = LocalAnalysis(posterior.names, readings, roots, prior_sd, none)
    bounds = np.array([cramer_rao(root, correlation) for root in roots])
    table = pd.DataFrame(
        {
            "parameter": list(posterior.names),
            "prior_sd": prior_sd,
            "cramer_rao": prior_sd * cramer_rao(plain.root),
            "with_prior": prior_sd * cramer_rao(plain.root, correlation),
            "local_sd": prior_sd * np.sqrt((bounds**2).mean(axis=0)),
            "posterior_sd": np.full(len(prior_sd), np.nan) if draws is None else draws.std(axis=0),
        }
    )
    table["expected"] = 1.0 - (table["local_sd"] / table["prior_sd"]) ** 2
    return replace(plain, table=table)


def information_roots(posterior: Whole, x: FloatArray, unit: FloatArray) -> FloatArray:
    """Roots (n', d, d) of the Fisher information at the sets of ``x`` (n, d) that have an answer.

    ``unit`` (d,) are the units of the parameters, SI.
    """
    roots_by_batch = [np.empty((0, len(unit), len(unit)))]
    for first in range(0, len(x), _BATCH):
        weighted = weighted_sensitivities(posterior, x[first : first + _BATCH]) * unit
        weighted = weighted[np.isfinite(weighted).all(axis=(1, 2))]
        missing = np.zeros((len(weighted), max(len(unit) - weighted.shape[1], 0), len(unit)))
        roots_by_batch.append(np.asarray(np.linalg.qr(np.concatenate([weighted, missing], axis=1), mode="r")))
    roots = np.concatenate(roots_by_batch)
    if not len(roots):
        raise ValueError("the model has no answer in some row for every parameter set given")
    return roots


def cramer_rao(root: FloatArray, correlation: FloatArray | None = None) -> FloatArray:
    """Cramér–Rao bounds (d,) on standard deviations, from a root (q, d) of the information.

    Parameters
    ----------
    correlation : of the prior (d, d), in the units of the root; its inverse is added to the information.

    Returns
    -------
    Bounds; inf for a parameter that takes part in a direction without information.
    """
    if correlation is not None:
        root = np.vstack([root, np.linalg.inv(np.linalg.cholesky(correlation))])
    length = np.sqrt((root**2).sum(axis=0))
    seen = length > 0
    _, values, rows = np.linalg.svd(root / np.where(seen, length, 1.0), full_matrices=False)
    null = values <= SINGULAR * max(values[0], 1e-300)
    open_ended = ~seen | (np.abs(rows[null]) > NEGLIGIBLE).any(axis=0)
    kept = rows[~null] / values[~null, None]
    bound = np.sqrt((kept**2).sum(axis=0)) / np.where(seen, length, 1.0)
    return np.where(open_ended, np.inf, bound)


CRITICAL = 15.0
"""Collinearity index above which a subset is not determined.

Usual thresholds lie between 10 and 20: 10 to 15 with Brun et al. (2001), 20 in the R package FME (Soetaert &
Petzoldt 2010, J. Stat. Softw. 33(3)).
"""
INFORMATIVE = 3.0
"""|s_j| from which a parameter counts as seen: the others known, a third of the prior's sd is left."""


MOST_SUBSETS = 13_000
"""All those of up to 16 parameters."""


@dataclass(frozen=True)
class Collinearity:
    """Collinearity indices of all subsets of two and more parameters.

    Attributes
    ----------
    names : the d free parameters.
    table : one row per subset, the most collinear of each size last: size, subset (names, joined by a blank),
        gamma (inf where a combination of its parameters changes no reading), highest (95 % of the sets are
        below).
    importance : one row per parameter: parameter, delta_msqr, length (|s_j|, prior sd over the sd that the
        readings alone would leave if all others were known).
    """

    names: tuple[str, ...]
    table: pd.DataFrame
    importance: pd.DataFrame

    def largest(self, critical: float = CRITICAL) -> tuple[str, ...]:
        """The largest determined subset: index up to ``critical``, each parameter seen (``INFORMATIVE``).

        The least collinear one where there are several; one parameter, or none, where no pair will do.
        """
        seen = set(self.importance.loc[self.importance["length"] >= INFORMATIVE, "parameter"])
        chosen = [set(subset.split()) <= seen for subset in self.table["subset"]]
        fine = self.table[np.array(chosen, dtype=bool) & (self.table["gamma"] <= critical)]
        if len(fine):
            best = fine[fine["size"] == fine["size"].max()].sort_values("gamma", kind="stable")
            return tuple(str(best["subset"].iloc[0]).split())
        top = self.importance.sort_values("length", ascending=False, kind="stable")["parameter"]
        return tuple(name for name in top[:1] if name in seen)


def collinearity(local: LocalAnalysis, sets: int = 200) -> Collinearity:
    """Collinearity at the parameter sets of a local analysis, ``sets`` of them evenly taken at most.

    There are 2^d − d − 1 subsets of d parameters: of sizes with more than ``MOST_SUBSETS`` none is looked at.
    """
    chosen = np.unique(np.linspace(0, len(local.roots) - 1, sets).astype(int))
    lengths = np.sqrt((local.roots[chosen] ** 2).sum(axis=1))
    unit = local.roots[chosen] / np.where(lengths > 0, lengths, 1.0)[:, None]
    sizes = range(2, len(local.names) + 1)
    tables = [_of_size(local.names, unit, k) for k in sizes if comb(len(local.names), k) <= MOST_SUBSETS]
    length = np.median(lengths, axis=0)
    importance = pd.DataFrame(
        {"parameter": list(local.names), "delta_msqr": length / np.sqrt(max(local.readings, 1)), "length": length}
    )
    columns = ["size", "subset", "gamma", "highest"]
    table = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(columns=columns)
    return Collinearity(local.names, table, importance)


def _of_size(names: Sequence[str], unit: FloatArray, size: int) -> pd.DataFrame:
    """Indices of all subsets of one size; ``unit`` (n, d, d) has columns of unit length."""
    chosen: IntArray = np.array(list(combinations(range(len(names)), size)), dtype=np.int64)
    gamma = collinearity_index(unit[:, :, chosen].transpose(0, 2, 1, 3))
    subsets = [" ".join(names[i] for i in subset) for subset in chosen]
    middle, highest = np.quantile(gamma, [0.5, 0.95], axis=0, method="higher")  # inf has no neighbours
    table = pd.DataFrame({"size": size, "subset": subsets, "gamma": middle, "highest": highest})
    return table.sort_values("gamma", kind="stable")


def collinearity_index(unit: FloatArray) -> FloatArray:
    """Index γ (...) of matrices (..., q, k) with columns of unit length; inf where they are dependent."""
    values = np.linalg.svd(unit, compute_uv=False)
    smallest = values[..., -1] if unit.shape[-2] >= unit.shape[-1] else np.zeros(unit.shape[:-2])
    dependent = smallest <= SINGULAR
    return np.asarray(np.where(dependent, np.inf, 1.0 / np.where(dependent, 1.0, smallest)))
