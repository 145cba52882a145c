"""Local analysis: how much the readings say about which combination of parameters, near given points.

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
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray
from bayesterra.identifiability._directions import NEGLIGIBLE, combination
from bayesterra.identifiability.fisher import weighted_sensitivities
from bayesterra.identifiability.sensitivities import read_where
from bayesterra.posteriors import Posterior

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
    def information(self) -> FloatArray:
        """Mean Fisher information (d, d) in units of the cut prior's standard deviations."""
        return np.asarray(self.root.T @ self.root)

    @cached_property
    def _decomposed(self) -> tuple[FloatArray, FloatArray]:
        _, values, rows = np.linalg.svd(self.root)
        largest = rows[np.arange(len(rows)), np.abs(rows).argmax(axis=1)]
        return values, rows * np.sign(largest)[:, None]

    @property
    def eigenvalues(self) -> FloatArray:
        """Spectrum (d,) of the mean information, largest first."""
        return self._decomposed[0] ** 2

    @property
    def directions(self) -> FloatArray:
        """Eigenvectors, columns (d, d), in prior standard deviations; the largest weight is positive."""
        return self._decomposed[1].T

    @property
    def decades(self) -> float:
        """Decades that the median of the spectra spans; inf where a direction carries no information."""
        values = np.sqrt(np.median(self.spectra, axis=0))
        if values[-1] <= SINGULAR * values[0]:
            return np.inf
        return float(2.0 * np.log10(values[0] / values[-1]))

    @property
    def combinations(self) -> tuple[str, ...]:
        """The eigenvectors' leading terms in words, in prior standard deviations: ``0.82 n0 − 0.57 c1``."""
        return tuple(combination(self.names, vector) for vector in self._decomposed[1])


def local_analysis(
    posterior: Posterior, x: FloatArray, prior: FloatArray, draws: FloatArray | None = None
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
    readings = int(read_where(posterior, posterior.likelihood.channels).sum())
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


def information_roots(posterior: Posterior, x: FloatArray, unit: FloatArray) -> FloatArray:
    """Roots (n', d, d) of the Fisher information at the sets of ``x`` (n, d) that have an answer.

    ``unit`` (d,) are the units of the parameters, SI.
    """
    found = [np.empty((0, len(unit), len(unit)))]
    for first in range(0, len(x), _BATCH):
        weighted = weighted_sensitivities(posterior, x[first : first + _BATCH]) * unit
        weighted = weighted[np.isfinite(weighted).all(axis=(1, 2))]
        missing = np.zeros((len(weighted), max(len(unit) - weighted.shape[1], 0), len(unit)))
        found.append(np.asarray(np.linalg.qr(np.concatenate([weighted, missing], axis=1), mode="r")))
    roots = np.concatenate(found)
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
