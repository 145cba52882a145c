"""Dependence of normal scores: mixture copulas against quadrature, draws, differences and Gaussian ones."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.random import default_rng
from scipy.special import ndtr, ndtri
from scipy.stats import ks_2samp, kstest, norm, qmc

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError
from bayesterra.stats.dependence import GaussianCopula, JoinedDependence, MixtureCopula

BENT = MixtureCopula.of(
    np.array([0.4, 0.35, 0.25]),
    np.array([[-1.0, 0.8, 0.0], [0.0, -0.7, 0.2], [1.1, 0.6, -0.3]]),
    np.array(
        [
            [[0.4, -0.3, 0.1], [-0.3, 0.3, 0.0], [0.1, 0.0, 1.0]],
            [[0.3, 0.0, 0.0], [0.0, 0.05, 0.02], [0.0, 0.02, 0.7]],
            [[0.4, 0.3, 0.1], [0.3, 0.3, 0.05], [0.1, 0.05, 0.9]],
        ]
    ),
)
"""A ridge in the first two scores that bends, and a third one beside it."""
R = np.array([[1.0, 0.5, 0.2], [0.5, 1.0, 0.3], [0.2, 0.3, 1.0]])


def scores(n: int, seed: int = 1) -> FloatArray:
    """Scores (n, 3) by the conditional laws."""
    return BENT.completed(np.empty((n, 0)), default_rng(seed).standard_normal((n, 3)))


def joint(z: FloatArray) -> FloatArray:
    """Log joint density of scores."""
    return np.asarray(BENT.log_density(z) + norm.logpdf(z).sum(axis=1))


def test_the_density_integrates_to_one_and_to_standard_normal_scores() -> None:
    """Over the plane of two scores; over either alone the normal density is left, as exact as sums are."""
    plane, axis = BENT.marginal([0, 1]), np.linspace(-7.0, 7.0, 401)
    grid = np.column_stack([g.ravel() for g in np.meshgrid(axis, axis)])
    density = np.exp(plane.log_density(grid) + norm.logpdf(grid).sum(axis=1)).reshape(401, 401)
    step = axis[1] - axis[0]
    assert density.sum() * step**2 == pytest.approx(1.0, abs=1e-8)
    for other in (0, 1):
        np.testing.assert_allclose(density.sum(axis=other) * step, norm.pdf(axis), atol=1e-7)


def test_conditional_draws_and_draws_of_the_mixture_have_one_law() -> None:
    """Each score is standard normal; along, across and around the bend both kinds agree, and the density."""
    z, direct = scores(40_000), BENT.sample(40_000, default_rng(2))
    for i in range(3):
        assert kstest(z[:, i], norm.cdf).pvalue > 1e-3
        assert kstest(direct[:, i], norm.cdf).pvalue > 1e-3
    along, alike = (
        np.column_stack([part @ default_rng(9).standard_normal((3, 4)), part[:, 0] ** 2 - part[:, 1]])
        for part in (z, direct)
    )
    for ours, theirs in zip(along.T, alike.T, strict=True):
        assert ks_2samp(ours, theirs).pvalue > 1e-3
    independent = default_rng(3).standard_normal((200_000, 3))
    ratio = np.exp(BENT.log_density(independent))
    bend = np.abs(independent[:, 0]) - independent[:, 1]
    for value, weighed in (((z[:, 1] < -1.0).mean(), independent[:, 1] < -1.0),
                           ((np.abs(z[:, 0]) - z[:, 1] < 0.0).mean(), bend < 0.0)):  # fmt: skip
        error = (ratio * weighed).std() / np.sqrt(len(ratio)) + 0.5 / np.sqrt(len(z))
        assert (ratio * weighed).mean() == pytest.approx(value, abs=4.5 * error)
    assert (bend < 0.0).mean() > (np.abs(z[:, 0]) - z[:, 1] < 0.0).mean() + 0.05  # the bend is there


def test_the_unit_cube_is_mapped_with_the_density() -> None:
    """|dz/du| times the density is 1, at evenly spread points of the cube: Jacobian by differences."""
    u, step = 0.02 + 0.96 * qmc.Sobol(3, seed=1).random(64), 1e-6
    z = BENT.completed(np.empty((64, 0)), ndtri(u))
    jacobian = np.zeros((64, 3, 3))
    for i, unit in enumerate(np.eye(3)):
        ahead, behind = (BENT.completed(np.empty((64, 0)), ndtri(u + sign * step * unit)) for sign in (1, -1))
        jacobian[:, :, i] = (ahead - behind) / (2 * step)
    assert np.abs(np.triu(jacobian, 1)).max() == 0.0
    np.testing.assert_allclose(joint(z) + np.linalg.slogdet(jacobian)[1], 0.0, atol=1e-5)


def test_scores_given_others_are_those_of_the_whole() -> None:
    """The last scores completed from the first are what the whole map gives."""
    normal = default_rng(4).standard_normal((500, 3))
    z = BENT.completed(np.empty((500, 0)), normal)
    for k in (1, 2):
        np.testing.assert_allclose(BENT.completed(z[:, :k], normal[:, k:]), z[:, k:], atol=1e-7)


def test_slope_and_curvature_are_those_of_the_density() -> None:
    """Against differences; where the density is not concave the curvature has no negative part."""
    z, h, units = scores(300), 1e-4, np.eye(3)
    slope, curvature = BENT.slope_and_curvature(z)
    by_step = [(BENT.log_density(z + h * e) - BENT.log_density(z - h * e)) / (2 * h) for e in units]
    np.testing.assert_allclose(slope, np.stack(by_step, axis=1), atol=1e-4)

    def second(a: FloatArray, b: FloatArray) -> FloatArray:
        ends = ((1, a + b), (-1, a - b), (-1, b - a), (1, -a - b))
        return np.asarray(sum(sign * joint(z + h * end) for sign, end in ends) / (4 * h**2))

    hessian = -np.stack([np.stack([second(a, b) for a in units], axis=1) for b in units], axis=2)
    convex = np.linalg.eigvalsh(hessian)[:, 0] > 0.01
    assert 100 < convex.sum() < 300
    np.testing.assert_allclose(curvature[convex], hessian[convex], atol=5e-3)
    assert np.linalg.eigvalsh(curvature)[:, 0].min() > -1e-9


def test_one_component_is_the_gaussian_copula() -> None:
    """Density, draws, slopes, conditionals."""
    one, gaussian = MixtureCopula.of(np.ones(1), np.zeros((1, 3)), R[None]), GaussianCopula(R)
    z = default_rng(5).standard_normal((100, 3))
    np.testing.assert_allclose(one.log_density(z), gaussian.log_density(z), atol=1e-12)
    for k in (0, 1, 2):
        pair = [d.completed(z[:, :k], z[:, k:]) for d in (one, gaussian)]
        np.testing.assert_allclose(pair[0], pair[1], atol=1e-10)
    for ours, theirs in zip(one.slope_and_curvature(z), gaussian.slope_and_curvature(z), strict=True):
        np.testing.assert_allclose(ours, np.broadcast_to(theirs, ours.shape), atol=1e-10)
    np.testing.assert_allclose(one.correlation, R, atol=0.02)


def test_no_row_depends_on_the_others_and_far_scores_are_finite() -> None:
    """Batches of any size give the same bits; so do scores that no number of draws reaches."""
    z = scores(50)
    whole, drawn = BENT.log_density(z), BENT.completed(np.empty((50, 0)), z)
    for n in (1, 7):
        np.testing.assert_array_equal(BENT.log_density(z[:n]), whole[:n])
        np.testing.assert_array_equal(BENT.completed(np.empty((n, 0)), z[:n]), drawn[:n])
    far = np.array([[1e100, -1e100, 0.0], [37.0, -37.0, 3.0], [-300.0, 2.0, 1.0], [9.0, 9.0, -9.0]])
    assert np.isfinite(BENT.log_density(far)).all()
    assert np.isfinite(BENT.completed(np.empty((4, 0)), far)).all()
    assert all(np.isfinite(part).all() for part in BENT.slope_and_curvature(far))


@pytest.mark.parametrize("order", [[0, 1, 2, 3, 4], [4, 1, 3, 0, 2]])
@pytest.mark.parametrize("shared", [0, 1, 3])
def test_sets_beside_each_other_split_as_any_dependence(order: Sequence[int], shared: int) -> None:
    """A mixture and a Gaussian copula in one: density, conditional draws, what groups share."""
    pair = GaussianCopula(np.array([[1.0, -0.7], [-0.7, 1.0]]))
    both = JoinedDependence((((0, 2, 3), BENT), ((1, 4), pair)))
    z = default_rng(6).standard_normal((40, 5))
    expected = BENT.log_density(z[:, [0, 2, 3]]) + pair.log_density(z[:, [1, 4]])
    np.testing.assert_allclose(both.log_density(z), expected, rtol=1e-12)
    moved = both.marginal(order)
    np.testing.assert_allclose(moved.log_density(z[:, order]), expected, atol=1e-10)
    np.testing.assert_allclose(moved.correlation, both.correlation[np.ix_(order, order)], atol=0.02)
    split = moved.split(shared)
    z = z[:, order]
    np.testing.assert_allclose(split.log_shared(z[:, :shared]) + split.log_own(z[:, :shared], z[:, shared:]),
                               expected, atol=1e-10)  # fmt: skip
    common = split.first(default_rng(7).standard_normal((20_000, shared)))
    normal = default_rng(8).standard_normal((20_000, len(order) - shared))
    drawn = np.concatenate([common, split.completed(common, normal)], axis=1)
    for column in drawn.T:
        assert kstest(column, norm.cdf).pvalue > 1e-3
    np.testing.assert_allclose(np.corrcoef(drawn.T), moved.correlation, atol=0.03)


def test_marginal_laws_are_exact_far_out() -> None:
    """Latent values found from scores give these scores back, from −36 to 36."""
    z = np.linspace(-36.0, 36.0, 2001)
    for law in BENT._marginals:
        np.testing.assert_allclose(law.score(law.at_score(z)), z, atol=1e-9)
        y = law.at_score(z[900:1101])
        below = ndtr((y[:, None] - law.means) / law.sds) @ np.exp(law.log_weights[0])
        np.testing.assert_allclose(below, ndtr(z[900:1101]), rtol=1e-12)


ONE = ((1.0, 0.2), (0.2, 1.0))
WRONG = {
    "lengths": ((1.0,), ((0.0, 0.0),) * 2, (ONE,), r"k rows of d .* \(got 1 weights, 2 means and 1 cov"),
    "ragged": ((0.5, 0.5), ((0.0, 0.0), (0.0,)), (ONE, ONE), "k numbers, k rows of d"),
    "sum": ((0.5, 0.6), ((0.0, 0.0),) * 2, (ONE, ONE), r"sum to 1 \(got the sum 1.1\)"),
    "negative": ((-0.5, 1.5), ((0.0, 0.0),) * 2, (ONE, ONE), "'weights' must be above 0"),
    "indefinite": ((0.5, 0.5), ((0.0, 0.0),) * 2, (ONE, ((1.0, 2.0), (2.0, 1.0))),
        r"eigenvalues above 0 \(got -1 as the least one of matrix 2\)"),
    "not symmetric": ((1.0,), ((0.0, 0.0),), (((1.0, 0.2), (0.1, 1.0)),), "must be symmetric"),
    "not finite": ((1.0,), ((0.0, 0.0),), (((1.0, np.nan), (np.nan, 1.0)),), "must be symmetric"),
    "far": ((1.0,), ((0.0, 50.0),), (ONE,), "'means' must lie within ±37"),
}  # fmt: skip


@pytest.mark.parametrize(("weights", "means", "covariances", "message"), WRONG.values(), ids=WRONG)
def test_mixtures_that_cannot_be_are_refused(
    weights: tuple[float, ...],
    means: tuple[tuple[float, ...], ...],
    covariances: tuple[tuple[tuple[float, ...], ...], ...],
    message: str,
) -> None:
    """One line with the rule and what was found."""
    with pytest.raises(StudyError, match=message) as caught:
        MixtureCopula(weights, means, covariances)
    assert "\n" not in str(caught.value)
