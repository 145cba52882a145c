"""The stored page of one table in many forms: made again, and as `check` prints it."""

from pathlib import Path
from types import ModuleType

import pandas as pd
import pytest
from scripts import STUDIES, loaded
from table_forms import TableForm, table_forms, text_of
from typer.testing import CliRunner

from bayesterra.cli import app

STORED = STUDIES / "tables"


@pytest.fixture(scope="module")
def run() -> ModuleType:
    """The script of the study."""
    return loaded(STORED / "run.py")


@pytest.fixture(scope="module")
def made(run: ModuleType) -> pd.DataFrame:
    """Its table, today."""
    table: pd.DataFrame = run.forms()
    return table


def test_the_stored_page_is_what_is_made_today(made: pd.DataFrame, run: ModuleType) -> None:
    """Every form, what is said of it, and the README."""
    stored = pd.read_csv(STORED / "forms.csv")
    pd.testing.assert_frame_equal(stored, made, check_exact=False, atol=1e-15, check_dtype=False)
    text = (STORED / "README.md").read_text(encoding="utf-8")
    assert run.filled(text, {"forms": run.block(made)}) == text


def test_forty_forms_give_the_same_numbers(made: pd.DataFrame) -> None:
    """To the last digits; what is open is refused with a way out."""
    taken = made[made["taken"]]
    assert len(taken) >= 40
    assert taken["furthest"].max() <= 1e-15
    refused = made[~made["taken"]]
    assert len(refused) >= 14
    assert [form.name for form in table_forms() if form.asks] == refused["form"].tolist()


def test_a_number_that_differs_is_noticed(run: ModuleType, tmp_path: Path) -> None:
    """In its last digits, or missing."""
    content = text_of().replace("20.125", "20.12500000001").encode()
    assert run.said(TableForm("changed", content), tmp_path)[1] == pytest.approx(5e-13, rel=0.01)
    assert run.said(TableForm("missing", text_of().replace("20.125", "").encode()), tmp_path)[1] == float("inf")


@pytest.mark.parametrize(
    "name", ["letters of the paper", "semicolons, decimal commas, sep=", "1.234 between semicolons"]
)
def test_check_prints_it(name: str, made: pd.DataFrame, run: ModuleType, tmp_path: Path) -> None:
    """Form and columns on standard output, an error with exit code 2."""
    form: TableForm = next(each for each in table_forms() if each.name == name)
    result = CliRunner().invoke(app, ["check", str(run.study_of(form, tmp_path))], env={"COLUMNS": "300"})
    words = made.set_index("form")["says"][name]
    if form.asks:
        assert words.removeprefix("table.csv: ") in str(result.exception)
        return
    assert result.exit_code == 0
    assert f"({words.split(';')[0]})" in result.stdout
    for column in words.split("; ")[1:]:
        header, _, rest = column.removeprefix("`").partition("` is ")
        line = next(line for line in result.stdout.splitlines() if f" {header} " in line)
        assert rest.split(", in ")[0] in line
