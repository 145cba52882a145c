"""Calibration folders: whole or not at all, resumable task by task, with a safe report."""

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

import bayesterra as bt
from bayesterra.__main__ import main
from bayesterra.checking.calibration import CalibrationRequest, Progress, calibrate_study
from bayesterra.checking.ranks import Calibration
from bayesterra.checking.short_runs import Fit, ShortRuns
from bayesterra.errors import ResultError
from bayesterra.runtime.checkpoints import Checkpoints, finished_tasks

from .conftest import MakeStudy, exact
from .test_calibration_replications import troubled

FILES = {"ranks.csv", "calibration.json", "report.html", "study.toml", "measurements.csv", "SHA256SUMS"}


def stop_at(number: int) -> Callable[[Progress], None]:
    """A watcher that interrupts after some replications."""

    def watch(progress: Progress) -> None:
        if progress.done == number:
            raise KeyboardInterrupt

    return watch


@pytest.fixture
def job(make_small: MakeStudy) -> CalibrationRequest:
    """Thirty replications of one parameter with exact draws."""
    return CalibrationRequest(make_small("phi", title="<script>alert(1)</script>"), 30, seed=5, fit=exact)


def test_an_interrupted_calibration_goes_on_where_it_was(job: CalibrationRequest, tmp_path: Path) -> None:
    """Ctrl-C keeps what is finished; resuming ends with the folder of an undisturbed run."""
    out, part = tmp_path / "out", tmp_path / "out.part"
    with pytest.raises(KeyboardInterrupt):
        calibrate_study(job, out, quiet=True, watch=stop_at(12))
    assert not out.exists()
    assert finished_tasks(part / "checkpoint") == 12
    status = json.loads((part / "status.json").read_text())
    assert (status["stage"], status["steps"], status["done"]) == ("calibrating", 12, 0.4)
    with pytest.raises(ResultError, match=r"holds 12 finished replications: add --resume to go on, or --over"):
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
    job: CalibrationRequest, make_small: MakeStudy, tmp_path: Path
) -> None:
    """Another seed or study is refused by name; with --overwrite the old work makes room."""
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        calibrate_study(job, out, quiet=True, watch=stop_at(3))
    with pytest.raises(ResultError, match="was begun with seed 5, not 6; add --overwrite in place of"):
        calibrate_study(CalibrationRequest(job.study, 30, seed=6, fit=exact), out, resume=True, quiet=True)
    other = CalibrationRequest(make_small("phi", noise={"drawbar_pull": 2.0}), 30, seed=5, fit=exact)
    with pytest.raises(ResultError, match="was begun with another study"):
        calibrate_study(other, out, resume=True, quiet=True)
    assert finished_tasks(tmp_path / "out.part" / "checkpoint") == 3
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
    assert record["thresholds"] == {"level": 0.01, "p_value_per_quantity": 0.0025, "share_not_converged": 0.05}
    assert record["power"][0]["error"] == "standard deviation 10 % too small"
    assert "<script" not in report
    assert "FloatingPointError: log density is NaN" in report
    assert report.index("not established") < report.index("<h2>Ranks</h2>")
    with pytest.raises(ResultError, match="exists already"):
        found.save(tmp_path / "out")


def test_others_read_the_store_while_it_is_written(tmp_path: Path) -> None:
    """A task is on the disk when ``add`` returns; a second reader sees it."""
    store = Checkpoints.opened(tmp_path, {"seed": 1}, "replications")
    store.add({1: {"task": 1, "ess": 10.5}})
    assert finished_tasks(tmp_path) == 1
    store.add({2: {"task": 2, "ess": float("nan")}, 10: {"task": 10}})
    assert list(store.tasks()) == [1, 2, 10]
    assert list(bt.read_tasks(tmp_path)["ess"])[:1] == [10.5]


@pytest.mark.skipif(sys.platform == "win32", reason="an open folder cannot be removed there")
def test_a_store_whose_folder_has_gone_takes_nothing(tmp_path: Path) -> None:
    """What is handed over after a removal, or after another folder took the name, is not said to be saved."""
    gone = r"part' was removed or replaced while work was being saved in it"
    path = tmp_path / "part"
    path.mkdir()
    store = Checkpoints.opened(path, {"seed": 1}, "replications")
    store.add({1: {"rank": 0.5}})
    shutil.rmtree(path)
    with pytest.raises(ResultError, match=gone):
        store.add({2: {"rank": 0.5}})
    path.mkdir()
    other = Checkpoints.opened(path, {"seed": 1}, "replications")
    other.add({1: {"rank": 0.5}})
    with pytest.raises(ResultError, match=gone):
        store.add({3: {"rank": 0.5}})
    assert list(other.tasks()) == [1]


def test_a_store_of_an_older_version_is_an_error_not_a_loss(tmp_path: Path) -> None:
    """Its file is named, and left as it is."""
    path = tmp_path / "checkpoint" / "tasks.sqlite"
    path.parent.mkdir()
    path.write_bytes(b"SQLite format 3")
    for place in (tmp_path, path.parent):
        with pytest.raises(ResultError, match=r"tasks\.sqlite' was written by an older version: read it"):
            bt.read_tasks(place)
    assert path.read_bytes() == b"SQLite format 3"
    assert finished_tasks(path.parent) == 0


def test_a_damaged_task_is_made_again(tmp_path: Path) -> None:
    """A flipped digit is as good as never saved, and makes room; a renumbered task is refused."""
    store = Checkpoints.opened(tmp_path, {"seed": 1}, "replications")
    store.add({task: {"rank": 0.123} for task in (1, 2, 3)})
    path = tmp_path / "task-1.segment"
    path.write_bytes(path.read_bytes().replace(b"0.123", b"0.723"))
    (tmp_path / "task-2.segment").unlink()
    assert store.tasks() == {3: {"rank": 0.123}}
    store.add({1: {"rank": 0.5}})  # damaged while the store is open
    assert store.tasks() == {1: {"rank": 0.5}, 3: {"rank": 0.123}}
    path.write_bytes(path.read_bytes().replace(b"0.5", b"0.7"))
    again = Checkpoints.opened(tmp_path, {"seed": 1}, "replications")
    assert again.notes[0] == "the saved segment 'task-1.segment' is damaged and is made again"
    again.add({1: {"rank": 0.25}})  # and while nobody has it open
    assert Checkpoints.opened(tmp_path, {"seed": 1}, "replications").tasks() == {
        1: {"rank": 0.25}, 3: {"rank": 0.123}
    }  # fmt: skip
    (tmp_path / "task-3.segment").rename(tmp_path / "task-7.segment")
    with pytest.raises(ResultError, match="was begun with another study, seed or version"):
        again.tasks()


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
    calibrate_study(job, tmp_path / "out", resume=True, quiet=True, watch=lambda progress: seen.append(progress.done))
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
    assert capsys.readouterr().err == ("error: 'n' must be at least 20 replications, better 200 or more (got 5)\n")
