"""Readings known by a limit where rows hang together: against orthant probabilities and integrals."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.likelihood.correlated import CorrelatedLikelihood
from bayesterra.likelihood.posterior import Posterior, posterior
from bayesterra.likelihood.sensitivities import score_and_information
from bayesterra.study.study import Study
from tests.likelihood.test_condition_errors import CURVE, NOISE, ROWS
from tests.support.joint_rows import CASES, HELD, TABLE, Written, joined, sets, written

NONE = float("nan")
_CELLS: Mapping[str, list[object]] = {
    "sinkage [mm]": [6.6, "<9.5", NONE, 14.2, 13.0, 26.0, 19.0],
    "drawbar_pull [N]": ["<13", 19.0, ">22", NONE, ">18", 19.0, ">21.5"],
    "resistance_moment [N m]": [3.7, 4.8, 5.5, 5.4, 4.5, ">5.8", 5.7],
}
LIMITS = TABLE.assign(**{name: pd.Series(cells, dtype=object) for name, cells in _CELLS.items()})
Case = tuple[Study, Posterior]


DISCREPANCY, ALL = (pytest.param(name, marks=pytest.mark.slow) for name in ("discrepancy", "all"))


@pytest.fixture(name="case", params=[DISCREPANCY, "ripple", "ripple and slip", ALL])
def fixture_case(request: pytest.FixtureRequest) -> Case:
    """Five readings known by a limit, of which errors of the model or of slip tie several to each other."""
    study = joined("phi", "n0", data=LIMITS, **CASES[request.param])
    return study, posterior(study)


def sides(density: Posterior) -> IntArray:
    """−1 for cells known by a limit from above, 1 from below, else 0, of all rows in the fit."""
    likelihood = density.likelihood
    assert likelihood.intervals is not None
    return likelihood.intervals.sides(likelihood.measured).ravel().astype(int)


def exact(law: Written, side: IntArray, cells: IntArray) -> float:
    """Log of the density of the numbers among some cells times the probability of the limits given these."""
    numbers, limits = cells[side[cells] == 0], cells[side[cells] != 0]
    K = law.covariance[np.ix_(numbers, numbers)]
    level = float(multivariate_normal(law.mean[numbers], K).logpdf(law.readings[numbers]))
    if not limits.size:
        return level
    mean, covariance = law.given(limits, numbers)
    turn = side[limits]
    beyond = multivariate_normal.logcdf(
        -turn * law.readings[limits], -turn * mean, turn[:, None] * covariance * turn,
        maxpts=1_000_000, abseps=1e-10, releps=1e-4,
    )  # fmt: skip
    return level + float(beyond)


def test_it_is_the_probability_of_what_lies_beyond(case: Case) -> None:
    """Times the density of the numbers; found: off by 0.004 at most."""
    study, density = case
    x = sets(density, 6)
    found, side = density.log_prior_and_likelihood(x)[1], sides(density)
    assert (side != 0).sum() == 5
    levels = []
    for i, each in enumerate(x):
        law = written(study, density, each)
        levels.append(exact(law, side, law.known))
        assert found[i] == pytest.approx(levels[-1], abs=0.01)
    assert np.ptp(levels) > 1


def test_a_row_is_given_all_others(case: Case) -> None:
    """The level of all rows less that of all others, as leave-one-out needs it; found: off by 0.1 at most.

    The laws in place of other rows' limits are those which all rows tell.
    """
    study, density = case
    x, side = sets(density, 6)[:1], sides(density)
    rows, law = density.log_rows(x)[1], written(study, density, x[0])
    whole = exact(law, side, law.known)
    for i in range(rows.shape[1]):
        others = exact(law, side, law.known[law.known // 3 != i])
        assert rows[0, i] == pytest.approx(whole - others, abs=0.12)


@pytest.mark.parametrize("name", [DISCREPANCY, pytest.param("all", marks=pytest.mark.slow)])
def test_errors_are_drawn_as_the_limits_allow(name: str) -> None:
    """Mean and spread at every row, against draws given the numbers of which those beyond the limits stay."""
    study = joined("phi", "n0", data=LIMITS, **CASES[name])
    density = posterior(study)
    x, side, n = sets(density, 6)[:1], sides(density), 20_000
    law = written(study, density, x[0])
    numbers = law.known[side[law.known] == 0]
    cells, limits = np.arange(len(law.mean)), np.flatnonzero(side)
    gain = law.smooth[:, numbers] @ np.linalg.inv(law.covariance[np.ix_(numbers, numbers)])
    mean = law.mean + gain @ (law.readings[numbers] - law.mean[numbers])
    rng = default_rng(1)
    root = np.linalg.cholesky(law.smooth - gain @ law.smooth[numbers] + 1e-12 * np.eye(len(cells)))
    smooth = mean + rng.standard_normal((400_000, len(cells))) @ root.T
    noise = np.sqrt(np.diag(law.covariance - law.smooth)[limits])
    read = smooth[:, limits] + noise * rng.standard_normal((len(smooth), len(limits)))
    kept = smooth[(side[limits] * (read - law.readings[limits]) > 0).all(axis=1)]
    assert len(kept) > 200
    soil = np.repeat(density.prior.soil_values(x), n, axis=0)
    drawn = density.likelihood.explained(soil, np.repeat(density.noise_values(x), n, axis=0), default_rng(2))
    found = density.likelihood.predicted(drawn).reshape(n, -1)
    here = np.arange(found.shape[1])
    error = kept[:, here].std(axis=0) * (len(kept) ** -0.5 + n**-0.5)
    assert (np.abs(found.mean(axis=0) - kept[:, here].mean(axis=0)) < 4 * error + 0.02 * found.std(axis=0)).all()
    assert_allclose(found.std(axis=0), kept[:, here].std(axis=0), rtol=4 * (2 * len(kept)) ** -0.5 + 0.03, atol=2e-6)


def test_scores_of_limits_are_those_of_what_lies_beyond(case: Case) -> None:
    """A normal score that halves the probability beyond: on the limit's side, and no farther than it must."""
    _, density = case
    x, side = sets(density, 4), sides(density)
    found = density.scores(x).reshape(len(x), -1)
    assert np.isfinite(found[:, side != 0]).all()
    law = density.likelihood
    assert isinstance(law, CorrelatedLikelihood)
    off = (law.measured - law.predicted(law.forward(density.prior.soil_values(x)))).reshape(len(x), -1)
    far = (side * off)[:, side != 0] > 5 * np.abs(off).mean()
    assert (np.sign(found[:, side != 0])[far] == np.broadcast_to(side[side != 0], far.shape)[far]).all()


def test_the_gradient_is_that_of_differences(case: Case) -> None:
    """By soil and sizes."""
    _, density = case
    x = sets(density, 2)
    found, step = score_and_information(density, x)[0], 1e-4
    for j in range(x.shape[1]):
        ends = []
        for sign in (-1, 1):
            moved = x.copy()
            moved[:, j] *= 1 + sign * step
            ends.append(density.log_prior_and_likelihood(moved)[1])
        slope = (ends[1] - ends[0]) / (2 * step * x[:, j])
        assert_allclose(found[:, j], slope, rtol=0.01, atol=0.01 * np.abs(found[:, j]).max())


@pytest.mark.parametrize("limit", ["drawbar_pull [N]", "normal_force [N]", "sinkage [mm]"])
def test_beside_latent_loads_it_is_the_integral_over_the_reading(limit: str) -> None:
    """Of two rows under latent loads; the density of a number, summed over all that lies beyond the limit."""
    both: dict[str, Any] = {"drive": "both", "load_range": ["40 N", "120 N"], "noise": NOISE}
    low = float(ROWS[limit][1])
    table = ROWS.assign(**{limit: pd.Series([ROWS[limit][0], f">{low:g}"], dtype=object)})
    density = posterior(joined("phi", "n0", data=table, discrepancy=CURVE, **both))
    x = np.array([HELD["n0"], HELD["phi"]]) * (1 + 0.03 * default_rng(1).standard_normal((8, 2)))
    found = density.log_prior_and_likelihood(x)[1]
    nodes, weights = np.polynomial.legendre.leggauss(60)
    width = {"drawbar_pull [N]": 12.0, "normal_force [N]": 60.0, "sinkage [mm]": 15.0}[limit]
    scale = 1e-3 if "mm" in limit else 1.0
    levels: list[FloatArray] = []
    for node, weight in zip(nodes, weights, strict=True):
        numbers = table.assign(**{limit: [ROWS[limit][0], low + 0.5 * width * (node + 1)]})
        study = joined("phi", "n0", data=numbers, discrepancy=CURVE, **both)
        levels.append(posterior(study).log_prior_and_likelihood(x)[1] + np.log(0.5 * width * scale * weight))
    assert np.ptp(found) > 1
    assert_allclose(found, logsumexp(levels, axis=0), atol=0.03)


def test_another_table_has_limits_of_its_own(case: Case) -> None:
    """A replicate in which one limit is a number and none of the others is one, as an instrument shows it."""
    study, density = case
    x, side = sets(density, 3), sides(density)
    likelihood = density.likelihood
    assert likelihood.intervals is not None
    law = likelihood.joint_law(density.prior.soil_values(x), density.noise_values(x))
    assert law is not None
    readings = likelihood.measured.copy()
    row, column = np.argwhere(side.reshape(readings.shape) > 0)[0]
    readings[row, column] -= 0.7
    assert not likelihood.intervals.limited(readings)[row, column]
    found = likelihood.reading(law, readings).log_density(readings)
    other = side.copy()
    other[row * readings.shape[1] + column] = 0
    for i, each in enumerate(x):
        of = written(study, density, each)
        of.readings[: readings.size] = readings.ravel()
        assert found[i] == pytest.approx(exact(of, other, of.known), abs=0.01)
    assert not np.allclose(found, law.log_density(readings), atol=0.05)
