"""Fisher information of the readings, and the gradient of the log likelihood, from exact sensitivities.

A reading y with modelled value μ(x), scale σ(x) and a symmetric law of unit scale carries the information

    a ∇μ ∇μᵀ / σ² + b ∇σ ∇σᵀ / σ²,    a = 1, b = 2 (Gaussian);  a = (ν+1)/(ν+3), b = 2ν/(ν+3) (Student-t)

(Lange, Little & Taylor 1989, J. Am. Stat. Assoc. 84, 881). σ depends on the parameters where it is a
fraction of the modelled value, and where it is estimated itself.

With drive ``both`` the load W of every row is unknown as well. It is a nuisance parameter of its row, removed
by the Schur complement I_xx − I_xW I_Wx / (I_WW + I_0), where I_0 = 12 / range² is the inverse variance of
its flat prior: the information of a normal law with that variance, weak wherever the readings say more. What
the edges of the range say is not counted, so this is too little where the readings leave the load anywhere in
it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.identifiability.sensitivities import Sensitivities, has_own_sd, read_where, sensitivities
from bayesterra.latent import LatentLoad
from bayesterra.noise import Noise
from bayesterra.posteriors import Posterior


def weighted_sensitivities(posterior: Posterior, x: FloatArray) -> FloatArray:
    """Sensitivities in units of the noise (n, q, d), whose product AᵀA is the Fisher information.

    Two rows stand for each row and channel, ∇μ √a / σ and ∇σ √b / σ; 0 where nothing is read, see
    :func:`read_where`. Sets without an answer in a row that is read are NaN.
    """
    return _weighted(posterior, Scaled.of(posterior, x))


def fisher_information(posterior: Posterior, x: FloatArray) -> FloatArray:
    """Fisher information (n, d, d) of the readings about the free parameters at sets ``x`` (n, d), SI.

    NaN where the model has no answer in a row that is read. With drive ``both``: exact for a model that is
    linear over the spread of the load given its readings; see the head of the module.
    """
    weighted = weighted_sensitivities(posterior, x)
    return np.asarray(weighted.transpose(0, 2, 1) @ weighted)


def score_and_information(posterior: Posterior, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gradient of the log likelihood (n, d) and Fisher information (n, d, d) at sets ``x`` (n, d), SI.

    The gradient takes a latent load for its best known value. NaN as with :func:`fisher_information`.
    """
    likelihood, found = posterior.likelihood, Scaled.of(posterior, x)
    known = ~np.isnan(likelihood.measured)
    standard = np.where(known, (likelihood.measured - found.local.values) / found.scale, 0.0)
    dof = np.array([noise.dof for noise in likelihood.noise])
    with np.errstate(invalid="ignore"):
        heavy = (dof + 1.0) * standard / (dof + standard**2)
    pull = np.where(np.isfinite(dof), heavy, standard) / found.scale
    widening = np.where(known, pull * standard - 1.0 / found.scale, 0.0)
    gradient = np.einsum("nmk,nmkd->nd", pull, np.where(known[..., None], found.local.by_parameter, 0.0))
    gradient += np.einsum("nmk,nmkd->nd", widening, np.where(known[..., None], found.spread, 0.0))
    weighted = _weighted(posterior, found)
    return gradient, np.asarray(weighted.transpose(0, 2, 1) @ weighted)


@dataclass(frozen=True)
class Scaled:
    """Sensitivities of the measured channels, their noise and its slopes.

    Attributes
    ----------
    local : values and derivatives.
    scale : standard deviations (n, m, k).
    spread, spread_by_load : derivatives of the noise's scale by the parameters and by a latent load.
    """

    local: Sensitivities
    scale: FloatArray
    spread: FloatArray
    spread_by_load: FloatArray

    @classmethod
    def of(cls, posterior: Posterior, x: FloatArray) -> Scaled:
        """At sets ``x`` (n, d)."""
        x = np.atleast_2d(np.asarray(x, dtype=np.float64))
        local = sensitivities(posterior, x).of(posterior.likelihood.channels)
        scale = posterior.likelihood.scales(local.values, posterior.noise_values(x))
        return cls(local, scale, *_spread_slopes(posterior, local))


def _weighted(posterior: Posterior, found: Scaled) -> FloatArray:
    likelihood = posterior.likelihood
    place, width = _weights(likelihood.noise)
    read = np.tile(read_where(posterior, likelihood.channels), 2)
    slopes = [place[:, None] * found.local.by_parameter, width[:, None] * found.spread]
    by_x = np.concatenate([part / found.scale[..., None] for part in slopes], axis=2)
    by_x = np.where(read[..., None], by_x, 0.0)
    if isinstance(likelihood, LatentLoad):
        loads = [place * found.local.by_load / found.scale, width * found.spread_by_load / found.scale]
        by_load = np.where(read, np.concatenate(loads, axis=2), 0.0)
        by_x = without_load(by_x, by_load, load_information(likelihood))
    return by_x.reshape(len(by_x), -1, by_x.shape[-1])


def load_information(likelihood: LatentLoad) -> float:
    """Information of the flat prior of a load: its inverse variance, 12 / range², 1/N²."""
    low, high = likelihood.load_range
    return 12.0 / (high - low) ** 2


def without_load(by_x: FloatArray, by_load: FloatArray, known: float) -> FloatArray:
    """Take an unknown load out of the rows ``by_x`` (n, m, k, d), ``by_load`` (n, m, k) their slopes by it.

    With g = ``by_load`` of a row, A the result and ``known`` the prior's information about the load, AᵀA is
    the Schur complement: A = (I − γ g gᵀ) ``by_x`` with (I − γ g gᵀ)² = I − g gᵀ / (gᵀg + known).
    """
    size = (by_load**2).sum(axis=2)
    kept = np.sqrt(np.divide(known, size + known, out=np.ones_like(size), where=size + known != 0))
    gain = np.divide(1.0 - kept, size, out=np.zeros_like(size), where=size != 0)
    along = np.einsum("nmk,nmkd->nmd", by_load, by_x)
    return np.asarray(by_x - (gain[..., None] * by_load)[..., None] * along[:, :, None])


def _weights(noise: Sequence[Noise]) -> tuple[FloatArray, FloatArray]:
    """Roots (k,) of a and b: information of a law of unit scale about its place and its scale."""
    dof = np.array([each.dof for each in noise])
    with np.errstate(invalid="ignore"):
        place = np.where(np.isinf(dof), 1.0, (dof + 1.0) / (dof + 3.0))
        width = np.where(np.isinf(dof), 2.0, 2.0 * dof / (dof + 3.0))
    return np.sqrt(place), np.sqrt(width)


def _spread_slopes(posterior: Posterior, found: Sensitivities) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the noise's scale by the parameters (n, m, k, d) and by a latent load (n, m, k)."""
    by_x, by_load = np.zeros_like(found.by_parameter), np.zeros_like(found.by_load)
    for i, noise in enumerate(posterior.likelihood.noise):
        own = has_own_sd(posterior.likelihood, noise)
        if noise.fraction is not None:
            rate = _fraction_rate(noise, found.values[:, :, i], own)
            by_x[:, :, i] = rate[..., None] * found.by_parameter[:, :, i]
            by_load[:, :, i] = rate * found.by_load[:, :, i]
        elif noise.parameter is not None:
            by_x[:, :, i, posterior.names.index(noise.parameter)] = np.where(own, 0.0, 1.0)
    return by_x, by_load


def _fraction_rate(noise: Noise, predicted: FloatArray, own: BoolArray) -> FloatArray:
    """Derivative (n, m) of max(fraction |μ|, floor) by μ."""
    fraction = float(noise.fraction or 0.0)
    above = (fraction * np.abs(predicted) > noise.floor) & ~own
    return np.where(above, fraction * np.sign(predicted), 0.0)
