"""Components added where a proposal is too thin."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.random import default_rng
from scipy.stats import multivariate_normal

from bayesterra.arrays import FloatArray
from bayesterra.sampling.adaptation import _Places, add_components
from bayesterra.stats.mixture import StudentMixture
from bayesterra.stats.transport import Proposal, TransportMap

D = 3
MAIN = multivariate_normal(np.zeros(D), np.eye(D))
FAR = multivariate_normal(np.full(D, 4.0), 0.25 * np.eye(D))


def log_target(u: FloatArray) -> FloatArray:
    """A normal law, and a small narrow one apart from it; nothing beyond 8."""
    density = np.log(0.9 * MAIN.pdf(u) + 0.1 * FAR.pdf(u) + 1e-300)
    return np.where((u < 8.0).all(axis=1), density, -np.inf)


def thin() -> Proposal:
    """A proposal that knows of the normal law only, with a wide component of little weight."""
    curves, widths = (tuple(np.zeros(n) for n in numbers) for numbers in (_terms(), range(1, D + 1)))
    flat = TransportMap(tuple(range(D)), np.zeros(D), np.ones(D), curves, widths)
    factors = np.stack([1.1 * np.eye(D), 3.0 * np.eye(D)])
    return Proposal(flat, StudentMixture(np.array([0.95, 0.05]), np.zeros((2, D)), factors, 4.0))


def _terms() -> list[int]:
    return [1 + k + k * (k + 1) // 2 + k for k in range(D)]


def known(n: int, seed: int = 1) -> tuple[FloatArray, FloatArray, Callable[[FloatArray], FloatArray]]:
    """Draws of the thin proposal."""
    u = thin().sample(n, default_rng(seed))
    return u, log_target(u), log_target


def log_weights(proposal: Proposal, seed: int = 5) -> FloatArray:
    """Log importance weights of fresh draws."""
    u = proposal.sample(40_000, default_rng(seed))
    return np.asarray(log_target(u) - proposal.log_density(u))


def test_the_greatest_weights_shrink() -> None:
    """The part that was missed is proposed: a smaller greatest weight, more effective draws."""
    before = log_weights(thin())
    after = log_weights(add_components(thin(), *known(20_000), default_rng(2), components=8, draws=400))
    assert np.exp(before.max()) > 50
    assert np.exp(after.max()) < 0.2 * np.exp(before.max())
    shares = [np.exp(w).sum() ** 2 / np.exp(2 * w).sum() / len(w) for w in (before, after)]
    assert shares[1] > 2 * shares[0]


def test_further_points_all_over_the_prior_are_no_yardstick() -> None:
    """Scattered along one coordinate they leave the components as narrow there as without them."""
    rng = default_rng(7)
    scattered = rng.standard_normal((4000, D)) * [100.0, 1.0, 1.0]
    plain, further = (
        add_components(thin(), *known(20_000), default_rng(2), components=8, draws=400, further=more)
        for more in (None, (scattered, log_target(scattered)))
    )
    widths = [np.sqrt((each.mixture.factors[2:, 0] ** 2).sum(axis=-1)) for each in (plain, further)]
    assert len(widths[0]) == len(widths[1]) == 8
    assert widths[1].max() < 1.5 * widths[0].max()
    assert np.exp(log_weights(further).max()) < 1.5 * np.exp(log_weights(plain).max())


def test_the_shored_proposal_is_a_density() -> None:
    """Weights of the new proposal average to the integral of the target, with and without components."""
    for components in (0, 8):
        proposal = add_components(thin(), *known(5000), default_rng(2), components=components, draws=200)
        weights = np.exp(log_weights(proposal))
        error = weights.std() / np.sqrt(len(weights))
        inside = 0.9 * MAIN.cdf(np.full(D, 8.0)) + 0.1 * FAR.cdf(np.full(D, 8.0))
        assert abs(weights.mean() - inside) < 4 * error
        assert proposal.mixture.weights.sum() == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("components", "draws"), [(1, [300]), (6, [300] * 6), (17, [600] * 8 + [300]), (33, [1200] * 8 + [300])]
)
def test_components_are_added_in_rounds(components: int, draws: list[int]) -> None:
    """As many as asked for, an eighth at a time, four at most: the target sees the draws of a round together."""
    seen = list[int]()

    def watched(u: FloatArray) -> FloatArray:
        seen.append(len(u))
        return log_target(u)

    u, level, _ = known(3000)
    found = add_components(thin(), u, level, watched, default_rng(3), components=components, draws=300)
    assert len(found.mixture.weights) == len(thin().mixture.weights) + components
    assert found.mixture.weights.sum() == pytest.approx(1.0)
    assert seen == draws


@pytest.mark.parametrize(("points", "components", "greatest"), [(4096, 16, 3.0), (2048, 4, 40.0)])
def test_few_components_close_what_is_thin(points: int, components: int, greatest: float) -> None:
    """In the sizes of short runs and of groups every component counts, so none is set before the last one's draws."""
    after = log_weights(add_components(thin(), *known(points), default_rng(2), components=components, draws=128))
    assert np.exp(after.max()) < greatest


def test_no_components_change_nothing() -> None:
    """With none to add the proposal is handed back."""
    proposal = thin()
    assert add_components(proposal, *known(100), default_rng(1), components=0, draws=50) is proposal


def test_components_stand_inside_the_support() -> None:
    """No component is centred where the target has no density, and the draws decide, not the order."""
    found = add_components(thin(), *known(3000), default_rng(3), components=6, draws=300)
    centres = found.mixture.means[2:]
    assert np.isfinite(log_target(centres)).all()
    again = add_components(thin(), *known(3000), default_rng(3), components=6, draws=300)
    np.testing.assert_array_equal(found.mixture.means, again.mixture.means)


def test_components_end_where_no_place_is_thin() -> None:
    """Five looks in a row at no greater weight are the last; each component weighs what it would among all."""
    proposals = [
        add_components(thin(), *known(20_000), default_rng(2), components=160, draws=100, enough=enough)
        for enough in (np.inf, 1.0, -np.inf)
    ]
    numbers = [len(proposal.mixture.weights) - 2 for proposal in proposals]
    assert numbers[0] == 4 * 4
    assert 16 < numbers[1] < 160
    assert numbers[2] == 160
    for proposal, number in zip(proposals, numbers, strict=True):
        weight = 0.2 / 160
        np.testing.assert_allclose(proposal.mixture.weights[2:], weight / (0.8 + number * weight))
        assert proposal.mixture.weights.sum() == pytest.approx(1.0)
    assert log_weights(proposals[1]).max() < 1.5 < log_weights(thin()).max()


def test_a_thin_place_begins_the_count_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four looks at nothing thin, one at a thin place, five at nothing: the tenth ends it, nine calls of four in."""
    seen = iter([0.0] * 4 + [2.0] + [0.0] * 155)
    monkeypatch.setattr(_Places, "greatest", property(lambda places: next(seen)))
    found = add_components(thin(), *known(2000), default_rng(2), components=160, draws=50, enough=1.0)
    assert len(found.mixture.weights) == len(thin().mixture.weights) + 9 * 4
