"""Readings that are rounded to a step, or known to lie below or above a limit."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.typing import NDArray
from scipy.integrate import quad

from bayesterra.likelihood.likelihood import LatentLoad
from bayesterra.likelihood.posterior import Posterior, likelihood_of, posterior
from bayesterra.likelihood.sensitivities import score_and_information
from bayesterra.stats.laws import Law
from bayesterra.study.noise import Noise
from bayesterra.study.study import Study
from tests.support.one_wheel import MakeStudy, MakeTable

STEP = 2e-3
PULL = "drawbar_pull [N]"
LAWS: Mapping[str, Mapping[str, object]] = {
    "given": {"sd": 1e-3},
    "heavy": {"sd": 1e-3, "dof": 3.0},
    "fraction": {"fraction": 0.1, "floor": 1e-4},
    "estimated": {"law": Law("halfnorm", {"scale": 2e-3}, lower=2e-4)},
}


def _rounded(table: pd.DataFrame, limits: bool = True) -> pd.DataFrame:
    """The table with sinkages in steps, and two pulls of which a limit is known."""
    table["sinkage [m]"] = STEP * np.round(table["sinkage [m]"] / STEP)
    pulls = table[PULL].astype(object)
    if limits:
        pulls[0], pulls[5] = "<1.5", "> 20"
    table[PULL] = pulls
    return table


@pytest.fixture(name="study", params=list(LAWS))
def fixture_study(request: pytest.FixtureRequest, make_study: MakeStudy, make_table: MakeTable) -> Study:
    """Rounded sinkages with every kind of noise, and pulls of which two are known by a limit."""
    noise = Noise("sinkage", resolution=STEP, **LAWS[request.param])  # type: ignore[arg-type]
    return make_study(data=_rounded(make_table()), free=("n0", "K", "phi"), noise={"sinkage": noise})


@pytest.fixture(name="target")
def fixture_target(study: Study) -> Posterior:
    """Its posterior."""
    return posterior(study)


def _sets(target: Posterior, n: int = 5) -> NDArray[np.float64]:
    """Parameter sets around the truth."""
    middle = {"n0": 0.8, "K": 0.01, "phi": 0.5, "noise_sinkage": 1e-3}
    x = np.array([[middle[name] for name in target.names]])
    return x * (1 + 0.03 * default_rng(5).standard_normal((n, len(target.names))))


def test_a_rounded_reading_is_the_mean_density_of_its_step(study: Study, target: Posterior) -> None:
    """Integrated by quadrature, for all laws of noise."""
    x = _sets(target, 2)
    terms = target.log_terms(x)[:, :, 0]
    blunt = replace(study.noise["sinkage"], resolution=0.0)
    sharp = replace(target.likelihood, noise=(blunt, *target.likelihood.noise[1:]))
    mean = sharp.predicted(target.outcomes(x))[:, :, 0]
    scale = sharp.scales(sharp.predicted(target.outcomes(x)), target.noise_values(x))[:, :, 0]
    for (i, j), level in np.ndenumerate(terms):
        read = study.observations.values["sinkage"][j]

        def density(y: float, i: int = i, j: int = j) -> float:
            z = np.array([(y - mean[i, j]) / scale[i, j]])
            return float(np.exp(blunt.tails.log_density(z)[0]) / scale[i, j])

        points = np.clip([mean[i, j]], read - STEP / 2, read + STEP / 2)
        mass = quad(density, read - STEP / 2, read + STEP / 2, points=points, epsabs=0, epsrel=1e-10)[0]
        assert level == pytest.approx(np.log(mass / STEP), abs=1e-7)


def test_probabilities_of_all_steps_add_up_to_one(target: Posterior) -> None:
    """Whatever the reading, one of the steps is shown."""
    x = _sets(target, 1)
    likelihood = target.likelihood
    predicted = likelihood.predicted(target.outcomes(x))
    scale = likelihood.scales(predicted, target.noise_values(x), rounded=False)
    total = np.zeros(len(likelihood.measured))
    for k in range(-500, 501):
        readings = likelihood.measured + np.array([k * STEP, 0.0, 0.0])
        total += STEP * np.exp(likelihood.log_readings(readings, predicted, scale)[0, :, 0])
    np.testing.assert_allclose(total, 1.0, atol=1e-6)


def test_a_limit_counts_what_lies_beyond_it(target: Posterior) -> None:
    """Below 1.5 N in the first row, above 20 N in the last, densities between."""
    x = _sets(target, 3)
    terms, pull = target.log_terms(x)[:, :, 1], target.outcomes(x)["drawbar_pull"]
    law = target.likelihood.noise[1].tails
    np.testing.assert_allclose(terms[:, 0], np.log(law.cdf((1.5 - pull[:, 0]) / 1.5)), rtol=1e-9)
    np.testing.assert_allclose(terms[:, 5], np.log(law.cdf((pull[:, 5] - 20.0) / 1.5)), rtol=1e-9)
    between = (target.likelihood.measured[1:5, 1] - pull[:, 1:5]) / 1.5
    np.testing.assert_allclose(terms[:, 1:5], law.log_density(between) - np.log(1.5), rtol=1e-9)


def test_gradient_is_that_of_differences(target: Posterior) -> None:
    """By place and by scale, of steps and of limits."""
    x = _sets(target)
    score, information = score_and_information(target, x)
    for i, size in enumerate(1e-6 * np.abs(x[0])):
        ends = [target.log_prior_and_likelihood(x + s * size * np.eye(x.shape[1])[i])[1] for s in (1, -1)]
        np.testing.assert_allclose(score[:, i], (ends[0] - ends[1]) / (2 * size), rtol=2e-5, atol=1e-4)
    assert (np.linalg.eigvalsh(information) > -1e-9).all()


def test_what_is_drawn_is_what_an_instrument_shows(study: Study, target: Posterior) -> None:
    """Sinkages in steps of the readings, pulls held at their limits, and the noise as it should be."""
    x = np.repeat(_sets(target, 1), 20_000, axis=0)
    likelihood = target.likelihood
    drawn = likelihood.draw(target.outcomes(x), target.noise_values(x), default_rng(1))
    steps = (drawn[:, :, 0] - study.observations.values["sinkage"]) / STEP
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert drawn[:, 0, 1].min() == 1.5
    assert drawn[:, 5, 1].max() == 20.0
    predicted = likelihood.predicted(target.outcomes(x[:1]))
    scale = likelihood.scales(predicted, target.noise_values(x[:1]), rounded=False)
    shown = np.unique(drawn[:, 2, 0])
    for value in shown[:: max(1, len(shown) // 5)]:
        readings = likelihood.measured.copy()
        readings[2, 0] = value
        expected = STEP * np.exp(likelihood.log_readings(readings, predicted, scale)[0, 2, 0])
        share = np.mean(drawn[:, 2, 0] == value)
        assert share == pytest.approx(expected, abs=4 * np.sqrt(expected / len(x)) + 1e-4)


def test_residuals_have_the_spread_that_is_stated(make_study: MakeStudy, make_table: MakeTable) -> None:
    """Standardised residuals of replicates have unit variance, also of rows that are known by a limit."""
    noise = Noise("sinkage", sd=1e-3, resolution=STEP)
    study = make_study(data=_rounded(make_table()), free=("n0",), noise={"sinkage": noise})
    target, scores = posterior(study), []
    x = np.full((4000, 1), 0.8)
    outcomes = target.outcomes(x[:1])
    for made in target.likelihood.draw(target.outcomes(x), target.noise_values(x), default_rng(2)):
        replicate = study.with_data({name: made[:, i] for i, name in enumerate(study.noise)})
        likelihood = likelihood_of(replicate, replicate.observations)
        scores.append(likelihood.standardised(likelihood.predicted(outcomes), np.empty((1, 0)))[0])
    spread = np.std(scores, axis=0)
    np.testing.assert_allclose(spread[:, [0, 2]], 1.0, atol=0.06)
    np.testing.assert_allclose(spread[1:5, 1], 1.0, atol=0.06)
    assert (spread[[0, 5], 1] < 1.0).all()


@pytest.mark.parametrize("kind", ["latent load", "discrepancy"])
def test_elsewhere_rounding_is_one_more_error(kind: str, make_study: MakeStudy, make_table: MakeTable) -> None:
    """Of variance step²/12: with a latent load, and where rows hang together."""
    table = _rounded(make_table(), limits=False)
    more: dict[str, Any] = {"data": table, "discrepancy": {"sinkage": {"sd": "1 mm", "length": 0.2}}}
    if kind == "latent load":
        more = {"data": table.rename(columns={"load [N]": "normal_force [N]"}), "drive": "both"}
    noises = Noise("sinkage", sd=1e-3, resolution=STEP), Noise("sinkage", sd=np.hypot(1e-3, STEP / 12**0.5))
    rounded, wider = (posterior(make_study(free=("n0", "K"), noise={"sinkage": n}, **more)) for n in noises)
    x = np.array([[0.8, 0.010], [0.82, 0.011]])
    np.testing.assert_allclose(rounded.log_prior_and_likelihood(x)[1], wider.log_prior_and_likelihood(x)[1], rtol=1e-9)
    assert isinstance(rounded.likelihood, LatentLoad) == (kind == "latent load")
    drawn = rounded.likelihood.draw(rounded.outcomes(x), rounded.noise_values(x), default_rng(3))
    steps = (drawn[:, :, rounded.likelihood.channels.index("sinkage")] - table["sinkage [m]"].to_numpy()) / STEP
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
