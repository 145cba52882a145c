"""Groups with eight parameters and linear normal readings of them: many locals, evidences in closed form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.random import Generator
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, ortho_group

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.likelihood.joint import JointPosterior, joint_posterior
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import Posterior
from bayesterra.models import Wheel
from bayesterra.study.groups import Pooling
from bayesterra.study.study import Study

LAWS = {
    "Ks": (2.5e6, 2e5), "n0": (0.85, 0.1), "n1": (1.0, 0.2), "c": (1000.0, 100.0),
    "phi": (0.6, 0.04), "K": (0.012, 0.001), "c1": (0.5, 0.03), "c2": (-0.1, 0.03),
}  # fmt: skip
"""Mean and standard deviation of the normal prior of every parameter, in the package's order, SI; no edge of
the physical support is nearer than four of them."""
CENTRE, SCALE = np.array(list(LAWS.values())).T
SHARPEST, FAINTEST = 30.0, 0.5
"""Prior over reading errors of the best and the worst measured direction."""
COMMON, OWN, POPULATION = "common", "own", "population"


@dataclass(frozen=True)
class LinearReadings(Likelihood):
    """Readings (m,) of standardised parameters through a matrix (m, 8), errors standard normal."""

    y: FloatArray = field(default_factory=lambda: np.zeros(0))
    H: FloatArray = field(default_factory=lambda: np.zeros((0, 8)))

    def log_likelihood(self, soil: FloatArray, noise_values: FloatArray) -> FloatArray:
        """Log density (n,) of all readings."""
        residual = self.y - (soil[:, : len(CENTRE)] - CENTRE) / SCALE @ self.H.T
        return np.asarray(-0.5 * (residual**2).sum(axis=1) - 0.5 * len(self.y) * np.log(2 * np.pi))

    def status(self, soil: FloatArray) -> IntArray:
        """Every parameter set has outcomes."""
        return np.zeros(len(soil), dtype=np.intp)


@dataclass(frozen=True)
class LinearSoils:
    """Readings (groups, 8), their matrices (groups, 8, 8), and all that follows in closed form."""

    y: FloatArray
    H: FloatArray

    @cached_property
    def _base(self) -> JointPosterior:
        rows = [{"wheel": name, "slip": slip, "load [N]": 80.0} for name in "ab" for slip in (0.1, 0.5)]
        wheel = Wheel(0.135, 0.165, 0.015, 24, shearing_radius_coefficient=0.75)
        study = Study(
            pd.DataFrame(rows).assign(**{"drawbar_pull [N]": 20.0}),
            {"a": wheel, "b": wheel},
            slip_reference="shearing",
            kind="simulated",
            model="M2",
            noise={"drawbar_pull": 1.0},
            priors={name: {"dist": "norm", "loc": loc, "scale": sd} for name, (loc, sd) in LAWS.items()},
            pooling={"by": "wheel", "shared": ["c"], "separate": [name for name in LAWS if name != "c"]},
        )
        return joint_posterior(study)

    def joint(self) -> JointPosterior:
        """The joint posterior with a common c, all else each group's own."""
        first = self._base.first
        assert first.names == tuple(LAWS)
        given = first.likelihood
        groups = {
            f"g{i}": Posterior(first.prior, LinearReadings(given.forward, given.observations, given.noise, y=y, H=H))
            for i, (y, H) in enumerate(zip(self.y, self.H, strict=True))
        }
        return JointPosterior(Pooling("wheel", ("c",), tuple(n for n in LAWS if n != "c")), groups)

    def chains(self, ensembles: int, n: int, rng: Generator) -> dict[str, FloatArray]:
        """Draws of each group's own posterior (ensembles, n/10, 10, 8)."""
        draws, size = {}, (ensembles, n // 10, 10)
        for i, (y, H) in enumerate(zip(self.y, self.H, strict=True)):
            covariance = np.linalg.inv(np.eye(len(CENTRE)) + H.T @ H)
            draws[f"g{i}"] = CENTRE + SCALE * rng.multivariate_normal(covariance @ H.T @ y, covariance, size)
        return draws

    def log_evidence(self, roles: Mapping[str, str]) -> float:
        """Of all readings; a parameter that ``roles`` does not name is each group's own.

        A population has the default laws: standard normal mean, spread half-normal of scale 1/2.
        """
        if POPULATION not in roles.values():
            return float(multivariate_normal(cov=self._covariance(roles, 0.0)).logpdf(self.y.ravel()))
        spreads = (np.arange(400) + 0.5) * 3.0 / 400
        levels = [multivariate_normal(cov=self._covariance(roles, s)).logpdf(self.y.ravel()) for s in spreads]
        weights = -0.5 * (spreads / 0.5) ** 2
        return float(logsumexp(np.array(levels) + weights) - logsumexp(weights))

    def _covariance(self, roles: Mapping[str, str], spread: float) -> FloatArray:
        """Prior covariance of all readings, group by group, at a spread of the population."""
        G, each = len(self.y), np.eye(len(self.y))
        between = {OWN: each, COMMON: np.ones((G, G)), POPULATION: 1.0 + spread**2 * each}
        values = np.array([between[roles.get(name, OWN)] for name in LAWS])
        covariance = np.einsum("gmj,jgh,hnj->gmhn", self.H, values, self.H)
        return np.asarray(covariance.reshape(self.y.size, -1) + np.eye(self.y.size))


def linear_soils(groups: int, rng: Generator, spread: float = 0.3) -> LinearSoils:
    """Groups that differ by a share of the prior; each measures other directions well, and others hardly."""
    d = len(LAWS)
    turns = ortho_group(d, seed=rng).rvs(groups)
    H = np.geomspace(SHARPEST, FAINTEST, d)[:, None] * turns
    values = 0.7 * rng.standard_normal(d) + spread * rng.standard_normal((groups, d))
    return LinearSoils(np.einsum("gmj,gj->gm", H, values) + rng.standard_normal((groups, d)), H)
