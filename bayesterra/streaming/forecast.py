"""What the earlier rows expect of the next one, before its readings are used."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.random import Generator
from scipy.special import ndtr

from bayesterra.arrays import FloatArray
from bayesterra.likelihood import Likelihood
from bayesterra.parameters import CHANNELS
from bayesterra.posteriors import Posterior
from bayesterra.streaming.cloud import Cloud, weighted_quantiles

LEVELS = (0.05, 0.5, 0.95)


@dataclass(frozen=True)
class Forecast:
    """One-step-ahead predictive law of a row, channel by channel, and where the readings fell in it.

    Attributes
    ----------
    channels : measured outcomes.
    observed : readings (k,), SI; NaN where not measured.
    quantiles : (3, k) 5, 50 and 95 % of the predicted readings, SI; NaN where the model has no answer.
    pit : (k,) probability that the reading would be lower than it is; uniform over rows where all is right.
    no_answer : share of the particles for which the model has no answer at the row's conditions.
    """

    channels: tuple[str, ...]
    observed: FloatArray
    quantiles: FloatArray
    pit: FloatArray
    no_answer: float

    @property
    def table(self) -> pd.DataFrame:
        """One row per channel, field units."""
        scale = np.array([CHANNELS[name].scale for name in self.channels])
        return pd.DataFrame(
            {
                "channel": self.channels,
                "unit": [CHANNELS[name].unit for name in self.channels],
                "observed": self.observed / scale,
                "q05": self.quantiles[0] / scale,
                "q50": self.quantiles[1] / scale,
                "q95": self.quantiles[2] / scale,
                "pit": self.pit,
            }
        )


def forecast(cloud: Cloud, known: Posterior, newest: Likelihood, rng: Generator) -> Forecast:
    """Predict a row with the particles of the earlier rows.

    Parameters
    ----------
    known : gives soil and noise of the particles.
    newest : likelihood of the row.
    """
    soil, noise = known.prior.soil_values(cloud.x), known.noise_values(cloud.x)
    outcomes = newest.imagined(soil, noise, rng)
    readings = newest.draw(outcomes, noise, rng)[:, 0]
    predicted = newest.predicted(outcomes)
    answered = np.isfinite(readings).all(axis=1)
    observed, weights, k = newest.measured[0], cloud.weights, len(newest.channels)
    if not answered.any() or weights[answered].sum() <= 0:
        return Forecast(newest.channels, observed, np.full((3, k), np.nan), np.full(k, np.nan), 1.0)
    standard = (observed - predicted[answered]) / newest.scales(predicted[answered], noise[answered])
    share = weights[answered] / weights[answered].sum()
    scores = [law.normal_score(standard[:, 0, i]) for i, law in enumerate(newest.noise)]
    return Forecast(
        newest.channels,
        observed,
        weighted_quantiles(readings[answered], share, LEVELS),
        np.array([share @ ndtr(score) for score in scores]),
        float(1.0 - weights[answered].sum()),
    )
