"""Errors of slip to first order against quadrature over the true slip, and slopes over slip."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.special import logsumexp
from scipy.stats import norm

from bayesterra.arrays import FloatArray
from bayesterra.joint_rows import JointRows, slip_slopes
from bayesterra.likelihood import Likelihood
from bayesterra.posteriors import Posterior, posterior

from .conftest import HELD, NOISE, joined, sets

ROWS = pd.DataFrame(
    {
        "slip": [0.2, 0.35, 0.45],
        "load [N]": 80.0,
        "sinkage [mm]": [10.2, 16.5, 21.6],
        "drawbar_pull [N]": [19.0, 21.2, 21.5],
        "resistance_moment [N m]": [4.8, 5.5, 5.8],
        "wheel": "A",
    }
)
NODES, WEIGHTS = np.polynomial.legendre.leggauss(96)


def by_quadrature(density: Posterior, x: FloatArray, sd: float) -> FloatArray:
    """Log likelihood (n,), the true slip of every row integrated out: a normal law around the one read."""
    whole = density.likelihood
    soil, total = density.prior.soil_values(x), np.zeros(len(x))
    for row in range(len(ROWS)):
        slip = whole.forward.conditions.slip[row] + 6 * sd * NODES
        levels = []
        for at in slip:
            forward = whole.forward.row(row)
            forward = replace(forward, conditions=replace(forward.conditions, slip=np.array([at])))
            one = whole.observations.take(np.arange(len(ROWS)) == row)
            levels.append(Likelihood(forward, one, whole.noise).log_likelihood(soil, np.empty((len(x), 0))))
        prior = norm.logpdf(slip, whole.forward.conditions.slip[row], sd)
        total += logsumexp(np.array(levels) + (prior + np.log(6 * sd * WEIGHTS))[:, None], axis=0)
    return total


@pytest.mark.parametrize(
    ("sd", "shift", "width"), [(0.005, 0.01, 0.003), (0.01, 0.04, 0.005), (0.02, 0.06, 0.03)]
)
def test_the_first_order_gives_the_posterior_of_the_integral(sd: float, shift: float, width: float) -> None:
    """Mean and standard deviation of two parameters from three rows through M2, by weights of the same sets.

    Found: means off by 0.006, 0.027 and 0.039 sd, sds by 0.1, 0.1 and 1.9 %.
    """
    density = posterior(joined("phi", "n0", data=ROWS, slip={"sd": sd}, noise=NOISE))
    middle = np.array([HELD[name] for name in density.names])
    x = middle * (1 + 0.05 * np.random.default_rng(1).standard_normal((300, 2)))
    levels = density.log_prior_and_likelihood(x)[1], by_quadrature(density, x, sd)
    found, exact = (np.exp(level - logsumexp(level)) for level in levels)
    assert 1 / (exact**2).sum() > 12
    spread = [np.sqrt(w @ (x - w @ x) ** 2) for w in (found, exact)]
    assert (np.abs(found @ x - exact @ x) < shift * spread[1]).all()
    np.testing.assert_allclose(spread[0], spread[1], rtol=width)


def test_slopes_are_those_of_the_model() -> None:
    """Central differences inside, one-sided at slip 0, and none across the end of the model."""
    study = joined("phi", data=ROWS, slip={"sd": 0.01})
    density = posterior(study)
    assert isinstance(density.likelihood, JointRows)
    soil, forward = density.prior.soil_values(sets(density, 2)), density.likelihood.forward
    at = replace(forward.conditions, slip=np.array([0.0, 0.3, 0.998]))
    forward = replace(forward, conditions=at)
    found = slip_slopes(forward, soil)
    for row, (low, high) in enumerate([(0.0, 1e-4), (0.2999, 0.3001), (0.9979, 0.998)]):
        ends = [
            replace(forward, conditions=replace(at, slip=np.full(3, s)))(soil).values[:, row]
            for s in (low, high)
        ]
        expected = (ends[1] - ends[0]) / (high - low)
        np.testing.assert_allclose(found[:, row], expected, rtol=0.05)
