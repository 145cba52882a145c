"""Ranks, their test, and what it would notice."""

import numpy as np
import pytest
from scipy.stats import norm

from bayesterra.checking.ranks import DRAWS, ERRORS, Error, covered, normalised_rank, rank_test, shift_and_width


def test_ranks_of_a_right_posterior_are_uniform() -> None:
    """Truth and draws from one law give normalised ranks with the moments of a uniform law."""
    rng = np.random.default_rng(1)
    ranks = [normalised_rank(rng.normal(), rng.normal(size=DRAWS), rng) for _ in range(4000)]
    assert abs(np.mean(ranks) - 0.5) < 4 * np.sqrt(1 / 12 / 4000)
    assert abs(np.var(ranks) - 1 / 12) < 4 * np.sqrt(1 / 180 / 4000)
    assert 0 < min(ranks) < max(ranks) < 1


def test_ties_are_broken_at_random() -> None:
    """A truth that equals half of the draws is ranked evenly over their places."""
    rng = np.random.default_rng(1)
    draws = np.repeat([0.0, 1.0], [40, 40])
    ranks = [normalised_rank(0.0, draws, rng) for _ in range(4000)]
    assert max(ranks) < 41 / 81
    assert abs(np.mean(ranks) - 0.5 * 41 / 81) < 0.01


def test_what_is_constant_has_no_rank() -> None:
    """A quantity that never varies, as a flat prior's density, is told apart from a tie."""
    assert np.isnan(normalised_rank(2.0, np.full(99, 2.0), np.random.default_rng(1)))


@pytest.mark.parametrize("level", [0.05, 0.001])
def test_uniform_ranks_fail_as_often_as_stated(level: float) -> None:
    """The p value of uniform ranks is below a level with that probability, ends included."""
    rng, test = np.random.default_rng(2), rank_test(150)
    p_values = np.array([test.p_value(rng.random(150)) for _ in range(4000)])
    share = float((p_values <= level).mean())
    assert abs(share - level) < 4 * np.sqrt(level / 4000)


def test_a_curve_leaves_the_band_when_its_p_value_is_below_the_level() -> None:
    """Band and p value are one test."""
    rng, test, left = np.random.default_rng(3), rank_test(100), 0
    low, high = test.band(0.05)
    for _ in range(500):
        ranks = rng.beta(1.0, 1.0 + 0.5 * rng.random(), size=100)
        share = test.below(ranks) / 100
        outside = bool(((share < low) | (share > high)).any())
        assert outside == (test.p_value(ranks) <= 0.05)
        left += outside
    assert 50 < left < 450


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: error.name)
def test_the_power_is_the_share_of_wrong_posteriors_that_fail(error: Error) -> None:
    """Ranks simulated draw by draw fail as often as the power says."""
    rng, n, level = np.random.default_rng(4), 300, 0.05
    truth = rng.normal(size=(400, n))
    below = rng.binomial(DRAWS, norm.cdf((truth - error.shift) / error.scale))
    ranks = (below + rng.random(below.shape)) / (DRAWS + 1)
    found = np.mean([rank_test(n).p_value(row) <= level for row in ranks])
    assert abs(found - rank_test(n).power(error.of_value(), level)) < 0.1


def test_the_log_likelihood_sees_what_all_parameters_share() -> None:
    """Eight standard deviations 10 % too small are found by it where no single parameter shows them."""
    error, test = ERRORS[0], rank_test(500)
    assert test.power(error.of_value(), 0.001) < 0.2
    assert test.power(error.of_density(8), 0.001) > 0.6


def test_no_error_is_noticed_as_often_as_the_level_says() -> None:
    """The power against a right posterior is the level."""
    right = Error("none")
    for shares in (right.of_value(), right.of_density(5)):
        assert abs(rank_test(200).power(shares, 0.05) - 0.05) < 0.02


def test_coverage_shift_and_width_of_a_known_error() -> None:
    """Draws a fifth too narrow and half an sd too high cover too little, and are described so."""
    rng = np.random.default_rng(5)
    ranks = norm.cdf((rng.normal(size=20000) - 0.5) / 0.8)
    shift, width = shift_and_width(ranks)
    assert abs(shift - 0.5) < 0.02
    assert abs(width - 0.8) < 0.02
    z = norm.ppf(0.9)
    assert abs(covered(ranks, 0.8) - (norm.cdf(0.8 * z + 0.5) - norm.cdf(-0.8 * z + 0.5))) < 0.01
