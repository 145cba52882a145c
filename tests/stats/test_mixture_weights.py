"""Importance weights against closed forms, and Pareto smoothing against ArviZ's."""

import numpy as np
import pytest
from arviz_stats.base.array import array_stats

from bayesterra.stats.mixture import (
    effective_number,
    largest_power,
    log_mean,
    normalised,
    pareto_smoothed,
    relative,
    systematic,
    weighted_log_mean,
    weighted_quantiles,
)


def test_the_effective_number_is_that_of_kong() -> None:
    """N of n equal weights, one of a single weight, none where no weight is left, whatever the scale."""
    assert effective_number(np.full(7, 3.0)) == pytest.approx(7.0)
    assert effective_number(np.array([0.0, 5.0, 0.0])) == 1.0
    assert effective_number(np.array([1.0, 2.0])) == pytest.approx(9 / 5)
    assert effective_number(relative(np.full(3, -np.inf))) == 0.0


def test_relative_and_normalised_weights() -> None:
    """Far below and above what exp can hold the greatest is one, or the sum is."""
    log_weights = np.array([-2000.0, -2000.0 + np.log(3.0), -np.inf])
    assert relative(log_weights) == pytest.approx([1 / 3, 1.0, 0.0])
    assert normalised(log_weights) == pytest.approx([0.25, 0.75, 0.0])


def test_the_log_of_a_mean() -> None:
    """Of all values or along an axis, also where no value is finite."""
    values = np.log([[1.0, 2.0], [3.0, 10.0]]) + 900.0
    assert log_mean(values) == pytest.approx(np.log(4.0) + 900.0)
    assert log_mean(values, axis=0) == pytest.approx(np.log([2.0, 6.0]) + 900.0)
    assert log_mean(np.array([-np.inf])) == -np.inf


def test_the_error_of_a_weighted_log_mean_is_its_spread() -> None:
    """For equal weights it is the relative standard error of a mean, and over repeats as large as it says."""
    rng, n = np.random.default_rng(1), 400
    repeats = rng.normal(size=(500, n))
    proposal = 0.5 * repeats**2 - 0.5 * (repeats - 0.5) ** 2  # weights that lead to a normal law around 1/2
    results = [weighted_log_mean(np.log(normalised(w)), x) for w, x in zip(proposal, 0.3 * repeats, strict=True)]
    means, errors = np.array(results).T
    assert means.mean() == pytest.approx(0.3 * 0.5 + 0.5 * 0.3**2, abs=4 * means.std() / np.sqrt(500))
    assert errors.mean() == pytest.approx(means.std(), rel=0.1)
    values = np.log(rng.random(n))
    even = weighted_log_mean(np.full(n, -np.log(n)), values)
    assert even[0] == pytest.approx(float(log_mean(values)))
    assert even[1] == pytest.approx(np.exp(values).std() / np.exp(values).mean() / np.sqrt(n))


def test_a_value_without_weight_spoils_no_error() -> None:
    """However great it is: a model that fits badly leaves such ones."""
    log_weights, log_values = np.log([0.4, 0.6]), np.array([1.0, 2.0])
    beside = weighted_log_mean(np.append(log_weights, -np.inf), np.append(log_values, 5000.0))
    assert beside == weighted_log_mean(log_weights, log_values)


def test_weighted_quantiles_of_equal_weights_are_those_of_the_values() -> None:
    """A value stands at the middle of its share; a weight of two is the value twice."""
    values = np.array([[3.0], [1.0], [2.0]])
    assert weighted_quantiles(values, np.ones(3), (1 / 6, 0.5, 5 / 6))[:, 0] == pytest.approx([1.0, 2.0, 3.0])
    assert weighted_quantiles(values, np.array([1.0, 2.0, 1.0]), (0.25, 0.625)) == pytest.approx(
        np.array([[1.0], [2.0]])
    )


def test_systematic_resampling_draws_each_as_often_as_its_weight_says() -> None:
    """To within one draw, in order, and never one without weight."""
    weights = np.random.default_rng(1).random(50)
    weights[::7] = 0.0
    counts = np.bincount(systematic(weights, 1000, np.random.default_rng(2)), minlength=50)
    assert (np.abs(counts - 1000 * weights / weights.sum()) < 1.0).all()
    assert (counts[::7] == 0).all()


def test_the_largest_power_leaves_the_wanted_number() -> None:
    """Where all of a factor would leave too few, so much of it that the wanted number is left."""
    factors = -0.5 * np.linspace(-30, 30, 2001) ** 2
    power = largest_power(factors, 1.0, 200.0)
    assert 0.0 < power < 1.0
    assert effective_number(np.exp(power * factors)) == pytest.approx(200.0, rel=1e-4)
    assert largest_power(factors, 0.5 * power, 200.0) == 0.5 * power
    before = 0.25 * power * factors
    assert largest_power(factors, 1.0, 200.0, before) == pytest.approx(0.75 * power, rel=1e-4)


@pytest.mark.parametrize("shape", [0.2, 0.5, 0.9])
def test_pareto_smoothing_is_that_of_arviz(shape: float) -> None:
    """Where a tail can be fitted, weights and shape are those of ArviZ, which takes minus their logs."""
    log_weights = -shape * np.log(np.random.default_rng(3).random(4000)) + 500.0
    smoothed, k = pareto_smoothed(log_weights)
    expected, expected_k = array_stats.psislw(-log_weights)
    np.testing.assert_array_equal(smoothed, expected)
    assert k == expected_k
    assert np.exp(smoothed).sum() == pytest.approx(1.0)
