"""What profiles minimise: minus log likelihood or minus log posterior density, and its local quadratic model.

The curvature is Fisher's information of the readings (for Gaussian noise the Gauss–Newton matrix), from the
models' exact derivatives. A latent load is a nuisance to each row, projected out of its information; the
gradient is then taken by differences, as it is where rows hang together.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.identifiability._chart import Chart
from bayesterra.identifiability.fisher import score_and_information
from bayesterra.joint_rows import JointRows
from bayesterra.latent import LatentLoad
from bayesterra.posteriors import Posterior

LATENT_STEP = 0.03
"""Step of differences, in standard deviations; the latent likelihood is known to 1e-3 only."""
ENOUGH, LATENT_ENOUGH = 2e-6, 5e-4
"""Changes of the log density that are worth a step; the latter is what a latent likelihood resolves."""
PULL = 3e-4
"""Curvature, per squared range, of the pull towards an anchor."""
PRIOR_STEP = 1e-4
"""Step of differences of the log prior, as a share of the range."""


@dataclass(frozen=True)
class Local:
    """Quadratic models at points y: values (n,), slopes (n, d) and curvatures (n, d, d)."""

    value: FloatArray
    slope: FloatArray
    curvature: FloatArray


@dataclass(frozen=True)
class Target:
    """Minus log likelihood, or with the log prior minus log posterior density in physical parameters.

    A faint pull towards ``anchor`` (d,), scaled, decides between points that are as good as each other: along
    directions without any information nothing moves that need not.
    """

    posterior: Posterior
    chart: Chart
    with_prior: bool
    anchor: FloatArray

    def value(self, y: FloatArray) -> FloatArray:
        """Values (n,) at scaled parameters (n, d) with the pull, +inf outside the support."""
        return np.asarray(-self.log_density(y) + 0.5 * PULL * ((y - self.anchor) ** 2).sum(axis=1))

    def log_density(self, y: FloatArray) -> FloatArray:
        """Log likelihood or log posterior density (n,), without the pull."""
        prior, likelihood = self.posterior.log_prior_and_likelihood(self.chart.to_physical(y))
        return np.asarray(likelihood + np.where(np.isfinite(prior), prior, 0.0) * self.with_prior)

    def local(self, y: FloatArray) -> Local:
        """Quadratic models at scaled parameters (n, d) inside the support."""
        x = self.chart.to_physical(y)
        score, information = (np.nan_to_num(found) for found in score_and_information(self.posterior, x))
        stretch = self.chart.stretch(x)
        information = information * stretch[:, :, None] * stretch[:, None, :]
        if self.latent or isinstance(self.posterior.likelihood, JointRows):
            sizes = LATENT_STEP / np.sqrt(np.einsum("nii->ni", information) + 1.0)
            slope = self._differences(y, sizes)
        else:
            slope = -score * stretch
        if self.with_prior:
            first, second = self._prior(y)
            slope = slope - first
            if self.posterior.prior.correlated:
                bent, joint = self._copula(y)
                slope, information = slope - bent, information + joint
                second[:, self.posterior.prior.correlated] = 0.0
            information = information + np.maximum(-second, 0.0)[:, :, None] * np.eye(y.shape[1])
        slope = slope + PULL * (y - self.anchor)
        return Local(self.value(y), slope, information + PULL * np.eye(y.shape[1]))

    def _differences(self, y: FloatArray, sizes: FloatArray) -> FloatArray:
        """Slope (n, d) of minus the log likelihood by central differences, one-sided at an edge."""
        n, d = y.shape
        offsets = sizes[:, :, None] * np.eye(d)
        shifted = np.stack([y[:, None] + offsets, y[:, None] - offsets])
        inside = (self.chart.slack(shifted.reshape(-1, d)) >= 0).all(axis=1).reshape(2, n, d)
        level = np.full((2, n, d), np.inf)
        likelihood = replace(self, with_prior=False)
        level[inside] = -likelihood.log_density(shifted[inside])
        centre = -likelihood.log_density(y)[:, None]
        usable = np.isfinite(level)
        ahead, behind = np.where(usable, level, centre)
        runs = np.maximum(usable.sum(axis=0), 1) * sizes
        return np.asarray((ahead - behind) / runs)

    @property
    def digits(self) -> float:
        """Change of the value that is worth a step."""
        return LATENT_ENOUGH if self.latent else ENOUGH

    @property
    def latent(self) -> bool:
        """Whether loads are integrated out, which takes long."""
        return isinstance(self.posterior.likelihood, LatentLoad)

    @cached_property
    def _shaped(self) -> list[int]:
        """Columns whose log prior is not flat."""
        return [i for i, law in enumerate(self.posterior.prior.laws.values()) if law.dist != "uniform"]

    def _prior(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """First and second derivatives (n, d) of each parameter's log prior by its scaled value."""
        first, second = np.zeros_like(y), np.zeros_like(y)
        laws = list(self.posterior.prior.laws.values())
        middle = np.clip(y, PRIOR_STEP, 1 - PRIOR_STEP)
        points = [self.chart.to_physical(middle + step) for step in (-PRIOR_STEP, 0.0, PRIOR_STEP)]
        for i in self._shaped:
            below, here, above = (laws[i].log_density(x[:, i]) for x in points)
            first[:, i] = (above - below) / (2 * PRIOR_STEP)
            second[:, i] = (above - 2 * here + below) / PRIOR_STEP**2
        first += second * (y - middle)
        return np.nan_to_num(first), np.nan_to_num(second)

    def _copula(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What correlation adds to the slope (n, d) of the log prior, and the whole curvature (n, d, d).

        The curvature is that of zᵀR⁻¹z/2, which is never negative, with the scores z taken as straight.
        """
        prior, d = self.posterior.prior, y.shape[1]
        stretch, precision = np.zeros((len(y), d)), np.linalg.inv(prior.score_correlation)
        middle = np.clip(y, PRIOR_STEP, 1 - PRIOR_STEP)
        below, above = (prior.scores(self.chart.to_physical(middle + h)) for h in (-PRIOR_STEP, PRIOR_STEP))
        stretch[:, prior.correlated] = ((above - below) / (2 * PRIOR_STEP))[:, prior.correlated]
        z = prior.scores(self.chart.to_physical(y))
        first = -stretch * (z @ (precision - np.eye(d)))
        return np.nan_to_num(first), np.nan_to_num(stretch[:, :, None] * precision * stretch[:, None, :])
