"""``fit``: a study in, one :class:`Fit` per method out."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from time import perf_counter

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError, SupportError, check_kind
from bayesterra.least_squares import settings as setup
from bayesterra.least_squares.groupwise import Passes, Plan, decoupled_steps, integral_steps, iterate, one_pass, plan
from bayesterra.least_squares.joint import JointFit, fit_joint
from bayesterra.least_squares.results import FORCES, METHODS, SOLVERS, Fit
from bayesterra.least_squares.solver import Clip, clip
from bayesterra.likelihood.forward import Forward
from bayesterra.models import M1
from bayesterra.models.decoupled import MARGIN
from bayesterra.parameters import CHANNELS, OFFSET, OUTCOMES, PARAMETERS, SOIL_PARAMETERS
from bayesterra.study.study import Study, without_wheels


def fit(
    study: Study,
    methods: Sequence[str] | None = None,
    *,
    hold: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
    lower: Mapping[str, float] | None = None,
    upper: Mapping[str, float] | None = None,
    delta: float | None = None,
    solvers: Sequence[str] | None = None,
    known: Mapping[str, Fit] | None = None,
) -> dict[str, Fit]:
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


def _joint_notes(joint_fit: JointFit, drive: Forward, theta: FloatArray) -> tuple[str, ...]:
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
