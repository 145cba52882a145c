"""Errors of slip to first order against quadrature over the true slip, and slopes over slip."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.special import logsumexp
from scipy.stats import norm

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.condition_errors import slip_slopes
from bayesterra.likelihood.correlated import CorrelatedLikelihood
from bayesterra.likelihood.forward import Forward
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import Posterior, posterior
from bayesterra.models import Conditions, Wheel
from bayesterra.study.drive import Drive
from bayesterra.study.study import Study
from tests.support.joint_rows import HELD, NOISE, TABLE, WHEELS, joined, sets

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
    for row in range(len(whole.observations)):
        slip = whole.forward.conditions.slip[row] + 6 * sd * NODES
        levels = []
        for at in slip:
            forward = whole.forward.row(row)
            forward = replace(forward, conditions=replace(forward.conditions, slip=np.array([at])))
            one = whole.observations.take(np.arange(len(whole.observations)) == row)
            levels.append(Likelihood(forward, one, whole.noise).log_likelihood(soil, np.empty((len(x), 0))))
        prior = norm.logpdf(slip, whole.forward.conditions.slip[row], sd)
        total += logsumexp(np.array(levels) + (prior + np.log(6 * sd * WEIGHTS))[:, None], axis=0)
    return total


@pytest.mark.parametrize(("sd", "shift", "width"), [(0.005, 0.01, 0.003), (0.01, 0.04, 0.005), (0.02, 0.06, 0.03)])
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


AT_BENDS = "rows 1, 2, 3 within 2 sd of the transition slips 0.15 and 0.5"


@pytest.mark.parametrize(
    ("sd", "distance", "shift", "doubts"),
    [
        (0.005, 0.0, 0.03, AT_BENDS),
        (0.01, 0.0, 0.08, AT_BENDS),
        (0.02, 0.0, 0.17, AT_BENDS),
        (0.03, 0.0, 0.23, f"{AT_BENDS}; row 1, off by more than 20% of the scatter of a reading"),
        (0.05, 0.0, 0.29, f"{AT_BENDS}; row 1, off by more than 20% of the scatter of a reading"),
        (0.03, 1.0, 0.00, AT_BENDS),
        (0.03, 3.0, -0.02, ""),
        (0.01, 3.0, -0.01, ""),
    ],
)
def test_rows_near_a_transition_slip_are_named(sd: float, distance: float, shift: float, doubts: str) -> None:
    """The model bends there, and the first order shifts φ by up to 0.3 sd; farther away all is silent."""
    slips = [0.15 + distance * sd, 0.5 - distance * sd, 0.5 + distance * sd]
    rows = ROWS.assign(slip=slips)
    blank = posterior(joined("phi", "n0", data=rows, slip={"sd": sd}))
    middle = np.array([HELD[name] for name in blank.names])
    forward = blank.likelihood.forward(blank.prior.soil_values(middle[None]))
    exactly = blank.likelihood.predicted(forward)[0] / [1e-3, 1.0, 1.0]
    rows = rows.assign(**dict(zip(ROWS.columns[2:5], exactly.T, strict=True)))
    density = posterior(joined("phi", "n0", data=rows, slip={"sd": sd}))
    x = middle * (1 + np.array([0.05, 0.08]) * np.random.default_rng(1).standard_normal((800, 2)))
    levels = density.log_prior_and_likelihood(x)[1], by_quadrature(density, x, sd)
    found, exact = (np.exp(level - logsumexp(level)) for level in levels)
    phi = x[:, density.names.index("phi")]
    spread = np.sqrt(exact @ (phi - exact @ phi) ** 2)
    assert (found @ phi - exact @ phi) / spread == pytest.approx(shift, abs=0.03)
    typical = middle[None]
    said = density.doubts(typical)
    first = f"errors of slip (sd {sd:.3g}) are taken to first order, which is doubtful in "
    assert said == (first + doubts if doubts else "")


def test_smooth_wheels_and_exact_slips_have_no_doubts() -> None:
    """Without lugs nothing shifts at the transition slips; without [slip] there is nothing to say."""
    rows = ROWS.assign(slip=[0.15, 0.3, 0.5])
    exact = posterior(joined("phi", data=rows, ripple={"sinkage": {"sd": 1e-3, "memory": 2.0}}))
    phi = {"dist": "uniform", "lower": 0.3, "upper": 0.7}
    smooth = Study(rows, {"A": Wheel(0.135, 0.165)}, slip_reference="shearing", model="M2", noise=NOISE,
                   priors={"set": "paper-box", **HELD, "phi": phi},
                   slip={"sd": 0.005})  # fmt: skip
    for density in (exact, posterior(smooth)):
        x = density.prior.sample(5, np.random.default_rng(1))
        assert density.doubts(x) == ""


def test_slopes_are_those_of_the_model() -> None:
    """Central differences inside, one-sided at slip 0, and none across the end of the model."""
    study = joined("phi", data=ROWS, slip={"sd": 0.01})
    density = posterior(study)
    assert isinstance(density.likelihood, CorrelatedLikelihood)
    soil, forward = density.prior.soil_values(sets(density, 2)), density.likelihood.forward
    at = replace(forward.conditions, slip=np.array([0.0, 0.3, 0.998]))
    forward = replace(forward, conditions=at)
    found = slip_slopes(forward, soil, forward.outcomes)
    for row, (low, high) in enumerate([(0.0, 1e-4), (0.2999, 0.3001), (0.9979, 0.998)]):
        ends = [replace(forward, conditions=replace(at, slip=np.full(3, s)))(soil).values[:, row] for s in (low, high)]
        expected = (ends[1] - ends[0]) / (high - low)
        np.testing.assert_allclose(found[:, row], expected, rtol=0.05)


def test_slip_errors_of_a_study_by_sinkage_reach_predictions_by_load() -> None:
    """Readings under a given load feel them where the channel is an outcome there; the load does not."""
    data = TABLE.assign(normal_force=80.0).rename(columns={"normal_force": "normal_force [N]"})
    data["sinkage [mm]"] = [6.6, 10.0, 15.0, 14.2, 13.0, 26.0, 19.0]
    noise = {"normal_force": 1.0, "drawbar_pull": 0.5, "resistance_moment": 0.1}
    study = joined("c", data=data, drive="sinkage", noise=noise, slip={"sd": 0.01})
    likelihood = posterior(study).likelihood
    slips = np.array([0.2, 0.4])
    by_load = Forward(study.model, Drive.LOAD, Conditions.of(WHEELS["A"], slips), np.full(2, 80.0))
    soil = study.prior.soil_values(np.full((400, 1), HELD["c"]))
    drawn = likelihood.fresh(by_load, soil, np.empty((400, 0)), np.random.default_rng(1))
    assert drawn is not None
    force, pull = (likelihood.channels.index(name) for name in ("normal_force", "drawbar_pull"))
    assert np.all(drawn[:, :, force] == 0.0)
    slopes = slip_slopes(by_load, soil[:1], ["drawbar_pull"])[0, :, 0]
    np.testing.assert_allclose(drawn[:, :, pull].std(axis=0), 0.01 * np.abs(slopes), rtol=0.15)
