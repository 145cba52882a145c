"""The verdict on a parameter beside closed forms for normal posteriors."""

import numpy as np
import pytest
from scipy.special import ndtri
from scipy.stats import multivariate_normal

from bayesterra.arrays import FloatArray
from bayesterra.laws import Law
from bayesterra.pooling.verdicts import Sharing, sharing, sharing_as_stated

LAWS = {"n0": Law("norm", {"loc": 0.0, "scale": 1.0}), "n1": Law("norm", {"loc": 0.0, "scale": 1.0})}


def _judged(values: FloatArray, sd: float, names: tuple[str, ...] = ("n0",)) -> Sharing:
    """Groups measured each to ``sd``, under a standard normal prior; values (groups, k)."""
    rng = np.random.default_rng(5)
    precision = 1.0 + sd**-2.0
    means = values / sd**2 / precision
    draws = [m + rng.standard_normal((4, 4000, len(m))) / np.sqrt(precision) for m in means]
    priors = [rng.standard_normal((4000, len(m))) for m in means]
    return sharing(names, LAWS, draws, priors, "wheel")


def _closed(values: FloatArray, sd: float) -> float:
    """Log Bayes factor of a common value for readings that are ``values`` (groups,) with noise ``sd``."""
    n, noise = len(values), sd**2 * np.eye(len(values))
    common = multivariate_normal(np.zeros(n), noise + 1.0).logpdf(values)
    own = multivariate_normal(np.zeros(n), noise + np.eye(n)).logpdf(values)
    return float(common - own)


def _closed_population(values: FloatArray, sd: float) -> float:
    """The same against a population with a half-normal spread of scale 1/2."""
    n = len(values)
    spreads = (np.arange(4000) + 0.5) * 3.0 / 4000
    levels = [multivariate_normal(np.zeros(n), (sd**2 + t**2) * np.eye(n) + 1.0).pdf(values) for t in spreads]
    weights = np.exp(-0.5 * (spreads / 0.5) ** 2)
    population = np.log(np.average(levels, weights=weights))
    return float(multivariate_normal(np.zeros(n), sd**2 * np.eye(n) + 1.0).logpdf(values) - population)


@pytest.mark.parametrize("values", [[0.5, 0.52, 0.48, 0.5], [0.5, 0.8, 0.4, 0.65]])
def test_factors_are_those_of_normal_laws(values: list[float]) -> None:
    """Against values of each group's own, and against a population."""
    at = np.array(values)
    found = _judged(at[:, None], 0.1)
    assert found.own == pytest.approx(_closed(at, 0.1), abs=0.25)
    assert found.population == pytest.approx(_closed_population(at, 0.1), abs=0.25)


def test_words() -> None:
    """Six groups: the same value, values far apart, and nothing known."""
    assert _judged(np.full((6, 1), 0.3), 0.01).verdict == "soil constant"
    assert _judged(np.linspace(-1.0, 1.0, 6)[:, None], 0.05).verdict == "wheel-dependent"
    assert _judged(np.zeros((6, 1)), 20.0).verdict == "cannot tell"


@pytest.mark.parametrize("values", [[0.5, 0.52, 0.48, 0.5], [0.5, 0.8, 0.4, 0.65], [-1.0, 0.0, 0.6, 0.9]])
def test_as_stated_it_is_the_factor_of_the_joint_posterior(values: list[float]) -> None:
    """Readings with noise of their own and an error common to all, which hides no difference between them."""
    at, groups = np.array(values), len(values)
    noise = 0.1**2 * np.eye(groups) + 0.8**2
    precision = np.linalg.inv(noise) + np.eye(groups)
    mean = np.linalg.solve(precision, np.linalg.solve(noise, at))
    rng = np.random.default_rng(8)
    draws = rng.multivariate_normal(mean, np.linalg.inv(precision), size=(4, 4000))
    priors = [rng.standard_normal(4000) for _ in values]
    found = sharing_as_stated("n0", LAWS["n0"], draws, priors, "wheel")

    def level(covariance: FloatArray) -> float:
        return float(multivariate_normal(np.zeros(groups), noise + covariance).logpdf(at))

    spreads = (np.arange(4000) + 0.5) * 3.0 / 4000
    levels = [np.exp(level(t**2 * np.eye(groups) + 1.0)) for t in spreads]
    population = np.log(np.average(levels, weights=np.exp(-0.5 * (spreads / 0.5) ** 2)))
    common = level(np.ones((groups, groups)))
    own, population = common - level(np.eye(groups)), common - population
    if own < -20.0:  # far out the fitted tails are heavier than normal ones: the word holds, not the figure
        assert own < found.own < -20.0
        assert found.verdict == "wheel-dependent"
        return
    assert found.own == pytest.approx(own, abs=0.25)
    assert found.population == pytest.approx(population, abs=0.25)


def test_as_stated_independent_groups_are_judged_as_alone() -> None:
    """Posteriors of any shape: two humps, or nearly flat."""
    rng = np.random.default_rng(9)
    shape = (2, 4000, 3)
    humps = np.where(rng.random(shape) < 0.4, rng.normal(-1.2, 0.3, shape), rng.normal(0.6, 0.5, shape))
    flat = ndtri(rng.uniform(0.05, 0.95, shape))
    priors = [rng.standard_normal(4000) for _ in range(3)]
    for draws in (humps, flat):
        alone = sharing(
            ["n0"], LAWS, [draws[:, :, g, None] for g in range(3)], [x[:, None] for x in priors], "wheel"
        )
        stated = sharing_as_stated("n0", LAWS["n0"], draws, priors, "wheel")
        assert stated.own == pytest.approx(alone.own, abs=0.2)
        assert stated.population == pytest.approx(alone.population, abs=0.2)


def test_two_parameters_together() -> None:
    """Independent ones add up, for a common value against values of each group's own."""
    values = np.column_stack([np.full(4, 0.2), np.full(4, -0.4)])
    together = _judged(values, 0.1, ("n0", "n1"))
    apart = _closed(values[:, 0], 0.1) + _closed(values[:, 1], 0.1)
    assert together.own == pytest.approx(apart, abs=0.4)
    assert together.population < together.own
