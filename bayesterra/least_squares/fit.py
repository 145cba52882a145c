"""``fit``: a study in, one :class:`Fit` per method out.

joint takes every measured outcome at once, weighted by its noise. The mode of a posterior under a flat prior
minimises the same sum of squares, so that IM1 against joint shows the method, joint against the posterior the
uncertainty. Laws of the prior enter as bounds only. θm/θ1 = c1 + c2 s must stay inside (c3, 1) at every slip, which
is a slanted edge in c1 and c2; in the ratios at the lowest and the highest slip it is a plain bound.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from operator import attrgetter
from time import perf_counter

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError, SupportError, check_kind
from bayesterra.least_squares import settings as setup
from bayesterra.least_squares.groupwise import Passes, Plan, decoupled_steps, integral_steps, iterate, one_pass, plan
from bayesterra.least_squares.results import FORCES, METHODS, SOLVERS, Fit, error_figure
from bayesterra.least_squares.settings import Settings
from bayesterra.least_squares.solver import (
    Box,
    Clip,
    ClippedModel,
    Minimum,
    clip,
    excess_jacobian,
    minimise,
    of_the_paper,
)
from bayesterra.likelihood.forward import Forward, Squares
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior
from bayesterra.models import M1
from bayesterra.models.decoupled import MARGIN, leaving
from bayesterra.parameters import CHANNELS, OFFSET, OUTCOMES, PARAMETERS, SOIL_PARAMETERS, columns_of
from bayesterra.study.study import Study, without_wheels


def fit(
    study: Study, methods: Sequence[str] | None = None, *, hold: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None, lower: Mapping[str, float] | None = None,
    upper: Mapping[str, float] | None = None, delta: float | None = None, solvers: Sequence[str] | None = None,
    known: Mapping[str, Fit] | None = None,
) -> dict[str, Fit]:  # fmt: skip
    """Identify the soil by least squares.

    Parameters
    ----------
    study : measurements, model, priors and noise. IM1, IM2 and IM3 take the measured sinkage as given and run
        on M1, M2 and M3 with the options of the study's model; joint uses its own model and drive.
    methods : any of ``IM1``, ``IM2``, ``IM3``, ``joint``; None: those that the study names, by default all.
    hold : parameters held at a value; those that the priors fix are held anyway. An empty mapping frees what
        the study holds.
    start, lower, upper : start values and bounds of IM1, IM2 and IM3 in place of Table 17's. joint is bounded
        by the priors' ranges, and takes ``start`` as one of its starts.
    delta : IM1 stops when c1 and c2 change by less.
    solvers : of IM1, IM2 and IM3: ``converged``, ``lsqcurvefit`` (an emulation of the paper's, to be compared
        with) or both; joint always converges. Where both are asked for, a fit by the latter is named after
        both, as in ``IM1 lsqcurvefit``.
    known : fits of the same study with the same settings, by name, which joint starts from.

    ``hold`` to ``delta`` are SI and radians, and replace the table of that name in the study where given.

    Raises
    ------
    StudyError : an unknown method or parameter, fewer readings than parameters, or nothing to be fitted.
    SupportError : joint finds no start value for which the model has an answer.
    """
    check_kind("bt.fit", study, Study)
    without_wheels(study, "fit")
    study = study.with_rows(study.observations.numbers())  # a limit has no residual
    overrides = setup.Overrides(hold, start, lower, upper, delta)
    methods = _known_methods(study) if methods is None else methods
    solvers = study.least_squares.solvers if solvers is None else solvers
    if not methods:
        raise StudyError(f"nothing can be fitted: with the model {study.model.name} only joint fits")
    unknown = [method for method in methods if method not in METHODS]
    if unknown:
        raise StudyError(f"'methods' must be among {', '.join(METHODS)} (got {unknown[0]!r})")
    if not solvers or not set(solvers) <= set(SOLVERS):
        raise StudyError(f"'solvers' must be among {', '.join(SOLVERS)} (got {', '.join(solvers) or 'none'})")
    fits: dict[str, Fit] = {}
    for method in sorted(methods, key=METHODS.index):
        if method == "joint":
            fits[method] = _fit_joint(method, study, overrides, {**(known or {}), **fits})
            continue
        for solver in solvers:
            found = _fit_groups(method, study, replace(overrides, solver=solver))
            fits[found.name if len(solvers) > 1 else method] = found
    if fits and all(not result.path for result in fits.values()):
        reasons = dict.fromkeys(note for result in fits.values() for note in result.notes)
        raise StudyError(f"nothing can be fitted by {', '.join(fits)}: {'; '.join(reasons)}")
    return {name: fits[name] for method in methods for name in fits if fits[name].method == method}


def _known_methods(study: Study) -> tuple[str, ...]:
    """The methods that the study names, without those that do not know its model."""
    methods: tuple[str, ...] = study.least_squares.methods
    return tuple(method for method in methods if method == "joint" or not _of_its_own(study))


def _of_its_own(study: Study) -> bool:
    return study.model.parameters != SOIL_PARAMETERS


def fit_all(study: Study) -> tuple[dict[str, Fit], tuple[str, ...]]:
    """Every method that the study names and its data allow, and one line on each that they do not."""
    fits: dict[str, Fit] = {}
    refused = []
    for method in _known_methods(study):
        try:
            fits |= {found.name: found for found in fit(study, (method,), known=fits).values()}
        except (StudyError, SupportError) as error:
            refused.append(str(error))
    return fits, tuple(refused)


STARTS: Mapping[str, tuple[float, ...]] = {"c": (50.0, 200.0, 1e3, 3e3), "Ks": (5e5, 2.5e6, 8e6)}
"""Start values, SI, from which a fit is repeated to see what it owes to them."""


def fit_from_starts(study: Study) -> pd.DataFrame:
    """Where the study's first method of IM1, IM2 and IM3 ends from several starts of c and K_s, by each solver.

    Columns: method, parameter, start, own (the study's start), and the end by solver; field units. Empty where
    no such method is asked for or can run.
    """
    methods = [method for method in _known_methods(study) if method != "joint"][:1]
    settings = setup.iteration_settings(study, setup.Overrides())
    rows = []
    for name in (name for name in STARTS if methods and name not in settings.held):
        column, scale = SOIL_PARAMETERS.index(name), PARAMETERS[name].scale
        own = float(settings.start[column])
        inside = (value for value in STARTS[name] if settings.lower[column] < value < settings.upper[column])
        for value in sorted({own, *inside}):
            found = fit(study, methods, start={**study.least_squares.start, name: value}, solvers=SOLVERS)
            ends = {each.solver: each.values()[name] / scale for each in found.values()}
            rows.append({"method": methods[0], "parameter": name, "start": value / scale, "own": value == own, **ends})
    return pd.DataFrame(rows, columns=["method", "parameter", "start", "own", *SOLVERS])


def _fit_groups(method: str, study: Study, overrides: setup.Overrides) -> Fit:
    """IM1, IM2 or IM3."""
    if _of_its_own(study):
        what = "load effect" if study.model.name == "M2L" else "parameters but those of Ding et al. 2015"
        raise StudyError(f"{method} knows no {what}: with the model {study.model.name} only joint fits")
    began = perf_counter()
    settings, rows = setup.iteration_settings(study, overrides), setup.readings(study)
    model = M1(**{each.name: getattr(study.model, each.name) for each in fields(M1)})
    steps = integral_steps(rows, model) if method == "IM1" else decoupled_steps(method, rows, model)
    todo = plan(method, steps, settings)
    passes = _passes(method, todo, settings)
    theta = passes.path[-1] if passes.path else settings.start
    judged = {step.channel: step.error(theta) for step in todo.judged}
    return Fit(
        method=method, soil=settings.soil(theta), errors={name: judged.get(name, np.nan) for name in FORCES},
        converged=passes.converged, passes=len(passes.path),
        path=tuple(settings.soil(point) for point in passes.path), held=settings.held,
        at_bound=settings.at_bound(theta, todo.columns(settings)), missing=todo.missing,
        clipped=_clipped(method, theta, rows.conditions.slip),
        notes=(*_notes(method, todo, passes, rows, theta), *_offset_note(study)),
        seconds=perf_counter() - began, noise={}, solver=settings.solver, evaluations=passes.evaluations,
    )  # fmt: skip


def _passes(method: str, todo: Plan, settings: setup.Settings) -> Passes:
    if not todo.steps:  # all held, so that the values are only judged, or nothing measured to fit them to
        held = bool(todo.judged) and not todo.missing
        return Passes((settings.start,) if held else (), converged=held, rested=True)
    if method == "IM1":
        return iterate(todo, settings)
    return one_pass(todo, settings.start, settings, first=False)


def _fit_joint(method: str, study: Study, overrides: setup.Overrides, fits: Mapping[str, Fit]) -> Fit:
    began = perf_counter()
    settings, density = setup.joint_settings(study, overrides), setup.weighted_target(study)
    joint_fit = fit_joint(density, settings, _other_results(study, overrides, fits))
    theta = joint_fit.best.theta
    drive = density.likelihood.forward
    return Fit(
        method=method, soil=settings.soil(theta),
        errors={name: joint_fit.errors.get(name, np.nan) for name in OUTCOMES},
        converged=joint_fit.best.converged, passes=len(joint_fit.path),
        path=tuple(settings.soil(point) for point in joint_fit.path), held=settings.held,
        at_bound=settings.at_bound(theta, settings.free(settings.names)), missing=(),
        clipped=_edge(theta, drive).any, notes=(*_joint_notes(joint_fit, drive, theta), *_stand_ins(study)),
        seconds=perf_counter() - began, noise=joint_fit.sd,
    )  # fmt: skip


def _edge(theta: FloatArray, drive: Forward) -> Clip:
    """Rows at the edge of the model's range, where a search is stopped a margin inside."""
    return clip(theta, drive.conditions.slip, 2 * MARGIN, names=drive.model.parameters)


def _joint_notes(joint_fit: "JointFit", drive: Forward, theta: FloatArray) -> tuple[str, ...]:
    edge = _edge(theta, drive)
    return (
        f"{joint_fit.reached} of {joint_fit.started} starts ended at the best fit",
        *(f"no {CHANNELS[name].description}" for name in drive.outcomes if name not in joint_fit.errors),
        *(["θm/θ1 = c1 + c2 s is at the edge of (c3, 1) at some slip"] if np.any(edge.angle) else []),
        *(["N = n0 + n1 s is at its edge, 0, at some slip"] if np.any(edge.exponent) else []),
    )


def _stand_ins(study: Study) -> tuple[str, ...]:
    """Notes on the values of quantities that least squares does not estimate."""
    load = ("the measured normal force stands for the load",) if study.drive.latent_load else ()
    alone = ("IM1, IM2 and IM3 know no load effect",) if study.model.name == "M2L" else ()
    return (*load, *_offset_note(study), *alone)


def _offset_note(study: Study) -> tuple[str, ...]:
    offset = setup.known_offset(study)
    stated = OFFSET in study.prior.entries
    return (f"the sinkage offset stands at {1e3 * offset:.3g} mm",) if stated else ()


def _other_results(study: Study, overrides: setup.Overrides, fits: Mapping[str, Fit]) -> list[FloatArray]:
    """Results of IM1, IM2 and IM3 as starts, where the data allow them."""
    starts = []
    for method in ("IM1", "IM2", "IM3"):
        try:
            result = fits.get(method) or _fit_groups(method, study, overrides)
        except StudyError:
            continue  # the method needs more readings than joint
        starts.append(np.array([*result.values().values()]))
    return starts


def _clipped(method: str, theta: FloatArray, slip: FloatArray) -> bool:
    clipped = clip(theta, slip)
    return clipped.any if method == "IM1" else bool(np.any(clipped.angle))


def _notes(method: str, todo: Plan, passes: Passes, rows: setup.Readings, theta: FloatArray) -> tuple[str, ...]:
    notes = list(todo.notes)
    if rows.left_out:
        notes.append(f"{rows.left_out} row(s) without a sinkage between 0 and the radius are left out")
    if _clipped(method, theta, rows.conditions.slip):
        notes.append("θm/θ1 = c1 + c2 s leaves (c3, 1) at some slip and was clipped there")
    if passes.path and not passes.converged:
        restless = f"the parameters did not come to rest in {len(passes.path)} passes"
        notes.append("an inner fit did not reach a minimum" if passes.rested else restless)
    return tuple(notes)


DRAWN_STARTS = 8
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
        few = self.model.forward.held_at(nodes)
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
        drawn = draw_cut_prior(posterior, DRAWN_STARTS, np.random.default_rng(0), batch=256).x
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
