"""How the readings answer to the free parameters: exact derivatives, and the information that they carry.

The derivatives are those of the models (forward-mode, no differences), led through the prior to the free
parameters: ties, K_s = k_c/b + k_φ under each wheel's own width, the zero error of the sinkage.

A reading y with modelled value μ(x), scale σ(x) and a symmetric law of unit scale carries the information

    a ∇μ ∇μᵀ / σ² + b ∇σ ∇σᵀ / σ²,    a = 1, b = 2 (Gaussian);  a = (ν+1)/(ν+3), b = 2ν/(ν+3) (Student-t)

(Lange, Little & Taylor 1989, J. Am. Stat. Assoc. 84, 881). σ depends on the parameters where it is a
fraction of the modelled value, and where it is estimated itself.

With drive ``both`` the load W of every row is unknown as well. It is a nuisance parameter of its row, removed
by the Schur complement I_xx − I_xW I_Wx / (I_WW + I_0), where I_0 = 12 / range² is the inverse variance of
its flat prior: the information of a normal law with that variance, weak wherever the readings say more. What
the edges of the range say is not counted, so this is too little where the readings leave the load anywhere in
it. It is taken at the load that the row knows best: given, else its normal force, else what others have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.forward import Forward, by_wheel, offset_of, take
from bayesterra.latent import LatentLoad
from bayesterra.likelihood import Likelihood
from bayesterra.models import Conditions
from bayesterra.noise import Noise
from bayesterra.parameters import MODULI, OFFSET, PRIOR_PARAMETERS, SOIL_PARAMETERS
from bayesterra.posteriors import Posterior
from bayesterra.priors import Prior

_SOILS = len(SOIL_PARAMETERS)
_KC, _KPHI, _OFFSET = (PRIOR_PARAMETERS.index(name) for name in (*MODULI, OFFSET))


@dataclass(frozen=True)
class Sensitivities:
    """Modelled outcomes of n parameter sets in m rows and their derivatives, SI; NaN without an answer.

    Attributes
    ----------
    names : the d free parameters.
    channels : the k outcomes.
    values : (n, m, k).
    by_parameter : (n, m, k, d), at the given load or sinkage reading; at constant load with drive ``both``.
    by_load : (n, m, k), derivative by the row's latent load; 0 where the load is known.
    """

    names: tuple[str, ...]
    channels: tuple[str, ...]
    values: FloatArray
    by_parameter: FloatArray
    by_load: FloatArray

    def of(self, channels: tuple[str, ...]) -> Sensitivities:
        """Only some channels."""
        kept = [self.channels.index(name) for name in channels]
        return Sensitivities(
            self.names,
            channels,
            self.values[:, :, kept],
            self.by_parameter[:, :, kept],
            self.by_load[:, :, kept],
        )


def sensitivities(posterior: Posterior, x: FloatArray) -> Sensitivities:
    """Values and exact derivatives of every outcome of the drive, measured or not, at sets ``x`` (n, d)."""
    x = np.atleast_2d(np.asarray(x, dtype=np.float64))
    forward, prior = posterior.likelihood.forward, posterior.prior
    soil, given = prior.soil_values(x), known_inputs(posterior.likelihood)
    offset = offset_of(soil) if forward.as_read else np.zeros((len(x), 1))
    shift = _offset_slopes(prior) if forward.as_read else np.zeros(len(prior.names))
    shape = (len(x), len(given), 3)
    values, slopes = np.empty(shape), np.empty((*shape, len(prior.names)))
    by_load = np.zeros(shape)
    for rows, theta in by_wheel(soil, forward.conditions):
        part = take(forward.conditions, rows)
        at = given[rows] - offset if forward.drive == "sinkage" else given[rows]
        values[:, rows], local = _by_soil_and_given(forward, theta, part, at)
        slopes[:, rows] = local[..., :_SOILS] @ _soil_slopes(prior, float(part.width[0]))
        by_load[:, rows] = local[..., _SOILS]
    if forward.drive == "sinkage":
        slopes -= by_load[..., None] * shift
    else:
        values[:, :, 0] += offset
        slopes[:, :, 0] += shift
    if forward.drive == "both":
        return _with_normal_force(posterior, given, values, slopes, by_load)
    return Sensitivities(posterior.names, forward.outcomes, values, slopes, np.zeros(shape))


def known_inputs(likelihood: Likelihood) -> FloatArray:
    """Load or sinkage reading of every row (m,); the best known value of a latent load, in its range."""
    given = likelihood.forward.given
    if not isinstance(likelihood, LatentLoad):
        return given
    middle = np.mean(likelihood.load_range)
    return np.asarray(np.clip(np.where(np.isnan(given), middle, given), *likelihood.load_range))


def _by_soil_and_given(
    forward: Forward, theta: FloatArray, conditions: Conditions, given: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """What the model says (n, m, 3), and its derivatives by the nine soil parameters and by what is given.

    Under a load, z(θ, W) follows from F_N(z, θ) = W by the implicit function theorem.
    """
    model = forward.model
    if forward.drive == "sinkage":
        values, _ = model.forces_at(theta, conditions, given, every_row=True)
        return values, model.jacobian_at(theta, conditions, given)
    values, _ = model.response_at(theta, conditions, given, every_row=True)
    slopes = model.jacobian_at(theta, conditions, values[..., 0])
    by_sinkage = slopes[..., _SOILS:].copy()
    sinkage = np.concatenate([-slopes[..., :1, :_SOILS], np.ones_like(by_sinkage[..., :1, :])], axis=-1)
    sinkage /= by_sinkage[..., :1, :]
    slopes[..., _SOILS] = 0.0
    slopes = slopes + by_sinkage * sinkage
    slopes[..., 0, :] = sinkage[..., 0, :]
    return values, slopes


def _soil_slopes(prior: Prior, width: float) -> FloatArray:
    """Derivative (9, d) of the soil parameters under a wheel of ``width`` by the free ones: a constant."""
    slopes = _column_slopes(prior)
    if prior.uses_moduli:
        slopes[0] = slopes[_KC] / width + slopes[_KPHI]
    return slopes[:_SOILS]


def _offset_slopes(prior: Prior) -> FloatArray:
    """Derivative (d,) of the zero error of the sinkage by the free parameters."""
    slopes = _column_slopes(prior)
    return slopes[_OFFSET] if len(slopes) > _SOILS else np.zeros(len(prior.names))


def _column_slopes(prior: Prior) -> FloatArray:
    template, into, source = prior.soil_template
    slopes = np.zeros((len(template), len(prior.names)))
    slopes[into, source] = 1.0
    return slopes


def _with_normal_force(
    posterior: Posterior, given: FloatArray, values: FloatArray, slopes: FloatArray, by_load: FloatArray
) -> Sensitivities:
    """The normal force reads the load: it knows nothing of the soil."""
    known = np.isfinite(values[:, :, 0])
    force = np.where(known, given, np.nan)
    zero = np.where(known[..., None], np.zeros(slopes.shape[-1]), np.nan)
    return Sensitivities(
        posterior.names,
        posterior.likelihood.forward.outcomes,
        np.insert(values, 1, force, axis=2),
        np.insert(slopes, 1, zero, axis=2),
        np.insert(by_load, 1, np.where(known, 1.0, np.nan), axis=2),
    )


def read_where(posterior: Posterior, channels: Sequence[str]) -> BoolArray:
    """Whether each row reads each channel (m, k).

    A channel without any reading counts as read in every row: it is yet to be measured.
    """
    measured = posterior.likelihood.observations.values
    none = np.zeros(len(posterior.likelihood.observations), dtype=np.bool_)
    columns = [~np.isnan(measured[name]) if name in measured else none for name in channels]
    read = np.column_stack(columns)
    return np.asarray(read | ~read.any(axis=0))


def weighted_sensitivities(posterior: Posterior, x: FloatArray) -> FloatArray:
    """Sensitivities in units of the noise (n, q, d), whose product AᵀA is the Fisher information.

    Two rows stand for each row and channel, ∇μ √a / σ and ∇σ √b / σ; 0 where nothing is read, see
    :func:`read_where`. Sets without an answer in a row that is read are NaN.
    """
    x = np.atleast_2d(np.asarray(x, dtype=np.float64))
    likelihood = posterior.likelihood
    found = sensitivities(posterior, x).of(likelihood.channels)
    spread, spread_by_load = _spread_slopes(posterior, found)
    scale = likelihood.scales(found.values, posterior.noise_values(x))
    place, width = _weights(likelihood.noise)
    read = np.tile(read_where(posterior, likelihood.channels), 2)
    slopes = [place[:, None] * found.by_parameter, width[:, None] * spread]
    by_x = np.concatenate([part / scale[..., None] for part in slopes], axis=2)
    by_x = np.where(read[..., None], by_x, 0.0)
    if isinstance(likelihood, LatentLoad):
        loads = [place * found.by_load / scale, width * spread_by_load / scale]
        by_load = np.where(read, np.concatenate(loads, axis=2), 0.0)
        by_x = without_load(by_x, by_load, load_information(likelihood))
    return by_x.reshape(len(x), -1, x.shape[1])


def fisher_information(posterior: Posterior, x: FloatArray) -> FloatArray:
    """Fisher information (n, d, d) of the readings about the free parameters at sets ``x`` (n, d), SI.

    NaN where the model has no answer in a row that is read. With drive ``both``: exact for a model that is
    linear over the spread of the load given its readings; see the head of the module.
    """
    weighted = weighted_sensitivities(posterior, x)
    return np.asarray(weighted.transpose(0, 2, 1) @ weighted)


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


def has_own_sd(likelihood: Likelihood, noise: Noise) -> BoolArray:
    """Rows (m,) whose table gives the standard deviation, which overrides the channel's noise."""
    own = likelihood.observations.given_sd.get(noise.channel)
    return np.zeros(len(likelihood.observations), dtype=np.bool_) if own is None else ~np.isnan(own)


def _fraction_rate(noise: Noise, predicted: FloatArray, own: BoolArray) -> FloatArray:
    """Derivative (n, m) of max(fraction |μ|, floor) by μ."""
    fraction = float(noise.fraction or 0.0)
    above = (fraction * np.abs(predicted) > noise.floor) & ~own
    return np.where(above, fraction * np.sign(predicted), 0.0)
