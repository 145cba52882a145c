"""Predicted readings and curves, and quantities that follow from the soil."""

from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd
import pytest

from bayesterra.checking.predictive import RowPredictions, curve_forward, predict_curves, predict_rows, predictive_table
from bayesterra.likelihood.forward import REFERENCE_SINKAGE, REFERENCE_STRESS, derive, reference_load
from bayesterra.likelihood.posterior import Posterior, posterior
from bayesterra.models import M2, Soil, Wheel
from bayesterra.models.traction import SLIP_GRID
from bayesterra.parameters import DERIVED, soil_array
from bayesterra.study.noise import Noise
from bayesterra.study.study import Study

MakeStudy = Callable[..., Study]
MakeTable = Callable[..., pd.DataFrame]
RNG_SEED = 5


@pytest.fixture(scope="module")
def study(make_study: MakeStudy, make_table: MakeTable) -> Study:
    """Noisy pull relative to its size; one row out of use, one reading missing."""
    table = make_table().assign(use=[1, 1, 1, 0, 1, 1])
    table.loc[1, "drawbar_pull [N]"] = np.nan
    noise = {"drawbar_pull": Noise("drawbar_pull", fraction=0.1, floor=0.5)}
    return make_study(data=table, free=("c", "phi"), noise=noise)


def repeated(truth: Mapping[str, float], n: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """The true c and φ, n times."""
    return np.repeat([[truth["c"], truth["phi"]]], n, axis=0)


def test_predicted_readings_have_model_and_noise(study: Study, truth: Mapping[str, float]) -> None:
    """Modelled values are those of the model for all rows; readings scatter about them with their noise."""
    rows = predict_rows(study, posterior(study), repeated(truth, 4000), np.random.default_rng(RNG_SEED))
    assert rows.channels == ("sinkage", "drawbar_pull", "resistance_moment")
    measured = study.observations.values["sinkage"]
    np.testing.assert_allclose(rows.modelled[0, :, 0], measured, rtol=1e-8)
    scatter = (rows.readings - rows.modelled).std(axis=0)
    pull = np.maximum(0.1 * np.abs(rows.modelled[0, :, 1]), 0.5)
    np.testing.assert_allclose(scatter, np.column_stack([np.full(6, 1e-3), pull, np.full(6, 0.3)]), rtol=0.06)


def test_predictive_table_is_in_field_units(study: Study, truth: Mapping[str, float]) -> None:
    """One row per row and channel with quantiles of the readings in mm, N and N m, used or not."""
    rows = predict_rows(study, posterior(study), repeated(truth, 4000), np.random.default_rng(RNG_SEED))
    table = predictive_table(study, rows)
    assert len(table) == 6 * 3
    one = table[(table["row"] == 4) & (table["channel"] == "sinkage")].iloc[0]
    assert (one["unit"], one["used"], one["no_answer"]) == ("mm", False, 0.0)
    z = 1e3 * study.observations.values["sinkage"][3]
    assert one["observed"] == pytest.approx(z)
    np.testing.assert_allclose(
        [one["mean"], one["q50"], one["q05"], one["q95"]], [z, z, z - 1.645, z + 1.645], atol=0.08
    )
    missing = table[(table["row"] == 2) & (table["channel"] == "drawbar_pull")].iloc[0]
    assert np.isnan(missing["observed"])
    assert np.isfinite(missing["q50"])


def test_a_row_without_an_answer_takes_no_other_with_it(make_study: MakeStudy) -> None:
    """Soils that cannot answer one row still predict the others, and the share is told."""
    study = make_study(free=("n0", "n1"))
    draws = np.array([[0.25, -0.6], [0.25, -0.6]])  # N = 0.25 − 0.6 s turns negative beyond s = 0.42
    rows = predict_rows(study, posterior(study), draws, np.random.default_rng(1))
    assert np.isfinite(rows.readings[:, :5]).all()
    assert np.isnan(rows.readings[:, 5]).all()
    table = predictive_table(study, rows)
    last = table[table["row"] == 6]
    assert (last["no_answer"] == 1.0).all()
    assert last["mean"].isna().all()


@pytest.mark.parametrize("driven", ["load", "sinkage"])
def test_curves_pass_through_the_data_they_were_made_with(
    driven: str, make_study: MakeStudy, truth: Mapping[str, float]
) -> None:
    """Modelled over slip with the true soil, the curves meet the noise-free readings at the driven slips."""
    study = make_study(drive=driven, free=("c", "phi"))
    curve = predict_curves(study, posterior(study), repeated(truth, 3), np.random.default_rng(1))[0]
    slips, values = study.observations.slip, study.observations.values
    for column, name in enumerate(curve.outcomes):
        modelled = np.interp(slips, curve.slip, curve.modelled[0, :, column])
        np.testing.assert_allclose(modelled, values[name], rtol=0.02, atol=0.1 if name != "sinkage" else 2e-4)
    assert np.isfinite(curve.readings).all()
    assert curve.slip.min() <= slips.min()
    assert curve.slip.max() >= slips.max()


def test_outcomes_that_were_not_measured_have_curves_without_readings(
    make_study: MakeStudy, make_table: MakeTable, truth: Mapping[str, float]
) -> None:
    """Without a moment column the moment is modelled all the same, but no reading is made up for it."""
    study = make_study(data=make_table().drop(columns="resistance_moment [N m]"), free=("c", "phi"))
    curve = predict_curves(study, posterior(study), repeated(truth, 2), np.random.default_rng(1))[0]
    assert np.isfinite(curve.modelled[:, :, 2]).all()
    assert np.isnan(curve.readings[:, :, 2]).all()


@pytest.mark.parametrize("driven", ["load", "sinkage"])
def test_a_wheel_out_of_use_has_curves_too(
    driven: str, make_table: MakeTable, wheel: Wheel, truth: Mapping[str, float]
) -> None:
    """A wheel none of whose rows is in use is driven as the others were."""
    first = make_table().assign(wheel="A", use=1)
    table = pd.concat([first, first.assign(wheel="B", use=0)], ignore_index=True)
    study = Study(
        table,
        {"A": wheel, "B": wheel},
        model="M2",
        drive=driven,
        slip_reference="shearing",
        noise={"sinkage": 1e-3, "drawbar_pull": 1.5, "resistance_moment": 0.3, "normal_force": 2.0},
        priors={"set": "paper-box"},
    )
    soil = np.array([[truth[name] for name in posterior(study).names]])
    curves = predict_curves(study, posterior(study), soil, np.random.default_rng(1))
    assert [curve.wheel for curve in curves] == ["A", "B"]
    np.testing.assert_allclose(curves[1].modelled, curves[0].modelled)
    np.testing.assert_array_equal(curve_forward(study, "B").given, curve_forward(study, "A").given)


def soils(truth: Mapping[str, float], **changes: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """One soil (1, p)."""
    return soil_array({**truth, "c3": 0.0, **changes})


def test_derived_quantities_by_hand(make_study: MakeStudy, truth: Mapping[str, float], wheel: Wheel) -> None:
    """Pressure K_s z^n0, strength c + σ tan φ, and the greatest pull, on or between grid slips, are right."""
    study, soil = make_study(free=("c", "phi")), soils(truth)
    found = derive(study, soil)
    assert set(found) == set(DERIVED)
    assert found["bearing_pressure"][0] == pytest.approx(truth["Ks"] * REFERENCE_SINKAGE ** truth["n0"])
    strength = truth["c"] + REFERENCE_STRESS * np.tan(truth["phi"])
    assert found["shear_strength"][0] == pytest.approx(strength)
    model, true_soil = M2(), Soil(**truth)
    z = model.sinkage(true_soil, wheel, SLIP_GRID, 80.0)
    pull = np.asarray(model.forces(true_soil, wheel, SLIP_GRID, z).drawbar_pull)
    assert pull.max() <= found["peak_pull"][0] == pytest.approx(pull.max(), rel=1e-3)
    assert found["peak_pull_slip"][0] == pytest.approx(SLIP_GRID[pull.argmax()], abs=SLIP_GRID[1] - SLIP_GRID[0])


def test_a_soil_that_carries_nowhere_has_no_peak(make_study: MakeStudy, truth: Mapping[str, float]) -> None:
    """Without an answer at any slip the peak is NaN; other soils beside it keep theirs."""
    study = make_study(free=("c", "phi"))
    both = np.vstack([soils(truth), soils(truth, Ks=1.0, c=0.0, phi=0.01)])
    found = derive(study, both)
    assert np.isfinite(found["peak_pull"][0])
    assert np.isnan(found["peak_pull"][1])
    assert np.isnan(found["peak_pull_slip"][1])


def test_without_any_force_nothing_is_driven(
    make_study: MakeStudy, make_table: MakeTable, truth: Mapping[str, float]
) -> None:
    """Where neither load nor normal force was measured, peaks are unknown; the soil's own quantities stay."""
    study = make_study(data=make_table().drop(columns="load [N]"), drive="sinkage", free=("c", "phi"))
    assert np.isnan(reference_load(study))
    found = derive(study, soils(truth))
    assert np.isnan(found["peak_pull"]).all()
    assert np.isfinite(found["bearing_pressure"]).all()


def test_noise_of_a_posterior_is_used_draw_by_draw(make_study: MakeStudy, truth: Mapping[str, float]) -> None:
    """Estimated noise scatters every draw's readings by that draw's own value."""
    from bayesterra.stats.laws import Law

    noise = {"drawbar_pull": Noise("drawbar_pull", law=Law("halfnorm", {"scale": 5.0}, lower=0.1))}
    study = make_study(free=("c", "phi"), noise=noise)
    density: Posterior = posterior(study)
    quiet, loud = (np.column_stack([repeated(truth, 2000), np.full(2000, sd)]) for sd in (0.1, 10.0))
    rows = predict_rows(study, density, np.vstack([quiet, loud]), np.random.default_rng(1))
    scatter = rows.readings[:, 0, 1] - rows.modelled[:, 0, 1]
    assert scatter[:2000].std() == pytest.approx(0.1, rel=0.1)
    assert scatter[2000:].std() == pytest.approx(10.0, rel=0.1)


def test_every_column_of_the_table_is_of_its_own_row_and_channel(study: Study) -> None:
    """Skew readings made by hand: mean, quantiles and share without an answer are those with noise."""
    rng = np.random.default_rng(3)
    readings = rng.exponential(size=(500, 6, 3)) * np.arange(1.0, 19.0).reshape(6, 3)
    readings[:50, 2, 1] = np.nan
    table = predictive_table(study, RowPredictions(tuple(study.noise), np.zeros((500, 6, 3)), readings))
    for cells in table.to_dict("records"):
        channel = list(study.noise).index(str(cells["channel"]))
        index = study.observations.rows.index(cells["row"])
        own = readings[:, index, channel] * (1e3 if cells["channel"] == "sinkage" else 1.0)
        expected = [np.nanmean(own), *np.nanquantile(own, [0.05, 0.5, 0.95]), np.isnan(own).mean()]
        found = [cells[name] for name in ("mean", "q05", "q50", "q95", "no_answer")]
        np.testing.assert_allclose(found, expected, rtol=1e-12)
        assert cells["slip"] == study.observations.slip[index]
        assert cells["used"] == study.observations.use[index]
