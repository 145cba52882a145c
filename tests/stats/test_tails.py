"""Laws of standardised residuals against integration and differences."""

import numpy as np
import pytest
from scipy.integrate import quad

from bayesterra.stats.tails import GAUSSIAN, StudentT, Tails

LAWS = pytest.mark.parametrize("law", [GAUSSIAN, StudentT(3.0), StudentT(9.5)], ids=lambda law: law.name)


def _mean(law: Tails, weight: str) -> float:
    def integrand(z: float) -> float:
        at = np.array([z])
        pull = float(law.pull(at)[0])
        value = {"one": 1.0, "square": z**2, "place": pull**2, "scale": (z * pull - 1.0) ** 2}[weight]
        return value * float(np.exp(law.log_density(at)[0]))

    return float(quad(integrand, -np.inf, np.inf, epsabs=1e-11, limit=200)[0])


@LAWS
def test_density_and_information_are_those_of_integration(law: Tails) -> None:
    """The density holds all probability; variance and both informations are expectations under it."""
    assert _mean(law, "one") == pytest.approx(1.0, rel=1e-8)
    assert _mean(law, "square") == pytest.approx(law.variance, rel=1e-6)
    assert (_mean(law, "place"), _mean(law, "scale")) == pytest.approx(law.information, rel=1e-7)


@LAWS
def test_pull_is_the_derivative_of_the_density(law: Tails) -> None:
    """By central differences."""
    z, step = np.array([-7.0, -0.4, 0.3, 2.0]), 1e-5
    slope = (law.log_density(z + step) - law.log_density(z - step)) / (2 * step)
    np.testing.assert_allclose(law.pull(z), -slope, rtol=1e-7)


@LAWS
def test_quantile_and_probability_belong_together(law: Tails) -> None:
    """One is the inverse of the other, and the probability grows as the density says."""
    for level in (0.01, 0.3, 0.5, 0.9):
        assert float(law.cdf(np.array([law.quantile(level)]))[0]) == pytest.approx(level, rel=1e-9)
    z, step = np.array([-2.0, 0.1, 1.5]), 1e-5
    slope = (law.cdf(z + step) - law.cdf(z - step)) / (2 * step)
    np.testing.assert_allclose(np.exp(law.log_density(z)), slope, rtol=1e-7)
