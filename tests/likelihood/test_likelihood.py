"""The likelihood against a sum written by hand, and against the errors that others make."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior, posterior
from bayesterra.models import MODELS, Soil, Wheel
from bayesterra.stats.laws import Law
from bayesterra.study.noise import Noise
from bayesterra.study.study import Study

MakeStudy = Callable[..., Study]
MakeTable = Callable[..., pd.DataFrame]

ESTIMATE = Law("halfnorm", {"scale": 2.0}, lower=0.2)
KINDS: Mapping[str, Mapping[str, Noise]] = {
    "given": {},
    "fraction": {
        name: Noise(name, fraction=0.07, floor=floor)
        for name, floor in (("sinkage", 8e-4), ("drawbar_pull", 1.2), ("resistance_moment", 0.1))
    },
    "estimated": {"drawbar_pull": Noise("drawbar_pull", law=ESTIMATE)},
}
OUTCOMES = {
    "load": ("sinkage", "drawbar_pull", "resistance_moment"),
    "sinkage": ("normal_force", "drawbar_pull", "resistance_moment"),
}


@pytest.fixture(scope="module")
def data(make_table: MakeTable) -> pd.DataFrame:
    """Noisy readings; two cells are empty, and one force has its own standard deviations in two rows."""
    table, rng = make_table("M1"), np.random.default_rng(3)
    table["sinkage [m]"] += 5e-4 * rng.standard_normal(6)
    table["drawbar_pull [N]"] += rng.standard_normal(6)
    table["normal_force [N]"] = table["load [N]"] + 2.0 * rng.standard_normal(6)
    table.loc[1, "resistance_moment [N m]"] = np.nan
    table.loc[4, "drawbar_pull [N]"] = np.nan
    return table.assign(**{"drawbar_pull_sd [N]": [np.nan, 3.0, np.nan, 0.7, np.nan, np.nan]})


def by_hand(study: Study, wheel: Wheel, values: Mapping[str, float]) -> FloatArray:
    """Log density of every reading (rows, channels), from the models and scipy.stats.norm, row by row."""
    model, rows = MODELS["M1"](), study.observations
    soil = Soil(**{name: value for name, value in values.items() if not name.startswith("noise_")})
    logs = np.zeros((len(rows), 3))
    for i in range(len(rows)):
        load = study.drive == "load"
        z = model.sinkage(soil, wheel, rows.slip[i], rows.load[i]) if load else rows.values["sinkage"][i]
        forces = model.forces(soil, wheel, rows.slip[i], z)
        first = {"sinkage": z} if load else {"normal_force": forces.normal}
        modelled = {**first, "drawbar_pull": forces.drawbar_pull, "resistance_moment": forces.resistance_moment}
        for j, (name, value) in enumerate(modelled.items()):
            noise, reading, sd = study.noise[name], rows.values[name][i], rows.given_sd[name][i]
            if noise.fraction is not None:
                sd = max(noise.fraction * abs(value), noise.floor) if np.isnan(sd) else sd
            elif np.isnan(sd):
                sd = values[f"noise_{name}"] if noise.law else noise.sd
            logs[i, j] = 0.0 if np.isnan(reading) else norm.logpdf(reading, value, sd)
    return logs


@pytest.mark.parametrize("drive", OUTCOMES)
@pytest.mark.parametrize("kind", KINDS)
def test_likelihood_is_the_sum_of_normal_log_densities(
    kind: str, drive: str, make_study: MakeStudy, data: pd.DataFrame, wheel: Wheel
) -> None:
    """Every drive and kind of noise, empty cells and own deviations included, agrees with scipy's norm."""
    noise = {name: value for name, value in KINDS[kind].items() if name in OUTCOMES[drive]}
    study = make_study(model="M1", data=data, drive=drive, noise=noise)
    density = posterior(study)
    draws = draw_cut_prior(density, 4, np.random.default_rng(1)).x
    _, found = density.log_prior_and_likelihood(draws)
    assert density.likelihood.channels == OUTCOMES[drive]
    for x, level in zip(draws, found, strict=True):
        expected = by_hand(study, wheel, dict(zip(density.names, x, strict=True)))
        np.testing.assert_allclose(level, expected.sum(), rtol=1e-9)
    pointwise = density.likelihood.pointwise(density.outcomes(draws), density.noise_values(draws))
    np.testing.assert_allclose(pointwise[-1], expected, rtol=1e-7, atol=1e-9)


def test_likelihood_adds_up_over_rows(make_study: MakeStudy, data: pd.DataFrame) -> None:
    """The log likelihood of all rows is the sum over studies of one row each."""
    whole = posterior(make_study(model="M1", data=data))
    draws = draw_cut_prior(whole, 20, np.random.default_rng(2)).x
    single = [posterior(make_study(model="M1", data=data.iloc[[i]])) for i in range(len(data))]
    parts = [one.log_prior_and_likelihood(draws)[1] for one in single]
    np.testing.assert_allclose(whole.log_prior_and_likelihood(draws)[1], np.sum(parts, axis=0), rtol=1e-9)


def test_rows_out_of_use_do_not_count(make_study: MakeStudy, data: pd.DataFrame) -> None:
    """A row with use = 0 leaves the density as if it were not there."""
    some = posterior(make_study(model="M1", data=data.assign(use=[1, 0, 1, 1, 0, 1])))
    fewer = posterior(make_study(model="M1", data=data.iloc[[0, 2, 3, 5]]))
    draws = draw_cut_prior(fewer, 20, np.random.default_rng(2)).x
    np.testing.assert_allclose(some.log_density(draws), fewer.log_density(draws), rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_likelihood_is_a_density_of_the_readings(kind: str, make_study: MakeStudy, make_table: MakeTable) -> None:
    """Integrated over what a reading could have been, its likelihood is one, whatever the noise."""
    study = make_study(data=make_table().iloc[[3]], noise=KINDS[kind])
    density = posterior(study)
    x = draw_cut_prior(density, 1, np.random.default_rng(5)).x
    outcomes, noise = density.outcomes(x), density.noise_values(x)
    middle = outcomes.values[0, 0, 1]
    readings = np.linspace(middle - 40.0, middle + 40.0, 4001)
    values = {**density.likelihood.observations.values}
    levels = []
    for reading in readings:
        rows = replace(density.likelihood.observations, values={**values, "drawbar_pull": np.array([reading])})
        levels.append(replace(density.likelihood, observations=rows).pointwise(outcomes, noise)[0, 0, 1])
    assert np.trapezoid(np.exp(levels), readings) == pytest.approx(1.0, rel=1e-9)


def spread(density: Callable[[FloatArray], FloatArray], grid: FloatArray) -> float:
    """Standard deviation of a density on a grid of one parameter."""
    level = density(grid[:, None])
    weight = np.exp(level - level.max())
    mean = np.average(grid, weights=weight)
    return float(np.sqrt(np.average((grid - mean) ** 2, weights=weight)))


def twice(table: pd.DataFrame) -> pd.DataFrame:
    """Every row two times."""
    return pd.concat([table, table], ignore_index=True)


def averaged(density: Posterior) -> Callable[[FloatArray], FloatArray]:
    """The error found in the field: the log likelihood divided by the number of readings."""
    readings = int(np.sum(~np.isnan(density.likelihood.measured)))

    def wrong(x: FloatArray) -> FloatArray:
        prior, likelihood = density.log_prior_and_likelihood(x)
        return prior + likelihood / readings

    return wrong


def test_doubling_the_data_narrows_the_posterior_by_root_two(make_study: MakeStudy, data: pd.DataFrame) -> None:
    """Each row twice: twice the log likelihood, spread of φ down by √2, but not if divided by the count."""
    once = posterior(make_study(model="M1", data=data, free=("phi",)))
    doubled = posterior(make_study(model="M1", data=twice(data), free=("phi",)))
    x = np.radians(np.linspace(27.0, 31.0, 5))[:, None]
    np.testing.assert_allclose(
        doubled.log_prior_and_likelihood(x)[1], 2 * once.log_prior_and_likelihood(x)[1], rtol=1e-12
    )
    grid = np.radians(np.linspace(20.0, 40.0, 2001))
    ratio = spread(once.log_density, grid) / spread(doubled.log_density, grid)
    assert ratio == pytest.approx(np.sqrt(2.0), rel=0.01)
    wrong = spread(averaged(once), grid) / spread(averaged(doubled), grid)
    assert wrong == pytest.approx(1.0, rel=0.01)


def test_drawn_readings_have_the_noise_of_the_likelihood(make_study: MakeStudy, data: pd.DataFrame) -> None:
    """Simulated readings scatter about the modelled values with the very scales that weigh residuals."""
    density = posterior(make_study(model="M1", data=data, noise=KINDS["fraction"]))
    x = draw_cut_prior(density, 1, np.random.default_rng(7)).x
    outcomes, none = density.outcomes(x), np.empty((1, 0))
    many = replace(outcomes, values=np.repeat(outcomes.values, 20000, axis=0))
    drawn = density.likelihood.draw(many, none, np.random.default_rng(8))
    predicted = density.likelihood.predicted(outcomes)
    standard = (drawn - predicted) / density.likelihood.scales(predicted, none)
    assert np.abs(standard.mean(axis=0)).max() < 4 / np.sqrt(20000)
    assert np.abs(standard.var(axis=0) - 1).max() < 4 * np.sqrt(2 / 20000)


def test_no_answer_in_one_row_is_no_likelihood(make_study: MakeStudy) -> None:
    """A soil that leaves one row without an answer has log likelihood −inf; row by row the others answer."""
    density = posterior(make_study(free=("n0", "n1")))
    soil = density.prior.soil_values(np.array([[0.1, -0.5]]))  # N = n0 + n1 s < 0 from s = 0.2 on
    outcomes = density.likelihood.forward(soil)
    assert outcomes.status[0] != 0
    assert np.isneginf(density.likelihood.log_density(outcomes, np.empty((1, 0))))[0]
    alone = density.likelihood.forward(soil, every_row=True).values[0, :, 1]
    assert np.isfinite(alone).tolist() == [True, True, False, False, False, False]
