"""Laws by their quantiles: one map behind density and quantiles, near the law that they stand for."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad

from bayesterra.errors import StudyError
from bayesterra.stats.quantile_law import QuantileLaw

SCORES = tuple(np.arange(-2.5, 2.6, 0.5).tolist())
KNOWN = {
    "norm": (stats.norm(1.0, 0.2), -np.inf, np.inf),
    "norm far from its ends": (stats.norm(1.0, 0.02), 0.0, 2.0),
    "lognorm": (stats.lognorm(0.9, scale=2e6), 0.0, np.inf),
    "halfnorm": (stats.halfnorm(scale=1000.0), 0.0, np.inf),
    "uniform": (stats.uniform(0.0, 2.0), 0.0, 2.0),
    "beta": (stats.beta(1.2, 4.0), 0.0, 1.0),
    "expon": (stats.expon(), 0.0, np.inf),
}


def tabulated(name: str) -> QuantileLaw:
    """The law with the quantiles of a known one."""
    law, low, high = KNOWN[name]
    values = law.ppf(stats.norm.cdf(SCORES))
    return QuantileLaw(lower=low, upper=high, scores=SCORES, values=tuple(values.tolist()))


each = pytest.mark.parametrize("name", KNOWN)


@each
def test_density_is_the_derivative_of_the_probability(name: str) -> None:
    """Between any two points lies the integral of the density, in the table, in both tails and in all."""
    law = tabulated(name)
    edges = law.at_score(np.array([-7.0, -4.0, -2.6, -1.1, 0.3, 2.2, 3.0, 5.0, 7.0]))
    knots = np.sort(np.concatenate([edges, law.values]))
    pieces = [
        quad(lambda x: float(np.exp(law.log_density(np.array(x)))), a, b, epsabs=0.0, epsrel=1e-9)[0]
        for a, b in pairwise(knots)
    ]
    np.testing.assert_allclose(pieces, np.diff(law.cdf(knots)), rtol=1e-6, atol=1e-12)
    assert sum(pieces) == pytest.approx(1.0, abs=1e-9)


@each
def test_scores_and_values_are_inverse(name: str) -> None:
    """Z → x → z returns to within rounding, also where 1 − Φ(z) has no digits left."""
    law = tabulated(name)
    z = np.linspace(-12.0, 7.0, 191)
    x = law.at_score(z)
    distinct = (np.diff(x, prepend=-np.inf) > 1e-12 * np.abs(x)) & (x < law.upper)
    np.testing.assert_allclose(law.score(x)[distinct], z[distinct], rtol=1e-3, atol=1e-6)
    assert distinct.sum() > 150
    assert (np.diff(x) >= 0).all()


@each
def test_the_law_is_near_the_one_it_stands_for(name: str) -> None:
    """Eleven exact quantiles leave probabilities within 0.001 and densities within 6 % of the known law."""
    law, (known, *_) = tabulated(name), KNOWN[name]
    x = known.ppf(np.linspace(0.01, 0.99, 197))
    assert np.abs(law.cdf(x) - known.cdf(x)).max() < 1e-3
    assert np.abs(law.log_density(x) - known.logpdf(x)).max() < 0.06


def test_the_normal_law_is_exact_and_tails_keep_their_digits() -> None:
    """A table of a normal law is that law, twelve standard deviations out too."""
    law, (known, *_) = tabulated("norm"), KNOWN["norm"]
    x = np.linspace(1.0 - 12 * 0.2, 1.0 + 12 * 0.2, 25)
    np.testing.assert_allclose(law.log_density(x), known.logpdf(x), rtol=1e-9)
    np.testing.assert_allclose(law.survival(x), known.sf(x), rtol=1e-9)
    np.testing.assert_allclose(law.upper_quantile(known.sf(x[12:])), x[12:], rtol=1e-9)


def test_nothing_lies_outside_the_range_and_no_end_has_a_pole() -> None:
    """Log density −inf outside; at the ends of a flat law it is that of a flat law."""
    law = tabulated("uniform")
    assert np.isneginf(law.log_density(np.array([-1e-9, 2.0 + 1e-9]))).all()
    np.testing.assert_allclose(law.log_density(np.array([0.0, 2.0])), np.log(0.5), atol=0.05)
    np.testing.assert_array_equal(law.cdf(np.array([-1.0, 0.0, 2.0, 3.0])), [0.0, 0.0, 1.0, 1.0])
    np.testing.assert_array_equal(law.survival(np.array([-1.0, 0.0, 2.0, 3.0])), [1.0, 1.0, 0.0, 0.0])


def test_draws_follow_the_law() -> None:
    """Draws of a table are uniform in its probabilities."""
    law = tabulated("beta")
    assert stats.kstest(law.cdf(law.sample(4000, np.random.default_rng(1))), "uniform").pvalue > 1e-3


def test_a_widened_law_has_its_values_at_spread_scores() -> None:
    """Spread by 1.5: the median stays, 1.5 deviations become one; the range holds."""
    law, wide = tabulated("halfnorm"), tabulated("halfnorm").widened(1.5)
    assert wide.median == pytest.approx(law.median, rel=1e-6)
    at = np.array(SCORES[::2])
    np.testing.assert_allclose(wide.at_score(at), law.at_score(1.5 * at), rtol=1e-5)
    assert wide.range == law.range
    assert law.widened(1.0) is law


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"scores": (-1.0, 1.0), "values": (1.0, 2.0)}, r"equally many, at least 3 \(got 2 and 2\)"),
        ({"scores": (-1.0, 0.0, 1.0), "values": (1.0, 2.0)}, r"equally many, at least 3 \(got 3 and 2\)"),
        ({"scores": (-1.0, 0.0, 0.0), "values": (1.0, 2.0, 3.0)}, r"'scores' must rise \(got 0 and 0\)"),
        ({"scores": (-1.0, 0.0, 1.0), "values": (1.0, 3.0, 2.0)}, r"'values' must rise \(got 3 and 2\)"),
        ({"scores": (1.0, 2.0, 3.0), "values": (1.0, 2.0, 3.0)}, r"begin below 0, end above it.*got 1 and 3"),
        (
            {"scores": (-1.0, 0.0, 1.0), "values": (1.0, 2.0, 3.0), "lower": 1.0},
            r"'values' must lie between 'lower' and 'upper' \(got 1 and 3\)",
        ),
        (
            {"scores": (-1.0, 0.0, 1.0), "values": (1.0, 2.0, 3.0), "lower": 5.0, "upper": 4.0},
            r"'lower' must be below 'upper' \(got 5 and 4\)",
        ),
    ],
)
def test_impossible_tables_say_why(content: dict[str, tuple[float, ...]], message: str) -> None:
    """Each impossible table is refused in one line."""
    with pytest.raises(StudyError, match=message):
        QuantileLaw(**{"lower": -np.inf, "upper": np.inf, **content})  # type: ignore[arg-type]


def test_a_widened_law_may_reach_its_bounds() -> None:
    """Values that meet there to six digits are one; the law stays inside and rises."""
    law = QuantileLaw(lower=0.0, upper=1.0, scores=(-2.0, -1.0, 0.0, 1.0, 2.0), values=(0.1, 0.3, 0.5, 0.7, 0.999999))
    wide = law.widened(1.6)
    assert len(wide.values) < len(law.values)
    assert np.all(np.diff(wide.values) > 0)
    assert wide.range == law.range
    assert wide.median == pytest.approx(0.5)
