"""Predictions of readings by the draws: at the measured rows, and as bands over slip."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.random import Generator

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.forward import Forward
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import Posterior, likelihood_of
from bayesterra.models import Conditions
from bayesterra.parameters import CHANNELS
from bayesterra.study.study import Study

GRID = 41
FORCE = "normal_force"


@dataclass(frozen=True)
class RowPredictions:
    """Predictions at every row of the table, used or not.

    Attributes
    ----------
    channels : measured outcomes, the last axis.
    modelled : (n, rows, channels) without noise, NaN where the model has no answer.
    readings : (n, rows, channels) with noise.
    """

    channels: tuple[str, ...]
    modelled: FloatArray
    readings: FloatArray


def predict_rows(
    study: Study, posterior: Posterior, draws: FloatArray, rng: Generator, *, before: bool = False
) -> RowPredictions:
    """Model all rows of the table for parameter sets (n, d) and draw a reading for each.

    Rows are modelled one by one, so that a row which a soil cannot answer takes no other with it. A latent
    load is drawn given the parameter set and the row's readings, or from its prior where these predictions
    are made ``before`` the readings; so are discrepancy, ripple and slip errors, given the rows in the fit.
    """
    likelihood = likelihood_of(study, study.observations)
    noise = posterior.noise_values(draws)
    soil = posterior.prior.soil_values(draws)
    outcomes = likelihood.imagined(soil, noise, rng) if before else likelihood.explained(soil, noise, rng)
    return RowPredictions(
        likelihood.channels, likelihood.predicted(outcomes), likelihood.draw(outcomes, noise, rng)
    )


def predict_at_read_loads(
    study: Study, posterior: Posterior, draws: FloatArray, rng: Generator
) -> RowPredictions:
    """Predictions before any reading but that of the normal force, drive ``both``.

    A load is drawn given its row's normal force alone. That law, unlike the flat one, does not hang on how
    wide the range of loads is, which serves the integral over loads and says nothing that is believed.
    """
    rows = study.observations
    blank = np.full(len(rows), np.nan)
    values = {name: column if name == FORCE else blank for name, column in rows.values.items()}
    told = likelihood_of(study, replace(rows, values=values))
    noise = posterior.noise_values(draws)
    outcomes = told.explained(posterior.prior.soil_values(draws), noise, rng)
    return RowPredictions(told.channels, told.predicted(outcomes), told.draw(outcomes, noise, rng))


def no_rows(study: Study, n: int) -> RowPredictions:
    """Predictions of ``n`` parameter sets without an answer for any row."""
    channels = tuple(study.noise)
    empty = np.full((n, len(study.observations), len(channels)), np.nan)
    return RowPredictions(channels, empty, empty)


def predictive_table(study: Study, predictions: RowPredictions) -> pd.DataFrame:
    """Predictive mean, 5, 50 and 95 % of every row and channel beside the reading, in field units."""
    records = []
    for index, row in enumerate(study.observations.rows):
        for column, name in enumerate(predictions.channels):
            scale, readings = CHANNELS[name].scale, predictions.readings[:, index, column]
            answered = readings[np.isfinite(readings)] / scale
            quantiles = np.quantile(answered, [0.05, 0.5, 0.95]) if answered.size else [np.nan] * 3
            records.append(
                {
                    "row": row,
                    "wheel": study.observations.wheel[index],
                    "slip": study.observations.slip[index],
                    "channel": name,
                    "unit": CHANNELS[name].unit,
                    "used": bool(study.observations.use[index]),
                    "observed": study.observations.values[name][index] / scale,
                    "mean": answered.mean() if answered.size else np.nan,
                    "q05": quantiles[0],
                    "q50": quantiles[1],
                    "q95": quantiles[2],
                    "no_answer": float(np.mean(~np.isfinite(readings))),
                }
            )
    return pd.DataFrame(records)


@dataclass(frozen=True)
class Curves:
    """Modelled outcomes of one wheel over slip.

    Attributes
    ----------
    wheel : its name.
    slip : (g,) grid.
    outcomes : names of the last axis of ``modelled``.
    modelled : (n, g, outcomes) without noise, NaN where the model has no answer.
    readings : the same with noise; outcomes that were not measured have none (NaN).
    given : load (N) or sinkage (m) along the grid, (g,).
    """

    wheel: str
    slip: FloatArray
    outcomes: tuple[str, ...]
    modelled: FloatArray
    readings: FloatArray
    given: FloatArray


def predict_curves(
    study: Study, posterior: Posterior, draws: FloatArray, rng: Generator
) -> tuple[Curves, ...]:
    """Model every wheel over the slips it was driven at, at its median load.

    In the sinkage drive the measured sinkages are joined by straight lines over slip. Sinkages are as read,
    with the zero error of the readings. A discrepancy, drawn given the readings, is part of what is modelled;
    ripple and slip errors are those of another sweep.
    """
    return tuple(_curves(study, posterior, draws, wheel, rng) for wheel in study.wheels)


def _curves(study: Study, posterior: Posterior, draws: FloatArray, wheel: str, rng: Generator) -> Curves:
    forward, whole = curve_forward(study, wheel), posterior.likelihood
    soil, values = posterior.prior.soil_values(draws), posterior.noise_values(draws)
    outcomes = forward(soil, every_row=True)
    curve = whole.beyond(soil, values, wheel, forward.conditions.slip, rng)
    fresh = whole.fresh(forward, soil, values, rng)
    readings = replace(outcomes, values=np.full(outcomes.values.shape, np.nan))
    noises = [noise for noise in whole.noise if noise.channel in forward.outcomes]
    columns = {noise.channel: whole.channels.index(noise.channel) for noise in noises}
    for name, column in columns.items():
        outcomes.add(name, curve[:, :, column])
    blank = replace(study.observations.used(), given_sd={}, values={}, rows=tuple(range(len(forward.given))))
    likelihood = Likelihood(forward, blank, noises)
    drawn = likelihood.draw(outcomes, posterior.noise_values(draws, likelihood.channels), rng)
    for i, (name, column) in enumerate(columns.items()):
        readings[name][...] = drawn[:, :, i] + fresh[:, :, column]
    slip, given = forward.conditions.slip, forward.given
    return Curves(wheel, slip, outcomes.names, outcomes.values, readings.values, given)


def curve_forward(study: Study, wheel: str) -> Forward:
    """The study's model on a slip grid for one wheel (see :func:`predict_curves`)."""
    observations = study.observations
    mine = np.array([name == wheel for name in observations.wheel]) & observations.use
    mine = mine if mine.any() else observations.use
    slips = observations.slip[mine]
    slip = np.linspace(min(0.02, slips.min()), min(0.95, slips.max() + 0.05), GRID)
    if study.drive.by_sinkage:
        order = np.argsort(slips, kind="stable")
        slip = np.linspace(slips.min(), slips.max(), GRID)
        driven = np.interp(slip, slips[order], observations.values["sinkage"][mine][order])
    else:
        load = float(np.median(observations.known_loads[mine]))
        driven = np.full(GRID, study.middle_load if np.isnan(load) else load)
    return Forward(
        study.model, study.drive.with_load, Conditions.of(study.wheels[wheel], slip), driven, as_read=True
    )
