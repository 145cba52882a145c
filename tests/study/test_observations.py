"""Tables of measurements."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from bayesterra.errors import StudyError
from bayesterra.models import Wheel
from bayesterra.study.observations import Column, Observations, labels, observations, read_table

LUGGED = Wheel(0.1, 0.1, lug_height=0.02, lug_count=24, shearing_radius_coefficient=0.5)  # r_s = 0.11
SMOOTH = Wheel(0.2, 0.1)


def read(columns: dict[str, Any], *, wheels: dict[str, Wheel] | None = None, **references: str) -> Observations:
    """Read a table given as columns, by default of the lugged wheel with slip on the shearing radius."""
    references.setdefault("slip_reference", "shearing")
    return observations(pd.DataFrame(columns), wheels or {"A": LUGGED}, **references)


def test_units_of_the_headers_become_si() -> None:
    """Any unit of the right dimension is accepted and converted once."""
    rows = read({"slip [%]": [10], "load [kN]": [0.08], "sinkage [cm]": [1.5], "drawbar_pull [N]": [-3]})
    assert_allclose(rows.slip, [0.1])
    assert_allclose(rows.load, [80.0])
    assert_allclose(rows.values["sinkage"], [0.015])
    assert_allclose(rows.values["drawbar_pull"], [-3.0])


def test_empty_cells_are_not_measured() -> None:
    """Empty text, None and NaN all mean that there is no reading."""
    rows = read({"slip": [0.1, 0.2, 0.3, 0.4], "sinkage [mm]": ["", None, float("nan"), "4"]})
    assert np.isnan(rows.values["sinkage"]).tolist() == [True, True, True, False]
    assert np.isnan(rows.load).all()


def test_text_and_numbers_read_alike() -> None:
    """A CSV's text cells and a DataFrame's numbers give the same observations."""
    numbers = {"slip": [0.1, 0.25], "load [N]": [80, 80.5], "sinkage [mm]": [4.5, np.nan]}
    texts = {"slip": ["0.1", "0.25"], "load [N]": ["80", " 80.5"], "sinkage [mm]": ["4.5", ""]}
    for name in ("slip", "load"):
        assert_allclose(getattr(read(numbers), name), getattr(read(texts), name), rtol=0)
    assert_allclose(read(numbers).values["sinkage"], read(texts).values["sinkage"], rtol=0)


@pytest.mark.parametrize(
    ("reference", "expected"), [("rim", 1 - 0.10 / 0.11 * 0.8), ("tip", 1 - 0.12 / 0.11 * 0.8), ("shearing", 0.2)]
)
def test_slip_is_converted_to_the_shearing_radius(reference: str, expected: float) -> None:
    """Equation (3): the travel speed stays, the radius behind the slip changes."""
    assert_allclose(read({"slip": [0.2]}, slip_reference=reference).slip, [expected])


def test_slip_of_each_row_is_converted_with_its_own_wheel() -> None:
    """Without lugs all radii agree, so only the lugged wheel's slip changes."""
    table = {"wheel": ["B", "A"], "slip": [0.2, 0.2]}
    rows = read(table, wheels={"A": LUGGED, "B": SMOOTH}, slip_reference="rim")
    assert_allclose(rows.slip, [0.2, 1 - 0.10 / 0.11 * 0.8])


def test_sinkage_from_the_tip_loses_the_lug_height() -> None:
    """A sinkage counted from the tips of the lugs is larger by h than that of the rim."""
    assert_allclose(read({"slip": [0.2], "sinkage [mm]": [30]}, sinkage_reference="tip").values["sinkage"], [0.01])


def test_ranges_are_checked_after_conversion() -> None:
    """A sinkage of the tip above r is allowed as long as the rim's is below r; a tip slip of 0 is braking."""
    table = {"slip": [0.2], "sinkage [mm]": [110]}
    assert_allclose(read(table, sinkage_reference="tip").values["sinkage"], [0.09])
    with pytest.raises(StudyError, match=r"'sinkage' must be below the wheel radius 100 mm \(got 110 mm, row 1\)"):
        read(table)
    with pytest.raises(StudyError, match=r"'slip' must lie in \[0, 1\) \(got 0, on the shearing radius -0\.09"):
        read({"slip": [0.0]}, slip_reference="tip")


def test_rows_that_are_not_used_and_out_of_range_are_left_out_with_a_note() -> None:
    """A braking row with 'use' 0 does no harm, and the row numbers of the others stay those of the file."""
    rows = read({"slip": [-0.2, 0.1, 0.2], "use": [0, 1, 0]})
    assert rows.rows == (2, 3)
    assert rows.use.tolist() == [True, False]
    assert "'slip' must lie in [0, 1) (got -0.2, row 1)" in rows.notes[0]
    assert rows.used().rows == (2,)


def test_standard_deviations_come_with_their_channel() -> None:
    """A column <channel>_sd is converted like its channel; a channel without one has NaN."""
    rows = read({"slip": [0.1], "sinkage [mm]": [5], "sinkage_sd [cm]": [0.1], "drawbar_pull [N]": [3]})
    assert_allclose(rows.given_sd["sinkage"], [0.001])
    assert np.isnan(rows.given_sd["drawbar_pull"]).all()


def test_observations_cannot_be_written_to() -> None:
    """Arrays of observations are read-only."""
    rows = read({"slip": [0.1], "sinkage [mm]": [5]})
    for array in (rows.slip, rows.load, rows.use, rows.values["sinkage"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"load [N]": [80]}, r"column 'slip' is missing"),
        ({"slip": [1.0]}, r"'slip' must lie in \[0, 1\) \(got 1, row 1\)"),
        ({"slip": [0.1, -0.1]}, r"'slip' must lie in \[0, 1\) \(got -0\.1, row 2\)"),
        ({"slip": [0.1, None]}, r"'slip' must be given in every row \(empty in row 2\)"),
        ({"slip": ["0,1"]}, r"'slip' must be a number or empty \(got '0,1', row 1\)"),
        ({"slip": ["1_0"]}, r"'slip' must be a number or empty"),
        ({"slip": ["nan"]}, r"'slip' must be finite or empty \(got nan, row 1\)"),
        ({"slip": [0.1], "load [N]": [np.inf]}, r"'load' must be finite or empty \(got inf, row 1\)"),
        ({"slip": [0.1], "load [N]": [0]}, r"'load' must be above 0 \(got 0 N, row 1\)"),
        ({"slip": [0.1], "load": [80]}, r"column 'load' needs a unit, e\.g\. 'load \[N\]' \(got 'load'\)"),
        ({"slip": [0.1], "load []": [80]}, r"column 'load' needs a unit"),
        ({"slip": [0.1], "load [-]": [80]}, r"column 'load' needs a unit"),
        ({"slip": [0.1], "load [mg]": [8]}, r"column 'load \[mg\]': the unit 'mg' is not a unit of force"),
        ({"slip [%]": [120]}, r"'slip' must lie in \[0, 100\) % \(got 120 %, row 1\)"),
        ({"slip": [0.1], "load [kN]": [-2]}, r"'load' must be above 0 \(got -2 kN, row 1\)"),
        ({"slip": [0.1], "s": [0.1]}, r"column 'slip' must appear once \(columns 's' and 'slip' both hold it\)"),
        ({"slip": ["2021-05-01"]}, r"\(got '2021-05-01', row 1\): a spreadsheet made a date of it"),
        ({"slip": [0.1], "load [Nn]": [8]}, r"column 'load \[Nn\]': unknown unit 'Nn'"),
        ({"slip": [0.1], "sinkge [mm]": [8]}, r"unknown column 'sinkge \[mm\]' \(did you mean 'sinkage'\?\)"),
        ({"slip": [0.1], "colour": [8]}, r"unknown column 'colour' \(known: slip, wheel, .*begins with 'remark'"),
        ({"slip": [0.1], "slip_sd": [0.1]}, r"unknown column 'slip_sd'"),
        ({"slip": [0.1], "sinkage [mm]": [8], "sinkage [cm]": [1]}, r"column 'sinkage' must appear once"),
        ({"slip": [0.1], "sinkage_sd [mm]": [8]}, r"column 'sinkage_sd' needs a column 'sinkage' beside it"),
        (
            {"slip": [0.1], "sinkage [mm]": [8], "sinkage_sd [mm]": [0]},
            r"'sinkage_sd' must be above 0 \(got 0 mm, row 1\)",
        ),
        ({"slip": [0.1], "use": [2]}, r"'use' must be 0 or 1 \(got 2, row 1\)"),
        ({"slip": [0.1], "use": [""]}, r"'use' must be 0 or 1 \(got '', row 1\)"),
        ({"slip": [0.1], "wheel": ["AA"]}, r"unknown wheel 'AA' in row 1"),
        ({"slip": []}, r"must hold at least one row of measurements"),
    ],
)
def test_wrong_tables_are_refused(columns: dict[str, Any], message: str) -> None:
    """The message names column and row, what must hold and the value got."""
    with pytest.raises(StudyError, match=message) as caught:
        read(columns)
    assert "\n" not in str(caught.value)


def test_several_wheels_need_a_wheel_column() -> None:
    """With two wheels every row must say which one it is."""
    with pytest.raises(StudyError, match=r"column 'wheel' is needed with several wheels \(A, B\)"):
        read({"slip": [0.1]}, wheels={"A": LUGGED, "B": SMOOTH})


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", r"\(the table is empty\)"),
        (b"slip,load [N]\n", r"\(the table is empty\)"),
        (b"slip;load [N]\n0.1;80\n0.2;80;3\n", r"every row must have 2 cells \(got 3, row 2\)"),
        (b"slip,load [N]\n0.1,80\n0.2\n", r"every row must have 2 cells \(got 1, row 2\)"),
        (b"slip \xc2\xb5\n0.1\xb0\n", r"must be UTF-8 text \(byte 11 is not\)"),
        (b"\xff\xfes\x00l\x00\n\x00\x00\xd8", r"must be text \(byte 8 is no UTF-16\)"),
        (b"\xd0\xcf\x11\xe0" + bytes(99), "is a workbook of an old form: save it as .xlsx or as CSV"),
        (b"PK\x03\x04" + bytes(99), "is no Excel workbook that can be read"),
        (b'slip\n"0.1\n', r"must be a table of comma-separated values"),
    ],
)
def test_wrong_files_are_refused(tmp_path: Path, content: bytes, message: str) -> None:
    """A file that is not a table of values says so."""
    (tmp_path / "table.csv").write_bytes(content)
    with pytest.raises(StudyError, match=message):
        read_table(tmp_path / "table.csv")


def test_files_may_have_a_byte_order_mark_and_blank_lines(tmp_path: Path) -> None:
    """What spreadsheets add does not count."""
    (tmp_path / "table.csv").write_bytes(b"\xef\xbb\xbfslip,use\r\n0.1,1\r\n\r\n0.2,0\r\n,\r\n")
    table = read_table(tmp_path / "table.csv")
    assert table.to_dict("list") == {"slip": ["0.1", "0.2"], "use": ["1", "0"]}


def test_files_that_cannot_be_opened_are_refused(tmp_path: Path) -> None:
    """A missing file and a folder are told apart."""
    with pytest.raises(StudyError, match="no such file of measurements"):
        read_table(tmp_path / "missing.csv")
    with pytest.raises(StudyError, match=r"cannot be read \(Is a directory\)"):
        read_table(tmp_path)


@pytest.mark.parametrize("empty", [None, np.nan, pd.NA, " "])
def test_a_label_that_is_left_out_is_no_group(empty: object) -> None:
    """Whatever stands for an empty cell in a table from Python."""
    with pytest.raises(StudyError, match=r"^'site' must be given in every row \(empty in row 2\)$"):
        labels(Column("site", ["a", empty], 1.0, "site", ""))
    table = pd.DataFrame({"wheel": ["A", empty], "slip": [0.1, 0.2], "drawbar_pull [N]": [1.0, 2.0]})
    with pytest.raises(StudyError, match=r"^'wheel' must be given in every row \(empty in row 2\)$"):
        observations(table, {"A": Wheel(0.1, 0.1), "B": Wheel(0.1, 0.2)}, slip_reference="rim")
