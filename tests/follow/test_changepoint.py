"""The watch for a change of soil: what it computes, what it finds, what it does not mistake for one."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import bayesterra as bt
from bayesterra.arrays import FloatArray
from bayesterra.follow.changepoint import CHANGE, MOST, Basis, Candidates, alarm_of
from bayesterra.follow.particles import Particles
from bayesterra.likelihood.forward import Outcomes
from bayesterra.study.noise import Noise
from bayesterra.study.observations import Observations
from tests.support.plain import plain_coordinates

SD = 0.3


@dataclass(frozen=True)
class Reading:
    """A row whose reading is linear in two parameters; stands in for a likelihood."""

    slope: FloatArray
    reading: float
    noise: tuple[Noise, ...] = (Noise("sinkage", sd=SD),)

    @property
    def measured(self) -> FloatArray:
        """The reading."""
        return np.array([[self.reading]])

    def forward(self, soil: FloatArray, *, every_row: bool) -> Outcomes:
        """The modelled reading."""
        return Outcomes(("sinkage",), (soil @ self.slope)[:, None, None], np.zeros(len(soil), dtype=np.int64))

    def predicted(self, outcomes: Outcomes) -> FloatArray:
        """All of it."""
        return outcomes.values

    def scales(self, predicted: FloatArray, noise_values: FloatArray) -> FloatArray:
        """The same everywhere."""
        return np.full(predicted.shape, SD)


class Prior:
    """Parameters that are their own soil."""

    names = ("c", "phi")

    @property
    def prior(self) -> Prior:
        """Itself."""
        return self

    def soil_values(self, x: FloatArray) -> FloatArray:
        """The parameters."""
        return x

    def noise_values(self, x: FloatArray) -> FloatArray:
        """None is estimated."""
        return np.empty((len(x), 0))


def test_factors_are_those_of_the_exact_density_where_all_is_linear() -> None:
    """The filter's densities of the rows multiply to their joint normal density."""
    rng = np.random.default_rng(2)
    x = rng.standard_normal((4000, 2)) @ np.array([[0.2, 0.1], [0.0, 0.3]]) + np.array([1.0, -0.5])
    basis = Basis(Prior(), plain_coordinates(("c", "phi")))  # type: ignore[arg-type]
    candidates = basis.opened(Candidates.none(2), 7, Particles.even(x, np.zeros(len(x))))
    mean, covariance = x.mean(axis=0), np.cov(x.T, bias=True) + CHANGE**2 * np.eye(2)
    slopes, readings = rng.standard_normal((3, 2)), np.array([1.3, 0.2, -0.9])
    for slope, reading in zip(slopes, readings, strict=True):
        candidates = basis.followed(candidates, Reading(slope, reading), -0.7)  # type: ignore[arg-type]
    marginal = slopes @ covariance @ slopes.T + SD**2 * np.eye(3)
    residual = readings - slopes @ mean
    exact = -0.5 * residual @ np.linalg.solve(marginal, residual)
    exact -= 0.5 * np.linalg.slogdet(2 * np.pi * marginal)[1]
    assert candidates.since.tolist() == [7]
    assert candidates.log_factors[0] == pytest.approx(exact + 3 * 0.7, abs=1e-9)
    gain = covariance @ slopes.T @ np.linalg.inv(marginal)
    assert candidates.means[0] == pytest.approx(mean + gain @ residual, abs=1e-9)
    assert candidates.covariances[0] == pytest.approx(covariance - gain @ slopes @ covariance, abs=1e-9)


def test_memory_of_the_watch_is_bounded() -> None:
    """The best and the youngest candidates stay, the others go."""
    candidates = Candidates.none(2)
    for row in range(100):
        candidates = candidates.joined(row, np.zeros(2), np.eye(2)).pruned()
        factors = np.where(candidates.since == 3, 5.0, -0.1 * (row - candidates.since))
        candidates = replace(candidates, log_factors=factors, log_sober=factors)
    assert len(candidates) == MOST
    assert 3 in candidates.since
    assert candidates.since[-8:].tolist() == list(range(92, 100))
    alarm = alarm_of(99, candidates, 1e-4)
    assert (alarm.since, alarm.first, alarm.last) == (3, 3, 3)
    assert "the soil seems to have changed at row 3;" in alarm.sentence


def test_an_unchanged_soil_raises_no_alarm(streamed: bt.Stream) -> None:
    """The evidence for a change stays far below its limit of e^9.2."""
    assert streamed.alarm is None
    assert streamed.watch.candidates.log_statistic < 6.0


def test_rows_that_say_nothing_are_no_evidence(script: ModuleType, plan: bt.Study) -> None:
    """Readings with huge errors: both factors stay at 1, also where many soils have no answer in a row."""
    stream = bt.Stream(plan, seed=3, particles=400)
    unknown: dict[str, Any] = {"sinkage_sd": "100 m", "drawbar_pull_sd": "1e6 N", "resistance_moment_sd": "1e6 N m"}
    readings: dict[str, Any] = {"sinkage": "10 mm", "drawbar_pull": "5 N", "resistance_moment": "4 N m"}
    slips, loads = np.linspace(0.2, 0.9, 12), np.geomspace(30.0, 500.0, 12)
    without = [
        stream.add(slip=slip, load=f"{load} N", **readings, **unknown).forecast.no_answer
        for slip, load in zip(slips, loads, strict=True)
    ]
    assert max(without[5:]) > 0.05
    candidates = stream.watch.candidates
    assert len(candidates) == 8
    assert np.abs(candidates.log_factors).max() < 1e-3
    assert np.abs(candidates.log_sober).max() < 1e-3


def test_a_change_of_soil_is_found_and_dated(
    script: ModuleType, plan: bt.Study, streamed: bt.Stream, rows: list[Observations]
) -> None:
    """Five degrees less friction: found within three rows, dated to a row."""
    stream, soft = deepcopy(streamed), {**script.TRUTH, "phi": script.TRUTH["phi"] - np.radians(5.0)}
    changed = script.driven(plan, soft, seed=8).observations
    alarms = [stream.learn(script.row(changed, index)).alarm for index in range(3)]
    found = [alarm for alarm in alarms if alarm]
    assert len(found) == 1
    assert abs(found[0].since - 25) <= 1
    assert found[0].log_statistic > -np.log(stream.watch.rate or 0.0)
    assert stream.alarm == found[0]


def test_one_wild_reading_is_no_change_of_soil(streamed: bt.Stream, rows: list[Observations]) -> None:
    """A pull that is off by sixteen standard deviations, then rows as before."""
    stream = deepcopy(streamed)
    wild = replace(rows[0], values={**rows[0].values, "drawbar_pull": rows[0].values["drawbar_pull"] + 8.0})
    first = stream.learn(wild)
    assert first.pit["drawbar_pull"] > 0.9999
    assert [stream.learn(row).alarm for row in rows[1:4]] == [None] * 3
    assert first.alarm is None


def test_the_watch_can_be_left_out(plan: bt.Study, rows: list[Observations]) -> None:
    """Without a rate nothing is looked for."""
    stream = bt.Stream(plan, particles=100, false_alarms=None)
    assert [stream.learn(row).log_statistic for row in rows[:7]] == [-np.inf] * 7
