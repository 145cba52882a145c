"""Predictions for wheels, loads and slips that were not measured."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import bayesterra as bt
from bayesterra.analysis.result import RunResult
from bayesterra.errors import StudyError
from bayesterra.models import M2, Soil, Status, Wheel
from bayesterra.parameters import SOIL_PARAMETERS
from bayesterra.prediction import page as prediction_pages
from bayesterra.prediction.prediction import PREDICTED, UNANSWERED, Condition, Forecast, forecast, name_of, slips_of
from bayesterra.report.figures import figure_of
from bayesterra.study.result import Result, parameter_dataset
from bayesterra.study.study import Study
from bayesterra.study.wheels import read_wheel

SMALL = Wheel(0.1, 0.1, 0.005, 24)
SMALL_FILE = 'radius = "100 mm"\nwidth = "100 mm"\nlug_height = "5 mm"\nlug_count = 24\n'


def test_prediction_is_the_model_at_every_draw(wide: Result) -> None:
    """Each draw predicts what the model says for its soil, under the load and with the wheel asked for."""
    wheel = Wheel(0.1, 0.1, 0.005, 24, 0.5)
    found = bt.predict(wide, [0.3], load=50.0, wheel=wheel)
    draw = int(np.flatnonzero(found.reasons[:, 0] == 0)[3])
    chain, number = found.index[draw]
    drawn = wide.draws["posterior"].isel(chain=chain, draw=number)
    fixed = wide.study.prior.fixed
    soil = Soil(**{n: fixed[n] if n in fixed else float(drawn[n]) for n in SOIL_PARAMETERS})
    z = M2(transition_slips=(0.1, 0.5)).sinkage(soil, wheel, 0.3, 50.0)
    forces = M2(transition_slips=(0.1, 0.5)).forces(soil, wheel, 0.3, z)
    wanted = np.array([z, forces.drawbar_pull, forces.resistance_moment], dtype=float)
    np.testing.assert_allclose(found.modelled[draw, 0, :3], wanted, rtol=1e-8)


def test_readings_scatter_by_the_noise_of_the_study(wide: Result) -> None:
    """Readings differ from modelled values by the stated noise; what was not measured has no readings."""
    found = bt.predict(wide, [0.1, 0.2, 0.3, 0.4])
    scatter = (found.readings - found.modelled).std(axis=(0, 1))
    np.testing.assert_allclose(scatter[:3], [1e-3, 1.5, 0.3], rtol=0.05)
    assert np.isnan(found.readings[:, :, 3]).all()


def test_draws_without_an_answer_are_counted_with_their_reason(wide: Result) -> None:
    """At high slip the count is that of the draws whose θm leaves the arc, and the band is marked."""
    found = bt.predict(wide, [0.3, 0.97])
    names = list(wide.names)
    draws = wide.values()
    ratio = draws[:, names.index("c1")] + 0.97 * draws[:, names.index("c2")]
    step = -(-len(draws) // 2000)
    outside = (ratio <= 0) | (ratio >= 1)
    assert (found.reasons[:, 1] == Status.CONTACT_ANGLE).sum() == outside[::step].sum() > 0
    assert found.unanswered[0] == 0
    assert np.isnan(found.modelled[found.reasons != 0]).all()
    row = found.table.query("slip == 0.97").iloc[0]
    assert row["no_answer"] == (found.reasons[:, 1] != 0).sum()
    assert row["reason"] == "θm outside (θ2, θ1)"


def test_a_band_is_marked_beyond_one_draw_in_twenty(wide: Result) -> None:
    """A load that some soils cannot carry marks its slips, and only those."""
    found = bt.predict(wide, [0.2, 0.9, 0.97], wheel=SMALL, load="150 N")
    assert found.unanswered[0] == 0 < found.unanswered[1] < UNANSWERED < found.unanswered[2]
    assert found.marked == (0.97,)
    assert set(found.table.query("marked")["slip"]) == set(found.marked)


def test_notes_say_where_the_measurements_are_left(wide: Result) -> None:
    """Slip, load and width outside what was measured are named; inside there is nothing to say."""
    assert bt.predict(wide, [0.1, 0.6], load="80 N").notes == ()
    slip, load, other, width = bt.predict(wide, [0.7], load="120 N", wheel=SMALL).notes
    assert slip.startswith("slip 0.7 lies outside the driven slips, 0.1 to 0.6")
    assert "120 N is not among the measured loads, 80 N" in load
    assert other.startswith("the wheel was not driven (Wh32 was)")
    assert "165 mm wide and taken unchanged for 100 mm" in width


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"slip": [0.1, 1.0]}, r"'slip' must lie in \[0, 1\) \(got 1\)"),
        ({"slip": []}, r"'slip' must lie in \[0, 1\) \(got none\)"),
        ({"slip": 0.1, "load": -1.0}, r"'load' must be above 0 \(got -1 N\)"),
        ({"slip": 0.1, "load": "80 mm"}, "'load': the unit 'mm' is not a unit of force"),
        ({"slip": 0.1, "wheel": "Wh3"}, r"'Wh3' is neither a wheel .* \(did you mean 'Wh32'\?\)"),
        ({"slip": 0.1, "wheel": Wheel(0.157, 0.165, 0.001, 30)}, "'shearing_radius_coefficient' from equation"),
    ],
)
def test_mistakes_are_named(wide: Result, options: dict[str, object], message: str) -> None:
    """Slips, loads and wheels outside the model's range are refused with the value got."""
    with pytest.raises(StudyError, match=message):
        bt.predict(wide, **options)  # type: ignore[arg-type]  # wrong on purpose


def test_wheel_files(tmp_path: Path) -> None:
    """A wheel's own file is named after it; in a study file the table names the wheel."""
    alone, study = tmp_path / "small.toml", tmp_path / "study.toml"
    alone.write_text(SMALL_FILE, encoding="utf-8")
    study.write_text(f'title = "x"\n[wheels.S1]\n{SMALL_FILE}', encoding="utf-8")
    assert read_wheel(alone) == ("small", SMALL)
    assert read_wheel(study) == ("S1", SMALL)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SMALL_FILE.replace("width", "widht"), r"small\.toml: .*unknown key 'widht' \(did you mean 'width'\?\)"),
        (SMALL_FILE.replace('"100 mm"', "100"), "'radius' needs a unit"),
        (SMALL_FILE.replace("100 mm", "-100 mm"), "'radius' must be positive"),
        (f"[wheels.A]\n{SMALL_FILE}[wheels.B]\n{SMALL_FILE}", "must describe one wheel"),
    ],
)
def test_wrong_wheel_files_are_named(text: str, message: str, tmp_path: Path) -> None:
    """A wheel file is checked like a study file."""
    (tmp_path / "small.toml").write_text(text, encoding="utf-8")
    with pytest.raises(StudyError, match=message):
        read_wheel(tmp_path / "small.toml")


def test_slips_are_read_and_converted(wide: Result) -> None:
    """Slips on the rim become slips on the shearing radius by (3); wrong text is named."""
    ((curve, at),) = forecast(wide, slips=slips_of(["0.1, 0.3"]), slip_reference="rim").cases
    assert at is not None
    np.testing.assert_allclose(at.slip, 1 - 157.35 / 163.85 * (1 - np.array([0.1, 0.3])))
    assert curve.slip[0] == pytest.approx(0.1)
    assert curve.slip[-1] == pytest.approx(0.6)
    with pytest.raises(StudyError, match=r"'slip' must be numbers with commas, e.g. 0.1,0.3 \(got 'x'\)"):
        slips_of(["0.1,x"])
    with pytest.raises(StudyError, match="'slip_reference' must be rim, tip or shearing"):
        forecast(wide, slips=[0.1], slip_reference="hub")


def test_tables_and_folder(wide: Result, tmp_path: Path) -> None:
    """Bands, draws and derived quantities are saved in field units, and the same again the next time."""
    found = bt.predict(wide, [0.1, 0.3], load="60 N")
    found.save(tmp_path / "a")
    bt.predict(wide, [0.1, 0.3], load="60 N").save(tmp_path / "b")
    for name in ("bands.csv", "draws.csv", "derived.csv", "prediction.json", "prediction.png"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert found.RECORD.read(tmp_path / "a" / found.MARK)["kind"] == "prediction"
    draws, bands = found.to_dataframe(), found.table.set_index(["slip", "quantity"])
    median = draws.query("slip == 0.3")["sinkage [mm]"].median()
    assert bands.loc[(0.3, "sinkage"), "modelled_q50"] == pytest.approx(median)
    assert "tractive_efficiency_reading" not in draws
    assert list(found.derived_table["quantity"]) == list(found.derived)


def test_no_result_is_replaced_by_a_prediction(wide: Result, saved: Path) -> None:
    """Overwriting replaces an older prediction, never a result folder."""
    with pytest.raises(bt.ResultError, match=r"is not a folder with prediction\.json"):
        bt.predict(wide, [0.1]).save(saved / "wide-result", overwrite=True)
    assert (saved / "wide-result" / "draws.nc").exists()


def test_figures_return_their_axes(wide: Result) -> None:
    """One quantity is drawn into given axes, all into a grid."""
    found = bt.predict(wide, np.linspace(0.05, 0.97, 20))
    axes = prediction_pages.predictions(Forecast(cases=((found, found.at(found.slip[:2])),)))
    assert axes.shape == (1, len(PREDICTED))
    assert prediction_pages.prediction(found, "sinkage", axes[0, 0]) is axes[0, 0]
    assert axes[0, 0].get_ylabel() == "$z$ [mm]"


def test_the_legend_says_what_hatching_means(wide: Result) -> None:
    """Of a band that too many draws leave without an answer."""
    found = bt.predict(wide, [0.3, 0.97], wheel=SMALL, load="200 N")
    (legend,) = figure_of(prediction_pages.predictions(found)).legends
    assert [entry.get_text() for entry in legend.get_texts()][-1] == "over 5 % of draws without answer"


def test_notebook_table_marks_and_escapes(wide: Result) -> None:
    """The table shows bands to their precision, doubtful shares in bold, and escapes names."""
    shown = bt.predict(wide, [0.3, 0.97], wheel=SMALL, load="200 N")._repr_html_()
    assert "<b>" in shown.split("<tbody>")[1]
    assert "other wheel under 200 N" in shown
    assert "no answer" in shown


def test_a_line_of_the_draws_is_of_the_draw_that_it_names(wide: Result) -> None:
    """Chain, draw, slip and values of a prediction belong together, line by line."""
    found = bt.predict(wide, [0.1, 0.3, 0.5])
    table = found.to_dataframe()
    assert len(table) == 3 * len(found.index)
    for line in (0, 1, 2, 1000, len(table) - 1):
        cells, draw = table.iloc[line], line // 3
        assert (cells["chain"], cells["draw"]) == tuple(found.index[draw])
        assert cells["slip"] == found.slip[line % 3]
        assert cells["sinkage [mm]"] == found.modelled[draw, line % 3, 0] / 1e-3
        assert (
            cells["drawbar_pull_reading [N]"] == found.readings[draw, line % 3, list(PREDICTED).index("drawbar_pull")]
        )


def test_derived_quantities_stand_beside_those_of_the_prior(wide: Result) -> None:
    """Shear strength under 5 kPa by hand, of the posterior's draws and of the prior's."""
    row = bt.predict(wide, [0.1]).derived_table.set_index("quantity").loc["shear_strength"]
    i, c = wide.names.index("phi"), wide.study.prior.fixed["c"]
    after, before = (1e-3 * (c + 5e3 * np.tan(wide.values(group)[:, i])) for group in ("posterior", "prior"))
    assert row["median"] == pytest.approx(np.median(after), rel=0.01)
    assert row["sd"] == pytest.approx(after.std(), rel=0.1)
    expected = [np.median(before[:2000]), *np.quantile(before[:2000], [0.05, 0.95])]
    found = row[["prior_median", "prior_q05", "prior_q95"]].to_numpy(float)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_some_slips_of_a_prediction_are_predicted_as_alone(wide: Result) -> None:
    """Values, and reasons for draws without an answer, go with their slip."""
    both, alone = bt.predict(wide, [0.3, 0.97]), bt.predict(wide, [0.97])
    some = both.at(np.array([0.97]))
    np.testing.assert_array_equal(some.modelled, alone.modelled)
    np.testing.assert_array_equal(some.reasons, alone.reasons)
    assert some.unanswered[0] > 0
    assert some.table["no_answer"].tolist() == alone.table["no_answer"].tolist()


def test_readings_have_the_zero_error_of_the_sinkage(make_study: Callable[..., Study]) -> None:
    """An instrument that reads 4 mm too much: its readings are higher by that, modelled values are not."""
    law = bt.Law("norm", {"loc": 0.004, "scale": 0.001})
    study = make_study(free=("phi",), priors={"sinkage_offset": law})
    x = np.column_stack([np.full(400, 0.511), np.full(400, 0.004)]).reshape(4, 100, 2)
    groups = {name: parameter_dataset(study.prior.names, x) for name in ("posterior", "prior")}
    assert study.prior.names == ("phi", "sinkage_offset")
    draws = xr.DataTree.from_dict(groups)
    known = RunResult(study=study, draws=draws, summary=pd.DataFrame(), record={})
    found = bt.predict(known, [0.2, 0.4])
    off = dict(zip(PREDICTED, (found.readings - found.modelled).mean(axis=(0, 1)), strict=True))
    assert off["sinkage"] == pytest.approx(0.004, abs=2e-4)
    assert (off["drawbar_pull"], off["resistance_moment"]) == pytest.approx((0.0, 0.0), abs=0.3)
    sinkage = make_study().observations.values["sinkage"][[2, 4]]
    np.testing.assert_allclose(found.modelled[0, :, 0], sinkage, rtol=0.01)


def test_probabilities_are_shares_of_the_draws(wide: Result) -> None:
    """Of modelled values, in the units of the condition; what has no answer meets none."""
    asked = ("drawbar_pull > 15 N", "sinkage<0.9 cm", "tractive_efficiency > 0.5")
    made = forecast(wide, slips=[0.1, 0.4], probabilities=asked)
    table, at = made.tables()["probabilities"], made.points[0]
    assert list(table["condition"]) == ["drawbar_pull > 15 N", "sinkage < 0.9 cm", "tractive_efficiency > 0.5"] * 2
    for row in table.to_dict("records"):
        name, sign, value = str(row["condition"]).split()[:3]
        column, i = list(PREDICTED).index(name), int(np.argmin(np.abs(at.slip - float(row["slip"]))))
        values, limit = at.modelled[:, i, column], float(value) * (0.01 if name == "sinkage" else 1.0)
        met = values > limit if sign == ">" else values < limit
        assert row["probability"] == pytest.approx(np.sum(met) / len(values))
    assert not table["model_error"].any()
    assert "error of the model itself is not in" in str(made.overview()[-1])
    with_error = replace(
        made, cases=tuple((replace(a, model_error=True), b and replace(b, model_error=True)) for a, b in made.cases)
    )
    assert "as the study states it, is in these" in str(with_error.overview()[-1])
    assert "probabilities" not in forecast(wide, slips=[0.1]).tables()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("pull > 20 N", "'probability' must be a quantity, > or <, and a value"),
        ("drawbar_pull 20 N", "'probability' must be a quantity, > or <, and a value"),
        ("drawbar_pull > 20", "'drawbar_pull' needs a unit"),
        ("sinkage < 3 N", "'sinkage'"),
        ("tractive_efficiency > high", "'tractive_efficiency'"),
    ],
)
def test_conditions_of_another_form_are_named(text: str, message: str) -> None:
    """One line each, before anything is computed."""
    with pytest.raises(StudyError, match=re.escape(message)):
        Condition.read(text, {name: channel.dimension for name, channel in PREDICTED.items()})


def test_wheels_of_one_size_are_told_apart_by_name(wide: Result) -> None:
    """A discrepancy is that of the wheel that was asked for, not of the first one like it."""
    (wheel,) = wide.study.wheels.values()
    alike = wide.study.having(wheels={"A": wheel, "B": wheel})
    assert [name_of(alike, wheel, called) for called in ("A", "B", "other wheel")] == ["A", "B", "A"]
    assert name_of(alike, SMALL, "A") is None


def test_names_of_wheels_are_used_once(wide: Result, tmp_path: Path) -> None:
    """A file called like a wheel of the study, and two files of one name, are refused where sizes differ."""
    for folder, radius in (("a", 100), ("b", 110)):
        (tmp_path / folder).mkdir()
        for name in ("wheel", "Wh32"):
            (tmp_path / folder / f"{name}.toml").write_text(SMALL_FILE.replace("100 mm", f"{radius} mm", 1))
    with pytest.raises(StudyError, match=r"^'Wh32' is a wheel of the study with other dimensions: give the"):
        bt.predict(wide, 0.2, wheel=tmp_path / "a" / "Wh32.toml")
    files = [str(tmp_path / folder / "wheel.toml") for folder in "ab"]
    with pytest.raises(StudyError, match=r"^two wheels are called 'wheel': rename one, its file or its table$"):
        forecast(wide, wheels=files, slips=[0.2])
    with pytest.raises(StudyError, match=r"^two wheels are called 'other wheel': ask for one after the other$"):
        bt.recommend(wide, wheels=[SMALL, replace(SMALL, radius=0.11)])
