"""Derivatives of readings by parameters, and the Fisher information that they carry.

The derivatives are those of the models (forward-mode, no differences), led through the prior to the free
parameters: ties, K_s = k_c/b + k_φ under each wheel's own width, the zero error of the sinkage. With drive
``both`` they are taken at the load that each row knows best: given, else its normal force, else that of
others.

A reading y with modelled value μ(x), scale σ(x) and a symmetric law of unit scale carries the information

    a ∇μ ∇μᵀ / σ² + b ∇σ ∇σᵀ / σ²,    a = 1, b = 2 (Gaussian);  a = (ν+1)/(ν+3), b = 2ν/(ν+3) (Student-t)

(Lange, Little & Taylor 1989, J. Am. Stat. Assoc. 84, 881). σ depends on the parameters where it is a
fraction of the modelled value, and where it is estimated itself.

With drive ``both`` the load W of every row is unknown as well. It is a nuisance parameter of its row, removed
by the Schur complement I_xx − I_xW I_Wx / (I_WW + I_0), where I_0 = 12 / range² is the inverse variance of
its flat prior: the information of a normal law with that variance, weak wherever the readings say more. What
the edges of the range say is not counted, so this is too little where the readings leave the load anywhere in
it.

Where rows hang together (:mod:`bayesterra.likelihood.correlated`) the readings are jointly normal with
covariance K, and carry

    ∇μᵀ K⁻¹ ∇μ + ½ tr(K⁻¹ ∂K K⁻¹ ∂K),

so what a discrepancy can imitate is not counted as known. So do the log readings of each soil test.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.likelihood.condition_errors import STEP
from bayesterra.likelihood.covariance import TableLaw
from bayesterra.likelihood.forward import Forward, offset_of, take
from bayesterra.likelihood.joint import Whole
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import Posterior
from bayesterra.models.forces import SINKAGE
from bayesterra.parameters import PRIOR_PARAMETERS, SoilColumns, columns_of
from bayesterra.study.noise import Noise
from bayesterra.study.priors import Prior


@dataclass(frozen=True)
class Sensitivities:
    """Modelled outcomes of n parameter sets in m rows and their derivatives, SI; NaN without an answer."""

    names: tuple[str, ...]  # the d free parameters
    channels: tuple[str, ...]  # the k outcomes
    values: FloatArray  # (n, m, k)
    by_parameter: FloatArray  # (n, m, k, d), at the given load or sinkage reading; at constant load with drive ``both``
    by_load: FloatArray  # (n, m, k), derivative by the row's latent load; 0 where the load is known

    def of(self, channels: tuple[str, ...]) -> "Sensitivities":
        """Only some channels."""
        kept = [self.channels.index(name) for name in channels]
        parts = (part[:, :, kept] for part in (self.values, self.by_parameter, self.by_load))
        return Sensitivities(self.names, channels, *parts)


def sensitivities(posterior: Posterior, x: FloatArray) -> Sensitivities:
    """Values and exact derivatives of every outcome of the drive, measured or not, at sets ``x`` (n, d)."""
    x = np.atleast_2d(np.asarray(x, dtype=np.float64))
    forward, prior = posterior.likelihood.forward, posterior.prior
    soil, inputs = prior.soil_values(x), forward.given
    offset = offset_of(soil) if forward.as_read else np.zeros((len(x), 1))
    shift = _column_slopes(prior)[SoilColumns.sinkage_offset] * forward.as_read
    values, slopes, by_load = _slopes(forward, prior, soil, offset)
    if forward.drive.by_sinkage:
        slopes -= by_load[..., None] * shift
    else:
        values[:, :, SINKAGE] += offset
        slopes[:, :, SINKAGE] += shift
    if forward.drive.latent_load:
        return _with_normal_force(posterior, inputs, values, slopes, by_load)
    return Sensitivities(posterior.names, forward.outcomes, values, slopes, np.zeros(values.shape))


def _slopes(
    forward: Forward, prior: Prior, soil: FloatArray, offset: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """True values (n, m, width) of soil arrays (n, p), and derivatives by the free parameters and by what is given.

    Where nodes tell the rows they tell the derivatives, too.
    """
    nodes, inputs = forward.nodes, forward.given
    if nodes is not None and forward.at_nodes(nodes, soil)[1].all():
        few = _slopes(forward.held_at(nodes), prior, soil, offset)
        values, slopes, by_load = (np.moveaxis(np.tensordot(part, nodes.spread, (1, 0)), -1, 1) for part in few)
        return values, slopes, by_load
    parameters, shape = forward.model.parameters, (len(soil), len(inputs), forward.width)
    values, slopes, by_load = np.empty(shape), np.empty((*shape, len(prior.names))), np.zeros(shape)
    for rows, theta in forward.by_wheel(soil):
        part = take(forward.conditions, rows)
        at = inputs[rows] - offset if forward.drive.by_sinkage else inputs[rows]
        values[:, rows], local = forward.slopes(theta, part, at)
        slopes[:, rows] = local[..., :-1] @ _soil_slopes(prior, float(part.width[0]), parameters)
        by_load[:, rows] = local[..., -1]
    return values, slopes, by_load


def _soil_slopes(prior: Prior, width: float, parameters: Sequence[str]) -> FloatArray:
    """Derivative (k, d) of the model's parameters under a wheel of ``width`` by the free ones: a constant."""
    slopes = _column_slopes(prior)
    if prior.uses_moduli:
        slopes[SoilColumns.Ks] = slopes[SoilColumns.kc] / width + slopes[SoilColumns.kphi]
    return slopes[columns_of(parameters)]


def _column_slopes(prior: Prior) -> FloatArray:
    """Derivative (p, d) of the columns of a soil array by the free parameters."""
    _, into, source = prior.soil_template
    slopes = np.zeros((len(PRIOR_PARAMETERS), len(prior.names)))
    slopes[into, source] = 1.0
    return slopes


def _with_normal_force(
    posterior: Posterior, loads: FloatArray, values: FloatArray, slopes: FloatArray, by_load: FloatArray
) -> Sensitivities:
    """The normal force reads the load: it knows nothing of the soil."""
    outcomes = posterior.likelihood.forward.outcomes
    place, answered = outcomes.index("normal_force"), np.isfinite(values[:, :, SINKAGE])
    force = np.where(answered, loads, np.nan)
    zero = np.where(answered[..., None], np.zeros(slopes.shape[-1]), np.nan)
    rate = np.where(answered, 1.0, np.nan)
    columns = ((values, force), (slopes, zero), (by_load, rate))
    filled = (np.insert(whole, place, column, axis=2) for whole, column in columns)
    return Sensitivities(posterior.names, outcomes, *filled)


def read_where(posterior: Whole, channels: Sequence[str] | None = None) -> list[BoolArray]:
    """Masks of the channels, by default those with noise, that each row reads (m, k), of every group.

    A channel without any reading counts as read in every row: it is yet to be measured.
    """
    masks = []
    for own in posterior.groups.values():
        measured, none = own.likelihood.observations.values, np.full(len(own.likelihood.observations), np.nan)
        columns = [measured.get(name, none) for name in channels or own.likelihood.channels]
        masks.append(~np.isnan(np.column_stack(columns)) if columns else np.empty((0, 0), dtype=np.bool_))
    return [np.asarray(mask | ~np.concatenate(masks).any(axis=0)) for mask in masks]


def has_own_sd(likelihood: Likelihood, noise: Noise) -> BoolArray:
    """Rows (m,) whose table gives the standard deviation, which overrides the channel's noise."""
    own = likelihood.observations.given_sd.get(noise.channel)
    return np.zeros(len(likelihood.observations), dtype=np.bool_) if own is None else ~np.isnan(own)


def weighted_sensitivities(posterior: Whole, x: FloatArray) -> FloatArray:
    """Sensitivities in units of the noise (n, q, d), whose product AᵀA is the Fisher information.

    Two rows stand for each row and channel, ∇μ √a / σ and ∇σ √b / σ; 0 where nothing is read, see
    :func:`read_where`. Sets without an answer in a row that is read are NaN. Where rows hang together there
    is one row for each reading, and one for each parameter about what the scatter says. Groups stand one
    after another.
    """
    x, parts = np.atleast_2d(np.asarray(x, dtype=np.float64)), []
    groups = zip(posterior.groups.values(), posterior.places, posterior.values_of_groups(x), strict=True)
    for (own, at, values), read in zip(groups, read_where(posterior), strict=True):
        each = [_weighted(own, values, Scaled.of(own, values), read)[1]] if own.driven else []
        for experiment in own.experiments:
            _, white, scatter = experiment.score(values)
            each += [white, _root(scatter)]
        for weighted in each:
            parts.append(np.zeros((*weighted.shape[:2], x.shape[1])))
            parts[-1][:, :, at] = weighted
    return np.concatenate(parts, axis=1)


def score_and_information(posterior: Posterior, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gradient of the log likelihood (n, d) and Fisher information (n, d, d) at sets ``x`` (n, d), SI.

    The gradient takes a latent load for its best known value. NaN where the model has no
    answer in a row that is read. With drive ``both`` exact for a model that is linear over the spread of the
    load given its readings; see the head of the module.
    """
    gradient, information = np.zeros(x.shape), np.zeros((*x.shape, x.shape[1]))
    if posterior.driven:
        scaled = Scaled.of(posterior, x)
        joint, weighted = _weighted(posterior, x, scaled, read_where(posterior)[0])
        gradient = _gradient(posterior, x, scaled) if joint is None else joint
        information = np.asarray(weighted.transpose(0, 2, 1) @ weighted)
    for experiment in posterior.experiments:
        slope, white, scatter = experiment.score(x)
        gradient, information = gradient + slope, information + white.transpose(0, 2, 1) @ white + scatter
    return gradient, information


def _gradient(posterior: Posterior, x: FloatArray, scaled: "Scaled") -> FloatArray:
    """Gradient of the log likelihood (n, d) where every reading is apart."""
    likelihood, values = posterior.likelihood, scaled.local.values
    read, intervals = ~np.isnan(likelihood.measured), likelihood.intervals
    if not likelihood.widened:  # the law is that of readings before they are rounded
        scale = likelihood.scales(values, posterior.noise_values(np.atleast_2d(x)), rounded=False)
        scaled = replace(scaled, scale=scale, spread=scaled.bare_spread)
    standard = np.where(read, (likelihood.measured - values) / scaled.scale, 0.0)
    pulls = [noise.tails.pull(standard[:, :, i]) for i, noise in enumerate(likelihood.noise)]
    pull = np.stack(pulls, axis=2) / scaled.scale
    widening = np.where(read, pull * standard - 1.0 / scaled.scale, 0.0)
    if intervals is not None:
        intervals.replace_pulls(pull, widening, values, scaled.scale)
    gradient = np.einsum("nmk,nmkd->nd", pull, np.where(read[..., None], scaled.local.by_parameter, 0.0))
    gradient += np.einsum("nmk,nmkd->nd", widening, np.where(read[..., None], scaled.spread, 0.0))
    return np.asarray(gradient)


@dataclass(frozen=True)
class Scaled:
    """Sensitivities of the measured channels, their noise and its slopes."""

    local: Sensitivities  # values and derivatives
    scale: FloatArray  # standard deviations (n, m, k)
    spread: FloatArray  # derivatives of the noise's scale by the parameters
    spread_by_load: FloatArray  # that by a latent load
    bare_spread: FloatArray  # by the parameters, of the scale before readings are rounded

    @classmethod
    def of(cls, posterior: Posterior, x: FloatArray) -> "Scaled":
        """At sets ``x`` (n, d)."""
        x = np.atleast_2d(np.asarray(x, dtype=np.float64))
        local = sensitivities(posterior, x).of(posterior.likelihood.channels)
        likelihood, noise = posterior.likelihood, posterior.noise_values(x)
        scale, (by_x, by_load) = likelihood.scales(local.values, noise), _spread_slopes(posterior, local)
        if not any(entry.resolution for entry in likelihood.noise):
            return cls(local, scale, by_x, by_load, by_x)
        share = likelihood.scales(local.values, noise, rounded=False) / scale
        return cls(local, scale, share[..., None] * by_x, share * by_load, by_x)


def _weighted(
    posterior: Posterior, x: FloatArray, scaled: Scaled, read: BoolArray
) -> tuple[FloatArray | None, FloatArray]:
    """Gradient (n, d) where rows hang together, else None, and :func:`weighted_sensitivities`."""
    likelihood = posterior.likelihood
    if not likelihood.rows_apart:
        return _jointly_weighted(posterior, np.atleast_2d(x), scaled, read)
    place, width = np.sqrt([each.tails.information for each in likelihood.noise]).T  # a law's, of place and scale
    read = np.tile(read, 2)
    slopes = [place[:, None] * scaled.local.by_parameter, width[:, None] * scaled.spread]
    by_x = np.concatenate([part / scaled.scale[..., None] for part in slopes], axis=2)
    by_x = np.where(read[..., None], by_x, 0.0)
    if likelihood.load_range is not None:
        loads = [place * scaled.local.by_load / scaled.scale, width * scaled.spread_by_load / scaled.scale]
        by_load = np.where(read, np.concatenate(loads, axis=2), 0.0)
        by_x = without_load(by_x, by_load, load_information(likelihood.load_range))
    return None, by_x.reshape(len(by_x), -1, by_x.shape[-1])


def _jointly_weighted(
    posterior: Posterior, x: FloatArray, scaled: Scaled, read: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Gradient (n, d) and whitened sensitivities (n, readings + d, d); see the head of the module."""
    whole = np.full((len(x), int(read.sum()) + x.shape[1], x.shape[1]), np.nan)
    gradient = np.full(x.shape, np.nan)
    good = np.flatnonzero(np.isfinite(scaled.local.values).all(axis=(1, 2)))
    likelihood, values, by_load = posterior.likelihood, scaled.local.values[good], None
    if likelihood.load_range is not None:  # by the standard deviation of their flat prior
        by_load = scaled.local.by_load[good] / np.sqrt(load_information(likelihood.load_range))
    soil, noise = posterior.prior.soil_values(x[good]), posterior.noise_values(x[good])
    law = likelihood.law_where(read, soil, values, noise, by_load) if good.size else None
    if law is None:
        return gradient, whole
    residuals, by_x = law.white(law.residuals(likelihood.measured)), scaled.local.by_parameter[good]
    white, bends, spread = _whitened(law, by_x), _bends(posterior, law, x[good]), scaled.spread[good]
    gradient[good], information = _scatter(posterior, law, spread, bends, residuals)
    for slopes, residual in zip(white, residuals, strict=True):
        gradient[good] += np.einsum("nqd,nq->nd", slopes, residual.reshape(len(good), -1))
    if law.sites is not None:
        place = (slice(None), law.sites.row, law.sites.column)
        gradient[good] += np.einsum("nq,nqd->nd", law.sites.stretch / law.scale[place], spread[place])
    if (expected := law.expected) is not law:
        white, spread = _whitened(expected, by_x), spread * (expected.scale / law.scale)[..., None]
        information = _scatter(posterior, expected, spread, bends, residuals)[1]
    whole[good] = np.concatenate([*white, _root(information)], axis=1)
    return gradient, whole


def _whitened(law: TableLaw, by_x: FloatArray) -> list[FloatArray]:
    """Slopes (n, q, d) of the white readings of every stack, for those of readings (n, m, k, d)."""
    pairs = zip(law.layout.stacks, law.whitenings, strict=True)
    return [
        (whitening.matrix @ by_x[:, stack.rows, stack.columns]).reshape(len(by_x), -1, by_x.shape[-1])
        for stack, whitening in pairs
    ]


def _bends(posterior: Posterior, law: TableLaw, x: FloatArray) -> FloatArray:
    """Derivatives (n, m, k, d) of the effect of errors in slip by the parameters; 0 where slips are exact."""
    likelihood, error = posterior.likelihood, law.layout.errors.slip
    rows = likelihood.forward.conditions
    if error is None:
        return np.zeros((len(x), *likelihood.measured.shape, x.shape[1]))
    ends = np.maximum(rows.slip - STEP, 0.0), np.where(rows.slip + STEP < 1.0, rows.slip + STEP, rows.slip)
    moved = (replace(likelihood, forward=likelihood.forward.at_slip(slip)) for slip in ends)
    low, high = (
        sensitivities(replace(posterior, likelihood=at), x).of(likelihood.channels).by_parameter for at in moved
    )
    size = law.sizes[:, -1, None, None]
    bends = np.nan_to_num((high - low) / (ends[1] - ends[0])[:, None, None]) * size[..., None]
    if error.parameter is not None:
        bends[..., posterior.names.index(error.parameter)] = law.effects[..., 0] / size
    return np.asarray(bends)


def _scatter(
    posterior: Posterior, law: TableLaw, spread: FloatArray, bends: FloatArray, white: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Gradient (n, d) by the scatter and its Fisher information (n, d, d): ½ tr(K⁻¹ ∂K K⁻¹ ∂K).

    The gradient is ½ (wᵀ M w − tr M) with white residuals w (n, B, q) of every stack and M = W ∂K Wᵀ.
    """
    n, d = len(spread), spread.shape[-1]
    gradient, total = np.zeros((n, d)), np.zeros((n, d, d))
    named = [None if error.parameter is None else posterior.names.index(error.parameter)
             for error in law.layout.errors.fields]  # fmt: skip
    for stack, whitening, w in zip(law.layout.stacks, law.whitenings, white, strict=True):
        at = (slice(None), stack.rows, stack.columns)
        moved = {i: np.eye(stack.rows.shape[1]) * (2.0 * law.scale[at] * spread[(*at, i)])[..., None]
                 for i in range(d) if spread[(*at, i)].any()}  # fmt: skip
        for i in range(d):
            if stack.tied and bends[(*at, i)].any():
                half = stack.tie(law.effects[..., :1], bends[..., i, None])
                moved[i] = moved.get(i, 0.0) + half + half.swapaxes(-1, -2)
        for which, column in enumerate(named):
            by_size = stack.by_size(which, law.sizes)
            if column is not None and by_size is not None:
                moved[column] = moved.get(column, 0.0) + by_size
        whitened = {i: whitening.matrix @ part @ whitening.matrix.swapaxes(-1, -2) for i, part in moved.items()}
        for i, first in whitened.items():
            square = np.einsum("nbq,nbqr,nbr->n", w, first, w)
            gradient[:, i] += 0.5 * (square - np.einsum("nbqq->n", first))
            for j, second in whitened.items():
                total[:, i, j] += 0.5 * (first * second).sum(axis=(1, 2, 3))
    return gradient, total


def _root(information: FloatArray) -> FloatArray:
    """Rows R (n, d, d) with RᵀR the information, which may be singular."""
    values, vectors = np.linalg.eigh(information)
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[..., None] * vectors.swapaxes(-1, -2))


def load_information(ends: tuple[float, float]) -> float:
    """Information of the flat prior of a load between ``ends``: its inverse variance, 12 / range², 1/N²."""
    return 12.0 / (ends[1] - ends[0]) ** 2


def without_load(by_x: FloatArray, by_load: FloatArray, prior: float) -> FloatArray:
    """Take an unknown load out of the rows ``by_x`` (n, m, k, d), ``by_load`` (n, m, k) their slopes by it.

    With g = ``by_load`` of a row, A the result and ``prior`` the prior's information about the load, AᵀA is
    the Schur complement: A = (I − γ g gᵀ) ``by_x`` with (I − γ g gᵀ)² = I − g gᵀ / (gᵀg + ``prior``).
    """
    size = (by_load**2).sum(axis=2)
    kept = np.sqrt(np.divide(prior, size + prior, out=np.ones_like(size), where=size + prior != 0))
    gain = np.divide(1.0 - kept, size, out=np.zeros_like(size), where=size != 0)
    along = np.einsum("nmk,nmkd->nmd", by_load, by_x)
    return np.asarray(by_x - (gain[..., None] * by_load)[..., None] * along[:, :, None])


def _spread_slopes(posterior: Posterior, local: Sensitivities) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the noise's scale by the parameters (n, m, k, d) and by a latent load (n, m, k)."""
    by_x, by_load = np.zeros_like(local.by_parameter), np.zeros_like(local.by_load)
    for i, noise in enumerate(posterior.likelihood.noise):
        own = has_own_sd(posterior.likelihood, noise)
        if noise.fraction is not None:
            # derivative of max(fraction |μ|, floor) by μ
            predicted, fraction = local.values[:, :, i], float(noise.fraction)
            above = (fraction * np.abs(predicted) > noise.floor) & ~own
            rate = np.where(above, fraction * np.sign(predicted), 0.0)
            by_x[:, :, i] = rate[..., None] * local.by_parameter[:, :, i]
            by_load[:, :, i] = rate * local.by_load[:, :, i]
        elif noise.parameter is not None:
            by_x[:, :, i, posterior.names.index(noise.parameter)] = np.where(own, 0.0, 1.0)
    return by_x, by_load
