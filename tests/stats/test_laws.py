"""Prior laws against scipy.stats, in the middle and far out in the tails."""

import pickle
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad

from bayesterra.errors import StudyError
from bayesterra.parameters import SOIL_PARAMETERS, SoilColumns
from bayesterra.sampling.coordinates import NormalScore
from bayesterra.stats.laws import SLOW, Law
from bayesterra.study.entries import prior_set
from bayesterra.study.priors import Prior

LAWS = {
    "uniform": Law("uniform", lower=-1.0, upper=3.0),
    "loguniform": Law("loguniform", lower=0.002, upper=0.05),
    "norm": Law("norm", {"loc": 32.0, "scale": 4.0}),
    "norm, cut": Law("norm", {"loc": 32.0, "scale": 4.0}, lower=20.0, upper=33.0),
    "norm, upper tail": Law("norm", {"loc": 0.0, "scale": 1.0}, lower=6.0, upper=8.0),
    "norm, lower tail": Law("norm", {"loc": 0.0, "scale": 1.0}, lower=-8.0, upper=-6.0),
    "halfnorm": Law("halfnorm", {"scale": 2.0}, lower=0.2),
    "gamma": Law("gamma", {"a": 2.5, "scale": 3.0}, upper=20.0),
    "beta": Law("beta", {"a": 2.0, "b": 5.0}, lower=0.1),
    "lognorm": Law("lognorm", {"s": 0.8, "scale": 2e6}, lower=1e5, upper=1e7),
    "cauchy": Law("cauchy", {"loc": 1.0, "scale": 0.2}, lower=0.0),
}
INNER = np.array([1e-12, 1e-6, 0.01, 0.3, 0.5, 0.8, 0.99])

each_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)


def uncut(law: Law) -> stats.rv_continuous:
    """The law without its limits, frozen by scipy itself."""
    if law.dist == "uniform":
        return stats.uniform(law.lower, law.upper - law.lower)
    if law.dist == "loguniform":
        return stats.loguniform(law.lower, law.upper)
    return getattr(stats, law.dist)(**law.shape)


@each_law
def test_density_integrates_to_one(law: Law) -> None:
    """The cut density has unit mass: between neighbouring quantiles lies what the quantiles say."""
    q = np.linspace(0.001, 0.999, 9)
    edges = law.quantile(q)
    pieces = [
        quad(lambda x: float(np.exp(law.log_density(np.array(x)))), low, high, epsabs=1e-12)[0]
        for low, high in pairwise(edges)
    ]
    np.testing.assert_allclose(pieces, np.diff(q), rtol=1e-7)


@each_law
def test_density_is_that_of_scipy_over_the_mass_inside(law: Law) -> None:
    """Log density = scipy's log density minus the log of the probability between the limits."""
    x, base = law.quantile(INNER), uncut(law)
    masses = base.cdf(law.upper) - base.cdf(law.lower), base.sf(law.lower) - base.sf(law.upper)
    mass = masses[1] if base.cdf(law.lower) > 0.5 else masses[0]
    np.testing.assert_allclose(law.log_density(x), base.logpdf(x) - np.log(mass), rtol=1e-12, atol=1e-12)


@each_law
def test_quantile_inverts_cdf_and_upper_quantile_inverts_survival(law: Law) -> None:
    """Each pair is inverse in its own tail, down to the digits of x at 1e-12, and the two add up to one."""
    np.testing.assert_allclose(law.cdf(law.quantile(INNER)), INNER, rtol=0.01)
    np.testing.assert_allclose(law.survival(law.upper_quantile(INNER)), INNER, rtol=0.01)
    np.testing.assert_allclose(law.cdf(law.quantile(INNER[2:])), INNER[2:], rtol=1e-9)
    x = law.quantile(np.linspace(0.01, 0.99, 7))
    np.testing.assert_allclose(law.cdf(x) + law.survival(x), 1.0, rtol=1e-12)


@each_law
def test_nothing_outside_the_range(law: Law) -> None:
    """Outside its range a law has log density −inf, probability 0 below and 1 above; NaN has −inf."""
    low, high = law.range
    outside = np.array([low - 1.0, high + 1.0, np.nan])
    assert np.isneginf(law.log_density(outside)).all()
    np.testing.assert_allclose(law.cdf(np.array([low, high])), [0.0, 1.0], atol=1e-14)


@each_law
def test_draws_follow_the_law(law: Law) -> None:
    """Draws lie in the range and their probabilities are uniform."""
    draws = law.sample(4000, np.random.default_rng(1))
    assert ((draws >= law.range[0]) & (draws <= law.range[1])).all()
    assert stats.kstest(law.cdf(draws), "uniform").pvalue > 1e-3


@each_law
def test_laws_survive_pickling(law: Law) -> None:
    """A law that has been used comes back from a pickle with the same densities."""
    x = law.quantile(INNER)
    before, again = law.log_density(x), pickle.loads(pickle.dumps(law))  # noqa: S301  # our own bytes
    assert again == law
    np.testing.assert_array_equal(again.log_density(x), before)


@pytest.mark.parametrize(("loc", "scale"), [(0.0, 1.0), (1.3, 0.3), (-7.1, 1e-3), (3e6, 2e5)])
@pytest.mark.parametrize("dist", ["norm", "halfnorm"])
def test_normal_laws_are_those_of_scipy_to_the_last_bit(dist: str, loc: float, scale: float) -> None:
    """Uncut, at ends, in tails and outside: they are computed here, because scipy takes longer."""
    law, base = Law(dist, {"loc": loc, "scale": scale}), getattr(stats, dist)(loc, scale)
    rng = np.random.default_rng(1)
    x = loc + scale * np.append(10 * rng.standard_normal(2000), [-40.0, 0.0, 40.0, np.inf, -np.inf])
    q = np.concatenate([rng.random(2000), 10.0 ** rng.uniform(-300, 0, 2000), [0.0, 0.5, 1.0]])
    np.testing.assert_array_equal(law.cdf(x), base.cdf(x))
    np.testing.assert_array_equal(law.survival(x), base.sf(x))
    np.testing.assert_array_equal(law.quantile(q), base.ppf(q))
    np.testing.assert_array_equal(law.upper_quantile(q), base.isf(q))


def test_far_tails_keep_their_digits() -> None:
    """Cut beyond eight standard deviations, the norm law is scipy's truncnorm, which is built for tails."""
    for low, high in ((8.0, 10.0), (-10.0, -8.0)):
        law, exact = Law("norm", {"scale": 1.0}, lower=low, upper=high), stats.truncnorm(low, high)
        x = np.linspace(low + 1e-3, high - 1e-3, 9)
        np.testing.assert_allclose(law.log_density(x), exact.logpdf(x), rtol=1e-9)
        np.testing.assert_allclose(law.quantile(INNER), exact.ppf(INNER), rtol=1e-9)


def test_upper_quantile_reaches_where_one_minus_q_is_one() -> None:
    """A probability of 1e-40 above has its value, which 1 − 1e-40 = 1 cannot have."""
    law = Law("norm", {"loc": 0.5, "scale": 0.01})
    expected = 0.5 + 0.01 * stats.norm.isf(1e-40)
    np.testing.assert_allclose(law.upper_quantile(np.array(1e-40)), expected, rtol=1e-12)
    np.testing.assert_allclose(law.survival(np.array(expected)), 1e-40, rtol=1e-9)


def test_far_out_is_minus_infinity_without_a_warning() -> None:
    """The square of 1e300 overflows to a log density of −inf, silently."""
    assert np.isneginf(Law("norm", {"scale": 1.0}).log_density(np.array([1e300, -1e300]))).all()


def test_a_pole_is_no_infinite_density() -> None:
    """The gamma law with a < 1 is infinite at 0, a point without probability: its density there is none."""
    assert np.isneginf(Law("gamma", {"a": 0.5}).log_density(np.array([0.0])))[0]


def test_text_of_a_law_says_what_it_is() -> None:
    """The text names law, arguments and limits."""
    assert str(LAWS["norm, cut"]) == "norm (loc=32, scale=4) cut to [20, 33]"
    assert str(LAWS["uniform"]) == "uniform [-1, 3]"
    assert str(LAWS["norm"]) == "norm (loc=32, scale=4)"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Law("gauss"), r"'dist' must be the name of a continuous scipy.stats law \(got 'gauss'\)"),
        (lambda: Law("poisson", {"mu": 1.0}), "'dist' must be the name of a continuous"),
        (lambda: Law("norm", lower=2.0, upper=1.0), r"'lower' must be below 'upper' \(got 2 and 1\)"),
        (lambda: Law("norm", lower=float("nan")), "'lower' must be below 'upper'"),
        (lambda: Law("uniform", lower=1.0), "a uniform law needs finite 'lower' and 'upper'"),
        (lambda: Law("loguniform", lower=0.0, upper=1.0), r"'lower' of a loguniform law must be above 0"),
        (lambda: Law("uniform", {"loc": 1.0}, 0.0, 1.0), r"takes 'lower' and 'upper' only \(got loc\)"),
        (lambda: Law("norm", {"sigma": 1.0}), "wrong arguments for norm"),
        (lambda: Law("gamma", {}), "wrong arguments for gamma"),
        (lambda: Law("norm", {"scale": -1.0}), "norm is not defined for scale=-1"),
        (lambda: Law("beta", {"a": 1.0, "b": 1.0}, lower=2.0), "has no probability between 2 and inf"),
        (lambda: Law("norm", {"scale": 1.0}, lower=50.0), "has no probability between 50 and inf"),
    ],
)
def test_impossible_laws_say_why(make: Callable[[], Law], message: str) -> None:
    """Each impossible law is refused in one line."""
    with pytest.raises(StudyError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


@pytest.fixture
def prior() -> Prior:
    """Three free soil parameters and an estimated noise, given in no order."""
    fixed = dict.fromkeys(SOIL_PARAMETERS, 0.25)
    laws = {"noise_sinkage": LAWS["halfnorm"], "phi": LAWS["norm, cut"], "Ks": LAWS["lognorm"]}
    return Prior({**laws, **{n: v for n, v in fixed.items() if n not in laws}, "c": Law("uniform", {}, 0, 5)})


def test_names_stand_in_the_package_order(prior: Prior) -> None:
    """Soil parameters come in their own order, estimated noise last, whatever the order of the entries."""
    assert prior.names == ("Ks", "c", "phi", "noise_sinkage")


def test_prior_density_is_the_sum_of_the_laws(prior: Prior) -> None:
    """Independent laws: log densities add up; one parameter outside makes the set impossible."""
    x = prior.sample(5, np.random.default_rng(1))
    expected = sum(law.log_density(x[:, i]) for i, law in enumerate(prior.laws.values()))
    np.testing.assert_allclose(prior.log_density(x), expected)
    x[:, 1] = -1.0
    assert np.isneginf(prior.log_density(x)).all()


def test_soil_values_put_free_and_fixed_in_place(prior: Prior) -> None:
    """Free columns and fixed values land on their own soil parameters."""
    x = np.array([[1e6, 2.0, 0.5, 0.3]])
    expected = {"Ks": 1e6, "c": 2.0, "phi": 0.5}
    soil = prior.soil_values(x)[0]
    assert [soil[SoilColumns[name]] for name in SOIL_PARAMETERS] == [expected.get(n, 0.25) for n in SOIL_PARAMETERS]
    others = {column.name: soil[column] for column in SoilColumns if column.name not in SOIL_PARAMETERS}
    assert others.pop("sinkage_offset") == 0.0
    assert np.isnan(list(others.values())).all()


def test_prior_draws_are_independent_draws_of_the_laws(prior: Prior) -> None:
    """Every column follows its law and columns do not correlate."""
    x = prior.sample(4000, np.random.default_rng(2))
    for i, law in enumerate(prior.laws.values()):
        assert stats.kstest(law.cdf(x[:, i]), "uniform").pvalue > 1e-3
    assert np.abs(np.corrcoef(stats.rankdata(x, axis=0).T) - np.eye(4)).max() < 0.07


def test_prior_without_free_parameters_has_no_columns() -> None:
    """Everything fixed: no names, draws of no width."""
    fixed = Prior(dict.fromkeys(SOIL_PARAMETERS, 1.0))
    assert fixed.sample(3, np.random.default_rng(1)).shape == (3, 0)


def test_unknown_and_missing_names_are_refused() -> None:
    """A prior needs all soil parameters and knows no others."""
    with pytest.raises(StudyError, match=r"unknown \['mu'\], missing \['Ks'"):
        Prior({"mu": 1.0})


def test_paper_box_is_flat_between_the_bounds_of_im1() -> None:
    """The set is flat on Table 17's bounds with c3 held at 0."""
    bounds = {n: law.range for n, law in prior_set("paper-box").items() if isinstance(law, Law)}
    assert bounds["Ks"] == (0.1e6, 10e6)
    assert bounds["c"] == (0.0, 5000.0)
    np.testing.assert_allclose(np.degrees(bounds["phi"]), [0.0, 50.0])
    assert bounds["K"] == (0.002, 0.05)
    assert [bounds[n] for n in ("n0", "n1", "c1", "c2")] == [(0, 2), (0, 2), (-1, 1), (-1, 1)]
    assert prior_set("paper-box")["c3"] == 0.0


POLES = {
    "beta": Law("beta", {"a": 0.02, "b": 0.02}),
    "beta, cut below": Law("beta", {"a": 0.02, "b": 0.02}, lower=0.1),
    "beta, cut above": Law("beta", {"a": 0.02, "b": 0.02}, upper=0.9),
    "beta, shifted and scaled": Law("beta", {"a": 0.02, "b": 0.02, "loc": 1.0, "scale": 2.0}),
    "beta, mirrored": Law("beta", {"a": 2.0, "b": 0.03, "loc": -1.0}),
    "beta, mild": Law("beta", {"a": 0.1, "b": 0.1}),
    "arcsine": Law("arcsine", {"loc": 3.0, "scale": 0.1}),
    "powerlaw": Law("powerlaw", {"a": 0.05}),
    "powerlaw, shifted": Law("powerlaw", {"a": 0.05, "loc": 1.0}),
    "weibull_max": Law("weibull_max", {"c": 0.05, "loc": 1.0}),
    "weibull_min, shifted and cut": Law("weibull_min", {"c": 0.05, "loc": 1.0}, upper=2.0),
    "gamma": Law("gamma", {"a": 0.02}),
    "gamma, shifted": Law("gamma", {"a": 0.03, "loc": 100.0}),
    "betaprime, cut": Law("betaprime", {"a": 0.03, "b": 3.0}, upper=10.0),
    "no pole": Law("beta", {"a": 2.0, "b": 5.0}),
}


@pytest.mark.parametrize("name", POLES)
def test_a_pole_loses_no_probability(name: str) -> None:
    """In its normal score the prior alone has the evidence 1, by quadrature, and every draw has a density."""
    law, u = POLES[name], np.linspace(-9.0, 9.0, 20_001)
    x, log_jacobian = NormalScore(law).to_physical(u[:, None])
    density = np.exp(law.log_density(x[:, 0]) + log_jacobian)
    assert np.log(np.trapezoid(density, u)) == pytest.approx(0.0, abs=1e-4)
    drawn = law.sample(20_000, np.random.default_rng(1))
    assert np.isfinite(law.log_density(drawn)).all()
    low, high = law.range
    cut = 0.5 * (low + min(high, low + 1.0))
    assert np.mean(drawn <= cut) == pytest.approx(law.cdf(np.array(cut)), abs=0.015)


def test_a_law_that_numbers_do_not_resolve_is_named() -> None:
    """Most of the probability at the ends: refused; and so is a correlation with such a law."""
    with pytest.raises(StudyError, match=r"beta with a=0.001, b=0.001, loc=1 has 9\d% of its probability nearer to an"):
        Law("beta", {"a": 0.001, "b": 0.001, "loc": 1.0})
    entries = {**prior_set("paper-box"), "phi": POLES["beta, mild"]}
    with pytest.raises(StudyError, match=r"correlation of 'c, phi': 'phi' must not have 0\.013 of its probability"):
        Prior(entries, correlation={"c, phi": 0.5})


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("levy_stable", {"alpha": 1.8, "beta": -0.5}),
        ("studentized_range", {"k": 3.0, "df": 10.0}),
        ("vonmises", {"kappa": 4.0}),
        ("geninvgauss", {"p": 2.3, "b": 1.5}),
    ],
)
def test_a_law_of_which_no_check_would_end(name: str, shape: dict[str, float]) -> None:
    """It is refused at once, by its name, with what to do instead."""
    with pytest.raises(StudyError, match=rf"the law {name} is too slow: .* dist = \"tabulated\""):
        Law(name, shape)


def test_slow_laws_are_laws_of_scipy() -> None:
    """A name that is misspelled would refuse nothing."""
    old = {"dpareto_lognorm", "irwinhall"} - set(dir(stats))  # which older versions do not have
    assert all(isinstance(getattr(stats, name), stats.rv_continuous) for name in SLOW - old)
