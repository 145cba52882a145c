"""Regressions: their laws, what they choose, and how they do with little."""

import numpy as np
import pytest
from numpy.random import default_rng
from scipy.stats import linregress, t

from bayesterra.checking.holdout_scores import TrainingRows, gaussian_process, polynomial, training_mean

SLIP = np.repeat(np.linspace(0.0, 0.8, 9), 3)
CONDITIONS = np.column_stack([SLIP, np.full(27, 80.0), np.zeros(27)])
LEVEL = np.repeat(np.arange(9), 3)
NEW = np.array([[0.25, 80.0, 0.0], [1.2, 80.0, 0.0]])


def known(readings: np.ndarray) -> TrainingRows:
    """Three readings at each of nine slips; load and wheel do not vary."""
    return TrainingRows(CONDITIONS, readings, LEVEL, LEVEL)


def test_a_line_has_the_textbook_prediction_interval() -> None:
    """Centre and scale of the predictive law of simple linear regression, Student-t with n − 2."""
    y = 3 + 5 * SLIP + default_rng(1).normal(0, 0.2, 27)
    answer = polynomial(known(y), NEW)
    assert answer.detail == "degree 1"
    line = linregress(SLIP, y)
    residual = np.sqrt(((y - line.intercept - line.slope * SLIP) ** 2).sum() / 25)
    away = (NEW[:, 0] - SLIP.mean()) ** 2 / ((SLIP - SLIP.mean()) ** 2).sum()
    for law, slip, far in zip(answer.laws, NEW[:, 0], away, strict=True):
        scale = residual * np.sqrt(1 + 1 / 27 + far)
        expected = t.ppf([0.05, 0.95], 25, line.intercept + line.slope * slip, scale)
        assert law.quantiles(np.array([0.05, 0.95])) == pytest.approx(expected)


def test_the_degree_follows_the_data() -> None:
    """A cubic is taken for a cubic; with three levels left nothing above a line can be chosen."""
    y = 20 * SLIP**3 - 10 * SLIP + default_rng(2).normal(0, 0.1, 27)
    assert polynomial(known(y), NEW).detail == "degree 3"
    few = known(y).take(LEVEL < 3)
    assert polynomial(few, NEW).detail == "degree 1"
    assert polynomial(known(y).take(LEVEL < 1), NEW).detail == "mean"


def test_the_mean_is_the_floor() -> None:
    """Student-t with n − 1 around the mean, the same at every slip; one reading is not enough."""
    y = default_rng(3).normal(5, 2, 27)
    first, second = training_mean(known(y), NEW).laws
    expected = t.ppf([0.05, 0.95], 26, y.mean(), y.std(ddof=1) * np.sqrt(1 + 1 / 27))
    assert first.quantiles(np.array([0.05, 0.95])) == pytest.approx(expected)
    assert second == first
    assert not training_mean(known(y).take(np.arange(27) == 0), NEW).laws


def test_a_gaussian_process_follows_a_curve_and_widens_beyond() -> None:
    """Inside the rows it knows the curve and the noise; beyond them it becomes unsure."""
    y = np.sin(6 * SLIP) + default_rng(4).normal(0, 0.05, 27)
    inside, beyond = gaussian_process(known(y), NEW).laws
    low, middle, high = inside.quantiles(np.array([0.05, 0.5, 0.95]))
    assert middle == pytest.approx(np.sin(1.5), abs=0.08)
    assert 0.1 < high - low < 0.3
    assert beyond.scale[0] > 3 * inside.scale[0]
