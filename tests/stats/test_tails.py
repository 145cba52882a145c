"""Laws of standardised residuals against integration and differences."""

from collections.abc import Callable

import mpmath
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
        assert float(law.cdf(np.array([law.quantile(np.array(level))]))[0]) == pytest.approx(level, rel=1e-9)
    z, step = np.array([-2.0, 0.1, 1.5]), 1e-5
    slope = (law.cdf(z + step) - law.cdf(z - step)) / (2 * step)
    np.testing.assert_allclose(np.exp(law.log_density(z)), slope, rtol=1e-7)


ENDS = np.array(
    [[-1.2, 0.4], [2.0, 2.7], [-9.0, -8.4], [30.0, 31.0], [0.3, 0.3 + 1e-6], [-np.inf, -2.0], [3.0, np.inf]]
)
"""Intervals in the middle, in both tails, far out, very narrow, and open."""


@LAWS
def test_probability_of_an_interval_keeps_its_digits(law: Tails) -> None:
    """Far out, where both ends have a probability of nearly one, and where the interval is narrow."""
    for (low, high), level in zip(ENDS, law.log_between(*ENDS.T), strict=True):
        assert float(level) == pytest.approx(_log_mass(law, float(low), float(high)), abs=2e-8)
    assert law.log_between(np.array([1e7]), np.array([1e7 + 1.0]))[0] > -np.inf
    assert not np.isnan(law.log_between(np.array([1e200]), np.array([1.1e200]))).any()


def _log_mass(law: Tails, low: float, high: float) -> float:
    """Log probability of an interval in many digits."""
    if low + high > 0:
        low, high = -high, -low
    with mpmath.workdps(40):
        if np.isinf(law.code):
            below, above = (mpmath.erfc(-mpmath.mpf(end) / mpmath.sqrt(2)) / 2 for end in (low, high))
            return float(mpmath.log(above - below))
        cuts = [low, *(cut for cut in (-50.0, -5.0, 0.0) if low < cut < high), high]
        return float(mpmath.log(mpmath.quad(_student(law.code), cuts)))


def _student(dof: float) -> Callable[[mpmath.mpf], mpmath.mpf]:
    peak = mpmath.gamma((dof + 1) / 2) / mpmath.gamma(dof / 2) / mpmath.sqrt(dof * mpmath.pi)
    return lambda z: peak * (1 + z**2 / dof) ** (-(dof + 1) / 2)


@LAWS
def test_slopes_of_an_interval_are_differences(law: Tails) -> None:
    """By a shift of the law, and by a stretch of it."""
    low, high = ENDS[[0, 1, 2, 4, 5, 6]].T
    step = 1e-6
    shift, stretch = law.pulls_between(low, high)
    by_shift = law.log_between(low - step, high - step) - law.log_between(low + step, high + step)
    by_stretch = [law.log_between(low / (1 + h), high / (1 + h)) for h in (step, -step)]
    np.testing.assert_allclose(shift, by_shift / (2 * step), rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(stretch, (by_stretch[0] - by_stretch[1]) / (2 * step), rtol=1e-4, atol=1e-3)


@LAWS
def test_the_middle_halves_the_probability(law: Tails) -> None:
    """In both tails and between."""
    low, high = ENDS[[0, 1, 2, 3, 5, 6]].T
    middle = law.middle(low, high)
    below, above = law.log_between(low, middle), law.log_between(middle, high)
    far = np.isin(low, (30.0, -9.0)) & np.isinf(law.code)
    np.testing.assert_allclose(below[~far], above[~far], atol=1e-6)
    assert ((low <= middle) & (middle <= high)).all()


@pytest.mark.parametrize("law", [GAUSSIAN, *(StudentT(dof) for dof in (1.0, 3.0, 9.5, 30.0, 200.0))])
def test_it_is_a_mixture_of_normal_laws(law: Tails) -> None:
    """Its density is that of the parts in their shares, where readings lie and far out."""
    sd, shares = law.parts
    z = np.array([0.0, 0.7, 1.5, 3.0, 6.0, 12.0])
    parts = shares - 0.5 * (z[:, None] / sd) ** 2 - np.log(sd) - 0.5 * np.log(2 * np.pi)
    np.testing.assert_allclose(np.logaddexp.reduce(parts, axis=1), law.log_density(z), atol=4e-4)


@LAWS
def test_a_normal_law_of_the_spread_pulls_as_much(law: Tails) -> None:
    """At any residual."""
    z = np.array([-9.0, -0.3, 2.0, 40.0])
    np.testing.assert_allclose(z / law.spread(z), law.pull(z), rtol=1e-12)


def test_other_laws_say_everything_themselves() -> None:
    """What a law does not say would be that of the normal law, in silence."""
    derived = {"log_mass", "log_between", "pulls_between", "middle"}
    said = {name for name in vars(Tails) if not name.startswith("_")} - derived
    assert {"parts", "spread", "log_density", "draw"} <= said
    for law in Tails.__subclasses__():
        assert said <= set(vars(law)), law.__name__
