"""How the readings answer to the free parameters: exact derivatives.

The derivatives are those of the models (forward-mode, no differences), led through the prior to the free
parameters: ties, K_s = k_c/b + k_φ under each wheel's own width, the zero error of the sinkage. With drive
``both`` they are taken at the load that each row knows best: given, else its normal force, else that of
others.
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
from bayesterra.parameters import MODULI, OFFSET, PRIOR_PARAMETERS
from bayesterra.posteriors import Posterior
from bayesterra.priors import Prior

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
    parameters, shape = forward.model.parameters, (len(x), len(given), 3)
    values, slopes = np.empty(shape), np.empty((*shape, len(prior.names)))
    by_load = np.zeros(shape)
    for rows, theta in by_wheel(soil, forward.conditions):
        part = take(forward.conditions, rows)
        at = given[rows] - offset if forward.drive == "sinkage" else given[rows]
        values[:, rows], local = _by_soil_and_given(forward, theta, part, at)
        slopes[:, rows] = local[..., :-1] @ _soil_slopes(prior, float(part.width[0]), parameters)
        by_load[:, rows] = local[..., -1]
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
    """What the model says (n, m, 3), and its derivatives by its parameters and by what is given.

    Under a load, z(θ, W) follows from F_N(z, θ) = W by the implicit function theorem.
    """
    model = forward.model
    if forward.drive == "sinkage":
        values, _ = model.forces_at(theta, conditions, given, every_row=True)
        return values, model.jacobian_at(theta, conditions, given)
    values, _ = model.response_at(theta, conditions, given, every_row=True)
    slopes = model.jacobian_at(theta, conditions, values[..., 0])
    by_sinkage = slopes[..., -1:].copy()
    sinkage = np.concatenate([-slopes[..., :1, :-1], np.ones_like(by_sinkage[..., :1, :])], axis=-1)
    sinkage /= by_sinkage[..., :1, :]
    slopes[..., -1] = 0.0
    slopes = slopes + by_sinkage * sinkage
    slopes[..., 0, :] = sinkage[..., 0, :]
    return values, model.known_under(given, slopes)


def _soil_slopes(prior: Prior, width: float, parameters: Sequence[str]) -> FloatArray:
    """Derivative (9, d) of the model's parameters under a wheel of ``width`` by the free ones: a constant."""
    slopes = _column_slopes(prior)
    if prior.uses_moduli:
        slopes[0] = slopes[_KC] / width + slopes[_KPHI]
    return slopes[[prior.soil_columns.index(name) for name in parameters]]


def _offset_slopes(prior: Prior) -> FloatArray:
    """Derivative (d,) of the zero error of the sinkage by the free parameters."""
    slopes = _column_slopes(prior)
    return slopes[_OFFSET] if OFFSET in prior.soil_columns else np.zeros(len(prior.names))


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


def has_own_sd(likelihood: Likelihood, noise: Noise) -> BoolArray:
    """Rows (m,) whose table gives the standard deviation, which overrides the channel's noise."""
    own = likelihood.observations.given_sd.get(noise.channel)
    return np.zeros(len(likelihood.observations), dtype=np.bool_) if own is None else ~np.isnan(own)
