"""The verdict on a parameter beside closed forms for normal posteriors."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bayesterra.arrays import FloatArray
from bayesterra.laws import Law
from bayesterra.pooling.verdicts import Sharing, sharing

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


def test_two_parameters_together() -> None:
    """Independent ones add up, for a common value against values of each group's own."""
    values = np.column_stack([np.full(4, 0.2), np.full(4, -0.4)])
    together = _judged(values, 0.1, ("n0", "n1"))
    apart = _closed(values[:, 0], 0.1) + _closed(values[:, 1], 0.1)
    assert together.own == pytest.approx(apart, abs=0.4)
    assert together.population < together.own
