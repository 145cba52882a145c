"""Latent loads: the compiled integral against brute force, its limits, and loads drawn from it."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError
from bayesterra.likelihood.forward import Forward, model_columns
from bayesterra.likelihood.likelihood import LatentLoad, Likelihood
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior, posterior
from bayesterra.models import Wheel
from bayesterra.study.drive import Drive
from bayesterra.study.study import Study
from tests.support.own_laws import PaperLaw

WHEEL = Wheel(0.058, 0.06, 0.005, 24, 0.5)
SLIPS = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7)
NONE = float("nan")
TABLE = pd.DataFrame(
    {
        "slip": SLIPS,
        "normal_force [N]": [24.0, 25.0, 23.0, NONE, 27.0, 21.0],
        "sinkage [mm]": [9.0, 12.0, NONE, 20.0, 24.0, 30.0],
        "drawbar_pull [N]": [1.0, 3.0, 4.0, NONE, 5.0, 5.0],
        "resistance_moment [N m]": [0.3, 0.5, NONE, 0.7, 0.9, NONE],
    }
)
"""Readings of several kinds of rows: complete, without force, without sinkage, without pull or moment."""

NOISE = {"normal_force": 1.2, "sinkage": 6e-4, "drawbar_pull": 0.34, "resistance_moment": 0.05}
_CELLS: Mapping[str, list[object]] = {
    "normal_force [N]": [24.0, 25.0, 23.0, NONE, 27.0, ">21"],
    "sinkage [mm]": ["<9", 12.0, NONE, ">20", 24.0, 30.0],
    "drawbar_pull [N]": [1.0, ">3", "<4", NONE, ">9", 5.0],
    "resistance_moment [N m]": [0.3, "<0.5", NONE, 0.7, "<0.5", NONE],
}
LIMITS = TABLE.assign(**{name: pd.Series(cells, dtype=object) for name, cells in _CELLS.items()})
"""The same with readings of which only a limit is known, some of them contradicted by the others."""
LOOSE = {"normal_force": 30.0, "sinkage": 0.05, "drawbar_pull": 10.0, "resistance_moment": 5.0}
CASES: Mapping[str, Mapping[str, Any]] = {
    "M1": {},
    "M2": {"model": "M2"},
    "rounded shares": {"noise": {"drawbar_pull": {"fraction": 0.1, "floor": 0.5, "resolution": 4.0}}, "model": "M2"},
    "M3": {"model": "M3"},
    "wide range": {"load_range": (1.0, 200.0)},
    "narrow range": {"load_range": (24.0, 24.5)},
    "little force noise": {"noise": {"normal_force": 1e-3}},
    "little sinkage noise": {"noise": {"sinkage": 1e-5}},
    "little pull noise": {"noise": {"drawbar_pull": 0.01}},
    "little moment noise": {"noise": {"resistance_moment": 1e-3}},
    "two peaks": {"noise": {**LOOSE, "drawbar_pull": 0.01}, "load_range": (1.0, 100.0)},
    "two peaks, M2": {"noise": {**LOOSE, "drawbar_pull": 0.01}, "load_range": (1.0, 100.0), "model": "M2"},
    "much noise": {"noise": LOOSE, "load_range": (1.0, 100.0)},
    "Student-t": {"noise": {name: {"sd": sd, "dof": 4} for name, sd in NOISE.items()}},
    "heavy tails": {"noise": {name: {"sd": sd, "dof": 2} for name, sd in NOISE.items()}, "model": "M2"},
    "fractions": {
        "noise": {
            "normal_force": {"fraction": 0.05, "floor": 0.5},
            "sinkage": {"fraction": 0.1, "floor": 5e-4},
            "drawbar_pull": {"fraction": 0.1, "floor": 0.1},
        },
        "load_range": (5.0, 60.0),
    },
    "limits": {"data": LIMITS, "load_range": (5.0, 60.0)},
    "limits, M2, much noise": {"data": LIMITS, "load_range": (1.0, 100.0), "noise": LOOSE, "model": "M2"},
    "limits, heavy tails": {
        "data": LIMITS,
        "load_range": (5.0, 60.0),
        "model": "M2",
        "noise": {name: {"sd": sd, "dof": 2} for name, sd in NOISE.items()},
    },
    "limits, fractions": {
        "data": LIMITS,
        "load_range": (5.0, 60.0),
        "model": "M3",
        "noise": {"sinkage": {"fraction": 0.1, "floor": 5e-4}, "drawbar_pull": {"fraction": 0.1, "floor": 0.1}},
    },
    "c3": {"priors": {"c3": {"dist": "uniform", "lower": -0.5, "upper": 0.3}}},
    "c3, falling forces": {
        "priors": {"c3": {"dist": "uniform", "lower": -0.5, "upper": 0.3}},
        "load_range": (1.0, 200.0),
        "model": "M2",
    },
    "one's own": {"model": PaperLaw("M1")},
    "one's own, little pull noise": {"model": PaperLaw("M2"), "noise": {"drawbar_pull": 0.01}},
    "one's own, wide range, heavy tails": {
        "model": PaperLaw("M2"),
        "load_range": (1.0, 200.0),
        "noise": {name: {"sd": sd, "dof": 2} for name, sd in NOISE.items()},
    },
    "one's own, limits, fractions": {
        "data": LIMITS,
        "load_range": (5.0, 60.0),
        "model": PaperLaw("M2"),
        "noise": {"sinkage": {"fraction": 0.1, "floor": 5e-4}, "drawbar_pull": {"fraction": 0.1, "floor": 0.1}},
        "priors": {"sinkage_offset": {"dist": "norm", "scale": "5 mm"}},
    },
    "offset": {"priors": {"sinkage_offset": {"dist": "norm", "scale": "5 mm"}}},
    "moduli": {
        "priors": {
            "kc": {"dist": "uniform", "lower": "0 kPa m", "upper": "100 kPa m"},
            "kphi": {"dist": "uniform", "lower": "0 kPa", "upper": "5000 kPa"},
        }
    },
}

SLOW = {"M1", "M2", "wide range", "one's own, little pull noise", "one's own, wide range, heavy tails"}

RowLevel = Callable[[LatentLoad, FloatArray, FloatArray, int], float]
Integrand = Callable[[LatentLoad, FloatArray, FloatArray, int, FloatArray], FloatArray]


def latent_study(
    *, noise: Mapping[str, Any] | None = None, priors: Mapping[str, Any] | None = None, **options: Any
) -> Study:
    """The study of these tests, with changes."""
    given: dict[str, Any] = {"data": TABLE, "wheels": {"A": WHEEL}, "model": "M1", **options}
    return Study(
        given.pop("data"),
        given.pop("wheels"),
        slip_reference="shearing",
        drive="both",
        noise={**NOISE, **(noise or {})},
        priors={"set": "paper-box", **(priors or {})},
        **given,
    )


def settled(study: Study, n: int) -> tuple[Posterior, LatentLoad, FloatArray, FloatArray]:
    """Posterior and likelihood of a study, and parameter sets of the cut prior with their soils."""
    density = posterior(study)
    assert isinstance(density.likelihood, LatentLoad)
    x = draw_cut_prior(density, n, np.random.default_rng(1), batch=1024).x
    return density, density.likelihood, x, density.prior.soil_values(x)


@pytest.mark.parametrize(
    "case", [pytest.param(CASES[name], id=name, marks=[pytest.mark.slow] * (name in SLOW)) for name in CASES]
)
def test_rows_agree_with_brute_force_over_the_prior(case: Mapping[str, Any], brute_force: RowLevel) -> None:
    """Within 1e-3 in log likelihood (1e-8 of it, where it is huge) anywhere in the prior, row by row."""
    density, whole, x, soil = settled(latent_study(**case), 6)
    found, none = density.log_terms(x)[:, :, 0], np.empty((1, 0))
    for k in range(len(x)):
        for row in range(len(SLIPS)):
            expected = brute_force(whole, soil[k : k + 1], none, row)
            assert found[k, row] == pytest.approx(expected, abs=1e-3, rel=1e-8)


@pytest.mark.parametrize("share", [0.95, 0.999, 0.9999])
def test_soils_that_hardly_carry_the_lowest_load(share: float, brute_force: RowLevel) -> None:
    """Where the wheel sinks to its axle under a load just above the lowest, rows still have a likelihood."""
    _, whole, _, soil = settled(latent_study(data=TABLE.iloc[[0, 4]]), 400)
    deep, none = np.full(2, 0.99999 * WHEEL.radius), np.empty((1, 0))
    model = whole.forward.model
    forces, _ = model.forces_at(model_columns(soil, model), whole.forward.conditions, deep)
    carried = forces[:, :, 0].min(axis=1)
    compared = 0
    for k in np.flatnonzero(carried > 0.1):
        low = share * float(carried[k])
        edge, one = replace(whole, load_range=(low, 4 * low)), soil[k : k + 1]
        found = edge.log_terms(one, none)[0, :, 0]
        assert np.isfinite(found).all()
        for row in range(2 if compared < 2 else 0):
            assert found[row] == pytest.approx(brute_force(edge, one, none, row), abs=1e-3, rel=1e-8)
            compared += 1
    assert compared == 2


def test_load_likelihood_is_the_limit_of_little_force_noise() -> None:
    """As the force error vanishes, a row is the load drive's at the measured force, over the range."""
    complete = TABLE.iloc[[0, 1, 4, 5]]
    _, _, x, _ = settled(latent_study(data=complete, noise={"normal_force": 1e-5}), 50)
    low, high = 13.8, 34.2
    study = latent_study(data=complete, noise={"normal_force": 1e-5}, load_range=(low, high))
    renamed = complete.rename(columns={"normal_force [N]": "load [N]"})
    load = Study(renamed, {"A": WHEEL}, slip_reference="shearing", noise=NOISE, priors={"set": "paper-box"})
    expected = posterior(load).log_prior_and_likelihood(x)[1] - len(complete) * np.log(high - low)
    inside = np.isfinite(expected)
    assert inside.sum() > 20
    found = posterior(study).log_prior_and_likelihood(x)[1]
    np.testing.assert_allclose(found[inside], expected[inside], atol=1e-3)


def test_sinkage_likelihood_is_the_limit_of_little_sinkage_noise() -> None:
    """As the sinkage error vanishes, a row is the sinkage drive's, times |dF_N/dz| over the range."""
    complete, low, high = TABLE.iloc[[0, 1, 4, 5]], 1.0, 500.0
    options: dict[str, Any] = {"data": complete, "load_range": (low, high)}
    density, whole, x, soil = settled(latent_study(**options, noise={"sinkage": 1e-9}), 50)
    driven = Study(
        complete, {"A": WHEEL}, drive="sinkage", slip_reference="shearing", noise=NOISE, priors={"set": "paper-box"}
    )
    sinkage = driven.observations.values["sinkage"]
    theta = model_columns(soil, driven.model)
    steps = driven.model.jacobian_at(theta, whole.forward.conditions, sinkage)[:, :, 0, 9]
    force = driven.model.forces_at(theta, whole.forward.conditions, sinkage)[0][:, :, 0]
    inside = ((force > low) & (force < high)).all(axis=1)
    assert inside.sum() > 10
    expected = posterior(driven).log_prior_and_likelihood(x)[1]
    expected = expected + np.log(np.abs(steps)).sum(axis=1) - len(complete) * np.log(high - low)
    found = density.log_prior_and_likelihood(x)[1]
    np.testing.assert_allclose(found[inside], expected[inside], atol=1e-3)


def test_a_row_is_a_density_of_its_readings() -> None:
    """Integrated over what the force could have read, the likelihood is that of the other readings alone."""
    table = TABLE.iloc[[0]]
    _, _, x, _ = settled(latent_study(data=table, load_range=(10.0, 40.0)), 1)
    grid = np.linspace(0.0, 50.0, 801)
    rows = pd.concat([table.assign(**{"normal_force [N]": reading}) for reading in grid])
    many = posterior(latent_study(data=rows, load_range=(10.0, 40.0)))
    without = posterior(latent_study(data=table.assign(**{"normal_force [N]": NONE}), load_range=(10.0, 40.0)))
    levels = many.log_terms(x)[0, :, 0]
    total = np.log(np.trapezoid(np.exp(levels - levels.max()), grid)) + levels.max()
    assert total == pytest.approx(without.log_terms(x)[0, 0, 0], abs=1e-3)


@pytest.mark.parametrize("model", ["M1", pytest.param(PaperLaw("M1"), marks=pytest.mark.slow)], ids=["M1", "one's own"])
def test_drawn_loads_follow_their_conditional_law(integrand: Integrand, model: object) -> None:
    """Loads drawn given soil and readings have the distribution that the integrand says."""
    _, whole, _, soil = settled(latent_study(noise=LOOSE, load_range=(1.0, 100.0), model=model), 1)
    none, n = np.empty((4000, 0)), 4000
    drawn = whole.loads(np.repeat(soil, n, axis=0), none, np.random.default_rng(3))
    loads = np.linspace(1.0, 100.0, 5001)
    for row in range(len(SLIPS)):
        weight = np.exp(integrand(whole, soil, np.empty((1, 0)), row, loads))
        law = np.cumsum(weight) / weight.sum()
        place = np.interp(drawn[:, row], loads, law)
        assert stats.kstest(place, "uniform").pvalue > 1e-3


def test_explained_outcomes_are_those_of_the_drawn_loads() -> None:
    """The outcomes behind the readings are the model's at loads inside the range; F_N is the load itself."""
    density, whole, x, soil = settled(latent_study(), 20)
    values = density.explained(x, np.random.default_rng(2)).values
    load = values[:, :, whole.forward.outcomes.index("normal_force")]
    low, high = whole.load_range
    known = np.isfinite(load)
    assert known.mean() > 0.9
    assert ((load[known] > low) & (load[known] < high)).all()
    held = Forward(whole.forward.model, Drive.LOAD, whole.forward.conditions, load, as_read=True)
    np.testing.assert_allclose(held(soil, every_row=True).values, values[:, :, [0, 2, 3]], rtol=1e-9)


def test_wheels_of_several_widths_share_the_soil() -> None:
    """Rows of two wheels together have the sum of the log likelihoods that each wheel's rows have alone."""
    other = replace(WHEEL, width=0.03)
    table = TABLE.assign(wheel=["A", "B"] * 3)
    moduli = CASES["moduli"]["priors"]
    wheels, options = {"A": WHEEL, "B": other}, {"load_range": (5.0, 50.0), "priors": moduli}
    density, _, x, _ = settled(latent_study(data=table, wheels=wheels, **options), 20)
    alone = [
        posterior(latent_study(data=TABLE.iloc[i::2], wheels={"A": wheel}, **options)).log_terms(x).sum(axis=(1, 2))
        for i, wheel in enumerate(wheels.values())
    ]
    np.testing.assert_allclose(density.log_terms(x).sum(axis=(1, 2)), np.sum(alone, axis=0), atol=1e-3)


def test_a_soil_that_carries_no_load_of_the_range_has_no_likelihood() -> None:
    """Where even the lowest load sinks the wheel to its axle, the status says so and the likelihood is −∞."""
    _, whole, _, soil = settled(latent_study(), 1)
    soft = soil.copy()
    soft[:, 0], soft[:, 1], soft[:, 3] = 10.0, 2.0, 0.0
    assert whole.status(soft)[0] != 0
    assert np.isneginf(whole.log_likelihood(soft, np.empty((1, 0))))[0]


def test_loads_near_readings_are_their_normal_forces() -> None:
    """Within the range; none where a row has no force, or the study knows no noise of it."""
    _, whole, _, _ = settled(latent_study(load_range=(22.0, 26.0)), 1)
    column = whole.channels.index("normal_force")
    readings = np.zeros((3, len(whole.channels)))
    readings[:, column] = [20.0, 24.0, 30.0]
    np.testing.assert_array_equal(whole.loads_near(readings), [22.0, 24.0, 26.0])
    readings[1, column] = NONE
    assert whole.loads_near(readings) is None
    without = replace(whole, noise=tuple(noise for noise in whole.noise if noise.channel != "normal_force"))
    assert without.loads_near(np.zeros((3, 3))) is None


def test_default_range_reaches_six_deviations_beyond_the_forces() -> None:
    """Without a load_range, the flat prior covers the forces and six sd of their noise, and says so."""
    study = latent_study()
    assert study.load_range == pytest.approx((21.0 - 7.2, 27.0 + 7.2))
    assert any("flat prior from 13.8 to 34.2 N" in note for note in study.notes)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"load_range": (40.0, 10.0)}, r"'load_range' must rise and be above 0 \(got 40 N and 10 N\)"),
        ({"load_range": 10.0}, r"'load_range' must be two loads"),
        ({"data": TABLE.drop(columns="normal_force [N]").dropna()}, "needs 'load_range' or readings"),
        (
            {"data": TABLE.assign(**{"normal_force [N]": NONE}), "load_range": (1.0, 9.0)},
            r"every row needs 'sinkage' or 'normal_force' \(row 3\)",
        ),
    ],
)
def test_what_the_drive_needs(change: Mapping[str, Any], message: str) -> None:
    """A range that is none, and rows that say nothing about their load, are refused in one line."""
    with pytest.raises(StudyError, match=message):
        latent_study(**change)


def test_row_likelihoods_do_not_depend_on_their_company() -> None:
    """A row's likelihood is the same to the last digit alone, with others, and for many sets at once."""
    density, _, x, _ = settled(latent_study(load_range=(5.0, 50.0)), 30)
    together = density.log_terms(x)[:, :, 0]
    for row in (0, 3):
        alone = posterior(latent_study(data=TABLE.iloc[[row]], load_range=(5.0, 50.0)))
        np.testing.assert_array_equal(alone.log_terms(x)[:, 0, 0], together[:, row])
    np.testing.assert_array_equal(density.log_terms(x[:1])[:, :, 0], together[:1])


def test_estimated_noise_is_that_of_each_set() -> None:
    """With estimated noise each parameter set has the likelihood that this noise, given, has."""
    estimate = {"estimate": {"dist": "halfnorm", "scale": "1 mm"}}
    density, _, x, _ = settled(latent_study(noise={"sinkage": estimate}, load_range=(5.0, 50.0)), 5)
    found = density.log_terms(x)[:, :, 0]
    for k in range(5):
        given = posterior(latent_study(noise={"sinkage": float(x[k, -1])}, load_range=(5.0, 50.0)))
        np.testing.assert_allclose(given.log_terms(x[k : k + 1, :-1])[0, :, 0], found[k], rtol=1e-12)


def test_outcomes_at_known_loads_are_the_load_drive_with_the_load_read() -> None:
    """The forward model of the drive gives what the load drive gives, and the load as the normal force."""
    study = latent_study()
    _, whole, _, soil = settled(study, 5)
    plain = replace(whole.forward, drive=Drive.LOAD)(soil).values
    np.testing.assert_array_equal(whole.forward(soil).values[:, :, [0, 2, 3]], plain)
    assert isinstance(whole, Likelihood)
    assert whole.forward.given[3] == pytest.approx(24.0)  # no reading: the median of the others
