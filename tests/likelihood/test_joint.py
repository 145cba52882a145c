"""The joint posterior: its density, its draws and its evidence beside sums over a grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.random import SeedSequence, default_rng
from scipy.special import logsumexp

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.joint import JointPosterior, draw_joint_prior, joint_posterior
from bayesterra.likelihood.posterior import draw_cut_prior
from bayesterra.pooling.evidence import weigh_joint
from bayesterra.sampling.family import JointFamily
from bayesterra.sampling.joint import JointSamples, PoolingOptions, sample_joint, starting_points
from bayesterra.sampling.moves import Walkers
from bayesterra.stats.laws import draw_population, log_population
from bayesterra.study.study import Study

MakeStudy = Callable[..., Study]


@pytest.fixture(scope="module")
def joint(make: MakeStudy) -> JointPosterior:
    """φ shared, K of each wheel from a population."""
    return joint_posterior(make())


@pytest.fixture(scope="module")
def samples(make: MakeStudy, joint: JointPosterior, small: PoolingOptions) -> JointSamples:
    """Draws of it."""
    return sample_joint(joint, make().sampling, SeedSequence(1), plan=small)


@dataclass(frozen=True)
class _Exact:
    """Sums over a grid of φ, K of each wheel, mean and spread of K.

    Attributes
    ----------
    log_z, without_first : log evidence of both wheels, and of the second alone.
    mean, sd : of φ, mean and spread of K.
    """

    log_z: float
    without_first: float
    mean: FloatArray
    sd: FloatArray

    @classmethod
    def of(cls, joint: JointPosterior, grid: Callable[[float, float, int], FloatArray]) -> _Exact:
        law, (mean_law, spread_law) = joint.laws["phi"], joint.hyper["K"]
        phi, K = grid(*law.range, 120), grid(*joint.laws["K"].range, 300)
        means, spreads = (
            grid(*joint.laws["K"].range, 100),
            grid(0.0, float(spread_law.quantile(np.array(0.9999))), 120),
        )
        m, tau = (part.ravel() for part in np.meshgrid(means, spreads, indexing="ij"))
        population = np.exp(log_population(K, m[:, None], tau[:, None], joint.laws["K"].range))
        both = np.stack(np.meshgrid(phi, K, indexing="ij"), axis=-1).reshape(-1, 2)
        levels = []
        for group in joint.groups:
            level = joint.log_likelihood_of_group(group, both[:, :1], both[:, 1:]).reshape(len(phi), len(K))
            top = level.max()
            summed = np.exp(level - top) @ population.T * (K[1] - K[0])
            levels.append(np.log(np.maximum(summed, 1e-300)) + top)
        cell = np.log((phi[1] - phi[0]) * (means[1] - means[0]) * (spreads[1] - spreads[0]))
        prior = law.log_density(phi)[:, None] + mean_law.log_density(m) + spread_law.log_density(tau) + cell
        total = prior + levels[0] + levels[1]
        weights = np.exp(total - logsumexp(total))
        at = np.stack(np.broadcast_arrays(phi[:, None], m, tau))
        mean = (weights * at).sum(axis=(1, 2))
        sd = np.sqrt((weights * at**2).sum(axis=(1, 2)) - mean**2)
        return cls(float(logsumexp(total)), float(logsumexp(prior + levels[1])), mean, sd)


@pytest.fixture(scope="module")
def exact(joint: JointPosterior, grid: Callable[[float, float, int], FloatArray]) -> _Exact:
    """Sums over a grid."""
    return _Exact.of(joint, grid)


def test_names_read_as_they_are_meant(joint: JointPosterior) -> None:
    """Drivers first, then the groups in turn."""
    assert joint.names == ("phi", "K.mean", "K.spread", "K[Wh11]", "K[Wh32]")


@pytest.mark.slow
def test_draws_have_the_posterior(samples: JointSamples, exact: _Exact) -> None:
    """Shared parameter, mean and spread of the population."""
    assert samples.diagnosis.converged
    flat = samples.chains.reshape(-1, samples.chains.shape[-1])[:, :3]
    z = (flat.mean(axis=0) - exact.mean) / exact.sd * np.sqrt(samples.diagnosis.ess_bulk[:3])
    assert np.abs(z).max() < 4.5
    np.testing.assert_allclose(flat.std(axis=0), exact.sd, rtol=0.06)


@pytest.mark.slow
def test_evidence_of_all_and_without_a_wheel(samples: JointSamples, exact: _Exact) -> None:
    """Both from the same importance draws; errors as stated."""
    weighed = weigh_joint(samples, default_rng(0), outer=2048, inner=8)
    found = weighed.evidence
    assert found.reliable
    assert found.error < 0.05
    assert abs(found.log_z - exact.log_z) < 4.5 * found.error + 0.005
    left = weighed.left_out(0)
    assert abs(left.elpd - (exact.log_z - exact.without_first)) < 4.5 * left.error + 0.005


def test_coordinates_keep_the_density(joint: JointPosterior) -> None:
    """Moves and ``log_density`` agree up to the Jacobian."""
    x = draw_joint_prior(joint, 200, default_rng(2))
    family = JointFamily(joint)
    D, L = joint.split(x)
    u, v = family.shared_from_physical(D), np.stack([family.group_from_physical(g, L[g]) for g in range(2)])
    jacobian = family.shared_to_physical(u)[1] + sum(family.group_to_physical(g, v[g])[1] for g in range(2))
    walkers = Walkers.at(family, u, v)
    np.testing.assert_allclose(walkers.log_density - jacobian, joint.log_density(x), rtol=1e-9)


def test_density_is_minus_infinity_outside_and_never_nan(joint: JointPosterior) -> None:
    """Outside a law, without spread, and for what is no number."""
    x = np.repeat(draw_joint_prior(joint, 1, default_rng(3)), 5, axis=0)
    x[0, 2] = 0.0  # no spread
    x[1, 3] = 1.0  # a K beyond its law
    x[2, 0] = np.nan
    x[3, 1] = np.inf
    assert np.isneginf(joint.log_density(x)[:4]).all()
    assert np.isfinite(joint.log_density(x)[4])
    with pytest.raises(ValueError, match=r"'x' must have shape \(n, 5\) \(got \(1, 4\)\)"):
        joint.log_density(x[:1, :4])


def test_population_is_a_law(grid: Callable[[float, float, int], FloatArray]) -> None:
    """It integrates to one whatever the spread, also with the mean outside; draws follow it."""
    limits = (0.002, 0.05)
    values = grid(*limits, 200_000)
    for mean, spread in ((0.01, 1e-4), (0.002, 0.01), (0.03, 5.0), (0.07, 0.004)):
        density = np.exp(log_population(values, np.array(mean), np.array(spread), limits))
        assert density.sum() * (values[1] - values[0]) == pytest.approx(1.0, rel=1e-4)
        drawn = draw_population(np.full(4000, mean), np.full(4000, spread), limits, default_rng(4))
        middle = values[np.searchsorted(np.cumsum(density) / density.sum(), 0.5)]
        assert np.mean(drawn < middle) == pytest.approx(0.5, abs=0.04)


def test_groups_by_a_label(make: MakeStudy) -> None:
    """A group may hold rows of several wheels."""
    joint = joint_posterior(make(pooling={"by": "site", "separate": ["K"]}))
    assert list(joint.groups) == ["a", "b"]
    assert [len(one.likelihood.observations) for one in joint.groups.values()] == [4, 2]
    assert joint.names == ("phi", "K[a]", "K[b]")


def test_start_where_nothing_is_shared(make: MakeStudy) -> None:
    """Populations alone hold the groups together; starting points lie inside the support."""
    joint = joint_posterior(make(pooling={"hierarchical": {"phi": {}, "K": {}}}))
    assert joint.names[:4] == ("phi.mean", "phi.spread", "K.mean", "K.spread")
    rng = default_rng(6)
    chains = {name: draw_cut_prior(one, 2000, rng).x.reshape(40, 50, 2) for name, one in joint.groups.items()}
    family = JointFamily(joint)
    D, L = starting_points(family, chains, rng)
    assert family.blocks == ((), (0, 1), (2, 3))
    assert np.isfinite(Walkers.at(family, D, L).log_density).all()


def test_rescaled_locals_keep_their_place_in_the_population(joint: JointPosterior) -> None:
    """And the Jacobian is that of differences; what would leave its range is no number."""
    family, rng = JointFamily(joint), default_rng(7)
    D, L = joint.split(draw_joint_prior(joint, 50, rng))
    u, v = family.shared_from_physical(D), family.group_from_physical(0, L[0])
    other = u.copy()
    other[:, 1:] += 0.05 * rng.standard_normal((50, 2))
    S = family.placed(other)[0]
    moved, log_jacobian = family.rescaled(0, D, v, S)
    kept = np.isfinite(moved[:, 0])
    after, K = S[kept], family.group_to_physical(0, moved[kept])[0][:, 0]
    before = (L[0][kept, 0] - D[kept, 1]) / D[kept, 2]
    np.testing.assert_allclose((K - after[:, 1]) / after[:, 2], before, rtol=1e-6)
    step = 1e-6
    further, _ = family.rescaled(0, D[kept], v[kept] + step, S[kept])
    slope = (further - moved[kept])[:, 0] / step
    known = np.isfinite(slope)
    np.testing.assert_allclose(np.log(slope[known]), log_jacobian[kept][known], atol=1e-3)
    assert kept.sum() > 25
    assert np.isneginf(log_jacobian[~kept]).all()
