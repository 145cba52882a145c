"""Cloned data of linear models with normal errors have a closed form at every power."""

import numpy as np
import pytest
from cloning import POWERS, Cloned, Cloud, cloned, cloning, cloning_objection, clouds, fitted_slope, word

from bayesterra.arrays import FloatArray
from bayesterra.identifiability.verdicts import STRUCTURAL
from bayesterra.likelihood.posterior import posterior
from bayesterra.study.result import Result

NAMES = ("c", "phi", "K")
PRECISION = np.array([[400.0, 400.0, 0.0], [400.0, 400.0, 0.0], [0.0, 0.0, 25.0]])
"""Of the likelihood: the sum of the first two is known, their difference not at all, the third fairly."""


def densities(u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Standard normal prior, likelihood around (0.3, 0, 0.5)."""
    away = u - np.array([0.3, 0.0, 0.5])
    return -0.5 * (u**2).sum(axis=1), -0.5 * np.einsum("ni,ij,nj->n", away, PRECISION, away)


@pytest.fixture(scope="module")
def linear() -> Cloned:
    """The linear model cloned from draws of its own posterior."""
    rng = np.random.default_rng(1)
    covariance = np.linalg.inv(np.eye(3) + PRECISION)
    mean = covariance @ PRECISION @ np.array([0.3, 0.0, 0.5])
    start = mean + rng.standard_normal((8192, 3)) @ np.linalg.cholesky(covariance).T
    found = clouds(densities, start, POWERS, rng)
    return cloned(NAMES, POWERS, found, rng.standard_normal((8000, 3)), lambda x: x)


def test_variances_are_the_closed_form_at_every_power(linear: Cloned) -> None:
    """The covariance at power K is (1 + K Λ)⁻¹."""
    for power, sd in zip(linear.powers, linear.sd, strict=True):
        exact = np.sqrt(np.diagonal(np.linalg.inv(np.eye(3) + power * PRECISION)))
        np.testing.assert_allclose(sd, exact, rtol=0.06)


def test_the_flat_direction_is_named(linear: Cloned) -> None:
    """The difference stays as wide as the prior, the sum and the third parameter shrink with slope −1."""
    table = linear.directions
    assert table["combination"][0] in ("c − φ", "φ − c", "c − 0.99 φ", "φ − 0.99 c")
    assert table["word"].tolist() == ["not estimable", "estimable", "estimable"]
    np.testing.assert_allclose(table["late_slope"], [0, -1, -1], atol=0.12)
    np.testing.assert_allclose(linear.eigenvalues[:, 0], 1.0, atol=0.1)


def test_parameters_on_the_flat_direction_are_not_estimable(linear: Cloned) -> None:
    """Each of the two keeps half of its variance for ever; the third is estimable."""
    assert linear.parameters["word"].tolist() == ["not estimable", "not estimable", "estimable"]
    assert linear.parameters["late_error"].between(0.005, 0.1).all()


def test_weights_are_judged(linear: Cloned) -> None:
    """Every power says how many draws are effective and whether their weights can be relied on."""
    assert linear.reliable
    assert (linear.sampling["effective"] > 1000).all()
    assert linear.sampling["power"].tolist() == list(POWERS)


def test_weights_that_rest_on_few_draws_say_nothing() -> None:
    """Where few draws carry the last power, no word is given and the power is named as unreliable."""
    rng = np.random.default_rng(2)
    x = rng.standard_normal((4000, 3))
    even, few = np.full(4000, -np.log(4000)), np.full(4000, -np.inf)
    few[:20] = -np.log(20)
    found = [Cloud(x, np.zeros(4000), even), Cloud(x, np.zeros(4000), few, 0.2)]
    spoilt = cloned(NAMES, (1, 2), found, x, lambda values: values)
    assert spoilt.sampling["reliable"].tolist() == [True, False]
    assert set(spoilt.parameters["word"]) == {"unreliable"}
    assert not spoilt.reliable


def test_an_exact_power_law_has_its_slope_and_error() -> None:
    """The slope of K⁻¹ is −1; its error is that of a straight line through points with these errors."""
    powers = (1, 2, 4, 8)
    variances, errors = 3.0 / np.array(powers)[:, None], np.full((4, 1), 0.1)
    slope, error = fitted_slope(powers, variances, errors)
    assert slope == pytest.approx([-1.0])
    x = np.log(powers)
    assert error == pytest.approx([0.1 / np.sqrt(((x - x.mean()) ** 2).sum())])


def test_words_wait_for_the_error() -> None:
    """A slope whose error leaves it open is undecided."""
    assert word(-1.0, 0.05) == "estimable"
    assert word(-1.0, 0.2) == "undecided"
    assert word(0.02, 0.05) == "not estimable"
    assert word(-0.5, 0.01) == "undecided"


def test_objections_are_those_to_words_that_more_data_would_change() -> None:
    """What stays although it is determined, and what narrows although it is unknown; nothing else."""
    assert cloning_objection("determined", "not estimable") == "more of the same data would not narrow it"
    assert cloning_objection("repeats its prior", "estimable") == "more of the same data would narrow it"
    assert cloning_objection(STRUCTURAL, "estimable") == "more of the same data would narrow it"
    agreeing = [("determined", "estimable"), ("repeats its prior", "not estimable"), ("weakly", "estimable")]
    assert not any(cloning_objection(*each) for each in [*agreeing, ("determined", "")])


def test_cloning_the_study_leaves_the_modulus_where_it_was(small_result: Result) -> None:
    """K_s keeps its spread while that of φ and K shrinks towards 1/√K; all weights are reliable."""
    target = posterior(small_result.study)
    prior, draws = small_result.values("prior"), small_result.values()
    found = cloning(target, prior, draws, np.random.default_rng(1), powers=(1, 2, 4, 8, 16))
    assert found.reliable
    table = found.parameters.set_index("parameter")
    assert table["word"]["Ks"] == "not estimable"
    assert (table["late_slope"][["c", "phi", "K"]] < -0.35).all()
    assert found.directions["word"].iloc[0] == "not estimable"
    assert found.directions["word"].iloc[-1] == "estimable"
