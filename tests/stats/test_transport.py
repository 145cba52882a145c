"""The map that straightens ridges: exact, with the Jacobian it states, and good at its job."""

import numpy as np
import pytest
from numpy.random import default_rng

from bayesterra.arrays import FloatArray
from bayesterra.stats.mixture import fit_mixture
from bayesterra.stats.transport import REACH, Proposal, TransportMap, fit_proposal, fit_transport_map


def ridge(n: int, seed: int = 1) -> FloatArray:
    """Points (n, 3) on a curved ridge: the second follows the first, the third follows both."""
    z = default_rng(seed).standard_normal((n, 3))
    z[:, 1] = 0.05 * z[:, 1] + z[:, 0] ** 2 - 0.3 * z[:, 0]
    z[:, 2] = 0.02 * z[:, 2] + 0.5 * z[:, 0] * z[:, 1] + 2.0
    return z


@pytest.fixture(scope="module")
def transport_map() -> TransportMap:
    """The map fitted to the ridge."""
    return fit_transport_map(ridge(4000), np.full(4000, 1.0), np.array([1.0, 10.0, 10.0]))


def funnel(n: int, seed: int = 1) -> FloatArray:
    """Points (n, 3): the log of the width of the others, as an estimated noise is, and two such others."""
    z = default_rng(seed).standard_normal((n, 3))
    z[:, 1:] *= 0.1 * np.exp(0.7 * z[:, :1])
    z[:, 2] += 2.0 * z[:, 1]
    return z


@pytest.fixture(scope="module")
def evening() -> TransportMap:
    """The map fitted to the funnel."""
    return fit_transport_map(funnel(4000), np.full(4000, 1.0), np.array([1.0, 10.0, 10.0]))


def test_the_map_is_invertible_everywhere(transport_map: TransportMap, evening: TransportMap) -> None:
    """Straightening and bending undo each other, also far outside the points, and so do their Jacobians."""
    u = np.vstack([ridge(200, 2), 30.0 * default_rng(3).standard_normal((200, 3))])
    for one in (transport_map, evening):
        v, log_jacobian = one.inverse(u)
        back, same = one.forward(v)
        np.testing.assert_allclose(back, u, atol=1e-9)
        np.testing.assert_allclose(same, log_jacobian, atol=1e-9)


def test_the_jacobian_is_what_it_says(transport_map: TransportMap, evening: TransportMap) -> None:
    """Central differences give the same log determinant at every point."""
    for one, points in ((transport_map, ridge(5, 4)), (evening, funnel(5, 4))):
        for u in points:
            steps = 1e-6 * np.eye(3)
            ahead, behind = (one.inverse(u + sign * steps)[0] for sign in (1, -1))
            _, expected = one.inverse(u[None])
            assert np.linalg.slogdet((ahead - behind) / 2e-6)[1] == pytest.approx(-expected[0], abs=1e-5)


def test_ridges_become_straight(transport_map: TransportMap) -> None:
    """What follows from other coordinates is gone: an uncorrelated remainder of about unit width is left."""
    v, _ = transport_map.inverse(ridge(4000, 5))
    assert transport_map.order[0] == 0  # the coordinate that the points leave as wide as it was drives the others
    np.testing.assert_allclose(v.std(axis=0), 1.2, atol=0.2)
    assert np.abs(np.corrcoef(np.column_stack([v[:, 1:], v[:, :1] ** 2]).T) - np.eye(3)).max() < 0.1


def test_what_widens_becomes_even(evening: TransportMap) -> None:
    """The spread of the straight coordinates is the same at both ends of the coordinate that rules it."""
    v, _ = evening.inverse(funnel(8000, 5))
    upper = v[:, 0] > 0.5
    lower = v[:, 0] < -0.5
    np.testing.assert_allclose(v[upper, 1:].std(axis=0) / v[lower, 1:].std(axis=0), 1.0, atol=0.15)


def test_far_out_the_map_only_shifts(transport_map: TransportMap) -> None:
    """Beyond its reach a coordinate bends the others no further."""
    u = np.zeros((2, 3))
    u[:, 0] = transport_map.centre[0] + transport_map.scale[0] * np.array([REACH, 10 * REACH])
    first, second = transport_map.inverse(u)[0]
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
    curves = tuple(np.zeros(1 + 2 * k + k * (k + 1) // 2) for k in range(3))
    widths = tuple(np.zeros(1 + k) for k in range(3))
    none = TransportMap((0, 1, 2), np.zeros(3), np.ones(3), curves, widths)
    np.testing.assert_array_equal(none.inverse(fresh)[0], fresh)
    plain = Proposal(none, fit_mixture(points, np.full(3000, 1.0), 4, default_rng(1)))
    assert bent.log_density(fresh).mean() > plain.log_density(fresh).mean() + 0.5
