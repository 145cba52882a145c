"""The joint fit: its weights, its way back from impossible parameters, its place on the posterior."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize

from bayesterra.arrays import FloatArray
from bayesterra.errors import SupportError
from bayesterra.least_squares.fit import WeightedMisfit, fit
from bayesterra.least_squares.results import Fit
from bayesterra.least_squares.settings import Overrides, joint_settings
from bayesterra.least_squares.solver import ClippedModel, clip
from bayesterra.likelihood.posterior import posterior
from bayesterra.models import Soil
from bayesterra.models.decoupled import MARGIN
from bayesterra.parameters import soil_array
from bayesterra.stats.laws import Law
from bayesterra.study.study import Study
from tests.support.soil_tests import SOIL, WHEEL, both

MakeStudy = Callable[..., Study]
MakeTable = Callable[..., pd.DataFrame]
CHANNELS = ("sinkage [m]", "drawbar_pull [N]", "resistance_moment [N m]")


@pytest.fixture(scope="module")
def soil(printed: Mapping[str, Mapping[str, Soil]]) -> Soil:
    """Table 10, Wh32."""
    return printed["IM1"]["Wh32"]


@pytest.fixture(scope="module")
def noisy(make_table: MakeTable, soil: Soil) -> pd.DataFrame:
    """Readings with 0.5 mm, 0.7 N and 0.15 N m of noise."""
    data, rng = make_table("M1", "Wh32", soil), np.random.default_rng(1)
    for column, sd in zip(CHANNELS, (5e-4, 0.7, 0.15), strict=True):
        data[column] += sd * rng.standard_normal(len(data))
    return data


def density_at(study: Study, found: Fit) -> float:
    """Log posterior density of a fit."""
    density, values = posterior(study), found.values()
    return float(density.log_density(np.array([[values[name] for name in density.names]]))[0])


@pytest.mark.parametrize("drive", ["load", "sinkage"])
def test_joint_is_the_mode_under_a_flat_prior(
    drive: str, make_paper_study: MakeStudy, noisy: pd.DataFrame, soil: Soil
) -> None:
    """A derivative-free search on the posterior density, started at joint, finds nothing better."""
    priors = {"set": "paper-box", "Ks": soil.Ks}
    study = make_paper_study("M1", "Wh32", soil, data=noisy, drive=drive, priors=priors)
    found = fit(study, ("joint",))["joint"]
    density, values = posterior(study), found.values()
    best = np.array([values[name] for name in density.names])
    scale = 0.02 * np.where(best == 0, 1.0, np.abs(best))

    def loss(x: FloatArray) -> float:
        return -float(density.log_density((best + scale * x)[None])[0])

    simplex = np.vstack([np.zeros(best.size), np.eye(best.size)])
    options: Any = {"maxfev": 3000, "initial_simplex": simplex}
    search = minimize(loss, np.zeros(best.size), method="Nelder-Mead", options=options)
    assert -search.fun <= density_at(study, found) + 1e-6


def test_estimated_noise_weighs_at_the_residuals_spread(
    make_paper_study: MakeStudy, make_table: MakeTable, soil: Soil
) -> None:
    """Estimated noise ends at the channel's residual rms, parameters counted off, near the noise put in."""
    data, rng = make_table("M1", "Wh32", soil, tuple(np.linspace(0.05, 0.6, 24))), np.random.default_rng(2)
    for column, sd in zip(CHANNELS, (5e-4, 0.7, 0.15), strict=True):
        data[column] += sd * rng.standard_normal(len(data))
    law = {"estimate": {"dist": "halfnorm", "scale": 10.0, "lower": 0.01}}
    noise = {"sinkage": 5e-4, "drawbar_pull": law, "resistance_moment": 0.15}
    study = make_paper_study("M1", "Wh32", soil, data=data, noise=noise)
    found = fit(study, ("joint",))["joint"]
    assert found.passes == 4
    assert found.noise["sinkage"] == 5e-4
    pull = posterior(study).likelihood.forward(soil_array(vars(found.soil))).values[0, :, 1]
    rms = np.sqrt(np.mean((pull - data["drawbar_pull [N]"]) ** 2) * 72 / (72 - 7))
    assert found.noise["drawbar_pull"] == pytest.approx(rms, rel=0.01)
    assert found.noise["drawbar_pull"] == pytest.approx(0.7, rel=0.3)


def test_noise_as_a_fraction_weighs_at_the_reading(
    make_paper_study: MakeStudy, noisy: pd.DataFrame, soil: Soil
) -> None:
    """A fraction is taken of the measured value, with its floor; a row's own deviation overrides it."""
    noise = {"sinkage": 1e-3, "drawbar_pull": {"fraction": 0.1, "floor": 1.0}, "resistance_moment": 0.3}
    data = noisy.assign(**{"drawbar_pull_sd [N]": [9.0] * 7})
    by_fraction = fit(make_paper_study("M1", "Wh32", soil, data=noisy, noise=noise), ("joint",))["joint"]
    by_row = fit(make_paper_study("M1", "Wh32", soil, data=data, noise=noise), ("joint",))["joint"]
    assert by_fraction.noise["drawbar_pull"] == pytest.approx(0.1 * np.median(noisy[CHANNELS[1]]))
    assert by_row.noise["drawbar_pull"] == 9.0


def test_more_certain_channels_pull_harder(make_paper_study: MakeStudy, noisy: pd.DataFrame, soil: Soil) -> None:
    """A channel's fit error falls when its noise is said to be smaller."""
    errors = [
        fit(
            make_paper_study(
                "M1", "Wh32", soil, data=noisy, noise={"sinkage": 1e-3, "drawbar_pull": sd, "resistance_moment": 0.3}
            ),
            ("joint",),
        )["joint"].errors["drawbar_pull"]
        for sd in (10.0, 0.1)
    ]
    assert errors[1] < 0.8 * errors[0]


def test_result_at_the_edge_lies_in_the_support(make_paper_study: MakeStudy, noisy: pd.DataFrame, soil: Soil) -> None:
    """Data that pull θm below θ2 end just inside, where the posterior still has a density, and it is said."""
    study = make_paper_study("M1", "Wh32", soil, data=noisy.assign(**{CHANNELS[1]: noisy[CHANNELS[1]] + 10.0}))
    found = fit(study, ("joint",))["joint"]
    assert np.min(found.soil.c1 + found.soil.c2 * study.observations.slip) == pytest.approx(MARGIN, rel=0.1)
    assert found.clipped
    assert any("θm/θ1 = c1 + c2 s is at the edge" in note for note in found.notes)
    assert "12 of 12 starts ended at the best fit" in found.notes
    assert np.isfinite(density_at(study, found))


def test_repeats_to_the_last_digit(make_paper_study: MakeStudy, noisy: pd.DataFrame, soil: Soil) -> None:
    """Two fits of the same study agree exactly: starts are drawn with a fixed seed."""
    study = make_paper_study("M1", "Wh32", soil, data=noisy)
    first, second = (fit(study, ("joint",))["joint"] for _ in range(2))
    assert first.soil == second.soil
    assert first.path == second.path


def test_no_start_with_an_answer(make_paper_study: MakeStudy, noisy: pd.DataFrame, soil: Soil) -> None:
    """Soil too soft for the load everywhere is refused in words."""
    study = make_paper_study("M1", "Wh32", soil, data=noisy.assign(**{"load [N]": 1e9}))
    with pytest.raises(SupportError, match="joint: the model has no answer for the conditions of the data"):
        fit(study, ("joint",))


@pytest.mark.parametrize("drive", ["load", "sinkage"])
@pytest.mark.parametrize(
    ("changes", "clipped"),
    [
        ({}, False),
        ({"c1": 0.1, "c2": -0.5, "c3": -0.1}, True),
        ({"c1": -0.2, "c2": 1.1}, True),
        ({"n0": -0.05, "n1": 0.8}, True),
    ],
)
def test_residuals_are_smooth_across_the_edge(
    drive: str, changes: dict[str, float], clipped: bool, make_paper_study: MakeStudy, noisy: pd.DataFrame, soil: Soil
) -> None:
    """Inside and outside the model's range the Jacobian is that of the residuals, penalties included."""
    study = make_paper_study("M1", "Wh32", soil, data=noisy, drive=drive)
    likelihood = posterior(study).likelihood
    low = np.array([0.1e6, 0, 0, 0, 0, 0.002, -1, -1, -1])
    high = np.array([10e6, 2, 2, 500, 1, 0.05, 1, 1, 1])
    sd = np.full((7, 3), 0.1)
    misfit = WeightedMisfit(ClippedModel(likelihood.forward), (0, 1, 2), likelihood.measured, sd, low, high)
    theta = replace(soil, **changes).as_array()
    assert clip(theta, study.observations.slip).any is clipped
    exact, shifts = misfit.jacobian(theta), 1e-6 * np.array([2e6, 1, 1, 300, 0.5, 0.01, 1, 1, 1])
    for column, shift in enumerate(shifts):
        step = np.eye(9)[column] * shift
        slope = (misfit.values(theta + step) - misfit.values(theta - step)) / (2 * shift)
        assert exact[:, column] == pytest.approx(slope, rel=1e-5, abs=1e-6 * np.abs(slope).max() + 1e-9)


def test_corner_of_edge_and_range(make_paper_study: MakeStudy, noisy: pd.DataFrame, soil: Soil) -> None:
    """Where θm/θ1 is at its edge and c2 at the end of its range, both hold, and no neighbour is better."""
    law = {"dist": "uniform", "lower": 0.1, "upper": 0.5}
    data = noisy.assign(**{CHANNELS[1]: noisy[CHANNELS[1]] + 10.0})
    study = make_paper_study("M1", "Wh32", soil, data=data, priors={"set": "paper-box", "Ks": soil.Ks, "c2": law})
    found = fit(study, ("joint",))["joint"]
    assert found.soil.c2 == pytest.approx(0.1, abs=1e-6)
    assert found.soil.c2 >= 0.1
    assert found.clipped
    assert "c2" in found.at_bound
    best, rng = density_at(study, found), np.random.default_rng(3)
    density, values = posterior(study), found.values()
    here = np.array([values[name] for name in density.names])
    near = here * (1 + 1e-3 * rng.standard_normal((2000, here.size)))
    assert np.max(density.log_density(near)) < best + 1e-3


def test_moduli_without_ends_leave_a_finite_start(make_paper_study: MakeStudy, noisy: pd.DataFrame, soil: Soil) -> None:
    """Laws of k_c and k_φ that reach everywhere, as those of plate tests do, bound K_s by zero alone."""
    priors = {
        "set": "paper-box",
        "kc": {"dist": "norm", "loc": 1e4, "scale": 2e3},
        "kphi": {"dist": "norm", "loc": 2.4e6, "scale": 4e5},
    }
    study = make_paper_study("M1", "Wh32", soil, data=noisy, priors=priors, least_squares={})
    settings = joint_settings(study, Overrides())
    assert settings.start[0] == pytest.approx(1e4 / 0.165 + 2.4e6)
    assert 0 < settings.lower[0] < settings.start[0]
    assert np.isposinf(settings.upper[0])
    assert fit(study, methods=("joint",))["joint"].converged


def test_many_rows_are_searched_by_few_residuals_of_the_same_sum(
    make_paper_study: MakeStudy, noisy: pd.DataFrame, soil: Soil
) -> None:
    """Of 300 rows of one wheel: sum of squares and its slopes as of all rows, from a third of their residuals."""
    rng = np.random.default_rng(2)
    slip = np.sort(rng.uniform(0.05, 0.6, 300))
    columns = {name: np.interp(slip, noisy["slip"], noisy[name]) for name in noisy.columns if name != "wheel"}
    data = pd.DataFrame({"wheel": "Wh32", **columns, "slip": slip})
    study = make_paper_study("M1", "Wh32", soil, data=data, priors={"set": "paper-box"})
    whole = posterior(study).likelihood
    sd = np.broadcast_to([5e-4, 0.7, 0.15], whole.measured.shape)
    held = np.full(len(soil.as_array()), np.inf)
    misfit = WeightedMisfit(ClippedModel(whole.forward), (0, 1, 2), whole.measured, sd, -held, held)
    told = misfit.told()
    for theta in (soil.as_array(), 1.05 * soil.as_array()):
        every, few = misfit.values(theta), told.values(theta)
        assert few.size < every.size / 3
        assert np.sum(few**2) == pytest.approx(np.sum(every**2), rel=1e-7)
        slopes, of_few = misfit.jacobian(theta).T @ every, told.jacobian(theta).T @ few
        np.testing.assert_allclose(of_few, slopes, rtol=1e-5, atol=1e-6 * np.abs(slopes).max())


def test_stiffness_of_moduli_at_a_sinkage_is_that_of_the_soil() -> None:
    """Their laws are about k z^n at 10 mm: the range of K_s covers them over all exponents."""
    study = both(reference=True)
    settings = joint_settings(study, Overrides())
    exponents = study.prior.laws["n0"].range
    stiffest = (1e3 / WHEEL.width + 50e3) * 0.01 ** -exponents[1]
    assert settings.upper[0] == pytest.approx(stiffest)
    assert settings.lower[0] < SOIL["kc"] / WHEEL.width + SOIL["kphi"] < settings.upper[0]
    normal = {"kc": Law("norm", {"loc": 0.0, "scale": 500.0}), "kphi": Law("norm", {"loc": 2e4, "scale": 5e3})}
    open_study = both(reference=True, priors={**normal, "n0": Law("norm", {"loc": 1.0, "scale": 0.2})})
    settings = joint_settings(open_study, Overrides())
    assert 0.0 < settings.lower[0] < settings.start[0] < settings.upper[0]
    assert settings.start[0] == pytest.approx(2e4 * 0.01**-1.0)
    settings = joint_settings(both(reference=True, priors={"n0": Law("norm", {"loc": 1.0, "scale": 0.2})}), Overrides())
    assert settings.upper[0] > (1e3 / WHEEL.width + 50e3) * 0.01**-1.6, "three standard deviations of n0"
