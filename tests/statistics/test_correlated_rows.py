"""What is made of rows that hang together: leave-one-out, replicates, information, groups, ranks."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.random import SeedSequence, default_rng
from numpy.testing import assert_allclose
from scipy.linalg import eigh
from scipy.special import logsumexp, ndtr
from scipy.stats import kstest, multivariate_normal

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.checking.calibration import replicated
from bayesterra.checking.folds import predictives
from bayesterra.checking.loo import cross_validate
from bayesterra.checking.predictive import Modelled, ReplicateOptions, predict_curves, predict_rows
from bayesterra.checking.predictive_checks import predictive_checks
from bayesterra.likelihood.correlated import CorrelatedLikelihood
from bayesterra.likelihood.joint import joint_posterior
from bayesterra.likelihood.posterior import Posterior, posterior
from bayesterra.likelihood.sensitivities import score_and_information
from bayesterra.models import M1, Soil
from bayesterra.study.study import Study
from tests.support.fisher import fisher_information
from tests.support.joint_rows import (
    CASES,
    CURVES,
    HELD,
    LOOSE,
    NOISE,
    RIPPLE,
    TABLE,
    WHEELS,
    Written,
    joined,
    sets,
    written,
)

ANGLES = np.linspace(0.3, 0.75, 241)
"""A grid of friction angles, the only free parameter."""


def weights(density: Posterior, level: FloatArray) -> FloatArray:
    """Posterior weights on the grid for log likelihoods (n,)."""
    level = level + density.prior.log_density(ANGLES[:, None])
    return np.asarray(np.exp(level - logsumexp(level)))


def one_angle() -> tuple[Study, Posterior, list[Written]]:
    """A study with φ free, and the law written out on the grid."""
    study = joined("phi", discrepancy=CURVES, ripple=RIPPLE)
    density = posterior(study)
    return study, density, [written(study, density, np.array([phi])) for phi in ANGLES]


def log_densities(laws: list[Written], cells: IntArray) -> FloatArray:
    """Log density (n,) of the readings in some cells."""
    return np.array(
        [
            multivariate_normal(one.mean[cells], one.covariance[np.ix_(cells, cells)]).logpdf(one.readings[cells])
            for one in laws
        ]
    )


@pytest.mark.parametrize("few_rows", [2, pytest.param(20, marks=pytest.mark.slow)], ids=["weights", "new samplings"])
def test_leave_one_out_is_that_of_the_joint_law(few_rows: int) -> None:
    """Every row predicted by all others, by sums over a grid; so are the probabilities of its channels."""
    _, density, laws = one_angle()
    whole = laws[0].known
    w = weights(density, log_densities(laws, whole))
    x = default_rng(1).choice(ANGLES, size=(4000, 1), p=w) + default_rng(2).uniform(-1, 1, (4000, 1)) * 9e-4
    found = cross_validate(density, x, SeedSequence(1), {}, few_rows=few_rows)[0]
    for i, row in enumerate(found.rows):
        mine = whole[whole // 3 == i]
        left = log_densities(laws, np.setdiff1d(whole, mine))
        prior = density.prior.log_density(ANGLES[:, None])
        expected = logsumexp(log_densities(laws, whole) + prior) - logsumexp(left + prior)
        assert row.elpd == pytest.approx(expected, abs=0.08)
        for column, channel in enumerate(density.likelihood.channels) if found.pit else ():
            if 3 * i + column in mine:
                w = weights(density, left)
                laws_of = [one.given(np.array([3 * i + column]), np.setdiff1d(whole, mine)) for one in laws]
                y = laws[0].readings[3 * i + column]
                pit = sum(a * ndtr((y - m[0]) / K[0, 0] ** 0.5) for a, (m, K) in zip(w, laws_of, strict=True))
                assert found.pit[channel][i] == pytest.approx(pit, abs=0.04)


@pytest.mark.parametrize("name", ["discrepancy", "all"])
def test_replicated_tables_have_the_likelihood_of_real_ones(name: str) -> None:
    """Weights of other readings come from the joint law, and what explains them from those readings."""
    study = joined("phi", "n0", **CASES[name])
    density = posterior(study)
    x = sets(density, 4)
    modelled = Modelled.of(density, x, density.explained(x, default_rng(1)))
    likelihood = density.likelihood
    table = likelihood.measured + 0.3 * np.array([1e-3, 1.0, 0.2])
    values = {n: table[:, i] for i, n in enumerate(likelihood.channels)}
    other = replace(likelihood, observations=replace(likelihood.observations, values=values))
    expected = replace(density, likelihood=other).log_prior_and_likelihood(x)[1]
    assert_allclose(modelled.log_likelihood(likelihood, table), expected, rtol=1e-9)
    one = modelled.take(np.zeros(4000, dtype=np.int64))
    moved = one.explaining(likelihood, table, default_rng(2)).mean.mean(axis=0)
    soil, noise = density.prior.soil_values(x[:1]), density.noise_values(x[:1])
    soil, noise = np.repeat(soil, 4000, axis=0), np.repeat(noise, 4000, axis=0)
    direct = other.predicted(other.explained(soil, noise, default_rng(3))).mean(axis=0)
    assert_allclose(moved, direct, atol=0.06, rtol=0.02)


def test_predictive_checks_run_on_such_tables() -> None:
    """Readings that the model made are not strange to it."""
    study = joined("phi", discrepancy=CURVES, ripple=RIPPLE)
    truth, made = replicated(study, default_rng(11))
    density = posterior(made)
    grid = np.linspace(max(0.02, truth[0, 0] - 0.3), truth[0, 0] + 0.3, 1200)[:, None]
    level = density.log_density(grid)
    w = np.exp(level - level.max())
    draws = default_rng(1).choice(grid[:, 0], size=(2000, 1), p=w / w.sum())
    draws = draws + default_rng(2).uniform(-2.5e-4, 2.5e-4, draws.shape)
    found = predictive_checks(density, draws, SeedSequence(3), ReplicateOptions(number=40, pool=1024))
    assert found.replicates == 40
    assert found.overall > 0.01
    assert found.effective[1] > 50


def from_covariances(study: Study, density: Posterior, x: FloatArray) -> FloatArray:
    """Information (d, d) about the parameters by differences of the law written out."""
    parts = []
    for i in range(len(x)):
        step = np.where(np.arange(len(x)) == i, 1e-5 * np.abs(x), 0.0)
        high, low = written(study, density, x + step), written(study, density, x - step)
        parts.append([(a - b) / (2 * step[i]) for a, b in
                      ((high.mean, low.mean), (high.covariance, low.covariance))])  # fmt: skip
    law = written(study, density, x)
    pick = law.known
    inverse = np.linalg.inv(law.covariance[np.ix_(pick, pick)])
    found = np.empty((len(x), len(x)))
    for i, (mean, K) in enumerate(parts):
        for j, (other, L) in enumerate(parts):
            scatter = inverse @ K[np.ix_(pick, pick)] @ inverse @ L[np.ix_(pick, pick)]
            found[i, j] = mean[pick] @ inverse @ other[pick] + 0.5 * np.trace(scatter)
    return found


@pytest.mark.parametrize("name", CASES)
def test_score_and_information_are_those_of_the_joint_law(name: str) -> None:
    """Slopes of the mean whitened by the whole covariance, and what the scatter says of sizes and noise.

    The score is the gradient of the log likelihood.
    """
    study = joined("phi", "n0", **CASES[name])
    density = posterior(study)
    x = sets(density, 1)
    found = fisher_information(density, x)[0]
    expected = from_covariances(study, density, x[0])
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert_allclose(found / size, expected / size, atol=2e-5)
    score, information = score_and_information(density, x)
    assert_allclose(information[0], found, rtol=1e-12)
    for i, unit in enumerate(np.eye(x.shape[1])):
        step = 1e-6 * x * unit
        ahead, behind = (density.log_prior_and_likelihood(at)[1][0] for at in (x + step, x - step))
        slope = (ahead - behind) / (2 * step[0, i])
        assert_allclose(score[0, i] / size[i, i] ** 0.5, slope / size[i, i] ** 0.5, rtol=1e-4, atol=1e-3)


def test_a_discrepancy_takes_information_away() -> None:
    """In every direction; a large one nearly all."""
    plain = posterior(joined("phi", "n0", "c"))
    x = sets(plain, 1)
    known = fisher_information(plain, x)[0]
    for sd, share in ((0.5, 1.0), (20.0, 0.05)):
        tables = {name: {"sd": sd * one, "length": 0.3} for name, one in NOISE.items()}
        told = fisher_information(posterior(joined("phi", "n0", "c", discrepancy=tables)), x)[0]
        assert np.linalg.eigvalsh(known - told).min() > -1e-6 * np.abs(known).max()
        assert eigh(told, known, eigvals_only=True).max() < share


@pytest.mark.parametrize("name", ["discrepancy", "ripple and slip"])
def test_rows_held_out_are_predicted_by_those_beside_them(name: str) -> None:
    """Law of each left-out reading for each draw: given the readings of the training rows."""
    study = joined("phi", "n0", **CASES[name])
    left = np.array([0, 0, 1, 0, 0, 1, 0], dtype=bool)
    target = posterior(study.with_use(study.observations.use & ~left))
    draws = np.repeat(sets(target, 2), 15, axis=0)
    found = predictives(study, target, draws, left, default_rng(1))
    for n in (0, 15):
        law = written(study, target, draws[n])
        training = law.known[~left[law.known // 3]]
        cells = np.array([6, 7, 8, 15, 16, 17])
        mean, K = law.given(cells, training)
        assert_allclose(found.centre[n].ravel(), mean, rtol=1e-7)
        assert_allclose(found.scale[n].ravel(), np.sqrt(np.diag(K)), rtol=1e-6)


def test_rows_and_curves_are_predicted_with_the_discrepancy() -> None:
    """At a fitted row the curve's band is that of the readings behind it; far from all, that of the prior."""
    study = joined("phi", discrepancy=CURVES, ripple=RIPPLE)
    density = posterior(study)
    x = np.repeat(sets(density, 1), 4000, axis=0)
    before = predict_rows(study, density, x, default_rng(1), before=True)
    after = predict_rows(study, density, x, default_rng(1))
    law = written(study, density, x[0])
    assert_allclose(before.readings.std(axis=0), np.sqrt(np.diag(law.covariance)).reshape(-1, 3), rtol=0.07)
    assert (after.modelled.std(axis=0)[:6, 0] < 0.6 * before.modelled.std(axis=0)[:6, 0]).all()
    curve = predict_curves(study, density, x, default_rng(2))[0]
    assert curve.modelled[:, -1, 0].std() < curve.modelled[:, 0, 0].std() * 4
    noisy = curve.readings.std(axis=0)[:, 1] ** 2 - curve.modelled.std(axis=0)[:, 1] ** 2
    assert_allclose(noisy, 0.5**2 + 0.8**2, rtol=0.35)


def test_groups_by_wheel_make_up_the_whole() -> None:
    """A curve belongs to a wheel, so the likelihoods of wheels multiply."""
    tables: dict[str, Any] = {"discrepancy": LOOSE, "ripple": RIPPLE, "slip": {"sd": 0.01}}
    study = joined("phi", "K", **tables, pooling={"by": "wheel", "separate": ["K"]})
    groups = joint_posterior(study).groups.values()
    density = posterior(joined("phi", "K", **tables))
    x = sets(density)
    parts = sum(one.log_prior_and_likelihood(x)[1] for one in groups)
    assert_allclose(parts, density.log_prior_and_likelihood(x)[1], rtol=1e-9)


def test_before_any_reading_there_is_the_prior_only() -> None:
    """A table of drives to come: nothing is learnt, and readings have all their errors."""
    data = TABLE[["wheel", "run", "slip", "load [N]"]]
    study = joined("phi", data=data, prior_only=True, **CASES["all"])
    density = posterior(study)
    x = sets(density, 3)
    assert (density.log_prior_and_likelihood(x)[1] == 0.0).all()
    assert (density.log_rows(x)[1] == 0.0).all()
    found = predict_rows(study, density, np.repeat(x[:1], 400, axis=0), default_rng(1), before=True)
    assert (found.readings.std(axis=0) > 0.9 * np.array(list(NOISE.values()))).all()
    assert np.isfinite(fisher_information(density, x)).all()


@pytest.mark.slow
def test_the_posterior_is_right_over_the_prior() -> None:
    """Ranks of 250 true angles among grid posteriors of the readings that they make are uniform."""
    law = {"dist": "norm", "loc": 0.5, "scale": 0.05, "lower": 0.3, "upper": 0.74}
    priors = {"set": "paper-box", **{n: v for n, v in HELD.items() if n != "phi"}, "phi": law}
    study = joined("phi", priors=priors, discrepancy=CURVES, ripple=RIPPLE, slip={"sd": 0.01})
    rng, ranks = default_rng(21), []
    for _ in range(250):
        truth, made = replicated(study, rng)
        density = posterior(made)
        assert isinstance(density.likelihood, CorrelatedLikelihood)
        w = weights(density, density.log_prior_and_likelihood(ANGLES[:, None])[1])
        ranks.append(w[truth[0, 0] > ANGLES].sum())
    assert kstest(ranks, "uniform").pvalue > 0.01


def test_a_wrong_model_is_sure_of_itself_until_told() -> None:
    """M2 on readings of M1: c and φ are far out without a discrepancy, inside 90 % with one."""
    slip = np.array([0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6])
    soil, wheel = Soil(**HELD), WHEELS["A"]
    z = np.asarray(M1().sinkage(soil, wheel, slip, 80.0))
    forces = M1().forces(soil, wheel, slip, z)
    data = pd.DataFrame(
        {
            "wheel": "A",
            "slip": slip,
            "load [N]": 80.0,
            "drawbar_pull [N]": forces.drawbar_pull,
            "resistance_moment [N m]": forces.resistance_moment,
        }
    )
    noise = {"drawbar_pull": 0.25, "resistance_moment": 0.05}
    curves = {"drawbar_pull": {"sd": 2.0, "length": 0.3}, "resistance_moment": {"sd": 0.4, "length": 0.3}}
    c, phi = np.meshgrid(np.linspace(0.0, 5000.0, 201), np.linspace(0.05, 0.85, 201))
    shares = []
    for told in ({}, curves):
        density = posterior(joined("phi", "c", data=data, noise=noise, discrepancy=told))
        columns = {"c": c.ravel(), "phi": phi.ravel()}
        x = np.column_stack([columns[name] for name in density.names])
        level = density.log_density(x)
        w = np.exp(level - level.max())
        truth = density.log_density(np.array([[HELD[name] for name in density.names]]))[0]
        shares.append(float(w[level > truth].sum() / w.sum()))
    assert shares[0] > 0.999
    assert shares[1] < 0.9
