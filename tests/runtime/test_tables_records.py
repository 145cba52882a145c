"""Records of folders: a format number on each, old ones read, others refused by name."""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayesterra.analysis.result import RunRecord, read_result
from bayesterra.analysis.run import load_result
from bayesterra.checking.ranks import Calibration
from bayesterra.errors import ResultError, StudyError
from bayesterra.runtime.netcdf import read_drawn
from bayesterra.runtime.tables import csv_text, read_csv
from bayesterra.study.result import Result

OLDER = Path(__file__).parents[1] / "analysis" / "older"
STUDIES = Path(__file__).parents[2] / "studies"


def edited(folder: Path, **entries: object) -> Path:
    """The older folder with other entries in its record."""
    shutil.copytree(OLDER, folder)
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    (folder / "run.json").write_text(json.dumps({**record, **entries}), encoding="utf-8")
    return folder


def test_tables_read_back_to_the_last_digit(tmp_path: Path) -> None:
    """Numbers of every size, with every pandas that is allowed."""
    rng = np.random.default_rng(1)
    values = rng.standard_normal(20_000) * 10.0 ** rng.integers(-30, 30, 20_000)
    (tmp_path / "values.csv").write_text(csv_text(pd.DataFrame({"value": values})), encoding="utf-8")
    assert np.array_equal(read_csv(tmp_path / "values.csv")["value"], values)


def test_a_record_begins_with_its_format(small_result: Result, tmp_path: Path) -> None:
    """The number stands first; reading and writing again keep it there, once."""
    RunRecord.write(tmp_path / "run.json", small_result.to_record())
    read = RunRecord.read(tmp_path / "run.json")
    assert next(iter(read)) == "format"
    assert read["format"] == RunRecord.FORMAT == 1
    RunRecord.write(tmp_path / "again.json", read)
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "run.json").read_bytes()


def test_a_record_without_a_number_has_the_first_format() -> None:
    """Folders of before there were numbers, of a run and of calibrations, are read."""
    assert "format" not in json.loads((OLDER / "run.json").read_text(encoding="utf-8"))
    assert read_result(OLDER).record["seed"] == 1
    stored = list(STUDIES.glob("calibration/*/calibration.json"))
    assert stored
    assert all(Calibration.RECORD.read(path)["verdict"] for path in stored)


@pytest.mark.parametrize("number", [2, "two", None])
def test_another_format_is_refused_by_name(number: object, tmp_path: Path) -> None:
    """Whoever reads the folder says its format and the one that can be read, and not that it is damaged."""
    folder = edited(tmp_path / "out", format=number)
    said = rf"^'.*out/run\.json' has format {number!r}, and this version of bayesterra reads format 1"
    with pytest.raises(ResultError, match=said):
        load_result(folder)
    with pytest.raises(StudyError, match=said):
        read_drawn(folder)


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        ({"loo": {}}, r"run\.json: loo lacks 'rows'"),
        ({"seed": True}, r"run\.json: seed is of the wrong kind \(got True\)"),
        ({"notes": {}}, r"run\.json: notes is of the wrong kind \(got {}\)"),
        ({"fits": {"IM9": {}}}, r"run\.json: fits: IM9: .* is of the wrong kind \(got 'IM9'\)"),
        ({"mode": {"log_density": 1e301, "agreeing_starts": 1}}, r"mode: log_density is of the wrong kind"),
        ({"loo": {"rows": [], "full": [1.0], "pit": {}}}, r"loo must have as many rows as densities"),
    ],
)
def test_a_spoilt_entry_is_named(entries: dict[str, object], said: str, tmp_path: Path) -> None:
    """Place and kind of the first entry that cannot be relied on."""
    with pytest.raises(ResultError, match=f"is damaged: .*{said}"):
        load_result(edited(tmp_path / "out", **entries))
