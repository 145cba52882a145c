"""Latent loads of rows that hang together, to first order: against integrals over the loads themselves."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from scipy.special import logsumexp
from scipy.stats import norm

from bayesterra.arrays import FloatArray
from bayesterra.checking.folds import predictives
from bayesterra.likelihood.correlated import CorrelatedLikelihood
from bayesterra.likelihood.likelihood import LatentLoad
from bayesterra.likelihood.posterior import Posterior, posterior
from bayesterra.likelihood.sensitivities import score_and_information
from bayesterra.study.study import Study
from tests.support.joint_rows import HELD, joined

NONE = float("nan")
ROWS = pd.DataFrame(
    {
        "slip": [0.2, 0.35],
        "normal_force [N]": [79.0, 82.0],
        "sinkage [mm]": [10.2, 16.5],
        "drawbar_pull [N]": [19.0, 21.2],
        "resistance_moment [N m]": [4.8, 5.5],
        "wheel": "A",
    }
)
NOISE = {"normal_force": 3.0, "sinkage": 1e-3, "drawbar_pull": 0.5, "resistance_moment": 0.1}
CURVE = {"drawbar_pull": {"sd": 1.5, "length": 0.3}}
NODES, WEIGHTS = np.polynomial.legendre.leggauss(256)


def study(**tables: Any) -> Study:
    """Two rows whose loads are latent; φ and n0 free."""
    given: dict[str, Any] = {"drive": "both", "load_range": ["40 N", "120 N"], "noise": NOISE, **tables}
    return joined("phi", "n0", data=given.pop("data", ROWS), **given)


def sets(n: int, spread: float = 0.05) -> FloatArray:
    """Parameter sets around the held values, n0 and φ."""
    middle = np.array([HELD["n0"], HELD["phi"]])
    return middle * (1 + spread * default_rng(1).standard_normal((n, 2)))


def by_quadrature(density: Posterior, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Log likelihood (n,) and mean loads (n, 2) of two rows: a sum over the loads of both."""
    whole = density.likelihood
    assert isinstance(whole, CorrelatedLikelihood)
    assert whole.load_range is not None
    low, high = whole.load_range
    loads = low + 0.5 * (high - low) * (NODES + 1)
    weights = np.log(0.5 * WEIGHTS)[:, None] + np.log(0.5 * WEIGHTS)
    soil, none = density.prior.soil_values(x), np.empty((len(x), 0))
    values = np.stack([whole.predicted(whole.forward.at_load(load)(soil, every_row=True)) for load in loads], axis=1)
    known = replace(whole, load_range=None)
    levels, means = np.empty(len(x)), np.empty((len(x), 2))
    for i in range(len(x)):
        law = known.law_at(soil[[i]], np.nan_to_num(values[i, :1]), none[[i]])
        pairs = np.stack(np.broadcast_arrays(values[i, :, None, 0], values[i, None, :, 1]), axis=2)
        flat = np.nan_to_num(pairs.reshape(-1, *pairs.shape[2:]), nan=1e9)
        parts = replace(law, mean=flat, scale=np.broadcast_to(law.scale, flat.shape))
        density_of = parts.log_density(whole.measured).reshape(len(loads), -1) + weights
        levels[i] = logsumexp(density_of)
        share = np.exp(density_of - levels[i])
        means[i] = share.sum(axis=1) @ loads, share.sum(axis=0) @ loads
    return levels, means


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"data": ROWS.drop(columns="normal_force [N]")},
        {"data": ROWS.assign(**{"sinkage [mm]": [10.2, NONE]})},
        {"load_range": ["80 N", "120 N"]},
        {"discrepancy": {**CURVE, "sinkage": {"sd": 2e-3, "length": 0.2}}},
    ],
    ids=["all", "no force", "a sinkage missing", "at an edge", "two curves"],
)
def test_it_is_the_integral_over_the_loads(change: dict[str, Any]) -> None:
    """Of two rows that a discrepancy ties; found: off by 0.007 at most."""
    density, x = posterior(study(**{"discrepancy": CURVE, **change})), sets(40)
    found, (exact, _) = density.log_prior_and_likelihood(x)[1], by_quadrature(density, x)
    assert np.ptp(exact) > 3
    np.testing.assert_allclose(found, exact, atol=0.01)


def test_it_tends_to_rows_apart_as_the_discrepancy_vanishes() -> None:
    """The same as where nothing ties the rows, whose loads are integrated out exactly."""
    tied = posterior(study(discrepancy={"drawbar_pull": {"sd": 1e-6, "length": 0.3}}))
    apart = posterior(study())
    assert isinstance(apart.likelihood, LatentLoad)
    x = sets(200)
    found, exact = (density.log_prior_and_likelihood(x)[1] for density in (tied, apart))
    np.testing.assert_allclose(found, exact, atol=0.02)
    soil, none = apart.prior.soil_values(x), np.empty((len(x), 0))
    rows = [density.likelihood.log_rows(soil, none)[1] for density in (tied, apart)]
    np.testing.assert_allclose(rows[0], rows[1], atol=0.02)


def test_loads_are_drawn_as_the_integral_has_them() -> None:
    """Their means given the readings; before them all over the range, with a discrepancy of its size."""
    density, x = posterior(study(discrepancy=CURVE)), sets(1)
    whole, soil = density.likelihood, np.repeat(density.prior.soil_values(x), 4000, axis=0)
    none = np.empty((4000, 0))
    loads = whole.explained(soil, none, default_rng(2))["normal_force"]
    _, means = by_quadrature(density, x)
    assert (np.abs(loads.mean(axis=0) - means[0]) < 4 * loads.std(axis=0) / 4000**0.5 + 0.01).all()
    imagined = whole.imagined(soil, none, default_rng(3))
    before = imagined["normal_force"]
    assert (before.min(), before.max()) == pytest.approx((40, 120), abs=0.2)
    pull = whole.forward.at_load(before)(soil)["drawbar_pull"]
    curve = imagined["drawbar_pull"] - pull
    assert curve.std() == pytest.approx(1.5, rel=0.05)
    assert np.asarray(np.corrcoef(curve.T))[0, 1] == pytest.approx(np.exp(-0.5 * 0.5**2), abs=0.05)


def test_a_row_left_out_is_foreseen_by_its_force_and_the_others() -> None:
    """The law of its pull is what its reading adds to the log likelihood."""
    data = ROWS.assign(**{"sinkage [mm]": [10.2, NONE], "resistance_moment [N m]": [4.8, NONE]})
    whole, x = study(discrepancy=CURVE, data=data), sets(20)
    without = data.assign(**{"drawbar_pull [N]": [19.0, NONE]})
    more, less = (
        posterior(each).log_prior_and_likelihood(x)[1] for each in (whole, study(discrepancy=CURVE, data=without))
    )
    left = np.array([False, True])
    foreseen = predictives(whole, posterior(whole), x, left, default_rng(1))
    pull = foreseen.channels.index("drawbar_pull")
    at = norm.logpdf(21.2, foreseen.centre[:, 0, pull], foreseen.scale[:, 0, pull])
    np.testing.assert_allclose(more - less, at, atol=0.02)


def test_score_and_information_count_the_load() -> None:
    """The score is the gradient; its scatter over readings is the information."""
    density, x = posterior(study(discrepancy=CURVE, slip={"sd": 0.005})), sets(20, 0.02)
    score, information = score_and_information(density, x)
    size = 1 / np.sqrt(np.einsum("ndd->nd", information))
    for i in range(2):
        step = 1e-3 * size[:, [i]] * np.eye(2)[i]
        up, down = (density.log_prior_and_likelihood(at)[1] for at in (x + step, x - step))
        gradient = (up - down) / (2 * step[:, i])
        np.testing.assert_allclose(score[:, i] * size[:, i], gradient * size[:, i], atol=0.15, rtol=0.1)
    whole, rng = density.likelihood, default_rng(4)
    soil, none = np.repeat(density.prior.soil_values(x[:1]), 400, axis=0), np.empty((400, 0))
    middle = study(discrepancy=CURVE, slip={"sd": 0.005}, load_range=["79 N", "81 N"])
    drawn = posterior(middle).likelihood.imagined(soil, none, rng)
    readings = whole.draw(drawn, none, rng)
    scores = []
    for table in readings:
        values = dict(zip(whole.channels, table.T, strict=True))
        own = replace(whole, observations=replace(whole.observations, values=values))
        scores.append(score_and_information(Posterior(density.prior, own), x[:1])[0][0])
    np.testing.assert_allclose(np.cov(np.array(scores).T), information[0], rtol=0.3)
