"""Calibration folders: whole or not at all, resumable task by task, with a safe report."""

import json
import shutil
import sqlite3
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pandas as pd
import pytest

import bayesterra as bt
from bayesterra.__main__ import main
from bayesterra.checking.calibration import CalibrationRequest, Progress, calibrate_study
from bayesterra.checking.ranks import Calibration
from bayesterra.checking.replications import Fit, ShortRuns
from bayesterra.errors import ResultError
from bayesterra.runtime.tasks import TaskStore, finished_tasks

from .conftest import MakeStudy, exact
from .test_tasks import troubled

FILES = {"ranks.csv", "calibration.json", "report.html", "study.toml", "measurements.csv", "SHA256SUMS"}


def stop_at(number: int) -> Callable[[Progress], None]:
    """A watcher that interrupts after some replications."""

    def watch(progress: Progress) -> None:
        if progress.done == number:
            raise KeyboardInterrupt

    return watch


@pytest.fixture
def job(make_study: MakeStudy) -> CalibrationRequest:
    """Thirty replications of one parameter with exact draws."""
    return CalibrationRequest(make_study("phi", title="<script>alert(1)</script>"), 30, seed=5, fit=exact)


def test_an_interrupted_calibration_goes_on_where_it_was(job: CalibrationRequest, tmp_path: Path) -> None:
    """Ctrl-C keeps what is finished; resuming ends with the folder of an undisturbed run."""
    out, part = tmp_path / "out", tmp_path / "out.part"
    with pytest.raises(KeyboardInterrupt):
        calibrate_study(job, out, quiet=True, watch=stop_at(12))
    assert not out.exists()
    assert finished_tasks(part / "checkpoint" / "tasks.sqlite") == 12
    status = json.loads((part / "status.json").read_text())
    assert (status["replications"], status["of"], status["done"]) == (12, 30, 0.4)
    with pytest.raises(
        ResultError, match=r"holds 12 finished replications: add --resume to go on, or --over"
    ):
        calibrate_study(job, out, quiet=True)
    seen: list[int] = []
    calibrate_study(job, out, resume=True, quiet=True, watch=lambda progress: seen.append(progress.done))
    assert seen[0] == 12
    assert {path.name for path in out.iterdir()} == FILES
    assert not part.exists()
    calibrate_study(job, tmp_path / "other", quiet=True)
    tables = [pd.read_csv(tmp_path / name / "ranks.csv").drop(columns="seconds") for name in ("out", "other")]
    pd.testing.assert_frame_equal(tables[0], tables[1])


def test_what_does_not_belong_together_is_not_resumed(
    job: CalibrationRequest, make_study: MakeStudy, tmp_path: Path
) -> None:
    """Another seed or study is refused by name; with --overwrite the old work makes room."""
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        calibrate_study(job, out, quiet=True, watch=stop_at(3))
    with pytest.raises(ResultError, match="was made with seed 5, not 6: give the same, or begin anew"):
        calibrate_study(CalibrationRequest(job.study, 30, seed=6, fit=exact), out, resume=True, quiet=True)
    other = CalibrationRequest(make_study("phi", noise={"drawbar_pull": 2.0}), 30, seed=5, fit=exact)
    with pytest.raises(ResultError, match="was made with another study"):
        calibrate_study(other, out, resume=True, quiet=True)
    assert finished_tasks(tmp_path / "out.part" / "checkpoint" / "tasks.sqlite") == 3
    assert len(calibrate_study(other, out, overwrite=True, quiet=True).table) == 30


def test_two_calibrations_do_not_share_a_folder(job: CalibrationRequest, tmp_path: Path) -> None:
    """While one is at work, a second one of the same folder is refused and takes nothing from it."""
    out, refused = tmp_path / "out", []

    def second(progress: Progress) -> None:
        if progress.done == 5:
            with pytest.raises(ResultError, match=r"'.*out\.part' is being written by another run \(process"):
                calibrate_study(job, out, overwrite=True, quiet=True)
            refused.append(progress.done)

    found = calibrate_study(job, out, quiet=True, watch=second)
    assert refused == [5]
    assert len(found.table) == 30
    assert {path.name for path in out.iterdir()} == FILES


def test_a_result_is_saved_whole_and_escapes_what_is_foreign(job: CalibrationRequest, tmp_path: Path) -> None:
    """All files are there; verdict and thresholds are in the record; titles and notes are text."""
    found = bt.calibrate(job.study, n=40, seed=5, fit=troubled)
    assert isinstance(found, Calibration)
    report = found.save(tmp_path / "out").read_text(encoding="utf-8")
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES
    record = json.loads((tmp_path / "out" / "calibration.json").read_text(encoding="utf-8"))
    assert Calibration.RECORD.read(tmp_path / "out" / Calibration.MARK) == record
    assert (record["verdict"], record["calibrated"]) == ("not established", False)
    assert (record["not_converged"], record["failed"], record["replications"]) == (20, 10, 40)
    assert record["thresholds"] == {
        "level": 0.01,
        "p_value_per_quantity": 0.0025,
        "share_not_converged": 0.05,
    }
    assert record["power"][0]["error"] == "standard deviation 10 % too small"
    assert "<script" not in report
    assert "FloatingPointError: log density is NaN" in report
    assert report.index("not established") < report.index("<h2>Ranks</h2>")
    with pytest.raises(ResultError, match="exists already"):
        found.save(tmp_path / "out")


def test_others_read_the_store_while_it_is_written(tmp_path: Path) -> None:
    """A task is on the disk when ``add`` returns; a second connection sees it."""
    with TaskStore(tmp_path / "tasks.sqlite", {"seed": 1}) as store:
        store.add({1: {"task": 1, "ess": 10.5}})
        assert finished_tasks(tmp_path / "tasks.sqlite") == 1
        store.add({2: {"task": 2, "ess": float("nan")}})
        assert list(store.tasks()) == [1, 2]


@pytest.mark.skipif(sys.platform == "win32", reason="an open file cannot be removed there")
def test_a_store_whose_file_has_gone_takes_nothing(tmp_path: Path) -> None:
    """What is handed over after a removal, or after another file took the name, is not said to be saved."""
    gone = r"tasks.sqlite' was removed or replaced while tasks were being saved in it"
    path = tmp_path / "part" / "tasks.sqlite"
    path.parent.mkdir()
    with TaskStore(path, {"seed": 1}) as store:
        store.add({1: {"rank": 0.5}})
        shutil.rmtree(path.parent)
        with pytest.raises(ResultError, match=gone):
            store.add({2: {"rank": 0.5}})
        path.parent.mkdir()
        with TaskStore(path, {"seed": 1}) as other:
            other.add({1: {"rank": 0.5}})
            with pytest.raises(ResultError, match=gone):
                store.add({3: {"rank": 0.5}})
            assert list(other.tasks()) == [1]


def test_a_damaged_store_is_an_error_not_a_loss(tmp_path: Path) -> None:
    """A file that is no database is named, and left as it is."""
    path = tmp_path / "tasks.sqlite"
    path.write_bytes(b"not a database, but long enough to be read as the head of one" * 20)
    with pytest.raises(ResultError, match=r"tasks.sqlite' is damaged \(file is not a database\)"):
        TaskStore(path, {"seed": 1})
    assert path.stat().st_size > 0
    assert finished_tasks(path) == 0


def test_a_damaged_task_is_made_again(tmp_path: Path) -> None:
    """A flipped digit and a renumbered task are as good as never saved."""
    path = tmp_path / "tasks.sqlite"
    with TaskStore(path, {"seed": 1}) as store:
        store.add({task: {"rank": 0.123} for task in (1, 2, 3)})
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE tasks SET content = replace(content, '0.123', '0.723') WHERE task = 1")
        connection.execute("UPDATE tasks SET task = 7 WHERE task = 2")
    with TaskStore(path, {"seed": 1}) as store:
        assert store.tasks() == {3: {"rank": 0.123}}


def test_a_kill_after_the_last_rename_costs_nothing(job: CalibrationRequest, tmp_path: Path) -> None:
    """The calibration stands whole; a refusal leaves what is left of the work, the next one removes it."""
    out, kept = tmp_path / "out", tmp_path / "kept"
    with pytest.raises(KeyboardInterrupt):
        calibrate_study(job, out, quiet=True, watch=stop_at(30))
    shutil.copytree(tmp_path / "out.part" / "checkpoint", kept)
    calibrate_study(job, out, resume=True, quiet=True)
    shutil.copytree(kept, out / "checkpoint")
    with pytest.raises(ResultError, match="out' exists already"):
        calibrate_study(job, out, resume=True, quiet=True)
    assert {path.name for path in out.iterdir()} == {*FILES, "checkpoint"}
    calibrate_study(job, out, overwrite=True, quiet=True)
    assert {path.name for path in out.iterdir()} == FILES
    assert {path.name for path in tmp_path.iterdir()} == {"out", "kept"}


def test_nothing_is_removed_before_the_folder_has_its_name(
    job: CalibrationRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that fails at the very end costs no replication."""

    def fail(part: Path, folder: Path) -> None:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as patch:
        patch.setattr("bayesterra.runtime.folders._swap", fail)
        with pytest.raises(ResultError, match=r"out\.part' cannot be written: Input/output error"):
            calibrate_study(job, tmp_path / "out", quiet=True)
    assert len(bt.read_tasks(tmp_path / "out")) == 30
    seen: list[int] = []
    calibrate_study(
        job, tmp_path / "out", resume=True, quiet=True, watch=lambda progress: seen.append(progress.done)
    )
    assert seen == [30]
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES


@pytest.mark.parametrize(("fit", "code"), [(exact, 0), (troubled, 3)])
def test_the_exit_code_is_the_verdict(
    fit: Fit,
    code: int,
    job: CalibrationRequest,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """0 where the posterior is calibrated, 3 where it is not or nothing is established."""
    monkeypatch.setattr("bayesterra.study.study.load_study", lambda path: job.study)
    monkeypatch.setattr(ShortRuns, "__call__", lambda self, study, seed: fit(study, seed))
    monkeypatch.chdir(tmp_path)
    assert main(["calibrate", "somewhere", "-n", "40", "--workers", "1", "--seed", "5", "--quiet"]) == code
    assert (tmp_path / f"{tmp_path.name}-calibration" / "report.html").is_file()
    assert ("Posterior calibrated" in capsys.readouterr().out) == (code == 0)


def test_too_few_replications_are_a_mistake(capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 2 and one line."""
    assert main(["calibrate", "studies/hit-wh32", "-n", "5"]) == 2
    assert capsys.readouterr().err == (
        "error: 'n' must be at least 20 replications, better 200 or more (got 5)\n"
    )
