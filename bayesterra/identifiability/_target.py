"""What profiles minimise: minus log likelihood or minus log posterior density, and its local quadratic model.

The curvature is Fisher's information of the readings (for Gaussian noise the Gauss–Newton matrix), from the
models' exact derivatives. A latent load is a nuisance to each row, projected out of its information; the
gradient is then taken by differences.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.forward import by_wheel, offset_of, take
from bayesterra.identifiability._chart import Chart
from bayesterra.latent import LatentLoad
from bayesterra.parameters import MODULI, OFFSET, SOIL_PARAMETERS
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
        information, slope = self._information(x)
        stretch = self.chart.stretch(x)
        information = information * stretch[:, :, None] * stretch[:, None, :]
        if isinstance(self.posterior.likelihood, LatentLoad):
            sizes = LATENT_STEP / np.sqrt(np.einsum("nii->ni", information) + 1.0)
            slope = self._differences(y, sizes)
        else:
            slope = slope * stretch
        if self.with_prior:
            first, second = self._prior(y)
            slope = slope - first
            information = information + np.maximum(-second, 0.0)[:, :, None] * np.eye(y.shape[1])
        slope = slope + PULL * (y - self.anchor)
        return Local(self.value(y), slope, information + PULL * np.eye(y.shape[1]))

    def _information(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Fisher's information (n, d, d), and the slope (n, d) of minus the log likelihood; not if latent."""
        likelihood, n, d = self.posterior.likelihood, len(x), x.shape[1]
        soil = self.posterior.prior.soil_values(x)
        predicted, derivatives, nuisance = _predicted(self.posterior, soil)
        scale = likelihood.scales(predicted, self.posterior.noise_values(x))
        by_scale = self._log_scale_derivatives(predicted, derivatives, scale)
        known = ~np.isnan(likelihood.measured) & np.isfinite(predicted)
        standard = np.where(known, (likelihood.measured - predicted) / scale, 0.0)
        dof = np.array([noise.dof for noise in likelihood.noise])
        with np.errstate(invalid="ignore"):
            heavy = np.isfinite(dof)
            pull = np.where(heavy, (dof + 1) * standard / (dof + standard**2), standard)
            weight = np.where(heavy, (dof + 1) / (dof + 3), 1.0)
            scale_weight = np.where(heavy, 2 * dof / (dof + 3), 2.0)
        J = np.where(known[..., None], derivatives / scale[..., None] * np.sqrt(weight)[:, None], 0.0)
        S = np.where(known[..., None], by_scale, 0.0)
        slope = np.einsum("nmc,nmcd->nd", -pull / np.sqrt(weight), J)
        slope += np.einsum("nmc,nmcd->nd", 1 - pull * standard, S)
        if nuisance is not None:
            J = _projected(J, np.where(known, nuisance / scale * np.sqrt(weight), 0.0))
        J, S = J.reshape(n, -1, d), (S * np.sqrt(scale_weight)[:, None]).reshape(n, -1, d)
        return J.swapaxes(1, 2) @ J + S.swapaxes(1, 2) @ S, slope

    def _log_scale_derivatives(
        self, predicted: FloatArray, derivatives: FloatArray, scale: FloatArray
    ) -> FloatArray:
        """Derivatives (n, m, channels, d) of the log of every standard deviation."""
        out, names = np.zeros_like(derivatives), self.posterior.names
        for i, noise in enumerate(self.posterior.likelihood.noise):
            own = self.posterior.likelihood.observations.given_sd.get(noise.channel)
            free = np.ones(scale.shape[1]) if own is None else np.isnan(own)
            if noise.parameter:
                out[:, :, i, names.index(noise.parameter)] = free / scale[:, :, i]
            elif noise.fraction is not None:
                proportional = noise.fraction * np.abs(predicted[:, :, i]) > noise.floor
                factor = free * proportional / np.where(proportional, predicted[:, :, i], 1.0)
                out[:, :, i] = factor[..., None] * derivatives[:, :, i]
        return out

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
        return LATENT_ENOUGH if isinstance(self.posterior.likelihood, LatentLoad) else ENOUGH

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


def _projected(J: FloatArray, nuisance: FloatArray) -> FloatArray:
    """Whitened derivatives (n, m, c, d) without their part along the row's own nuisance (n, m, c)."""
    norm = np.maximum((nuisance**2).sum(axis=2), 1e-300)
    along = np.einsum("nmc,nmcd->nmd", nuisance, J) / norm[..., None]
    return np.asarray(J - nuisance[..., None] * along[:, :, None, :])


def _predicted(posterior: Posterior, soil: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Modelled readings (n, m, channels), derivatives by the free parameters, and those by a latent sinkage.

    Sets without an answer have readings that are NaN.
    """
    likelihood = posterior.likelihood
    forward, mixing = likelihood.forward, _mixing(posterior)
    values = forward(soil, every_row=True).values
    offset = offset_of(soil) if forward.as_read else np.zeros((len(soil), 1))
    sinkage = forward.given - offset if forward.drive == "sinkage" else values[:, :, 0] - offset
    usable = np.where(np.isfinite(sinkage), sinkage, 0.1 * forward.conditions.radius)
    whole = np.empty((len(soil), usable.shape[1], 3, 10))
    by_soil = np.empty((len(soil), usable.shape[1], 3, len(posterior.names)))
    for rows, theta in by_wheel(soil, forward.conditions):
        part = take(forward.conditions, rows)
        whole[:, rows] = forward.model.jacobian_at(theta, part, np.ascontiguousarray(usable[:, rows]))
        by_soil[:, rows] = whole[:, rows, :, :9] @ _soil_rows(posterior, mixing, float(part.width[0]))
    columns = [forward.outcomes.index(name) for name in likelihood.channels]
    derivatives, nuisance = _by_drive(forward.drive, by_soil, whole[..., 9], mixing[-1])
    return (
        values[:, :, columns],
        derivatives[:, :, columns],
        None if nuisance is None else nuisance[:, :, columns],
    )


def _by_drive(
    drive: str, by_soil: FloatArray, by_sinkage: FloatArray, offset: FloatArray
) -> tuple[FloatArray, FloatArray | None]:
    """Derivatives of the outcomes of a drive, from those of the forces by soil (n, m, 3, d) and sinkage.

    ``offset`` (d,) says which parameter is the zero error of the sinkage.
    """
    reading = np.broadcast_to(offset, by_soil[:, :, :1].shape)
    if drive == "sinkage":
        return by_soil - by_sinkage[..., None] * offset, None
    if drive == "both":
        nuisance = np.concatenate([np.ones_like(by_sinkage[..., :1]), by_sinkage], axis=2)
        return np.concatenate([reading, by_soil], axis=2), nuisance
    # the load is held: implicit function theorem on F_N(z, θ) = W
    sinkage = -by_soil[:, :, :1] / by_sinkage[:, :, :1, None]
    rest = by_soil[:, :, 1:] + by_sinkage[:, :, 1:, None] * sinkage
    return np.concatenate([sinkage + reading, rest], axis=2), None


def _mixing(posterior: Posterior) -> FloatArray:
    """Derivatives (12, d) of the nine soil parameters, k_c, k_φ and the sinkage offset by the free ones."""
    prior = posterior.prior
    order = (*SOIL_PARAMETERS, *MODULI, OFFSET)
    _, into, source = prior.soil_template
    mixing = np.zeros((len(order), len(prior.names)))
    for column, parameter in zip(into, source, strict=True):
        mixing[order.index(prior.soil_columns[column]), parameter] = 1.0
    return mixing


def _soil_rows(posterior: Posterior, mixing: FloatArray, width: float) -> FloatArray:
    """Derivatives (9, d) of the soil parameters under a wheel of ``width`` by the free ones."""
    rows = mixing[: len(SOIL_PARAMETERS)].copy()
    if posterior.prior.uses_moduli:
        cohesive, frictional = (mixing[len(SOIL_PARAMETERS) + i] for i in range(len(MODULI)))
        rows[0] = cohesive / width + frictional
    return rows
