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

Where rows hang together (:mod:`bayesterra.joint_rows`) the readings are jointly normal with covariance K, and
carry

    ∇μᵀ K⁻¹ ∇μ + ½ tr(K⁻¹ ∂K K⁻¹ ∂K),

so what a discrepancy can imitate is not counted as known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.identifiability.sensitivities import Sensitivities, has_own_sd, read_where, sensitivities
from bayesterra.joint_rows import STEP, JointRows, TableLaw
from bayesterra.latent import LatentLoad
from bayesterra.noise import Noise
from bayesterra.posteriors import Posterior


def weighted_sensitivities(posterior: Posterior, x: FloatArray) -> FloatArray:
    """Sensitivities in units of the noise (n, q, d), whose product AᵀA is the Fisher information.

    Two rows stand for each row and channel, ∇μ √a / σ and ∇σ √b / σ; 0 where nothing is read, see
    :func:`read_where`. Sets without an answer in a row that is read are NaN. Where rows hang together there
    is one row for each reading, and one for each parameter about what the scatter says.
    """
    return _weighted(posterior, x)


def fisher_information(posterior: Posterior, x: FloatArray) -> FloatArray:
    """Fisher information (n, d, d) of the readings about the free parameters at sets ``x`` (n, d), SI.

    NaN where the model has no answer in a row that is read. With drive ``both``: exact for a model that is
    linear over the spread of the load given its readings; see the head of the module.
    """
    weighted = weighted_sensitivities(posterior, x)
    return np.asarray(weighted.transpose(0, 2, 1) @ weighted)


def score_and_information(posterior: Posterior, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gradient of the log likelihood (n, d) and Fisher information (n, d, d) at sets ``x`` (n, d), SI.

    The gradient takes a latent load for its best known value, and is NaN where rows hang together. NaN as
    with :func:`fisher_information`.
    """
    if isinstance(posterior.likelihood, JointRows):
        information = fisher_information(posterior, x)
        return np.full(information.shape[:2], np.nan), information
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
    weighted = _weighted(posterior, x)
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


def _weighted(posterior: Posterior, x: FloatArray) -> FloatArray:
    likelihood, found = posterior.likelihood, Scaled.of(posterior, x)
    if isinstance(likelihood, JointRows):
        return _jointly_weighted(posterior, likelihood, np.atleast_2d(x), found)
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


def _jointly_weighted(
    posterior: Posterior, likelihood: JointRows, x: FloatArray, found: Scaled
) -> FloatArray:
    """Whitened sensitivities (n, readings + d, d); see the head of the module."""
    read = read_where(posterior, likelihood.channels)
    whole = np.full((len(x), int(read.sum()) + x.shape[1], x.shape[1]), np.nan)
    good = np.flatnonzero(np.isfinite(found.local.values).all(axis=(1, 2)))
    if not good.size:
        return whole
    law = likelihood.reading(read).law_at(
        posterior.prior.soil_values(x[good]), found.local.values[good], posterior.noise_values(x[good])
    )
    white = []
    for stack, one in zip(law.layout.stacks, law.whitenings, strict=True):
        slopes = one.matrix @ found.local.by_parameter[good][:, stack.rows, stack.columns]
        white.append(slopes.reshape(len(good), -1, x.shape[1]))
    bends = _bends(posterior, likelihood, x[good])
    scatter = _root(_scatter_information(posterior, law, found.spread[good], bends))
    whole[good] = np.concatenate([*white, scatter], axis=1)
    return whole


def _bends(posterior: Posterior, likelihood: JointRows, x: FloatArray) -> FloatArray:
    """Derivatives (n, m, k, d) of the slopes over slip by the parameters; 0 where slips are exact."""
    rows = likelihood.forward.conditions
    if likelihood.errors.slip is None:
        return np.zeros((len(x), *likelihood.measured.shape, x.shape[1]))
    ends = np.maximum(rows.slip - STEP, 0.0), np.where(rows.slip + STEP < 1.0, rows.slip + STEP, rows.slip)
    low, high = (
        sensitivities(replace(posterior, likelihood=replace(likelihood, forward=replace(
            likelihood.forward, conditions=replace(rows, slip=at)))), x).of(likelihood.channels).by_parameter
        for at in ends
    )  # fmt: skip
    return np.asarray(np.nan_to_num((high - low) / (ends[1] - ends[0])[:, None, None]))


def _scatter_information(
    posterior: Posterior, law: TableLaw, spread: FloatArray, bends: FloatArray
) -> FloatArray:
    """What the scatter says (n, d, d): ½ tr(K⁻¹ ∂K K⁻¹ ∂K)."""
    n, d = len(spread), spread.shape[-1]
    total = np.zeros((n, d, d))
    named = [None if one.parameter is None else posterior.names.index(one.parameter)
             for one in law.layout.errors]  # fmt: skip
    for stack, one in zip(law.layout.stacks, law.whitenings, strict=True):
        at = (slice(None), stack.rows, stack.columns)
        moved = {i: np.eye(stack.rows.shape[1]) * (2.0 * law.scale[at] * spread[(*at, i)])[..., None]
                 for i in range(d) if spread[(*at, i)].any()}  # fmt: skip
        for i in range(d):
            if stack.slip is not None and bends[(*at, i)].any():
                moved[i] = moved.get(i, 0.0) + stack.by_slopes(law.sizes, law.slopes, bends[..., i])
        for which, column in enumerate(named):
            by_size = stack.by_size(which, law.sizes, law.slopes)
            if column is not None and by_size is not None:
                moved[column] = moved.get(column, 0.0) + by_size
        whitened = {i: one.matrix @ part @ one.matrix.swapaxes(-1, -2) for i, part in moved.items()}
        for i, first in whitened.items():
            for j, second in whitened.items():
                total[:, i, j] += 0.5 * (first * second).sum(axis=(1, 2, 3))
    return total


def _root(information: FloatArray) -> FloatArray:
    """Rows R (n, d, d) with RᵀR the information, which may be singular."""
    values, vectors = np.linalg.eigh(information)
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[..., None] * vectors.swapaxes(-1, -2))


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
