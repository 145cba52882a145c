"""A rover on the draws of a result: predict_rover, and predict --rover."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import bayesterra as bt
from bayesterra.__main__ import main
from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError
from bayesterra.likelihood.forward import model_columns, soil_at
from bayesterra.models import Conditions, Wheel
from bayesterra.models.statics import Greatest, Outcome
from bayesterra.prediction.outlook import RoverOutlook, predict_rover
from bayesterra.prediction.page import rover_outlook
from bayesterra.prediction.prediction import spread
from bayesterra.report.figures import figure_of
from bayesterra.study.model_errors import Discrepancy, ModelErrors, Size
from bayesterra.study.result import Result

FILE = """\
weight = "320 N"
wheelbase = { value = "0.8 m", assumption = "read from a drawing" }
wheel = "Wh32"
[centre_of_gravity]
height = "0.3 m"
ahead_of_rear_axle = "0.4 m"
"""
Captured = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of a rover on the study's wheel."""
    path = tmp_path_factory.mktemp("rover") / "rover.toml"
    path.write_text(FILE, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def sheet(wide: Result, file: Path) -> RoverOutlook:
    """Three slopes with and without a tow force, on 300 draws."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayesterra.prediction.outlook.DRAWS", 300)
        return bt.predict_rover(wide, file, slopes=["5 deg", "10 deg", "16 deg"], tows=["0 N", "20 N"])


def test_every_draw_drives_on_its_own_soil(wide: Result, sheet: RoverOutlook) -> None:
    """The pull at the reported slip and load is the model's for that draw, and holds slope and tow."""
    states = sheet.asked
    chain, number = sheet.index[7]
    draw = wide.values().reshape(wide.draws["posterior"].sizes["chain"], -1, len(wide.names))[chain, number]
    study = wide.study
    wheel = study.wheels["Wh32"]
    theta = model_columns(soil_at(study.prior.soil_values(draw[None]), wheel.width), study.model)
    held = states.outcome[7] == Outcome.HELD
    assert held.sum() > 2
    for axle in (0, 1):
        conditions = Conditions.of(wheel, states.slip[7, held, axle])
        values, _ = study.model.response_at(theta, conditions, states.load[7, held, axle])
        np.testing.assert_allclose(values[0, :, 1], states.pull[7, held, axle], rtol=1e-7)
    asked = 320 * np.sin(states.slope[7, held]) + states.tow[7, held]
    np.testing.assert_allclose(2 * states.pull[7, held].sum(axis=1), asked, rtol=1e-8)


def test_the_table_counts_and_orders(sheet: RoverOutlook) -> None:
    """A row per slope, tow, axle and quantity; more of either needs more slip, and more draws fail."""
    table = sheet.table
    assert len(table) == 6 * 2 * 5
    found = table.query("quantity == 'slip' and axle == 'rear'").to_dict("records")
    slips: dict[tuple[float, float], Any] = {(row["slope [deg]"], row["tow [N]"]): row for row in found}
    assert slips[10, 20]["q50"] > slips[10, 0]["q50"] > slips[5, 0]["q50"]
    drawn = sheet.to_dataframe().query("`slope [deg]` == 10 and `tow [N]` == 20")
    assert len(drawn) == len(sheet.index)
    assert slips[10, 20]["q95"] == pytest.approx(np.quantile(drawn["rear_slip"].dropna(), 0.95))
    counted = table[["pulls_too_little", "sinks", "lifts"]].sum(axis=1) / len(sheet.index)
    np.testing.assert_allclose(table["cannot"], counted)
    assert 0.05 < slips[16, 0]["cannot"] < slips[16, 20]["cannot"]


def test_the_greatest_slope_is_a_distribution(sheet: RoverOutlook) -> None:
    """Its share above a slope is the probability to climb, and the share of draws that hold that slope."""
    greatest = sheet.greatest_slope
    assert greatest.shape == (len(sheet.index),)
    asked = sheet.asked
    column = int(np.flatnonzero((asked.slope[0] > 0.27) & (asked.tow[0] == 0))[0])
    fails = sheet.cannot[column] + sheet.unanswered[column]
    assert sheet.probability_to_climb(np.radians(16)) == pytest.approx(1 - fails, abs=0.02)
    assert sheet.probability_to_climb(np.radians(60)) == 0
    at_driven = sheet.slopes_driven
    assert float((at_driven.value - greatest).max()) < 1e-5
    assert at_driven.slip.max() <= 0.6 + 1e-9
    climb = sheet.climb_table.set_index("slope [deg]")["probability"]
    assert climb.loc[16.0] == pytest.approx(float((greatest >= np.radians(16)).mean()), abs=1e-3)
    assert climb.iloc[-1] == 0


def test_notes_name_assumptions_and_what_is_left(
    wide: Result, sheet: RoverOutlook, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assumed numbers, loads and wheels that were not measured, and the model's own error."""
    notes = "\n".join(sheet.notes)
    assert "wheelbase 0.8 m is an assumption: read from a drawing" in notes
    assert "tow height 300 mm is an assumption: none is given" in notes
    assert "all wheels turn at one speed and slip alike" in notes
    assert "leave the measured loads, 80 N: extrapolated" in notes
    assert "the error of the wheel-soil model itself is not in them" in notes
    assert "the wheel was not driven" not in notes
    monkeypatch.setattr("bayesterra.prediction.outlook.DRAWS", 50)
    small = bt.Rover(
        name="small", weight=100.0, wheelbase=0.5, centre_height=0.2, centre_ahead=0.25, tow_height=0.1,
        wheels=(Wheel(0.1, 0.1, 0.005, 24),) * 2, gravity=1.62,
    )  # fmt: skip
    notes = "\n".join(bt.predict_rover(wide, small, slopes=["25 deg"]).notes)
    assert "the wheel was not driven (Wh32 was)" in notes
    assert "under 1.62 m/s²" in notes


def test_the_figure_has_rows_for_slope_and_tow(
    wide: Result, sheet: RoverOutlook, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four panels a row; without a tow force there is no second row."""
    monkeypatch.setattr("bayesterra.prediction.outlook.DRAWS", 50)
    axes = rover_outlook(sheet)
    assert axes.shape == (2, 4)
    figure_of(axes).canvas.draw()
    assert rover_outlook(bt.predict_rover(wide, file, slopes=["5 deg"])).shape == (1, 4)


def test_the_command_writes_and_prints(
    saved: Path, file: Path, tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder with tables, figure and record; slopes in degrees; a second time needs --overwrite."""
    monkeypatch.setattr("bayesterra.prediction.outlook.DRAWS", 50)
    out = tmp_path / "driven"
    call = ["predict", str(saved / "wide-result"), "--rover", str(file), "--slope", "5,12", "--out", str(out)]
    assert main([*call, "--tow", "0 N,20 N"]) == 0
    printed = capsys.readouterr().out
    assert "Greatest slope:" in printed
    assert "read from a drawing" in printed
    bands = pd.read_csv(out / "bands.csv")
    assert sorted(set(bands["slope [deg]"].round(9))) == [5, 12]
    assert sorted(set(bands["tow [N]"])) == [0, 20]
    for name in ("draws.csv", "greatest.csv", "climb.csv", "rover.json"):
        assert (out / name).stat().st_size > 0
    assert (out / "rover.png").read_bytes().startswith(b"\x89PNG")
    assert RoverOutlook.RECORD.read(out / RoverOutlook.MARK)["kind"] == "rover"
    assert main(call) == 2
    assert "add --overwrite" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--rover", "none.toml"], "none.toml: no such rover file"),
        (["--rover", "{file}", "--slope", "steep"], "'slope' must be degrees with commas, e.g. 0,5,10 (got"),
        (["--rover", "{file}", "--slope", "50"], "'slope' must lie between 0 and 45 deg (got 50 deg)"),
        (["--rover", "{file}", "--tow", "35"], "'tow' needs a unit"),
        (["--rover", "{file}", "--tow", "-1 N"], "'tow' must not be below 0 N (got -1 N)"),
        (["--rover", "{file}", "--load", "80 N"], "'--load' does not go with '--rover'"),
        (["--slope", "5"], "'--slope' needs '--rover FILE'"),
    ],
)  # fmt: skip
def test_mistakes_are_one_line(
    arguments: list[str], message: str, saved: Path, file: Path, tmp_path: Path, capsys: Captured,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Bad input ends with 2 and one line that names it; no folder appears."""
    monkeypatch.chdir(tmp_path)
    given = [argument.format(file=file) for argument in arguments]
    assert main(["predict", str(saved / "wide-result"), *given]) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert printed.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_numbers_in_python_are_radians(wide: Result, file: Path) -> None:
    """A slope of 10 is refused with the value in degrees."""
    with pytest.raises(StudyError, match=r"'slope' must lie between 0 and 45 deg \(got 573 deg\)"):
        bt.predict_rover(wide, file, slopes=[10.0])


def test_greatest_slopes_and_tow_forces_have_rows_of_their_own(sheet: RoverOutlook) -> None:
    """Four peaks made by hand, at all slips and at driven ones: each with its values, slips and counts."""

    def peak(value: float, slip: float, rising: int) -> Greatest:
        n: FloatArray = np.arange(10.0)
        return Greatest(value * (1 + 0.01 * n), slip + 0.01 * n, n < rising)

    peaks = (peak(0.3, 0.5, 1), peak(0.2, 0.4, 2), peak(90.0, 0.6, 3), peak(60.0, 0.3, 4))
    slopes, slopes_driven, tows, tows_driven = peaks
    made = replace(sheet, slopes=slopes, slopes_driven=slopes_driven, tows=tows, tows_driven=tows_driven)
    table = made.greatest_table
    asked = (*(["greatest_slope"] * 2), *(["greatest_tow"] * 2))
    assert (tuple(table["quantity"]), tuple(table["slips"])) == (asked, ("all", "driven") * 2)
    for row, own in zip(table.to_dict("records"), peaks, strict=True):
        values = np.degrees(own.value) if row["unit"] == "deg" else own.value
        np.testing.assert_allclose([row["q05"], row["q50"], row["q95"]], np.quantile(values, [0.05, 0.5, 0.95]))
        assert row["at_slip_q50"] == pytest.approx(np.median(own.slip))
        assert (row["draws"], row["no_answer"], row["still_rising"]) == (10, 0, own.rising.sum())
    climb = made.climb_table
    for column, own in (("probability", peaks[0]), ("probability_driven_slips", peaks[1])):
        share = [(np.degrees(own.value) >= slope).mean() for slope in climb["slope [deg]"]]
        np.testing.assert_allclose(climb[column], share)
    assert (climb["probability"] > climb["probability_driven_slips"]).any()


def test_a_discrepancy_moves_with_the_rover(wide: Result, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pulls are the model's plus one curve of the wheel for each draw, at both axles."""
    monkeypatch.setattr("bayesterra.prediction.outlook.DRAWS", 150)
    noisy = Discrepancy("drawbar_pull", Size(sd=3.0), 0.3)
    study = wide.study.having(errors=ModelErrors({"drawbar_pull": noisy}))
    found = bt.predict_rover(replace(wide, study=study), file, slopes=["5 deg", "10 deg"])
    plain = bt.predict_rover(wide, file, slopes=["5 deg", "10 deg"])
    states, held = found.asked, (found.asked.outcome == Outcome.HELD).all(axis=1)
    assert held.mean() > 0.5
    draws = spread(wide, 150)[0]
    ground = found.rover.on(study.prior.soil_values(draws), study.model)
    errors = []
    for i in (0, 1):
        load = states.load[held, i]
        values, _ = ground.respond(np.flatnonzero(held), states.slip[held, i], load, load.mean(axis=1))
        errors.append(states.pull[held, i] - values[:, :, 1])
    first, second = errors
    np.testing.assert_allclose(first[:, 0], first[:, 1], atol=1e-6)
    assert np.corrcoef(first[:, 0], second[:, 0])[0, 1] > 0.5
    assert 0.1 < first[:, 0].std() < 3.0
    widths = [np.nanstd(outlook.asked.slip[:, 0, 0]) for outlook in (plain, found)]
    assert widths[1] > widths[0]
    notes = "\n".join(found.notes)
    assert "the model's own error is part of it, as its readings tell it" in notes
    assert "the error of the wheel-soil model itself" not in notes
    again = bt.predict_rover(replace(wide, study=study), file, slopes=["5 deg", "10 deg"])
    np.testing.assert_array_equal(again.asked.slip, states.slip)


def test_probabilities_of_a_rover(wide: Result, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the greatest slope as the curve of climbing has it; of both axles on every slope."""
    monkeypatch.setattr("bayesterra.prediction.outlook.DRAWS", 150)
    asked = ("slope > 10 deg", "sinkage < 12 mm", "sinkage > 9 mm")
    made = predict_rover(wide, file, slopes=("0 deg", "5 deg"), probabilities=asked)
    table = made.tables()["probabilities"]
    assert table["probability"][0] == pytest.approx(made.probability_to_climb(np.radians(10.0)), abs=1e-9)
    deep, shallow = made.asked.sinkage.max(axis=2), made.asked.sinkage.min(axis=2)
    assert list(table["probability"][1:3]) == pytest.approx((deep < 0.012).mean(axis=0))
    assert list(table["probability"][3:]) == pytest.approx((shallow > 0.009).mean(axis=0))
    assert list(table["slope [deg]"][1:3]) == pytest.approx([0.0, 5.0])
    assert not table["model_error"].any()
