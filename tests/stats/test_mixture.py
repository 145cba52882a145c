"""Mixtures of t laws: density, draws and fit."""

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import kstest, multivariate_normal, multivariate_t, t

from bayesterra.arrays import FloatArray
from bayesterra.stats.mixture import StudentMixture, fit_mixture, root, with_defensive_component

MIXTURE = StudentMixture(
    weights=np.array([0.7, 0.3]),
    means=np.array([[0.0, 1.0], [5.0, -2.0]]),
    factors=np.array([[[1.0, 0.0], [0.8, 0.5]], [[0.4, 0.0], [-0.3, 2.0]]]),
    dof=6.0,
)


def clusters(n: int, rng: np.random.Generator) -> FloatArray:
    """Two normal clusters, three quarters of the points in the first."""
    first = rng.random(n) < 0.75
    return np.where(first[:, None], 0.0, 8.0) + rng.standard_normal((n, 3)) * np.where(first[:, None], 1, 0.5)


def test_density_is_the_weighted_sum_of_t_densities() -> None:
    """The log density agrees with scipy's multivariate t law, far tails included."""
    points = np.random.default_rng(1).standard_normal((50, 2)) * np.logspace(-1, 4, 50)[:, None]
    parts = [
        multivariate_t(mean, factor @ factor.T, df=6.0).logpdf(points)
        for mean, factor in zip(MIXTURE.means, MIXTURE.factors, strict=True)
    ]
    expected = logsumexp(np.array(parts).T + np.log(MIXTURE.weights), axis=1)
    np.testing.assert_allclose(MIXTURE.log_density(points), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("dof", [3.0, 4.0, 4.5, 2000.0, np.inf])
def test_shares_and_densities_agree_by_products_and_by_logarithms(dof: float) -> None:
    """Whether or not a power is one of products, near or so far that none is left: densities, shares, distances."""
    mixture = StudentMixture(MIXTURE.weights, MIXTURE.means, MIXTURE.factors, dof)
    points = np.random.default_rng(1).standard_normal((60, 2)) * np.logspace(-1, 120, 60)[:, None]
    offsets = points[:, None] - mixture.means
    white = np.einsum("kij,nkj->nki", np.linalg.inv(mixture.factors), offsets)
    distances = (white**2).sum(axis=2)
    scale = [np.linalg.slogdet(factor)[1] for factor in mixture.factors]
    if np.isinf(dof):
        terms = -0.5 * distances - np.log(2 * np.pi)
    else:
        terms = -0.5 * (dof + 2) * np.log1p(distances / dof) - np.log(2 * np.pi)
    terms = terms - scale + np.log(mixture.weights)
    expected = logsumexp(terms, axis=1)
    level, shares, found = mixture.weighed(points)
    np.testing.assert_allclose(level, expected, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(mixture.log_density(points), expected, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(shares, np.exp(terms - expected[:, None]), rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(found, distances, rtol=1e-9)


def test_densities_beyond_numbers() -> None:
    """A point beyond all numbers has no density, and one that is no number none that is a number."""
    points = np.array([[0.0, 1.0], [1e200, 0.0], [np.nan, 0.0]])
    for density in (MIXTURE.log_density(points), MIXTURE.weighed(points)[0]):
        assert np.isfinite(density[0])
        assert density[1] == -np.inf
        assert np.isnan(density[2])


def test_draws_follow_the_density() -> None:
    """Means and covariances of draws are those of the law, and shares those of the weights."""
    draws = MIXTURE.sample(200_000, np.random.default_rng(2))
    spread = MIXTURE.factors @ MIXTURE.factors.swapaxes(1, 2) * 6.0 / 4.0
    mean = MIXTURE.weights @ MIXTURE.means
    offsets = MIXTURE.means - mean
    between = np.einsum("k,ki,kj->ij", MIXTURE.weights, offsets, offsets)
    covariance = np.einsum("k,kij->ij", MIXTURE.weights, spread) + between
    np.testing.assert_allclose(draws.mean(axis=0), mean, atol=0.04)
    np.testing.assert_allclose(np.cov(draws.T), covariance, rtol=0.05)


def test_draws_of_one_component_are_t_distributed() -> None:
    """A single component in one dimension passes a Kolmogorov–Smirnov test against scipy's t law."""
    one = StudentMixture(np.ones(1), np.array([[2.0]]), np.array([[[3.0]]]), 4.0)
    draws = one.sample(20_000, np.random.default_rng(3))[:, 0]
    assert kstest(draws, t(4.0, loc=2.0, scale=3.0).cdf).pvalue > 1e-3


def test_old_and_new_generators_serve() -> None:
    """The legacy generator that emcee hands over serves as well as the new one."""
    assert MIXTURE.sample(5, np.random.RandomState(1)).shape == (5, 2)
    assert MIXTURE.sample(5, np.random.default_rng(1)).shape == (5, 2)


def test_fit_finds_clusters_and_their_shares() -> None:
    """Mass, places and spread of two clusters are found by a fit with more components than clusters."""
    rng = np.random.default_rng(4)
    found = fit_mixture(clusters(4000, rng), np.full(4000, 1.0), 6, rng)
    near_first = np.linalg.norm(found.means, axis=1) < 4.0
    assert found.weights.sum() == pytest.approx(1.0)
    assert found.weights[near_first].sum() == pytest.approx(0.75, abs=0.03)
    fresh = clusters(4000, rng)
    # relative to the cost of t laws for normal clusters, the log density is nearly that of the truth
    exact = np.logaddexp(
        np.log(0.75) - 0.5 * (fresh**2).sum(axis=1),
        np.log(0.25) - 0.5 * (((fresh - 8.0) / 0.5) ** 2).sum(axis=1) - 3 * np.log(0.5),
    ) - 1.5 * np.log(2 * np.pi)
    assert np.mean(exact - found.log_density(fresh)) < 0.3


def test_weights_move_the_fit() -> None:
    """Points without weight do not count."""
    rng = np.random.default_rng(5)
    u = clusters(4000, rng)
    second = u[:, 0] > 4.0
    found = fit_mixture(u, second.astype(float), 4, rng)
    np.testing.assert_allclose(found.weights @ found.means, 8.0, atol=0.1)


def test_fit_does_not_depend_on_place_and_scale() -> None:
    """Shifted and stretched points give the shifted and stretched mixture."""
    u = clusters(1000, np.random.default_rng(6))
    scale, shift = np.array([1e-6, 1.0, 1e6]), np.array([1e3, 0.0, -1e7])
    plain = fit_mixture(u, np.full(1000, 1.0), 3, np.random.default_rng(7))
    moved = fit_mixture(shift + scale * u, np.full(1000, 1.0), 3, np.random.default_rng(7))
    np.testing.assert_allclose(
        moved.log_density(shift + scale * u), plain.log_density(u) - np.log(scale).sum(), atol=1e-5
    )


@pytest.mark.parametrize(
    "points",
    [
        np.repeat(np.random.default_rng(1).standard_normal((5, 3)), 100, axis=0),
        np.random.default_rng(2).standard_normal((500, 1)) @ np.ones((1, 3)),
        np.random.default_rng(3).standard_normal((500, 3)) * np.array([1.0, 0.0, 1.0]),
    ],
    ids=("copies", "a line", "one constant"),
)
def test_degenerate_points_give_a_proper_mixture(points: FloatArray) -> None:
    """Copies, points on a line and a constant coordinate still give finite densities and draws."""
    rng = np.random.default_rng(1)
    found = fit_mixture(points, np.full(len(points), 1.0), 8, rng)
    assert np.isfinite(found.log_density(points)).all()
    assert np.isfinite(found.sample(100, rng)).all()


def test_defence_covers_all_points_at_its_share() -> None:
    """The wide component has the share asked for, the others keep their proportions, nothing lies far out."""
    rng = np.random.default_rng(8)
    u = clusters(2000, rng)
    narrow = fit_mixture(u[u[:, 0] < 4.0], np.full((u[:, 0] < 4.0).sum(), 1.0), 2, rng)
    wide = with_defensive_component(narrow, u, np.full(2000, 1.0), 0.1)
    assert wide.weights[-1] == pytest.approx(0.1)
    np.testing.assert_allclose(wide.weights[:-1], 0.9 * narrow.weights)
    missed = u[u[:, 0] > 4.0]
    assert (wide.log_density(missed) - narrow.log_density(missed)).min() > 2.0
    assert wide.log_density(missed).min() > -15.0


def test_a_covariance_that_rounding_left_indefinite_has_a_factor() -> None:
    """Points on a ridge of no width; a sound covariance keeps its own, to the last bit."""
    sound = np.array([[2.0, 0.3], [0.3, 1.0]])
    np.testing.assert_array_equal(root(sound), np.linalg.cholesky(sound))
    flat = np.array([[1.0, 1.0 + 1e-12], [1.0 + 1e-12, 1.0]])
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(flat)
    for matrix in (flat, np.stack([sound, flat]), 1e-300 * flat, np.zeros((2, 2))):
        factor = root(matrix)
        np.testing.assert_allclose(factor @ np.swapaxes(factor, -1, -2), matrix, rtol=1e-2, atol=1e-280)
        assert (np.diagonal(factor, axis1=-2, axis2=-1) > 0).all()


def test_without_end_of_degrees_of_freedom_laws_are_normal() -> None:
    """Density and draws against scipy's; a fit with a floor finds thin clusters and no thinner ones."""
    mixture = StudentMixture(MIXTURE.weights, MIXTURE.means, MIXTURE.factors, np.inf)
    rng = np.random.default_rng(9)
    draws = mixture.sample(100_000, rng)
    parts = [
        multivariate_normal(mean, factor @ factor.T).logpdf(draws[:50])
        for mean, factor in zip(MIXTURE.means, MIXTURE.factors, strict=True)
    ]
    expected = logsumexp(np.array(parts).T + np.log(MIXTURE.weights), axis=1)
    np.testing.assert_allclose(mixture.log_density(draws[:50]), expected, atol=1e-10)
    between = np.cov(MIXTURE.means.T, aweights=MIXTURE.weights, ddof=0)
    within = np.einsum("k,kij,klj->il", MIXTURE.weights, MIXTURE.factors, MIXTURE.factors)
    np.testing.assert_allclose(np.cov(draws.T), within + between, rtol=0.03)
    thin = rng.standard_normal((4000, 2)) * np.array([0.05, 1.0])
    thin += rng.choice([-1.0, 1.0], 4000)[:, None] * np.array([1.0, 3.0])
    found = fit_mixture(thin, np.ones(4000), 2, rng, dof=np.inf, steps=200, gain=1e-7, floor=1e-4)
    np.testing.assert_allclose(np.sort(found.means[:, 0]), [-1.0, 1.0], atol=0.01)
    np.testing.assert_allclose(found.factors[:, 0, 0], 0.05, rtol=0.1)
    held = fit_mixture(thin, np.ones(4000), 2, rng, dof=np.inf, steps=200, gain=1e-7, floor=0.04)
    np.testing.assert_allclose(held.factors[:, 0, 0], 0.2 * thin[:, 0].std(), rtol=0.01)
