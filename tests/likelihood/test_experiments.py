"""Curves, likelihood, derivatives and coordinates of soil tests, each held against another way to compute it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.random import default_rng
from scipy.stats import kstest, multivariate_normal, uniform

from bayesterra.identifiability.structure import structure
from bayesterra.likelihood.experiments import Scatter, Spread, covariance, marginal_sd
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.likelihood.sensitivities import score_and_information, weighted_sensitivities
from bayesterra.likelihood.target import Target, chart
from bayesterra.sampling.coordinates import coordinates
from bayesterra.stats.laws import Law
from bayesterra.study.study import Study
from tests.support.soil_tests import both, plates, shear


@pytest.mark.parametrize("spread", ["memory", "seating", "independent"])
def test_the_likelihood_is_that_of_the_stated_covariance(spread: str) -> None:
    """The one-pass likelihood against SciPy's multivariate normal law of every test."""
    readings = posterior(plates()).experiments[0].readings
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
    readings = posterior(plates((0.03,), tests=1, readings=4)).experiments[0].readings
    n = 40_000
    values = Spread(np.full(n, 0.2), np.full(n, 1.0), np.full(n, 5e-4))
    drawn = Scatter(readings).deviations(values, default_rng(3))
    one = Spread(*(part[:1] for part in (values.scatter, values.memory, values.shift) if part is not None))
    np.testing.assert_allclose(np.cov(drawn.T), covariance(readings.path, one)[0], atol=1.5e-3)


DESIGNS: dict[str, Callable[[], Study]] = {
    "plates": plates, "one radius": lambda: plates((0.03,)), "shear": shear, "one stress": lambda: shear((5e3,)),
    "independent": lambda: shear(noise={"independent": True}), "both": both,
    "both, at a sinkage": lambda: both(reference=True), "with a ring": lambda: both(ring=True),
}  # fmt: skip


@pytest.fixture(params=DESIGNS, scope="module")
def study(request: pytest.FixtureRequest) -> Study:
    """Plates and rings, alone and beside a wheel."""
    return DESIGNS[request.param]()


def test_the_log_density_is_the_sum_of_its_parts(study: Study) -> None:
    """Prior, wheel and each series of tests, from parts that know nothing of each other."""
    whole = posterior(study)
    x = draw_cut_prior(whole, 20, default_rng(1)).x
    parts = [experiment.log_likelihood(x) for experiment in whole.experiments]
    if study.wheels:
        alone = replace(whole, experiments=())
        parts.append(alone.likelihood.log_likelihood(alone.prior.soil_values(x), alone.noise_values(x)))
    np.testing.assert_allclose(whole.log_density(x), whole.prior.log_density(x) + np.sum(parts, axis=0), rtol=1e-12)
    np.testing.assert_allclose(
        whole.log_before(x), whole.prior.log_density(x) + np.sum(parts[: len(whole.experiments)], axis=0), rtol=1e-12
    )


def test_gradient_and_information_are_those_of_differences(study: Study) -> None:
    """The gradient of the log likelihood; the information as the product of the sensitivities."""
    whole = posterior(study)
    x = draw_cut_prior(whole, 6, default_rng(1)).x
    gradient, information = score_and_information(whole, x)
    for i in range(x.shape[1]):
        step = np.where(np.arange(x.shape[1]) == i, 1e-6 * np.abs(x), 0.0)
        ends = [whole.log_prior_and_likelihood(x + sign * step)[1] for sign in (1, -1)]
        np.testing.assert_allclose(gradient[:, i], (ends[0] - ends[1]) / (2 * step[:, i]), rtol=2e-3)
    rows = weighted_sensitivities(whole, x)
    size = np.sqrt(np.einsum("nii,njj->nij", information, information))
    np.testing.assert_allclose((rows.transpose(0, 2, 1) @ rows) / size, information / size, atol=1e-9)


def test_information_is_the_covariance_of_the_gradient() -> None:
    """Of readings simulated from one parameter set, the scatter's share too."""
    whole = posterior(plates((0.03,), tests=1, readings=5))
    x = draw_cut_prior(whole, 1, default_rng(4)).x
    rng, gradients = default_rng(5), []
    series = whole.experiments[0]
    for stress in series.draw(np.repeat(x, 2000, axis=0), rng):
        test = replace(series.test, readings=replace(series.readings, stress=stress))
        drawn = replace(whole, experiments=(replace(series, test=test),))
        gradients.append(score_and_information(drawn, x)[0][0])
    expected = score_and_information(whole, x)[1][0]
    size = np.sqrt(np.outer(np.diagonal(expected), np.diagonal(expected)))
    np.testing.assert_allclose(np.cov(np.array(gradients).T) / size, expected / size, atol=0.12)


def test_coordinates_are_exact(study: Study) -> None:
    """There and back, and the Jacobian is that of differences."""
    whole = posterior(study)
    x = draw_cut_prior(whole, 30, default_rng(1)).x
    chart_of = coordinates(whole)
    u = chart_of.from_physical(x)
    back, log_jacobian = chart_of.to_physical(u)
    np.testing.assert_allclose(back, x, rtol=1e-6)
    steps = 1e-5 * np.eye(u.shape[1])
    columns = [(chart_of.to_physical(u + step)[0] - chart_of.to_physical(u - step)[0]) / 2e-5 for step in steps]
    determinants = np.linalg.slogdet(np.stack(columns, axis=2))[1]
    np.testing.assert_allclose(log_jacobian, determinants, atol=1e-4)


def test_the_optimisers_slope_is_that_of_its_value(study: Study) -> None:
    """With the prior, also where laws of moduli are stated at a sinkage."""
    whole = posterior(study)
    target = Target(whole, chart(whole), with_prior=True, anchor=None)
    y = target.chart.from_physical(draw_cut_prior(whole, 6, default_rng(1)).x)
    slope = target.local(y).slope
    for i, step in enumerate(1e-7 * np.eye(y.shape[1])):
        found = (target.value(y + step) - target.value(y - step)) / 2e-7
        inside = np.isfinite(found)
        np.testing.assert_allclose(slope[inside, i], found[inside], rtol=2e-3, atol=1e-3 * np.abs(found[inside]).max())


def test_moduli_stated_at_a_sinkage_do_not_favour_an_exponent() -> None:
    """Draws and density: n keeps its own law, and the parts of the pressure are uniform."""
    prior = plates().prior
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
    """k_c and k_φ under one radius, c and φ under one stress; a wheel beside one radius parts the moduli."""
    for made, one, other, lost in ((plates, (0.03,), (0.03, 0.06), 2), (shear, (5e3,), (5e3, 15e3), 2)):
        for levels, missing in ((one, lost), (other, 0)):
            study = made(levels)
            whole = posterior(study)
            seen = structure(whole, draw_cut_prior(whole, 100, default_rng(1)).x)
            assert len(study.prior.names) - len(seen.determined) == missing
            if missing:
                word = "all plates have the radius 30 mm" if made is plates else "all tests the normal stress 5 kPa"
                assert word in seen.nulls[0].words
    whole = posterior(both())
    seen = structure(whole, draw_cut_prior(whole, 100, default_rng(1)).x)
    assert seen.determined == whole.names


def test_far_proposals_have_no_density_and_raise_no_warning() -> None:
    """Coordinates far out overflow; they are outside the support, silently."""
    whole = posterior(plates())
    x = np.array([[1e300, -1e308, 5.0, 0.1, 1.0, 1e-4, 0.0], [np.inf, np.nan, 1.0, 0.1, 1.0, 1e-4, 0.0]])
    assert np.isneginf(whole.log_density(x)).all()
    far = coordinates(whole).to_physical(np.full((1, 7), 1e4))[0]
    assert np.isneginf(whole.log_density(far)).all()


def test_moduli_at_a_sinkage_have_a_chart_where_the_exponent_is_open() -> None:
    """Its ends are those of all but 1e-4 of its law on either side; a profile needs numbers."""
    density = posterior(both(reference=True, priors={"n0": Law("norm", {"loc": 1.0, "scale": 0.2})}))
    drawn = chart(density)
    assert np.isfinite(drawn.ends).all()
    low, high = drawn.ends[density.names.index("kphi")]
    assert (low, high) == pytest.approx((-50e3 * 0.01**-1.74, 50e3 * 0.01**-1.74), rel=0.02)
