"""Texts in tables: no spreadsheet takes one for a formula, numbers stay, and we read what we wrote."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesterra.analysis.comparison import compare
from bayesterra.errors import StudyError
from bayesterra.prediction.prediction import forecast
from bayesterra.runtime.tables import csv_text, read_cells, read_csv, shielded, unshielded
from bayesterra.study.canonical import write_study
from bayesterra.study.result import Result
from bayesterra.study.study import load_study
from tests.support.pages import undrawn

FORMULAS = [
    "=1+1", "+1+1", "-1+1", "@SUM(A1)", "=cmd|' /C calc'!A0", "=HYPERLINK(\"http://x\")", "＝1+1", "\t=1+1",
    "\r=1+1", " =1+1", "\n=1", "-cmd", "'=1+1", "''@x", "+A1", "=", "-2+3+cmd|' /C calc'!A0", "@",
]  # fmt: skip
STARTS = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")


def acts(cell: str) -> bool:
    """Whether a spreadsheet may take a cell for a formula: by its first sign, unless it is a number."""
    try:
        float(cell)
    except ValueError:
        return len(cell.strip()) > 1 and cell.lstrip(" ").startswith(STARTS)
    return False


def cells_of(text: str) -> list[str]:
    """All cells of a CSV."""
    return [cell for row in csv.reader(io.StringIO(text, newline="")) for cell in row]


@pytest.mark.parametrize("text", FORMULAS)
def test_formulas_are_shielded(text: str, tmp_path: Path) -> None:
    """In cells and headers; read back by us they are as they were."""
    table = pd.DataFrame({text: [text, "sound"], "number": [-1.5, 2.0]})
    written = csv_text(table)
    assert not any(map(acts, cells_of(written)))
    (tmp_path / "x.csv").write_text(written, encoding="utf-8", newline="")
    pd.testing.assert_frame_equal(read_csv(tmp_path / "x.csv"), table)
    assert read_cells(tmp_path / "x.csv")[0][1] == [text, "-1.5"]


@given(st.text())
def test_shielding_is_undone(text: str) -> None:
    """Whatever the text, also one that is shielded already."""
    assert unshielded(shielded(text)) == text
    assert unshielded(shielded(shielded(text))) == shielded(text)
    assert not acts(shielded(text))


@pytest.mark.parametrize("number", ["-1.5", "+2", "-.5", "1e-3", "-1E+5", "-inf", "nan", "-"])
def test_numbers_and_signs_stay(number: str) -> None:
    """A number is no formula, also where it is written as a text; nor is a sign alone."""
    assert shielded(number) == number
    assert csv_text(pd.DataFrame({"x": [number]})) == f"x\n{number}\n"


def test_sound_tables_are_written_as_ever() -> None:
    """Nothing changes where there is nothing to shield."""
    table = pd.DataFrame({"wheel": ["Wh32", "o'clock"], "x [mm]": [-1.0, None], "u": [True, False]})
    assert csv_text(table) == table.to_csv(index=False)
    assert csv_text(table, "%.3g") == table.to_csv(index=False, float_format="%.3g")


def hostile_study(folder: Path, wheel: str, site: str) -> Path:
    """A study whose wheel and sites have such names."""
    (folder / "study.toml").write_text(
        f"""[data]
file = "measurements.csv"
slip_reference = "shearing"
[wheels.{json.dumps(wheel, ensure_ascii=False)}]
radius = "157.35 mm"
width = "165 mm"
[noise]
sinkage = "1 mm"
"""
    )
    table = pd.DataFrame(
        {"wheel": wheel, "site": [site, "b"], "slip": [0.1, 0.2], "load [N]": 80.0, "sinkage [mm]": 5.0}
    )
    (folder / "measurements.csv").write_text(csv_text(table), encoding="utf-8", newline="")
    return folder


@pytest.mark.parametrize("name", ["=1+1", "@x", "-a", "'=x", "+x y", "=cmd|' /C calc'!A0"])
def test_names_like_formulas_survive_study_and_table(name: str, tmp_path: Path) -> None:
    """A study with such names is read, written out and read again unchanged; its table holds no formula."""
    study = load_study(hostile_study(tmp_path, name, name))
    assert study.observations.wheel[0] == study.observations.labels["site"][0] == name
    copy = tmp_path / "copy"
    copy.mkdir()
    write_study(study, copy)
    assert not any(map(acts, cells_of((copy / "measurements.csv").read_text(encoding="utf-8"))))
    assert load_study(copy).fingerprint == study.fingerprint


@pytest.mark.parametrize("name", ["\\t=x", "a\\u001b[2J", "", " a", "a\\nb", "a" * 101, "\\u202e"])
def test_names_that_do_not_show_are_refused(name: str, tmp_path: Path) -> None:
    """A wheel's name stands in tables, plots and columns: it must be seen there as it is."""
    file = hostile_study(tmp_path, "A", "b") / "study.toml"
    file.write_text(file.read_text().replace('"A"', f'"{name}"'))
    with pytest.raises(StudyError, match="the name of a wheel must") as caught:
        load_study(file)
    assert str(caught.value).isprintable()


def test_tables_of_commands_hold_no_formulas(small_result: Result, tmp_path: Path) -> None:
    """Names of wheels and of result folders in the tables of predictions and comparisons."""
    name = "=cmd|' /C calc'!A0"
    wheel = tmp_path / "=1+1.toml"
    wheel.write_text('radius = "100 mm"\nwidth = "80 mm"\n')
    forecast(small_result, slips=[0.2], wheels=[str(wheel)]).save(tmp_path / "p")
    with undrawn():
        compare({name: small_result, "@b": small_result}).save(tmp_path / "c")
    tables = [path for folder in ("p", "c") for path in (tmp_path / folder).glob("*.csv")]
    assert len(tables) == 6
    for path in tables:
        assert not any(map(acts, cells_of(path.read_text(encoding="utf-8")))), path
    assert "=1+1" in set(read_csv(tmp_path / "p" / "bands.csv")["wheel"])
