"""Log evidence by importance sampling from the frozen proposals of all ensembles, pooled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from scipy.special import logsumexp

from bayesterra.arrays import FloatArray
from bayesterra.diagnostics import pareto_limit, pareto_smoothed
from bayesterra.sampling.adaptation import Densities
from bayesterra.sampling.mixture import ProposalLaw

DRAWS = 16384
SPREAD = 0.3
"""Root mean square distance of the ensembles' own log evidences from the pooled one, above which it cannot be
relied on. Proposals that cover their posterior agree to some hundredths."""


@dataclass(frozen=True)
class Evidence:
    """Log of prior density times likelihood, integrated over all parameters.

    Attributes
    ----------
    log_z : log evidence; the prior is the stated one, cut to the physical support and not renormalised.
    error : its Monte Carlo standard error, with what the ensembles' own values say of it.
    efficiency : effective share of the draws.
    k_hat : Pareto shape of the greatest weights; above ``limit`` the error cannot be relied on.
    limit : largest reliable k̂ for this number of draws.
    draws : importance draws.
    spread : root mean square distance of the ensembles' own values from ``log_z``, see :meth:`beside`; 0
        where they are not known.
    """

    log_z: float
    error: float
    efficiency: float
    k_hat: float
    limit: float
    draws: int
    spread: float = 0.0

    @property
    def reliable(self) -> bool:
        """Whether the weights have a tail light enough for the error to hold, and the ensembles agree."""
        return self.k_hat <= self.limit and self.spread <= SPREAD

    def beside(self, own: Sequence[float]) -> Evidence:
        """The same with the log evidences that every ensemble found alone, from draws of its own proposal.

        Where all proposals miss the same part of a posterior, draws of theirs cannot show it: neither the
        spread of their weights nor the tail. Each proposal alone misses more, though, and each another
        share, so that what they have apart from the pooled value, as of so many estimates, joins the error.
        """
        known = np.array([value for value in own if np.isfinite(value)])
        if not len(known):
            return self
        spread = float(np.sqrt(np.mean((known - self.log_z) ** 2)))
        error = float(np.hypot(self.error, spread / np.sqrt(len(known))))
        return replace(self, error=error, spread=spread)


def evidence(
    densities: Densities, proposals: Sequence[ProposalLaw], rng: Generator, draws: int = DRAWS
) -> Evidence:
    """Weigh fresh draws, as many from each proposal, against the mixture of them all.

    No fit has seen these draws. A part of the posterior that one proposal misses is covered by the others
    (the balance heuristic of Veach and Guibas 1995).
    """
    each = -(-draws // len(proposals))
    u = np.concatenate([proposal.sample(each, rng) for proposal in proposals])
    pooled = logsumexp([proposal.log_density(u) for proposal in proposals], axis=0) - np.log(len(proposals))
    log_prior, log_likelihood = densities(u)
    log_weights = np.where(np.isneginf(log_prior), -np.inf, log_prior + log_likelihood) - pooled
    return summed(log_weights.reshape(len(proposals), each))


def summed(log_weights: FloatArray) -> Evidence:
    """Evidence of log weights (proposals, draws); draws of one proposal are a stratum."""
    top = log_weights.max()
    weights = np.exp(log_weights - top)
    mean, (strata, each) = weights.mean(), weights.shape
    error = np.sqrt(weights.var(axis=1, ddof=1).sum() / each) / strata
    k_hat = pareto_smoothed(log_weights[np.isfinite(log_weights)])[1]
    efficiency = weights.sum() ** 2 / (weights**2).sum() / weights.size
    return Evidence(
        log_z=float(top + np.log(mean)),
        error=float(error / mean),
        efficiency=float(efficiency),
        k_hat=k_hat,
        limit=pareto_limit(weights.size),
        draws=weights.size,
    )
