"""The command identify: folders, messages, exit codes and what stands on the terminal."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest

import bayesterra as bt
from bayesterra.__main__ import main
from bayesterra.errors import ResultError
from bayesterra.identifiability.analysis import Identified, identify_into
from bayesterra.report.terminal import show
from bayesterra.report.verdicts import Failures
from bayesterra.study.canonical import write_study

from .conftest import VARIANTS, trial
from .test_analysis_identify import TABLES

pytestmark = pytest.mark.usefixtures("little_adaptation")

Captured = pytest.CaptureFixture[str]
FILES = {Identified.MARK, "SHA256SUMS", "report.html", *(f"{name}.csv" for name in TABLES)}


def strict(path: Path) -> Any:
    """JSON without NaN and infinities."""

    def refuse(word: str) -> float:
        raise AssertionError(f"{word} is no JSON")

    return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """A study folder with one free parameter."""
    folder = tmp_path / "soil"
    folder.mkdir()
    write_study(trial("phi"), folder)
    return folder


def test_a_result_is_identified_into_a_whole_folder(
    pair_folder: Path, tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The default name is the result's without -result; exit code 0; all files, and the finding printed."""
    monkeypatch.chdir(tmp_path)
    assert main(["identify", str(pair_folder), "--quiet"]) == 0
    printed = capsys.readouterr()
    out = tmp_path / "pair-identifiability"
    assert {path.name for path in out.iterdir()} == FILES
    assert {path.name for path in tmp_path.iterdir()} == {out.name}
    record = strict(out / Identified.MARK)
    assert Identified.RECORD.read(out / Identified.MARK) == record
    assert record["sentence"] in printed.out
    assert "Report: pair-identifiability/report.html" in printed.out
    assert printed.err == ""
    assert pd.read_csv(out / "verdicts.csv")["parameter"].tolist() == ["c", "phi"]


@pytest.mark.usefixtures("plain_page")
def test_a_study_is_sampled_first(study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A study's own folder gives the name; the record says where the draws are from."""
    monkeypatch.chdir(tmp_path)
    code = main(["identify", str(study / "study.toml"), "--quiet", "--seed", "5"])
    record = strict(tmp_path / "soil-identifiability" / Identified.MARK)
    assert (record["draws_from"], record["seed"]) == ("here", 5)
    assert code == (0 if record["converged"] else 3)


@pytest.fixture
def plain_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """A page of one line, for tests that are not about it."""
    page = SimpleNamespace(html=lambda: "page\n", failures=Failures())
    monkeypatch.setattr("bayesterra.identifiability.page.identifiability_page", lambda made: page)


@pytest.mark.usefixtures("plain_page")
def test_a_folder_is_only_replaced_when_asked(
    pair_folder: Path, moduli: Identified, tmp_path: Path, capsys: Captured
) -> None:
    """An older analysis with --overwrite; a folder of another kind never."""
    out = tmp_path / "out"
    made = moduli
    made.save(out)
    (out / "note.txt").write_text("old")
    assert main(["identify", str(pair_folder), "--out", str(out), "--quiet"]) == 2
    assert "add --overwrite to replace it" in capsys.readouterr().err
    with pytest.raises(ResultError, match=r"note\.txt' was not written by bayesterra and is left alone"):
        made.save(out, overwrite=True)
    (out / "note.txt").unlink()
    (out / "report.html").write_text("old")
    made.save(out, overwrite=True)
    assert (out / "report.html").read_text(encoding="utf-8") != "old"
    other = tmp_path / "other"
    shutil.copytree(pair_folder, other)
    with pytest.raises(ResultError, match=r"is not a folder with identifiability\.json"):
        made.save(other, overwrite=True)
    assert (other / "draws.nc").is_file()


def test_a_page_that_fails_leaves_no_folder(
    moduli: Identified, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tables are written before the page; without it none of them stays."""

    def fail(made: Identified) -> str:
        raise ResultError("no ink")

    monkeypatch.setattr("bayesterra.identifiability.page.identifiability_page", fail)
    with pytest.raises(ResultError, match="no ink"):
        moduli.save(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("plain_pictures")
def test_draws_that_did_not_converge_end_with_3(pair_folder: Path, tmp_path: Path, capsys: Captured) -> None:
    """The folder is written, and terminal and page warn."""
    poor = tmp_path / "poor-result"
    shutil.copytree(pair_folder, poor)
    record = json.loads((poor / "run.json").read_text(encoding="utf-8"))
    record["verdict"]["converged"] = False
    (poor / "run.json").write_text(json.dumps(record), encoding="utf-8")
    (poor / "SHA256SUMS").unlink()
    assert main(["identify", str(poor), "--out", str(tmp_path / "out"), "--quiet"]) == 3
    assert "! The sampling did not converge" in capsys.readouterr().out
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert page.index("<b>not converge</b>") < page.index("Independent directions")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "'nowhere' is neither a study nor a result: no such file or folder"),
        (["empty"], "'empty' is neither a study nor a result: neither run.json nor study.toml in it"),
        (["nowhere", "--prior-only"], "nowhere: no such study file"),
        (["empty", "--prior-only", "--out", "x"], "--prior-only prints and writes nothing"),
        (["fixed"], "every parameter is fixed"),
        (["fixed", "--prior-only"], "every parameter is fixed"),
        (["damaged"], "'damaged' is not a complete result folder"),
    ],
)
def test_mistakes_are_one_line_and_write_nothing(
    arguments: list[str], message: str, tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is neither a study nor a result, or has nothing free, ends with 2 and one line."""
    monkeypatch.chdir(tmp_path)
    for name in ("empty", "fixed", "damaged"):
        (tmp_path / name).mkdir()
    write_study(trial(), tmp_path / "fixed")
    (tmp_path / "damaged" / "run.json").write_text("{}")
    assert main(["identify", *arguments]) == 2
    printed = capsys.readouterr()
    assert message in printed.err
    assert printed.err.count("\n") == 1
    assert printed.out == ""
    assert {path.name for path in tmp_path.iterdir()} == {"empty", "fixed", "damaged"}


def test_a_design_that_cannot_determine_something_says_why(
    tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before any reading: which parameters, and what would help; nothing is written."""
    monkeypatch.chdir(tmp_path)
    write_study(VARIANTS["one slip"](), tmp_path)
    (tmp_path / "measurements.csv").write_text("wheel,slip,load [N]\nA,0.3,80\n")
    before = set(tmp_path.iterdir())
    assert main(["identify", "study.toml", "--prior-only"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum("NOT determine it" in line for line in lines) == 2
    assert any(line.startswith("Only n0 + 0.3 n1 is determined") for line in lines)
    assert set(tmp_path.iterdir()) == before


def test_no_row_on_the_terminal_is_broken(
    moduli: Identified, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On 80 columns every parameter has one line with its symbol, verdict and profile's class."""
    monkeypatch.setenv("COLUMNS", "80")
    table = moduli.found.verdicts.assign(profile="bounded only by the prior")
    show(replace(moduli, found=replace(moduli.found, verdicts=table)).overview())
    lines = capsys.readouterr().out.splitlines()
    (row,) = (line for line in lines if line.strip().startswith("k_c"))
    assert row.split()[:4] == ["k_c", "structurally", "not", "determined"]
    assert row.split()[-1] == "prior-bound"
    assert not any("…" in line for line in lines)


def test_parts_are_named_as_they_begin(pair_folder: Path) -> None:
    """From Python the same work, with a word on every part."""
    parts: list[str] = []
    bt.identify(bt.load_result(pair_folder), progress=parts.append)
    assert parts[0] == "profiles"
    assert {"coupling", "information", "structure"} <= set(parts)


def test_a_bad_target_is_refused_before_the_work(pair_folder: Path, tmp_path: Path) -> None:
    """A folder that is in the way is noticed at once."""
    (tmp_path / "out").mkdir()
    with pytest.raises(ResultError, match="exists already"):
        identify_into(bt.load_result(pair_folder), tmp_path / "out", quiet=True)


@pytest.mark.usefixtures("plain_page")
def test_saved_numbers_are_those_of_the_analysis(moduli: Identified, tmp_path: Path) -> None:
    """Every table reads back with its columns; six digits are kept."""
    moduli.save(tmp_path / "out")
    read = pd.read_csv(tmp_path / "out" / "verdicts.csv")
    pd.testing.assert_series_equal(read["contraction"], moduli.verdicts["contraction"], rtol=1e-5)
