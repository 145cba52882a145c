"""Forecasts: predictions of wheels and loads from a result, as a folder."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError
from bayesterra.models import Wheel
from bayesterra.models.geometry import convert_slip
from bayesterra.prediction.prediction import Case, Forecast, predict
from bayesterra.study.result import Result
from bayesterra.study.wheels import checked_slips, chosen_wheel, driven_range


def slips_of(texts: Sequence[str]) -> list[float]:
    """Slips from texts such as ``0.1,0.3``.

    Raises
    ------
    StudyError : one is not a number.
    """
    slips = []
    for part in (part.strip() for text in texts for part in text.split(",")):
        try:
            slips.append(float(part))
        except ValueError:
            raise StudyError(f"'slip' must be numbers with commas, e.g. 0.1,0.3 (got {part!r})") from None
    return slips


def forecast(
    result: Result,
    *,
    slips: Sequence[float] = (),
    loads: Sequence[str] = (),
    wheels: Sequence[str] = (),
    slip_reference: str = "shearing",
    group: str | None = None,
) -> Forecast:
    """Predict every wheel under every load.

    Parameters
    ----------
    group : of a joint posterior, whose parameters count; by default as for :func:`predict`.
    slips : asked for; by default those that were driven.
    loads : texts with units; by default the median load of the study.
    wheels : names or files; by default the study's first wheel.
    slip_reference : radius behind ``slips``: ``rim`` r, ``tip`` r + h, ``shearing`` r_s.
    """
    cases: list[Case] = []
    for name, wheel in [chosen_wheel(result.study, text) for text in wheels or (None,)]:
        asked = _on_shearing_radius(slips, wheel, slip_reference)
        asked = asked if asked.size else np.unique(result.study.observations.used().slip)
        grid = _grid(result, asked)
        for load in loads or (None,):
            slip = np.union1d(grid, asked)
            whole = predict(result, slip, load=load, wheel=wheel, name=name, group=group)
            cases.append((whole.at(grid), whole.at(asked)))
    return Forecast(tuple(cases))


def _on_shearing_radius(slips: Sequence[float], wheel: Wheel, reference: str) -> FloatArray:
    radii = {"rim": wheel.radius, "tip": wheel.radius + wheel.lug_height}
    if not len(slips):
        return np.empty(0)
    values = checked_slips(slips)
    if reference in radii:
        converted = convert_slip(values, radii[reference], float(wheel.shearing_radius()))
        return checked_slips(np.asarray(converted))
    if reference != "shearing":
        raise StudyError(f"'slip_reference' must be rim, tip or shearing (got {reference!r})")
    return values


def _grid(result: Result, asked: FloatArray) -> FloatArray:
    """Slips for the bands of the plot: all that were driven or asked for."""
    driven = driven_range(result.study)
    low, high = min(driven[0], asked.min()), max(driven[-1], asked.max())
    return np.linspace(low, high, len(driven))
