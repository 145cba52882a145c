"""The draws of a result pushed through a rover."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError
from bayesterra.predicting import measured_loads, prior_phi, resolved, spread, wheel_remarks
from bayesterra.prediction import quantiles
from bayesterra.results import Result
from bayesterra.rover.climbing import Sweep, greatest, states_at, sweep
from bayesterra.rover.equilibrium import SoftGround, State
from bayesterra.rover.geometry import EARTH, Rover, read_rover
from bayesterra.rover.outlook import DEGREE, RoverOutlook
from bayesterra.study import Study
from bayesterra.units import quantity

SLOPES = (0.0, 5 * DEGREE, 10 * DEGREE, 15 * DEGREE)
"""Slopes, rad, that are asked for by default."""
DRAWS = 1000
"""Posterior draws, at most, that a rover drives on."""
STEEPEST = 45 * DEGREE
CURVE = 21
"""Slopes, or tow forces, of a smooth curve."""


def drive_rover(
    result: Result,
    rover: Rover,
    slopes: Sequence[float | str] = SLOPES,
    tows: Sequence[float | str] = (0.0,),
) -> RoverOutlook:
    """Drive a rover up slopes and against tow forces on the soil of every posterior draw.

    Parameters
    ----------
    slopes : rad, or text with a unit, from 0 to 45 degrees.
    tows : N, or text with a unit.

    Raises
    ------
    StudyError : a slope or tow force outside these ranges.
    """
    study = result.study
    if study.errors.discrepancy:
        raise StudyError(
            "a rover is driven by the model alone: leave [discrepancy] out, or predict wheels one by one"
        )
    front, rear = (resolved(wheel, prior_phi(study)) for wheel in rover.wheels)
    rover = replace(rover, wheels=(front, rear))
    alphas, pulls = checked_slopes(slopes), checked_tows(tows)
    draws, index = spread(result, DRAWS)
    ground = SoftGround(study.model, rover, study.prior.soil_values(draws))
    found = {tow: sweep(rover, ground, len(draws), "slope", tow) for tow in dict.fromkeys((0.0, *pulls))}
    pulled = sweep(rover, ground, len(draws), "tow")
    asked = _joined([states_at(rover, ground, found[tow], alphas) for tow in pulls])
    rows = study.observations.used().slip
    driven = (float(rows.min()), float(rows.max()))
    return RoverOutlook(
        title=study.title,
        model=study.model.name,
        rover=rover,
        asked=asked,
        over_slope=states_at(rover, ground, found[pulls[0]], _curve(alphas.max(), SLOPES[-1])),
        over_tow=_over_tow(rover, ground, float(alphas[0]), pulls, pulled),
        slopes=greatest(rover, ground, found[0.0]),
        slopes_driven=greatest(rover, ground, found[0.0], driven[1]),
        tows=greatest(rover, ground, pulled),
        tows_driven=greatest(rover, ground, pulled, driven[1]),
        index=index,
        driven=driven,
        remarks=tuple(_remarks(study, rover, asked)),
    )


def rover_for(study: Study, rover: Rover | str | Path) -> Rover:
    """A rover, or the one that a file describes, with the wheels of a study."""
    return rover if isinstance(rover, Rover) else read_rover(Path(rover), study.wheels, prior_phi(study))


def checked_slopes(slopes: Sequence[float | str]) -> FloatArray:
    """Slopes, rad, in ascending order, each once."""
    values = np.unique([quantity(slope, "rad", "slope", bare=True) for slope in slopes])
    wrong = values[(values < 0) | (values > STEEPEST * (1 + 1e-12))]
    if wrong.size or not values.size:
        got = f"{wrong[0] / DEGREE:.4g} deg" if wrong.size else "none"
        raise StudyError(f"'slope' must lie between 0 and 45 deg (got {got})")
    return values


def checked_tows(tows: Sequence[float | str]) -> FloatArray:
    """Tow forces, N, in ascending order, each once."""
    values = np.unique([quantity(tow, "N", "tow", bare=True) for tow in tows])
    if not values.size or values[0] < 0:
        raise StudyError(f"'tow' must not be below 0 N (got {f'{values[0]:g} N' if values.size else 'none'})")
    return values


def _curve(last: float, least: float) -> FloatArray:
    return np.linspace(0.0, max(last, least), CURVE)


def _over_tow(rover: Rover, ground: SoftGround, slope: float, tows: FloatArray, flat: Sweep) -> State | None:
    if tows[-1] == 0:
        return None
    found = flat if slope == 0 else sweep(rover, ground, len(flat.held), "tow", slope)
    return states_at(rover, ground, found, np.linspace(0.0, tows[-1], CURVE))


def _joined(states: Sequence[State]) -> State:
    """States (n, k) side by side."""
    names = [field.name for field in fields(State)]
    return State(**{name: np.concatenate([getattr(one, name) for one in states], axis=1) for name in names})


def _remarks(study: Study, rover: Rover, asked: State) -> Iterator[str]:
    """Say where loads, wheels and gravity leave what was measured."""
    middles = [quantiles(asked.load[:, i, axle])[2] for i in range(asked.load.shape[1]) for axle in (0, 1)]
    known, loads = measured_loads(study), np.array(middles)[np.isfinite(middles)]
    if known and loads.size and not (0.999 * known[0] <= loads.min() and loads.max() <= 1.001 * known[1]):
        named = " to ".join(dict.fromkeys(f"{end:.4g}" for end in known))
        yield (
            f"wheel loads of {loads.min():.3g} to {loads.max():.3g} N leave the measured loads, {named} N:"
            " extrapolated"
        )
    for wheel in dict.fromkeys(rover.wheels):
        yield from wheel_remarks(study, wheel)
    if rover.gravity is not None and abs(rover.gravity - EARTH) > 0.1:
        yield (
            f"the rover weighs {rover.weight:.4g} N under {rover.gravity:.3g} m/s²; the soil's parameters are"
            " taken unchanged from where they were measured"
        )
