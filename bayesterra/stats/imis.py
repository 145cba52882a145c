"""Components where a proposal falls short of its target (incremental mixture sampling, Raftery and Bao 2010).

An independent proposal that is thin somewhere leaves walkers standing there: a point whose importance weight
is a hundred times the mean is left once in some hundred steps. So that is where components are added, one
after another, each fitted to the points around the greatest weight.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import FloatArray
from bayesterra.stats.mixture import StudentMixture, root
from bayesterra.stats.transport import Proposal

SHARE = 0.2
"""Weight of all added components together."""
NEIGHBOURS = 200
"""Points around the greatest weight that a component is fitted to."""
WIDENING = 1.3


@dataclass(frozen=True)
class EvaluatedPoints:
    """A target, and points that cover it.

    Attributes
    ----------
    u, level : points (n, d) and the target's log density there (n,), −inf outside the support.
    log_target : the log density itself.
    """

    u: FloatArray
    level: FloatArray
    log_target: Callable[[FloatArray], FloatArray]


def add_components(
    proposal: Proposal, evaluated: EvaluatedPoints, rng: Generator, *, components: int, draws: int
) -> Proposal:
    """Add components to a proposal where its importance weights are greatest.

    Parameters
    ----------
    components : number of components to add; 0 adds none.
    draws : draws of each new component, among which the next greatest weight is looked for too.
    """
    if not components:
        return proposal
    straight, share = proposal.transport_map, SHARE / components
    mixture = _thinned(proposal.mixture, 1.0 - SHARE)
    points = _Points.of(proposal, mixture, evaluated.u, evaluated.level)
    for _ in range(components):
        component = points.component()
        mixture = _with(mixture, component, share)
        u, _ = straight.forward(component.sample(draws, rng))
        fresh = _Points.of(proposal, mixture, u, evaluated.log_target(u))
        points = points.with_component(component, share).joined(fresh)
    return Proposal(straight, mixture)


def _thinned(mixture: StudentMixture, share: float) -> StudentMixture:
    return StudentMixture(share * mixture.weights, mixture.means, mixture.factors, mixture.dof)


def _with(mixture: StudentMixture, component: StudentMixture, share: float) -> StudentMixture:
    return StudentMixture(
        np.append(mixture.weights, share),
        np.vstack([mixture.means, component.means]),
        np.concatenate([mixture.factors, component.factors]),
        mixture.dof,
    )


@dataclass(frozen=True)
class _Points:
    """Straight coordinates (n, d), log target in these and log density of the growing mixture there (n,)."""

    v: FloatArray
    log_target: FloatArray
    log_proposal: FloatArray
    dof: float

    @classmethod
    def of(
        cls, proposal: Proposal, mixture: StudentMixture, u: FloatArray, log_target: FloatArray
    ) -> _Points:
        v, log_jacobian = proposal.transport_map.inverse(u)
        level = log_target + log_jacobian
        inside = np.isfinite(level) & np.isfinite(v).all(axis=1)
        return cls(v[inside], level[inside], mixture.log_density(v[inside]), mixture.dof)

    def component(self) -> StudentMixture:
        """A component about the point of greatest weight, as wide as the weighted points next to it."""
        log_weights = self.log_target - self.log_proposal
        centre = self.v[np.argmax(log_weights)]
        spread = self.v.std(axis=0) + 1e-300
        distances = (((self.v - centre) / spread) ** 2).sum(axis=1)
        near = np.argsort(distances, kind="stable")[:NEIGHBOURS]
        weights = np.exp(log_weights[near] - log_weights[near].max())
        weights = 0.5 * weights / weights.sum() + 0.5 / len(near)
        offsets = self.v[near] - centre
        covariance = (offsets * weights[:, None]).T @ offsets + 1e-9 * np.diag(spread**2)
        factor = WIDENING * root(covariance)
        return StudentMixture(np.ones(1), centre[None], np.asarray(factor)[None], self.dof)

    def with_component(self, component: StudentMixture, share: float) -> _Points:
        grown = np.logaddexp(self.log_proposal, np.log(share) + component.log_density(self.v))
        return _Points(self.v, self.log_target, grown, self.dof)

    def joined(self, more: _Points) -> _Points:
        return _Points(
            np.concatenate([self.v, more.v]),
            np.concatenate([self.log_target, more.log_target]),
            np.concatenate([self.log_proposal, more.log_proposal]),
            self.dof,
        )
