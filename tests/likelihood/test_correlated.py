"""The joint law of a table: densities, rows given all others, what is drawn, against the law written out."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.correlated import CorrelatedLikelihood
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import Posterior, likelihood_of, posterior
from bayesterra.study.study import Study
from tests.support.joint_rows import CASES, CURVES, HELD, RIPPLE, joined, sets, written

Case = tuple[Study, Posterior]


@pytest.fixture(params=list(CASES.values()), ids=list(CASES))
def case(request: pytest.FixtureRequest) -> Case:
    """A study of each kind with two soil parameters free, and its posterior."""
    study = joined("phi", "n0", **request.param)
    return study, posterior(study)


def law_of(study: Study) -> CorrelatedLikelihood:
    """Likelihood of all rows, in the fit or not."""
    found = likelihood_of(study, study.observations)
    assert isinstance(found, CorrelatedLikelihood)
    return found


def test_the_log_likelihood_is_that_of_the_joint_normal_law(case: Case) -> None:
    """Against SciPy, covariances summed cell by cell; rows that are not in use do not count."""
    study, density = case
    x = sets(density)
    found = density.log_prior_and_likelihood(x)[1]
    for i, each in enumerate(x):
        law = written(study, density, each)
        K = law.covariance[np.ix_(law.known, law.known)]
        expected = multivariate_normal(law.mean[law.known], K).logpdf(law.readings[law.known])
        assert found[i] == pytest.approx(expected, rel=1e-8, abs=1e-8)
    whole = law_of(study).log_likelihood(density.prior.soil_values(x), density.noise_values(x))
    assert_allclose(whole, found, rtol=1e-12)


def test_a_row_s_term_is_given_all_other_rows(case: Case) -> None:
    """All readings of a row together, as leave-one-out needs it; their sum is not the log likelihood."""
    study, density = case
    x = sets(density, 2)
    total, rows = density.log_rows(x)
    assert_allclose(density.log_terms(x)[:, :, 0], rows, rtol=1e-12)
    assert_allclose(total, density.log_prior_and_likelihood(x)[1], rtol=1e-12)
    for n, each in enumerate(x):
        law = written(study, density, each)
        for i in range(rows.shape[1]):
            mine = law.known[law.known // 3 == i]
            mean, K = law.given(mine, np.setdiff1d(law.known, mine))
            expected = multivariate_normal(mean, K).logpdf(law.readings[mine])
            assert rows[n, i] == pytest.approx(expected, rel=1e-7, abs=1e-7)


def test_scores_are_readings_given_all_other_rows(case: Case) -> None:
    """Each channel alone, which cross-validation turns into probabilities; NaN where nothing was read."""
    study, density = case
    x = sets(density, 1)
    likelihood = density.likelihood
    assert isinstance(likelihood, CorrelatedLikelihood)
    found = likelihood.scores(density.prior.soil_values(x), density.noise_values(x))[0].ravel()
    law = written(study, density, x[0])
    for cell in range(len(found)):
        if cell not in law.known:
            assert np.isnan(found[cell])
            continue
        others = law.known[law.known // 3 != cell // 3]
        mean, K = law.given(np.array([cell]), others)
        expected = (law.readings[cell] - mean[0]) / np.sqrt(K[0, 0])
        assert found[cell] == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_a_row_that_is_not_in_use_is_predicted_by_the_others(case: Case) -> None:
    """Mean and standard deviation of its readings, noise included."""
    study, density = case
    x = sets(density, 2)
    likelihood = law_of(study)
    soil, noise = density.prior.soil_values(x), density.noise_values(x)
    centre, scale = likelihood.ahead(soil, noise, ~study.observations.use, np.random.default_rng(1))
    for n, each in enumerate(x):
        law = written(study, density, each)
        mean, K = law.given(np.arange(18, 21), law.known)
        assert_allclose(centre[n, 0], mean, rtol=1e-8)
        assert_allclose(scale[n, 0], np.sqrt(np.diag(K)), rtol=1e-7)


def moments(draws: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance of draws (n, m, k), cell after cell."""
    flat = draws.reshape(len(draws), -1)
    return flat.mean(axis=0), np.cov(flat.T)


def close(found: FloatArray, mean: FloatArray, K: FloatArray) -> None:
    """Draws have the moments that they should have, within five of their standard errors."""
    n, (centre, spread) = len(found), moments(found)
    sd = np.sqrt(np.maximum(np.diag(K), 1e-300))
    assert (np.abs(centre - mean) <= 5 * sd / np.sqrt(n) + 1e-9 * np.abs(mean)).all()
    assert (np.abs(spread - K) <= 5 * np.outer(sd, sd) * np.sqrt(2 / n) + 1e-14).all()


@pytest.mark.parametrize("given", [True, False], ids=["explained", "imagined"])
def test_what_is_behind_the_readings_is_drawn_with_its_moments(case: Case, *, given: bool) -> None:
    """Given the readings in use, and before any; at rows that are not in use too."""
    study, density = case
    x = np.repeat(sets(density, 1), 6000, axis=0)
    soil, noise, rng = density.prior.soil_values(x), density.noise_values(x), np.random.default_rng(2)
    likelihood = law_of(study)
    found = (likelihood.explained if given else likelihood.imagined)(soil, noise, rng)
    law = written(study, density, x[0])
    mean, K = law.mean, law.smooth
    if given:
        gain = K[:, law.known] @ np.linalg.inv(law.covariance[np.ix_(law.known, law.known)])
        mean = mean + gain @ (law.readings[law.known] - mean[law.known])
        K = K - gain @ K[law.known]
    close(likelihood.predicted(found), mean, K)


def test_the_discrepancy_elsewhere_goes_with_that_at_the_rows() -> None:
    """At the slip of a row it is what it is there; another wheel's is as before any reading."""
    study = joined("phi", discrepancy=CURVES)
    density = posterior(study)
    x = np.repeat(sets(density, 1), 4000, axis=0)
    soil, noise = density.prior.soil_values(x), density.noise_values(x)
    slip = np.array([0.1, 0.28, 0.9])
    found = law_of(study).beyond(soil, noise, "A", slip, np.random.default_rng(3))
    law = written(study, density, x[0])
    inverse = np.linalg.inv(law.covariance[np.ix_(law.known, law.known)])
    residual = law.readings[law.known] - law.mean[law.known]
    rows = study.observations
    for column, name in enumerate(density.likelihood.channels):
        if name not in CURVES:
            assert not found[:, :, column].any()
            continue
        one = study.errors.discrepancy[name]
        same = (law.known % 3 == column) & (np.array(rows.wheel)[law.known // 3] == "A")
        between = (one.size.sd or 0.0) ** 2 * one.correlation(slip, rows.slip[law.known // 3]) * same
        K = (one.size.sd or 0.0) ** 2 * one.correlation(slip, slip) - between @ inverse @ between.T
        close(found[:, :, column], between @ inverse @ residual, K)
    other = law_of(study).beyond(soil, noise, None, slip, np.random.default_rng(4))
    assert np.abs(other.mean(axis=0)[:, 0]).max() < 5 * 1e-3 / np.sqrt(4000)
    assert_allclose(other.std(axis=0)[:, 0], 1e-3, rtol=0.06)


def test_readings_of_another_sweep_have_ripple_and_slip_errors_of_their_own() -> None:
    """Each reading by itself: variance of the ripple, and g² times that of the slip."""
    study = joined("phi", ripple=RIPPLE, slip={"sd": 0.02})
    density, whole = posterior(study), law_of(study)
    x = np.repeat(sets(density, 1), 6000, axis=0)
    soil, noise = density.prior.soil_values(x), density.noise_values(x)
    found = whole.fresh(whole.forward, soil, noise, np.random.default_rng(1))
    expected = np.sqrt(np.diag(written(study, density, x[0]).smooth)).reshape(-1, 3)
    assert_allclose(found.std(axis=0), expected, rtol=0.06)
    plain = Likelihood(whole.forward, whole.observations, whole.noise)
    assert plain.fresh(whole.forward, soil, noise, np.random.default_rng(1)) is None
    assert plain.beyond(soil, noise, "A", np.array([0.1]), np.random.default_rng(1)) is None


def test_a_soil_without_an_answer_has_no_likelihood() -> None:
    """Among others that have one; its rows have none either, and what is drawn for it is NaN."""
    study = joined("phi", "n0", discrepancy=CURVES)
    density = posterior(study)
    x = sets(density, 3)
    x[1] = [5.0, HELD["phi"]] if density.names[0] == "n0" else [HELD["phi"], 5.0]  # nothing carries the load
    soil, noise = density.prior.soil_values(x), density.noise_values(x)
    assert density.likelihood.status(soil)[1] != 0
    total, rows = density.likelihood.log_rows(soil, noise)
    assert np.isneginf(total).tolist() == [False, True, False]
    assert np.isneginf(rows[1]).all()
    assert np.isfinite(rows[[0, 2]]).all()
    curve = law_of(study).beyond(soil, noise, "A", np.array([0.2]), np.random.default_rng(1))
    assert np.isnan(curve[1]).all()
    assert np.isfinite(curve[[0, 2]]).all()


def test_without_anything_told_it_is_the_likelihood_of_independent_rows() -> None:
    """As the size of a discrepancy falls to nothing, so does the difference."""
    tiny = joined("phi", discrepancy={"sinkage": {"sd": 1e-12, "length": 0.3}})
    density, plain = posterior(tiny), posterior(joined("phi"))
    x = sets(density)
    assert_allclose(density.log_density(x), plain.log_density(x), rtol=1e-10)
    assert_allclose(density.log_rows(x)[1], plain.log_rows(x)[1], rtol=1e-9)
