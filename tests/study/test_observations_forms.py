"""Tables as people have them: the same numbers out of all that mean the same, one line where something is open."""

from pathlib import Path

import numpy as np
import openpyxl
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from paper_wheels import WHEELS
from table_forms import HEADER, ROWS, TableForm, table_forms, workbook

from bayesterra.errors import StudyError
from bayesterra.runtime import tables
from bayesterra.study.observations import Observations, observations, read_table

FORMS = table_forms()


def read(form: TableForm, folder: Path) -> Observations:
    """The rows of a form, from its file."""
    (folder / form.file).write_bytes(form.content)
    return observations(
        read_table(folder / form.file, form.data.get("sheet", "")), {"Wh32": WHEELS["Wh32"]}, slip_reference="shearing"
    )


@pytest.mark.parametrize("form", [form for form in FORMS if not form.asks], ids=lambda form: form.name)
def test_all_forms_mean_the_same(form: TableForm, tmp_path: Path) -> None:
    """Every number, and what is not measured; what is left alone is said."""
    rows = read(form, tmp_path)
    expected = pd.DataFrame(ROWS, columns=pd.Index(HEADER), dtype=float)
    loads = rows.values.get("normal_force", rows.load)
    assert_allclose(rows.slip, expected["slip"], rtol=1e-15)
    assert_allclose(loads, expected["load [N]"], rtol=1e-15)
    assert_allclose(rows.values["sinkage"], expected["sinkage [mm]"] * 1e-3, rtol=1e-15)
    assert_allclose(rows.values["drawbar_pull"], expected["drawbar_pull [N]"], rtol=1e-15)
    assert_allclose(rows.values["resistance_moment"], expected["resistance_moment [N m]"], rtol=1e-15)
    assert sum(bool(heading.name) for heading in rows.headings) == 5
    assert all(heading.remark == "left alone" for heading in rows.headings if not heading.name)
    assert ("kg: the weight" in str(rows.notes)) == ("[kg]" in str(rows.headings))


@pytest.mark.parametrize("form", [form for form in FORMS if form.asks], ids=lambda form: form.name)
def test_what_is_open_is_asked_for(form: TableForm, tmp_path: Path) -> None:
    """In one line that says what to do."""
    with pytest.raises(StudyError) as caught:
        read(form, tmp_path)
    assert form.asks in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("decimal", "load"), [(",", 1.234), (".", 1234.0)])
def test_an_answer_settles_it(decimal: str, load: float, tmp_path: Path) -> None:
    """The same cell is one number or the other; limits keep their mark."""
    (tmp_path / "t.csv").write_text(
        "slip;load [N];DP [N]\n0.25;1,234;<1,500\n" if decimal == "." else "s;load [N];DP [N]\n0,25;1,234;<1,5\n"
    )
    rows = observations(read_table(tmp_path / "t.csv", decimal=decimal), {"Wh32": WHEELS["Wh32"]}, slip_reference="rim")
    assert rows.load[0] == load
    assert rows.cells("drawbar_pull")[0] == ("<1500.0" if decimal == "." else "<1.5")


def test_minus_signs_of_printers_are_minus_signs(tmp_path: Path) -> None:
    """U+2212, with a decimal point or comma."""
    (tmp_path / "t.csv").write_text("slip;DP [N]\n0,1;−1,5\n0,2;-2,5\n", encoding="utf-8")
    (tmp_path / "u.csv").write_text("slip,DP [N]\n0.1,−1.5\n0.2,-2.5\n", encoding="utf-8")
    for name in ("t.csv", "u.csv"):
        rows = observations(read_table(tmp_path / name), {"Wh32": WHEELS["Wh32"]}, slip_reference="rim")
        assert rows.values["drawbar_pull"].tolist() == [-1.5, -2.5]


def test_errors_of_workbooks_are_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sheet that is not there, a sheet of a CSV, a bomb, no openpyxl."""
    (tmp_path / "t.xlsx").write_bytes(workbook(("rows", (HEADER, *ROWS))))
    (tmp_path / "t.csv").write_text("slip\n0.1\n")
    with pytest.raises(StudyError, match=r"has no sheet 'x' \(it has 'rows'\)"):
        read_table(tmp_path / "t.xlsx", sheet="x")
    with pytest.raises(StudyError, match=r"is no \.xlsx workbook, so it has no sheet 'x': leave 'sheet' out"):
        read_table(tmp_path / "t.csv", sheet="x")
    monkeypatch.setattr(tables, "MOST_UNPACKED", 1000)
    with pytest.raises(StudyError, match="MB when unpacked"):
        read_table(tmp_path / "t.xlsx")
    monkeypatch.setattr(tables, "MOST_UNPACKED", 2**28)
    monkeypatch.setattr(tables, "MOST_ROWS", 2)
    with pytest.raises(StudyError, match="must have at most 2 rows"):
        read_table(tmp_path / "t.xlsx", rows=2)
    monkeypatch.setitem(__import__("sys").modules, "openpyxl", None)
    with pytest.raises(StudyError, match=r"Excel workbooks need openpyxl: pip install 'bayesterra\[excel\]'"):
        read_table(tmp_path / "t.xlsx")


def test_numbers_of_a_workbook_stay_numbers(tmp_path: Path) -> None:
    """A number with three decimals beside texts with decimal commas is no thousands."""
    (tmp_path / "t.xlsx").write_bytes(workbook(("rows", (("slip", "load [N]"), (0.125, "80,5"), ("0,2", 1.234)))))
    table = read_table(tmp_path / "t.xlsx")
    assert table.to_numpy().tolist() == [[0.125, "80.5"], ["0.2", 1.234]]
    assert table.attrs["form"] == "Excel, sheet 'rows', decimal commas"
    assert np.isnan(observations(pd.DataFrame({"slip": [0.1]}), {"Wh32": WHEELS["Wh32"]}, slip_reference="rim").load[0])


@pytest.mark.parametrize(
    ("header", "cells", "form"),
    [
        ("slip [%]", (0.1, 0.07, 0.3), "0%"),
        ("slip [%]", (0.1, 0.07, 0.3), "0.00 %"),
        ("slip [%]", (10, 7, 30), "General"),
        ("slip [%]", (10, 7, 30), '0"%"'),
        ("slip [%]", (10, 7, 30), r"0\%"),
        ("slip_percent", (0.1, 0.07, 0.3), "0%"),
        ("slip_pct", (0.1, 0.07, 0.3), "0%"),
        ("slip [percent]", (0.1, 0.07, 0.3), "0%"),
        ("slip", (0.1, 0.07, 0.3), "0%"),
        ("slip", (0.1, 0.07, 0.3), "General"),
    ],
)
def test_cells_in_percent_say_what_they_show(header: str, cells: tuple[float, ...], form: str, tmp_path: Path) -> None:
    """Below a header in %, 10 % is 10; below one without a unit it is 0.1; a sign that is only shown is none."""
    book = openpyxl.Workbook()
    sheet = book.active
    assert sheet is not None
    sheet.append([header, "drawbar_pull [N]"])
    for i, slip in enumerate(cells):
        sheet.append([slip, 1.0])
        sheet.cell(i + 2, 1).number_format = form
    book.save(tmp_path / "t.xlsx")
    rows = observations(read_table(tmp_path / "t.xlsx"), {"Wh32": WHEELS["Wh32"]}, slip_reference="shearing")
    assert_allclose(rows.slip, [0.1, 0.07, 0.3], rtol=1e-15)
