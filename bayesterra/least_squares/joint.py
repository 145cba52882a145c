"""joint: every measured outcome at once, weighted by its noise.

The mode of a posterior under a flat prior minimises the same sum of squares, so that IM1 against joint shows
the method, joint against the posterior the uncertainty. Laws of the prior enter as bounds only.

θm/θ1 = c1 + c2 s must stay inside (c3, 1) at every slip, which is a slanted edge in c1 and c2. In the
ratios at the lowest and the highest slip it is a plain bound.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError, SupportError
from bayesterra.least_squares.results import error_figure
from bayesterra.least_squares.settings import Settings
from bayesterra.least_squares.solver import Box, ClippedModel, Minimum, clip, excess_jacobian, minimise, of_the_paper
from bayesterra.likelihood.nodes import Squares
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior
from bayesterra.models.decoupled import MARGIN, leaving
from bayesterra.parameters import SOIL_PARAMETERS, columns_of

STARTS = 8
"""Starts drawn from the cut prior, beside those that the caller has."""

ROUNDS = 3
"""Rounds in which the weights of channels with estimated noise follow the residuals."""

PENALTY = 1e4
"""Residual per unit of θm/θ1 or N outside the model's range, and per width of a parameter outside its own."""

COARSE, COARSE_EVALUATIONS = 1e-10, 300
"""Tolerance and evaluations of the search from each start; the best is refined."""

SAME_COST = 0.01
"""Starts within this much of the best half sum of squares count as having reached it."""


@dataclass(frozen=True)
class WeightedMisfit:
    """Residuals of all readings in standard deviations, and penalties that lead back into the model's range.

    Parameters
    ----------
    model : the model at the rows.
    columns : which outcomes were measured, among those of the drive.
    measured, sd : readings and standard deviations (m, channels); readings are NaN where not measured.
    lower, upper : (k,) ranges of the parameters.
    squares : of every channel, where the rows of ``model`` are nodes that tell those of the readings.
    """

    model: ClippedModel
    columns: tuple[int, ...]
    measured: FloatArray
    sd: FloatArray
    lower: FloatArray
    upper: FloatArray
    squares: tuple[Squares, ...] = ()

    def told(self) -> "WeightedMisfit":
        """The misfit of many rows by few residuals, as near as nodes tell the model there; else itself."""
        nodes = self.model.forward.nodes
        if nodes is None:
            return self
        few = replace(self.model.forward, conditions=nodes.conditions, given=nodes.load, as_read=False)
        channels = zip(self.measured.T, self.sd.T, strict=True)
        sums = tuple(Squares.of(readings, sd, nodes.spread) for readings, sd in channels)
        return replace(self, model=ClippedModel(few), squares=sums)

    @property
    def _slip(self) -> FloatArray:
        return self.model.forward.conditions.slip

    def predicted(self, theta: FloatArray) -> FloatArray:
        """Modelled readings (m, channels)."""
        return self.model.values(theta)[:, self.columns]

    def values(self, theta: FloatArray) -> FloatArray:
        """Residuals of the readings, then 2 m + k penalties; NaN where no sinkage carries a load."""
        clipped, predicted = clip(theta, self._slip, names=self.model.forward.model.parameters), self.predicted(theta)
        if self.squares:
            misfit = np.concatenate([sums.residuals(v) for sums, v in zip(self.squares, predicted.T, strict=True)])
        else:
            misfit = ((predicted - self.measured) / self.sd)[~np.isnan(self.measured)]
        penalties = np.concatenate([clipped.angle, clipped.exponent, self._outside(theta) / self._size])
        return np.concatenate([misfit, PENALTY * penalties])

    def _outside(self, theta: FloatArray) -> FloatArray:
        return theta - np.clip(theta, self.lower, self.upper)

    @property
    def _size(self) -> FloatArray:
        width = self.upper - self.lower
        return np.where(np.isfinite(width) & (width > 0), width, 1.0)

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """Derivatives of :meth:`values` by the parameters."""
        clipped = clip(theta, self._slip, names=self.model.forward.model.parameters)
        slopes = self.model.jacobian(theta)[:, self.columns]
        if self.squares:
            misfit = np.concatenate([sums.slopes(slopes[:, i]) for i, sums in enumerate(self.squares)])
        else:
            misfit = (slopes / self.sd[..., None])[~np.isnan(self.measured)]
        outside = np.diag((self._outside(theta) != 0) / self._size)
        return np.concatenate([misfit, PENALTY * excess_jacobian(clipped, self._slip), PENALTY * outside])


@dataclass(frozen=True)
class JointFit:
    """Outcome of :func:`fit_joint`."""

    best: Minimum  # parameters and cost after the last round
    path: tuple[FloatArray, ...]  # parameters (k,) after each round of weights
    sd: Mapping[str, float]  # typical standard deviation of each channel behind the last weights, SI
    errors: Mapping[str, float]  # error figure (16) of each channel, percent
    reached: int  # how many starts ended at the best cost
    started: int  # of how many


def fit_joint(posterior: Posterior, settings: Settings, starts: list[FloatArray]) -> JointFit:
    """Minimise the weighted misfit from ``starts`` (k,), the prior's median and draws from the cut one.

    Estimated noise weighs at the median of its prior law first; then, ``ROUNDS`` times, at the root mean
    square residual of its channel (with the parameters fitted counted off), kept inside its law's range.
    Noise that is a fraction is taken of the measured value, so that weights do not move with the fit.

    Raises
    ------
    StudyError : fewer readings than free parameters.
    SupportError : no start has an answer.
    """
    columns, likelihood = settings.free(settings.names), posterior.likelihood
    count = int(np.sum(~np.isnan(likelihood.measured)))
    if count < len(columns):
        raise StudyError(f"too few observations for joint: {count} readings, {len(columns)} parameters")
    box = ratio_box(settings, columns, likelihood.forward.conditions.slip)
    medians = {noise.channel: noise.law.median for noise in likelihood.noise if noise.law}
    misfit = _misfit(posterior, settings, medians)
    begun = [*starts, settings.start, *_drawn(posterior, settings)]
    inside = [box.parameters(box.coordinates(start)) for start in begun]
    feasible = [start for start in inside if np.isfinite(misfit.values(start)).all()]
    if not feasible:
        raise SupportError("joint: the model has no answer for the conditions of the data at any start value")
    search = misfit.told()
    minima = [minimise(search, start, box, tolerance=COARSE, evaluations=COARSE_EVALUATIONS) for start in feasible]
    best = _refined(misfit, min(minima, key=attrgetter("cost")), box)
    reached = sum(minimum.cost <= best.cost + SAME_COST for minimum in minima)
    path = [best.theta]
    for _ in range(ROUNDS if any(noise.law for noise in likelihood.noise) else 0):
        misfit = _misfit(posterior, settings, _residual_sd(posterior, misfit, best.theta, len(columns)))
        best = _refined(misfit, best, box)
        path.append(best.theta)
    predicted, channels = misfit.predicted(best.theta), likelihood.channels
    sd = {name: float(np.median(misfit.sd[:, i])) for i, name in enumerate(channels)}
    errors = {name: error_figure(misfit.measured[:, i], predicted[:, i]) for i, name in enumerate(channels)}
    return JointFit(best, tuple(path), sd, errors, reached, len(minima))


def _refined(misfit: WeightedMisfit, rough: Minimum, box: Box) -> Minimum:
    """The minimum to full precision; what a penalty lets past a range, some 1e-9 of its width, is cut off."""
    best = minimise(misfit, rough.theta, box)
    return replace(best, theta=np.clip(best.theta, misfit.lower, misfit.upper))


def _misfit(posterior: Posterior, settings: Settings, estimated: Mapping[str, float]) -> WeightedMisfit:
    likelihood = posterior.likelihood
    outcomes = likelihood.forward.outcomes
    columns = tuple(outcomes.index(channel) for channel in likelihood.channels)
    none = np.full(len(likelihood.measured), np.nan)
    sd = np.empty(likelihood.measured.shape)
    for i, noise in enumerate(likelihood.noise):
        value = np.array([estimated[noise.channel]]) if noise.law else None
        stated_sd = likelihood.observations.given_sd.get(noise.channel, none)
        sd[:, i] = noise.scale(likelihood.measured[None, :, i], value, stated_sd)[0]
    held = np.isin(settings.names, settings.held)  # they cannot move: no range
    lower, upper = np.where(held, -np.inf, settings.lower), np.where(held, np.inf, settings.upper)
    return WeightedMisfit(ClippedModel(likelihood.forward), columns, likelihood.measured, sd, lower, upper)


def _residual_sd(posterior: Posterior, misfit: WeightedMisfit, theta: FloatArray, free: int) -> dict[str, float]:
    """Root mean square residual of the channels with estimated noise, inside the ranges of their laws."""
    residual = misfit.measured - misfit.predicted(theta)
    count = int(np.sum(~np.isnan(misfit.measured)))
    inflation = count / max(count - free, 1)
    spread = np.sqrt(inflation * np.nanmean(residual**2, axis=0))
    return {
        noise.channel: float(np.clip(value, *noise.law.range))
        for noise, value in zip(posterior.likelihood.noise, spread, strict=True)
        if noise.law
    }


def _drawn(posterior: Posterior, settings: Settings) -> list[FloatArray]:
    """Starts from the cut prior, the same every time, with the held parameters in place."""
    try:
        drawn = draw_cut_prior(posterior, STARTS, np.random.default_rng(0), batch=256).x
    except SupportError:
        return []  # held parameters may still leave an answer at the other starts
    columns = columns_of(settings.names)
    soil = posterior.prior.soil_values(drawn)[:, columns]
    held = [settings.names.index(name) for name in settings.held]
    soil[:, held] = settings.start[held]
    return list(soil)


_C1, _C2 = (SOIL_PARAMETERS.index(name) for name in ("c1", "c2"))


def ratio_box(settings: Settings, columns: list[int], slip: FloatArray) -> Box:
    """Box in which θm/θ1 at the lowest and at the highest slip stand for c1 and c2, where both are free."""
    if not of_the_paper(settings.names):
        return Box(settings.lower, settings.upper, columns)
    if not {_C1, _C2}.issubset(columns) or np.ptp(slip) < 1e-6:
        return _narrowed(settings, columns, slip)
    angles = [_C1, _C2]
    lower, upper, basis = settings.lower.copy(), settings.upper.copy(), np.eye(len(settings.lower))
    ends = np.array([slip.min(), slip.max()])
    lower[angles], upper[angles] = leaving(settings.lower, ends) + MARGIN, 1 - MARGIN
    basis[np.ix_(angles, angles)] = np.linalg.inv([[1.0, ends[0]], [1.0, ends[1]]])
    return Box(lower, upper, columns, basis)


def _narrowed(settings: Settings, columns: list[int], slip: FloatArray) -> Box:
    """Box of the parameters themselves; c1 free alone is bounded by the limits at the held c2 as well."""
    lower, upper = settings.lower.copy(), settings.upper.copy()
    if _C1 in columns and _C2 not in columns:
        growth = settings.start[_C2] * slip
        lower[_C1] = max(lower[_C1], float(np.max(leaving(settings.lower, slip) + MARGIN - growth)))
        upper[_C1] = min(upper[_C1], 1 - MARGIN - growth.max())
    if not lower[_C1] < upper[_C1]:
        return Box(settings.lower, settings.upper, columns)
    return Box(lower, upper, columns)
