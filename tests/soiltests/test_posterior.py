"""Curves, likelihood, prior and coordinates of soil tests, each held against another way to compute it."""

import numpy as np
import pytest
from numpy.random import default_rng
from scipy.stats import kstest, multivariate_normal, uniform

from bayesterra.likelihood.posterior import draw_cut_prior
from bayesterra.soiltests.checks import fit
from bayesterra.soiltests.posterior import (
    Scatter,
    Spread,
    TestPosterior,
    coordinates,
    covariance,
    marginal_sd,
    structural,
)
from bayesterra.soiltests.study import SoilTest

from .conftest import SOIL, STRENGTH, plates, shear


@pytest.mark.parametrize("spread", ["memory", "seating", "independent"])
def test_the_likelihood_is_that_of_the_stated_covariance(spread: str) -> None:
    """The one-pass likelihood against SciPy's multivariate normal law of every test."""
    readings = plates().readings
    values = {
        "memory": Spread(np.array([0.2, 0.3]), np.array([2.0, 0.4]), None),
        "seating": Spread(np.array([0.2, 0.3]), np.array([2.0, 0.4]), np.array([1e-3, 2e-4]), np.array([5e-4, 0.0])),
        "independent": Spread(np.array([0.2, 0.3]), None, None),
    }[spread]
    residuals = default_rng(1).normal(size=(2, len(readings)))
    found = Scatter(readings).log_likelihoods(residuals, values)
    for test in range(len(readings.tests)):
        own = readings.test == test
        laws = covariance(readings.path[own], values)
        expected = [multivariate_normal(cov=law).logpdf(r[own]) for law, r in zip(laws, residuals, strict=True)]
        np.testing.assert_allclose(found[:, test], expected, rtol=1e-9)
        sd = np.sqrt(np.einsum("nii->ni", laws))
        np.testing.assert_allclose(marginal_sd(readings.path[own], values), sd)


def test_simulated_deviations_have_the_stated_covariance() -> None:
    """Empirical covariance of many simulated tests."""
    readings = plates((0.03,), tests=1, readings=4).readings
    n = 40_000
    values = Spread(np.full(n, 0.2), np.full(n, 1.0), np.full(n, 5e-4))
    drawn = Scatter(readings).deviations(values, default_rng(3))
    one = Spread(*(part[:1] for part in (values.scatter, values.memory, values.shift) if part is not None))
    np.testing.assert_allclose(np.cov(drawn.T), covariance(readings.path, one)[0], atol=1.5e-3)


DESIGNS = [plates(), plates((0.03,)), shear(), shear((5e3,))]


@pytest.mark.parametrize("test", DESIGNS)
def test_coordinates_are_exact(test: SoilTest) -> None:
    """There and back, and the Jacobian is that of differences."""
    posterior = TestPosterior.of(test)
    x = draw_cut_prior(posterior, 30, default_rng(1)).x
    chart = coordinates(posterior)
    u = chart.from_physical(x)
    back, log_jacobian = chart.to_physical(u)
    np.testing.assert_allclose(back, x, rtol=1e-6)
    steps = 1e-5 * np.eye(u.shape[1])
    columns = [(chart.to_physical(u + step)[0] - chart.to_physical(u - step)[0]) / 2e-5 for step in steps]
    determinants = np.linalg.slogdet(np.stack(columns, axis=2))[1]
    np.testing.assert_allclose(log_jacobian, determinants, atol=1e-4)


def test_moduli_stated_at_a_sinkage_do_not_favour_an_exponent() -> None:
    """Draws and density: n keeps its own law, and the parts of the pressure are uniform."""
    prior = TestPosterior.of(plates()).prior
    x = prior.sample(4000, default_rng(2))
    assert kstest(x[:, 2], uniform(0.3, 1.7).cdf).pvalue > 0.01
    assert kstest(x[:, 0] * 0.01 ** x[:, 2], uniform(-1e3, 2e3).cdf).pvalue > 0.01
    point = x[:1].copy()
    moved = point.copy()
    moved[:, 2] += 0.1
    moved[:, :2] *= 0.01**-0.1  # the same parts of the pressure
    change = prior.log_density(moved) - prior.log_density(point)
    assert change == pytest.approx(2 * 0.1 * np.log(0.01))  # the Jacobian of two moduli


def test_structure_sees_what_one_radius_and_one_stress_hide() -> None:
    """k_c and k_φ under one radius, c and φ under one stress; a fixed partner sets the other free."""
    every = np.ones(3, dtype=bool)
    for made, one, other in ((plates, (0.03,), (0.03, 0.06)), (shear, (5e3,), (5e3, 15e3))):
        for levels, expected in ((one, [False, False, True]), (other, [True, True, True])):
            test = made(levels)
            posterior = TestPosterior.of(test)
            x = posterior.soil(draw_cut_prior(posterior, 100, default_rng(1)).x)
            assert structural(test.readings, x, every).tolist() == expected
            assert structural(test.readings, x, np.array([False, True, True])).all()


def test_least_squares_recover_exact_soils_and_say_what_they_cannot_separate() -> None:
    """Without scatter both methods return the soil; with one level they say which sum they know."""
    found = fit(plates(scatter=0.0).readings).values
    for method in ("regression", "nonlinear"):
        assert found[method] == pytest.approx(SOIL, rel=1e-5)
    for values in fit(shear(tests=1).readings).values.values():
        assert values == pytest.approx(STRENGTH, rel=0.3)
    alone = fit(plates((0.03,), scatter=0.0).readings)
    assert alone.values["nonlinear"] == pytest.approx({"n": 1.1})
    assert alone.notes == (
        "plates of one radius: k_c and k_φ cannot be separated, k_c/b + k_φ = 866.7 kPa/m^n at b = 30 mm",
    )
    assert "one normal stress: c and φ cannot be separated, c + σ tan φ =" in fit(shear((15e3,)).readings).notes[0]


def test_far_proposals_have_no_density_and_raise_no_warning() -> None:
    """Coordinates far out overflow; they are outside the support, silently."""
    posterior = TestPosterior.of(plates())
    x = np.array([[1e300, -1e308, 5.0, 0.1, 1.0, 1e-4, 0.0], [np.inf, np.nan, 1.0, 0.1, 1.0, 1e-4, 0.0]])
    assert np.isneginf(posterior.log_density(x)).all()
    far = coordinates(posterior).to_physical(np.full((1, 7), 1e4))[0]
    assert np.isneginf(posterior.log_density(far)).all()
