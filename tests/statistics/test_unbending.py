"""The map that straightens ridges: exact, volume-keeping up to a constant, and good at its job."""

import numpy as np
import pytest
from numpy.random import default_rng

from bayesterra.arrays import FloatArray
from bayesterra.sampling.mixture import fit_mixture
from bayesterra.sampling.unbending import REACH, Proposal, Unbending, fit_proposal, fit_unbending


def ridge(n: int, seed: int = 1) -> FloatArray:
    """Points (n, 3) on a curved ridge: the second follows the first, the third follows both."""
    z = default_rng(seed).standard_normal((n, 3))
    z[:, 1] = 0.05 * z[:, 1] + z[:, 0] ** 2 - 0.3 * z[:, 0]
    z[:, 2] = 0.02 * z[:, 2] + 0.5 * z[:, 0] * z[:, 1] + 2.0
    return z


@pytest.fixture(scope="module")
def unbending() -> Unbending:
    """The map fitted to the ridge."""
    return fit_unbending(ridge(4000), np.full(4000, 1.0), np.array([1.0, 10.0, 10.0]))


def test_the_map_is_invertible_everywhere(unbending: Unbending) -> None:
    """Straightening and bending undo each other, also far outside the points."""
    u = np.vstack([ridge(200, 2), 30.0 * default_rng(3).standard_normal((200, 3))])
    np.testing.assert_allclose(unbending.bend(unbending.straighten(u)), u, atol=1e-9)


def test_the_jacobian_is_the_constant_it_says(unbending: Unbending) -> None:
    """Central differences give the same log determinant at every point."""
    h = 1e-5
    for u in ridge(5, 4):
        columns = [
            (unbending.straighten(u[None] + h * e) - unbending.straighten(u[None] - h * e))[0] / (2 * h)
            for e in np.eye(3)
        ]
        assert np.linalg.slogdet(np.array(columns))[1] == pytest.approx(-unbending.log_scale, abs=1e-6)


def test_ridges_become_straight(unbending: Unbending) -> None:
    """What follows from other coordinates is gone: a narrow, uncorrelated remainder is left."""
    v = unbending.straighten(ridge(4000, 5))
    assert unbending.order[0] == 0  # the coordinate that the points leave as wide as it was drives the others
    assert v[:, 1].std() < 0.1
    assert v[:, 2].std() < 0.1
    assert np.abs(np.corrcoef(np.column_stack([v[:, 1:], v[:, :1] ** 2]).T) - np.eye(3)).max() < 0.1


def test_far_out_the_map_only_shifts(unbending: Unbending) -> None:
    """Beyond its reach a coordinate bends the others no further."""
    u = np.zeros((2, 3))
    u[:, 0] = unbending.centre[0] + unbending.scale[0] * np.array([REACH, 10 * REACH])
    first, second = unbending.straighten(u)
    np.testing.assert_allclose(first[1:], second[1:], atol=1e-12)


def test_a_proposal_draws_from_the_density_it_states() -> None:
    """Importance weights of one proposal against another average to one."""
    points = ridge(3000, 6)
    narrow, wide = (
        fit_proposal(points, np.full(3000, 1.0), np.full(3, 1.0), k, share, default_rng(7))
        for k, share in ((8, 0.1), (2, 0.5))
    )
    drawn = wide.sample(40_000, default_rng(8))
    weights = np.exp(narrow.log_density(drawn) - wide.log_density(drawn))
    assert weights.mean() == pytest.approx(1.0, abs=4 * weights.std() / 200)


def test_straightening_makes_better_proposals() -> None:
    """On a curved ridge the proposal fits fresh points better than the same mixture without the map."""
    points, fresh = ridge(3000, 9), ridge(3000, 10)
    bent = fit_proposal(points, np.full(3000, 1.0), np.array([1.0, 10.0, 10.0]), 4, 0.05, default_rng(1))
    none = Unbending(
        (0, 1, 2), np.zeros(3), np.ones(3), tuple(np.zeros(1 + 2 * k + k * (k + 1) // 2) for k in range(3))
    )
    np.testing.assert_array_equal(none.straighten(fresh), fresh)
    plain = Proposal(none, fit_mixture(points, np.full(3000, 1.0), 4, default_rng(1)))
    assert bent.log_density(fresh).mean() > plain.log_density(fresh).mean() + 0.5
