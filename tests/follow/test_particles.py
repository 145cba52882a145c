"""Against a target whose posterior and evidence are known exactly: linear in the parameters, all Gaussian."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np
import pytest

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.follow.particles import Levels, Particles, learn
from bayesterra.sampling.coordinates import Coordinates
from tests.support.plain import plain_coordinates

SD = 0.3
D = 3


@dataclass(frozen=True)
class Line:
    """Readings y = A w + noise, w standard normal; stands in for the rows of a wheel.

    The parameters are w, or with ``bent`` w1 and the others plus its square: a curved ridge of uneven width.
    """

    design: FloatArray
    readings: FloatArray
    bent: bool = False

    def straight(self, x: FloatArray) -> FloatArray:
        """The w of parameters (n, d)."""
        if not self.bent:
            return x
        width = np.exp(0.5 * x[:, :1])
        return np.column_stack([x[:, 0], (x[:, 1:] - x[:, :1] ** 2) / width])

    def curved(self, w: FloatArray) -> FloatArray:
        """The parameters of w (n, d)."""
        if not self.bent:
            return w
        return np.column_stack([w[:, 0], w[:, 1:] * np.exp(0.5 * w[:, :1]) + w[:, :1] ** 2])

    def first(self, order: IntArray, number: int) -> Line:
        """Some first rows in some order."""
        return Line(self.design[order[:number]], self.readings[order[:number]], self.bent)

    @property
    def coordinates(self) -> Coordinates:
        """Plain ones; what is curved in them the moves have to straighten."""
        return plain_coordinates([str(i) for i in range(D)])

    def terms(self, x: FloatArray) -> FloatArray:
        """Log likelihood (n, rows)."""
        residual = (self.readings - self.straight(x) @ self.design.T) / SD
        return np.asarray(-0.5 * residual**2 - np.log(SD * np.sqrt(2 * np.pi)))

    def __call__(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Log prior, and log likelihood of the earlier rows and of the newest."""
        w, terms = self.straight(x), self.terms(x)
        prior = -0.5 * (w**2).sum(axis=1) - 0.5 * D * np.log(2 * np.pi)
        prior -= 0.5 * (D - 1) * x[:, 0] * self.bent  # the map's Jacobian
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


def rows_of(number: int, bent: bool) -> Line:
    """Rows of which the first few leave directions open."""
    rng = np.random.default_rng(11)
    design = rng.standard_normal((number, D)) * np.array([0.1 if bent else 1.0, 1.0, 0.2])
    return Line(design, design @ np.array([1.0, -0.5, 2.0]) + SD * rng.standard_normal(number), bent)


def followed(line: Line, order: IntArray, particles: int, seed: int) -> tuple[Particles, float, float, int]:
    """The cloud after all rows one by one, log evidence and its error, and the number of resamplings."""
    rng = np.random.default_rng(seed)
    before = line.curved(rng.standard_normal((particles, D)))
    cloud, total, variance, events = Particles.even(before, np.zeros(particles)), 0.0, 0.0, 0
    for number in range(1, len(order) + 1):
        part = line.first(order, number)
        learned = learn(cloud, _made(part), part.terms(cloud.x)[:, -1], before[:200], rng)
        cloud, total = learned.particles, total + learned.log_predictive
        variance, events = variance + learned.variance, events + len(learned.rejuvenations)
        assert np.allclose(cloud.log_likelihood, part.terms(cloud.x).sum(axis=1))
    return cloud, total, float(np.sqrt(variance + cloud.variance)), events


@pytest.mark.parametrize(("bent", "backwards"), [(False, False), (False, True), (True, False)])
def test_rows_one_by_one_end_at_the_exact_posterior_and_evidence(bent: bool, backwards: bool) -> None:
    """Means, spreads and the evidence agree within four Monte Carlo errors, in either order of the rows."""
    line = rows_of(20, bent)
    order = np.arange(20)[::-1] if backwards else np.arange(20)
    cloud, total, error, events = followed(line, order, 1000, seed=6)
    mean, covariance, evidence = exact(line)
    lines = line.straight(cloud.x)
    found = cloud.weights @ lines
    spread = np.sqrt(cloud.weights @ (lines - found) ** 2)
    sd = np.sqrt(np.diagonal(covariance))
    assert events > 3
    assert (np.abs(found - mean) < 4 * sd / np.sqrt(cloud.effective)).all()
    assert (np.abs(spread / sd - 1) < 4 / np.sqrt(2 * cloud.effective)).all()
    assert abs(total - evidence) < 4 * error


def test_the_stated_error_of_the_evidence_is_the_spread_over_repetitions() -> None:
    """Thirty runs scatter about the exact evidence as far as each says of itself."""
    line = rows_of(10, bent=False)
    found = [followed(line, np.arange(10), 200, seed)[1:3] for seed in range(30)]
    totals, stated = np.array(found).T
    spread = np.sqrt(((totals - exact(line)[2]) ** 2).mean())
    assert 0.65 < spread / stated.mean() < 1.5
