"""What a result says about wheels, loads and slips that were not measured."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import ArrayLike

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.derived import derive_for, reference_load, tractive_efficiency
from bayesterra.errors import StudyError
from bayesterra.forward import Forward, Outcomes, offset_of
from bayesterra.laws import Law
from bayesterra.likelihood import Likelihood
from bayesterra.messages import did_you_mean
from bayesterra.models import Conditions, Wheel
from bayesterra.posteriors import posterior
from bayesterra.prediction import PREDICTED, Prediction
from bayesterra.results import Result
from bayesterra.study import Study
from bayesterra.units import quantity
from bayesterra.wheelfiles import read_wheel

DRAWS = 2000
"""Posterior draws, at most, that are predicted with."""
GRID = 61


def predict(
    result: Result,
    slip: ArrayLike,
    *,
    load: float | str | None = None,
    wheel: str | Wheel | None = None,
    name: str = "",
    seed: int = 1,
) -> Prediction:
    """Predict sinkage, drawbar pull, moment and tractive efficiency with the draws of a result.

    Parameters
    ----------
    slip : slips on the shearing radius, in [0, 1); sorted, each once.
    load : vertical load, N or text with a unit; by default the median load of the study's rows in the fit.
    wheel : name of one of the study's wheels (by default its first), or another wheel.
    name : what another wheel is called.
    seed : of the noise on the readings.

    Raises
    ------
    StudyError : a slip or load outside the model's range, or an unknown wheel.
    """
    study = result.study
    at, carried = checked_slips(slip), _load(study, load)
    called, driven = chosen_wheel(study, wheel, name)
    draws, index = spread(result)
    forward = Forward(study.model, "load", Conditions.of(driven, at), np.full(len(at), carried))
    soil = study.prior.soil_values(draws)
    parts = [forward.row(i)(soil) for i in range(len(at))]
    rng = default_rng(seed)
    outcomes = np.concatenate([part.values for part in parts], axis=1)
    outcomes = outcomes + _discrepancy(study, forward, driven, draws, rng)
    rows = study.observations.used().slip
    return Prediction(
        title=study.title,
        name=called,
        wheel=driven,
        load=carried,
        slip=at,
        modelled=_with_efficiency(outcomes, forward.conditions),
        readings=_with_noise(study, forward, outcomes, draws, rng),
        reasons=np.column_stack([part.status for part in parts]),
        index=index,
        driven=(float(rows.min()), float(rows.max())),
        derived=_derived(study, driven, carried, draws),
        derived_prior=_derived(study, driven, carried, result.values("prior")[:DRAWS]),
        remarks=tuple(_remarks(study, driven, carried)),
    )


def driven_range(study: Study) -> FloatArray:
    """Slips for smooth bands, from the lowest to the highest that was driven."""
    slips = study.observations.used().slip
    return np.linspace(slips.min(), slips.max(), GRID)


def spread(result: Result, most: int = DRAWS) -> tuple[FloatArray, IntArray]:
    """At most ``most`` evenly spaced posterior draws (n, d), and chain and draw of each (n, 2)."""
    draws = result.values()
    take = np.arange(0, len(draws), max(1, -(-len(draws) // most)))
    chain, draw = np.divmod(take, result.draws["posterior"].sizes["draw"])
    return draws[take], np.column_stack([chain, draw])


def checked_slips(slip: ArrayLike) -> FloatArray:
    """Slips in ascending order, each once; StudyError where one lies outside [0, 1)."""
    if np.asarray(slip).dtype.kind not in "iuf":
        raise StudyError(f"'slip' must be a number or numbers (got {slip!r:.60})")
    slips = np.unique(np.atleast_1d(np.asarray(slip, dtype=np.float64)))
    wrong = slips[~((slips >= 0) & (slips < 1))]
    if wrong.size or not slips.size:
        raise StudyError(f"'slip' must lie in [0, 1) (got {f'{wrong[0]:g}' if wrong.size else 'none'})")
    return slips


def _load(study: Study, load: float | str | None) -> float:
    value = reference_load(study) if load is None else quantity(load, "N", "load", bare=True)
    if np.isnan(value):
        raise StudyError("'load' must be given, as the study holds neither load nor normal force")
    if value <= 0:
        raise StudyError(f"'load' must be above 0 (got {value:g} N)")
    return value


def chosen_wheel(study: Study, wheel: str | Wheel | None, name: str = "") -> tuple[str, Wheel]:
    """Name and dimensions of a wheel of the study, by default its first, or of another one.

    A shearing-radius coefficient that is left out comes from (2) at the median of the prior of φ, as in the
    study.
    """
    if isinstance(wheel, Wheel):
        return name or "other wheel", resolved(wheel, prior_phi(study))
    called = next(iter(study.wheels)) if wheel is None else wheel
    if called not in study.wheels:
        raise StudyError(f"unknown wheel '{called}'{did_you_mean(called, study.wheels)}")
    return called, study.wheels[called]


def prior_phi(study: Study) -> float:
    """The friction angle, rad, at which (2) gives a wheel's shearing radius: the median of its prior."""
    phi = study.prior.entries[study.prior.root("phi")]
    return phi.median if isinstance(phi, Law) else study.prior.fixed["phi"]


def wheel_named(study: Study, given: str | None) -> tuple[str, Wheel]:
    """A wheel of the study by its name, by default its first, or another one from a file.

    Raises
    ------
    StudyError : neither.
    """
    wheels = study.wheels
    if given is None or given in wheels:
        return chosen_wheel(study, given)
    if not given.endswith(".toml") and not Path(given).is_file():
        raise StudyError(f"'{given}' is neither a wheel of the study nor a file{did_you_mean(given, wheels)}")
    name, wheel = read_wheel(Path(given))
    return chosen_wheel(study, wheel, name)


def resolved(wheel: Wheel, phi: float) -> Wheel:
    """The same wheel with its shearing-radius coefficient, by (2) at ``phi`` (rad) where none is given."""
    if wheel.lug_height == 0 or wheel.shearing_radius_coefficient is not None:
        return wheel
    try:
        radius = float(wheel.shearing_radius(phi))
    except ValueError as error:
        raise StudyError(f"the other wheel's {error}") from error
    return replace(wheel, shearing_radius_coefficient=(radius - wheel.radius) / wheel.lug_height)


def _with_efficiency(outcomes: FloatArray, conditions: Conditions) -> FloatArray:
    efficiency = tractive_efficiency(outcomes[:, :, 1], outcomes[:, :, 2], conditions)
    return np.concatenate([outcomes, efficiency[:, :, None]], axis=2)


def _discrepancy(
    study: Study, forward: Forward, driven: Wheel, draws: FloatArray, rng: Generator
) -> FloatArray:
    """The model's own error (n, k, 3): as the readings of the same wheel tell it, else as stated before."""
    slip, found = forward.conditions.slip, np.zeros((len(draws), len(forward.conditions.slip), 3))
    if not study.errors.discrepancy:
        return found
    target = posterior(study)
    name = next((name for name, wheel in study.wheels.items() if wheel == driven), None)
    values = target.noise_values(draws)
    curve = target.likelihood.beyond(study.prior.soil_values(draws), values, name, slip, rng)
    for column, channel in enumerate(target.likelihood.channels):
        if channel in forward.outcomes:
            found[:, :, forward.outcomes.index(channel)] = curve[:, :, column]
    return found


def _with_noise(
    study: Study, forward: Forward, outcomes: FloatArray, draws: FloatArray, rng: Generator
) -> FloatArray:
    """Readings (n, k, 4) of the study's instruments, with the zero error of the sinkage.

    NaN where a channel was not measured.
    """
    noise = tuple(noise for name, noise in study.noise.items() if name in forward.outcomes)
    readings = np.full((*outcomes.shape[:2], len(PREDICTED)), np.nan)
    if not noise:
        return readings
    blank = replace(study.observations.used(), given_sd={}, values={}, rows=tuple(range(outcomes.shape[1])))
    read = Outcomes(outcomes.copy(), np.zeros(len(outcomes), dtype=np.int64))
    read.values[:, :, 0] += offset_of(study.prior.soil_values(draws))
    columns = [study.prior.names.index(entry.parameter) for entry in noise if entry.parameter]
    drawn = Likelihood(forward, blank, noise).draw(read, draws[:, columns], rng)
    fresh = _fresh(study, forward, draws, rng)
    for column, entry in enumerate(noise):
        more = fresh[:, :, forward.outcomes.index(entry.channel)]
        readings[:, :, list(PREDICTED).index(entry.channel)] = drawn[:, :, column] + more
    return readings


def _fresh(study: Study, forward: Forward, draws: FloatArray, rng: Generator) -> FloatArray:
    """Ripple and effect of slip errors (n, k, 3) of readings of another sweep."""
    found = np.zeros((len(draws), len(forward.conditions.slip), 3))
    if study.errors:
        target = posterior(study)
        channels = tuple(name for name in target.likelihood.channels if name in forward.outcomes)
        values, soil = target.noise_values(draws), study.prior.soil_values(draws)
        drawn = target.likelihood.fresh(forward, soil, values, rng)
        for channel in channels:
            column = target.likelihood.channels.index(channel)
            found[:, :, forward.outcomes.index(channel)] = drawn[:, :, column]
    return found


def _derived(study: Study, wheel: Wheel, load: float, x: FloatArray) -> dict[str, FloatArray]:
    return derive_for(study.model, wheel, load, study.prior.soil_values(x))


def _remarks(study: Study, wheel: Wheel, load: float) -> Iterator[str]:
    """Say where load and wheel leave what was measured."""
    ends = measured_loads(study)
    if ends and not 0.999 * ends[0] <= load <= 1.001 * ends[1]:
        named = " to ".join(dict.fromkeys(f"{end:.4g}" for end in ends))
        yield f"load {load:.4g} N is not among the measured loads, {named} N: extrapolated"
    if study.errors.discrepancy:
        known = (
            "as its readings tell it" if wheel in study.wheels.values() else "as stated before any reading"
        )
        yield (
            f"the model's own error is part of it, {known}; derived quantities are those of the model alone"
        )
    yield from wheel_remarks(study, wheel)


def measured_loads(study: Study) -> tuple[float, ...]:
    """Lowest and highest load (N) among the rows in the fit; nothing where none was measured."""
    rows = study.observations.used()
    loads = rows.load if not np.isnan(rows.load).all() else rows.values.get("normal_force", rows.load)
    known = loads[~np.isnan(loads)]
    return (float(known.min()), float(known.max())) if known.size else ()


def wheel_remarks(study: Study, wheel: Wheel) -> Iterator[str]:
    """Say where a wheel leaves those that were measured."""
    if wheel not in study.wheels.values():
        yield (
            f"the wheel was not driven ({', '.join(study.wheels)} was): parameters that one wheel finds in a"
            " soil need not hold for another, least of all when only one of them has lugs"
        )
    widths = {one.width for one in study.wheels.values()}
    if wheel.width not in widths and not study.prior.uses_moduli:
        given = ", ".join(f"{1e3 * width:g} mm" for width in sorted(widths))
        yield (
            f"K_s = k_c/b + k_φ was identified with wheels {given} wide and taken unchanged for"
            f" {1e3 * wheel.width:g} mm: small where k_c is, as in dry soils"
        )
