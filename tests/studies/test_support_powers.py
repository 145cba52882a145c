"""Power-scaling sensitivities against integrals, ArviZ and made-up posteriors."""

import numpy as np
import pytest
from arviz_stats.base.array import array_stats
from cloning import ALPHAS, PowerScaling, Reweighted, Stated, distance, power_scaling, power_word, scaled
from scipy.special import ndtr
from scipy.stats import multivariate_normal

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.posterior import posterior
from bayesterra.stats.dependence import MixtureCopula
from bayesterra.stats.laws import Law
from bayesterra.study.result import Result

N = 4000
FLAT = Law("uniform", lower=0.0, upper=1.0)


def made_up(precision: float, mean: float, *, law: Law = FLAT, seed: int = 1) -> PowerScaling:
    """A parameter whose normal score has a standard normal prior and a normal likelihood."""
    rng = np.random.default_rng(seed)
    prior = law.quantile(ndtr(rng.standard_normal((N, 1))))
    total = 1.0 + precision
    z = precision * mean / total + rng.standard_normal((N, 1)) / np.sqrt(total)
    likelihood = Reweighted(-0.5 * precision * (z[:, 0] - mean) ** 2)
    return scaled(Stated(["c"], [law], [True]), likelihood, prior, law.quantile(ndtr(z)), noise=0.01)


@pytest.fixture(scope="module")
def found(small_result: Result) -> PowerScaling:
    """Sensitivities of a short run on the shipped HIT study."""
    target = posterior(small_result.study)
    prior, draws = small_result.values("prior"), small_result.values()
    return power_scaling(target, prior, draws, np.random.default_rng(1))


@pytest.mark.parametrize("tilt", [-0.5, 0.01, 0.3])
def test_distance_is_that_of_arviz(tilt: float) -> None:
    """The same draws and weights have the same distance in ArviZ."""
    x = np.sort(np.random.default_rng(1).standard_normal(N))
    weights = np.exp(tilt * x - 0.2 * x**2)
    theirs = max(
        array_stats._cjs_dist(values, weights[order] / weights.sum())
        for values, order in ((x, slice(None)), (-x, slice(None)))
    )
    assert distance(x, weights) == pytest.approx(theirs, rel=1e-6)


def test_a_parameter_without_data_repeats_its_flat_prior() -> None:
    """A flat law that ordinary power-scaling cannot see is followed as far as the cut prior follows it."""
    row = made_up(0.0, 0.0).table.iloc[0]
    assert row["silent"]
    assert row["own"] == pytest.approx(row["cut_own"], rel=0.15)
    assert row["likelihood"] < 1e-6
    assert row["word"] == "repeats its prior"


def test_a_parameter_with_strong_data_follows_them() -> None:
    """A likelihood a hundred times sharper than the prior moves the posterior, the prior does not."""
    row = made_up(100.0, 0.5).table.iloc[0]
    assert row["word"] == "data"
    assert row["own"] < 0.02
    assert row["likelihood"] == pytest.approx(0.089, abs=0.01)


def test_data_far_out_in_the_prior_are_in_conflict_with_it() -> None:
    """Prior and likelihood that pull against each other both move the posterior."""
    row = made_up(2.0, 4.0).table.iloc[0]
    assert row["word"] == "prior and data"
    assert min(row["own"], row["likelihood"]) > 0.1


def test_a_normal_law_is_scaled_as_ever() -> None:
    """For a normal law the scaling by normal scores is ordinary power-scaling."""
    law = Law("norm", {"loc": 3.0, "scale": 2.0})
    x = law.sample(N, np.random.default_rng(1))
    ours, ordinary = Reweighted(-0.5 * law.score(x) ** 2), Reweighted(law.log_density(x))
    assert ours.sensitivity(x) == pytest.approx(ordinary.sensitivity(x), rel=1e-9)


def test_sensitivity_of_a_normal_law_to_its_own_weight_is_known() -> None:
    """Scaling by α changes the sd to 1/√α; 16 000 draws give the integral's distance per doubling."""
    x = np.random.default_rng(1).standard_normal(4 * N)
    grid = np.linspace(-8, 8, 20_001)

    def exact(alpha: float) -> float:
        p, q = ndtr(grid), ndtr(grid * np.sqrt(alpha))
        terms = p * np.log2(2 * p / (p + q)) + q * np.log2(2 * q / (p + q))
        inside = (grid > x.min()) & (grid < x.max())
        return float(np.sqrt(terms[inside].sum() / (p + q)[inside].sum()))

    expected = np.mean([exact(alpha) / abs(np.log2(alpha)) for alpha in ALPHAS])
    assert Reweighted(-0.5 * x**2).sensitivity(x) == pytest.approx(expected, rel=0.05)


def test_a_stranger_stays_within_the_noise() -> None:
    """Parameters that have nothing to do with the density stay below the noise's 95 % point, mostly."""
    rng = np.random.default_rng(2)
    density = Reweighted(-0.5 * rng.chisquare(8, N))
    noise = density.noise(rng)
    strangers: FloatArray = np.array([density.sensitivity(rng.random(N)) for _ in range(40)])
    assert 0.002 < noise < 0.03
    assert (strangers <= noise).mean() > 0.75


def test_words_change_at_their_thresholds() -> None:
    """The likelihood decides first, then the own law, then any other."""
    assert power_word(0.08, 0.08, 0.08, 0.049) == "repeats its prior"
    assert power_word(0.03, 0.08, 0.09, 0.049) == "another's prior"
    assert power_word(0.03, 0.08, 0.04, 0.049) == "unmoved"
    assert power_word(0.08, 0.2, 0.08, 0.0) == "another's prior"
    assert power_word(0.03, 0.08, 0.04, 0.05) == "data"
    assert power_word(0.03, 0.08, 0.06, 0.05) == "prior and data"


def test_the_modulus_repeats_its_prior_and_the_exponent_follows_the_modulus(found: PowerScaling) -> None:
    """On the HIT set K_s answers to its own law alone, and n0 to that of K_s."""
    table = found.table.set_index("parameter")
    assert table["word"]["Ks"] == "repeats its prior"
    assert table["strongest"]["n0"] == "Ks"
    assert table["word"]["n0"] == "another's prior"
    assert table["likelihood"]["Ks"] < 0.03
    assert table["silent"].all()
    assert found.reliable
    assert found.by_law.shape == (8, 8)


def test_laws_that_correlate_are_scaled_together() -> None:
    """Two of three normal laws correlate: their density is the joint one of both, the third stays alone."""
    rng, law = np.random.default_rng(2), Law("norm", {"loc": 1.0, "scale": 0.1})
    joint = np.array([[1.0, 0.0, -0.8], [0.0, 1.0, 0.0], [-0.8, 0.0, 1.0]])
    z = rng.standard_normal((50, 3))
    stated = Stated(["n0", "n1", "c1"], [law] * 3, [False] * 3, joint)
    first, second, third = (found.log_density for found in stated.densities(1.0 + 0.1 * z))
    both = multivariate_normal(cov=joint[::2, ::2])
    np.testing.assert_allclose(first, both.logpdf(z[:, ::2]) - both.logpdf(np.zeros(2)), atol=1e-9)
    np.testing.assert_array_equal(first, third)
    np.testing.assert_allclose(second, -0.5 * z[:, 1] ** 2, atol=1e-9)
    np.testing.assert_allclose(stated.together(1.0 + 0.1 * z).log_density, first + second, atol=1e-9)
    one = MixtureCopula((1.0,), ((0.0, 0.0),), (((1.0, -0.8), (-0.8, 1.0)),))
    mixed = Stated(["n0", "n1", "c1"], [law] * 3, [False] * 3, np.eye(3), [([0, 2], one)])
    alike = [found.log_density - found.log_density[0] for found in mixed.densities(1.0 + 0.1 * z)]
    for ours, theirs in zip(alike, (first, second, third), strict=True):
        np.testing.assert_allclose(ours, theirs - theirs[0], atol=1e-9)
