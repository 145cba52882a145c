"""Against a target whose posterior and evidence are known exactly: linear in the parameters, all Gaussian."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np
import pytest

from bayesterra.arrays import FloatArray
from bayesterra.coordinates import Coordinates, plain_coordinates
from bayesterra.streaming.cloud import Cloud
from bayesterra.streaming.learning import learn, settled
from bayesterra.streaming.moves import Levels

SD = 0.3
ROWS, PARTICLES, D = 30, 800, 3


@dataclass(frozen=True)
class Line:
    """Readings y = A x + noise, x standard normal; stands in for the rows of a wheel."""

    design: FloatArray
    readings: FloatArray

    @property
    def coordinates(self) -> Coordinates:
        """Plain ones."""
        return plain_coordinates([str(i) for i in range(D)])

    def terms(self, x: FloatArray) -> FloatArray:
        """Log likelihood (n, rows)."""
        residual = (self.readings - x @ self.design.T) / SD
        return np.asarray(-0.5 * residual**2 - np.log(SD * np.sqrt(2 * np.pi)))

    def __call__(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Log prior, and log likelihood of the earlier rows and of the newest."""
        prior, terms = -0.5 * (x**2).sum(axis=1) - 0.5 * D * np.log(2 * np.pi), self.terms(x)
        return np.where(np.isnan(prior), -np.inf, prior), terms[:, :-1].sum(axis=1), terms[:, -1]


def exact(line: Line) -> tuple[FloatArray, FloatArray, float]:
    """Posterior mean and covariance, and log evidence."""
    precision = np.eye(D) + line.design.T @ line.design / SD**2
    covariance = np.linalg.inv(precision)
    mean = covariance @ line.design.T @ line.readings / SD**2
    marginal = line.design @ line.design.T + SD**2 * np.eye(len(line.readings))
    level = -0.5 * line.readings @ np.linalg.solve(marginal, line.readings)
    return (
        np.asarray(mean),
        np.asarray(covariance, dtype=np.float64),
        float(level - 0.5 * np.linalg.slogdet(2 * np.pi * marginal)[1]),
    )


def _made(line: Line) -> Callable[[], Levels]:
    """What makes the densities of all rows."""
    return lambda: cast(Levels, line)


@pytest.fixture(scope="module")
def line() -> Line:
    """Rows of which the first few leave directions open."""
    rng = np.random.default_rng(11)
    design = rng.standard_normal((ROWS, D)) * np.array([1.0, 1.0, 0.2])
    return Line(design, design @ np.array([1.0, -0.5, 2.0]) + SD * rng.standard_normal(ROWS))


@pytest.mark.parametrize("backwards", [False, True])
def test_rows_one_by_one_end_at_the_exact_posterior_and_evidence(line: Line, backwards: bool) -> None:
    """Means, spreads and the evidence agree within four Monte Carlo errors, in either order of the rows."""
    order = np.arange(ROWS)[::-1] if backwards else np.arange(ROWS)
    rng = np.random.default_rng(5)
    before = rng.standard_normal((PARTICLES, D))
    cloud, total, variance, events = Cloud.even(before, np.zeros(PARTICLES)), 0.0, 0.0, 0
    for number in range(1, ROWS + 1):
        part = Line(line.design[order[:number]], line.readings[order[:number]])
        learned = learn(cloud, _made(part), part.terms(cloud.x)[:, -1], before[:200], rng)
        cloud, total = learned.cloud, total + learned.log_predictive
        variance, events = variance + learned.variance, events + len(learned.rejuvenations)
        assert np.allclose(cloud.log_likelihood, part.terms(cloud.x).sum(axis=1))
    mean, covariance, evidence = exact(line)
    found, spread = cloud.moments()
    sd = np.sqrt(np.diagonal(covariance))
    assert events > 3
    assert (np.abs(found - mean) < 4 * sd / np.sqrt(cloud.effective)).all()
    assert (np.abs(spread / sd - 1) < 4 / np.sqrt(2 * cloud.effective)).all()
    assert abs(total - evidence) < 4 * np.sqrt(variance + settled(cloud))


def test_the_stated_error_of_the_evidence_is_the_spread_over_repetitions(line: Line) -> None:
    """Ten runs scatter about the exact evidence as far as each says of itself, within a factor of two."""
    part = Line(line.design[:10], line.readings[:10])
    found = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        before = rng.standard_normal((300, D))
        cloud, total, variance = Cloud.even(before, np.zeros(300)), 0.0, 0.0
        for number in range(1, 11):
            rows = Line(part.design[:number], part.readings[:number])
            learned = learn(cloud, _made(rows), rows.terms(cloud.x)[:, -1], before, rng)
            cloud, total = learned.cloud, total + learned.log_predictive
            variance += learned.variance
        found.append((total - exact(part)[2], np.sqrt(variance + settled(cloud))))
    errors, stated = np.array(found).T
    assert 0.5 < np.sqrt((errors**2).mean()) / stated.mean() < 2.0
