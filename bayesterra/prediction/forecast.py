"""Forecasts: predictions of wheels and loads from a result, as a folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError, check_kind, check_seed
from bayesterra.models import Wheel
from bayesterra.models.geometry import convert_slip
from bayesterra.prediction import prediction
from bayesterra.prediction.prediction import Case, Forecast, Prediction
from bayesterra.study.result import Result
from bayesterra.study.wheels import checked_slips, driven_range, wheel_named


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
    for name, wheel in [wheel_named(result.study, text) for text in wheels or (None,)]:
        known, basis = of_group(result, name, group)
        asked = _on_shearing_radius(slips, wheel, slip_reference)
        asked = asked if asked.size else np.unique(result.study.observations.used().slip)
        grid = _grid(result, asked)
        for load in loads or (None,):
            whole = prediction.predict(
                known, np.union1d(grid, asked), load=load, wheel=wheel, name=name, basis=basis
            )
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


def predict(
    result: Result,
    slip: ArrayLike,
    *,
    load: float | str | None = None,
    wheel: str | Path | Wheel | None = None,
    seed: int = 1,
    group: str | None = None,
) -> Prediction:
    """Predict sinkage, drawbar pull, moment and tractive efficiency with the draws of a result.

    Parameters
    ----------
    slip : slips on the shearing radius, in [0, 1).
    load : vertical load, N or text with a unit; by default the median load of the study's rows in the fit.
    wheel : name of one of the study's wheels (by default its first), a file of one, or another wheel.
    seed : of the noise on the readings, and of the parameters of a group that was not tested.
    group : of a joint posterior, whose parameters count; by default that of the wheel, where groups are
        wheels, else one that was not tested: its own parameters are drawn from the population.

    Raises
    ------
    StudyError : a slip or load outside the model's range, or an unknown wheel or group.
    """
    check_kind("bt.predict", result, Result)
    check_seed(seed)
    if isinstance(wheel, Wheel):
        name, chosen = "", wheel
    else:
        name, chosen = wheel_named(result.study, None if wheel is None else str(wheel))
    known, basis = of_group(result, name, group, seed)
    return prediction.predict(known, slip, load=load, wheel=chosen, name=name, seed=seed, basis=basis)


def of_group(result: Result, wheel: str, group: str | None, seed: int = 1) -> tuple[Result, str]:
    """The result that predicts a wheel, and a sentence on it where it is one group of a joint posterior.

    Raises
    ------
    StudyError : there is no such group, or the result has none.
    """
    if result.study.pooling is None:
        if group is not None:
            raise StudyError(f"'group' needs a result with groups, of a study with [pooling] (got {group!r})")
        return result, ""
    from bayesterra.pooling.group import basis, group_result
    from bayesterra.pooling.run import PooledResult

    if not isinstance(result, PooledResult):  # of the prior alone
        raise StudyError("a prediction needs a joint posterior (got a prior of several groups)")
    if group is None and result.study.pooling.by == "wheel" and wheel in result.groups:
        group = wheel
    return group_result(result, group, seed=seed), basis(result, group)
