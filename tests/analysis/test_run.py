"""A run into a folder: what stands in it, what a poller sees on the way, what a failure leaves."""

import json
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bayesterra.analysis.run import load_result, run_prior_study, run_study
from bayesterra.errors import ResultError, SupportError
from bayesterra.runtime.checkpoints import CheckpointStore
from bayesterra.sampling.sampler import Progress
from bayesterra.stats.diagnostics import Diagnosis
from bayesterra.study.result import Result
from bayesterra.study.study import Study
from tests.support.pages import plain_pages
from tests.support.thinned import thinned

FILES = {
    "report.html", "draws.nc", "summary.csv", "least_squares.csv", "identifiability.csv", "predictive.csv",
    "run.json", "study.toml", "measurements.csv", "SHA256SUMS",
}  # fmt: skip


def diagnosis(ess: float, r_hat: float) -> Diagnosis:
    """A diagnosis of one parameter."""
    one = np.ones(1)
    return Diagnosis(("phi",), ess * one, ess * one, r_hat * one, 5 * one, 0.5, 200, ())


@pytest.fixture(scope="module")
def small_result(small_result: Result) -> Result:
    """Few draws of the small result: they are written and read by almost every test."""
    return replace(small_result, draws=thinned(small_result.draws))


@pytest.fixture
def plain_report() -> Iterator[None]:
    """A report of one line, for tests that are not about it."""
    with plain_pages():
        yield


@pytest.fixture
def quick(small_result: Result, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Runs that report their progress and hand over the small result at once; the seeds asked for."""
    seeds: list[Any] = []

    def run(
        study: Study, *, seed: int, report: Callable[[Progress], None], checkpoint_store: CheckpointStore, **_: Any
    ) -> Result:
        seeds.append(seed)
        report(Progress("adapting", 0.0))
        report(Progress("sampling", 0.4, diagnosis(40.0, 1.02), 12.5))
        return small_result

    monkeypatch.setattr("bayesterra.analysis.inference.run", run)
    return seeds


@pytest.mark.usefixtures("plain_report")
def test_a_run_ends_with_a_whole_folder(quick: list[int], small_result: Result, tmp_path: Path) -> None:
    """All promised files and nothing else; the folder reads back as the result; the seed is passed on."""
    result = run_study(small_result.study, out=tmp_path / "out", seed=5, quiet=True)
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES
    assert {path.name for path in tmp_path.iterdir()} == {"out"}
    assert quick == [5]
    again = load_result(tmp_path / "out")
    np.testing.assert_array_equal(again.values(), result.values())
    assert again.converged == result.converged


@pytest.mark.usefixtures("plain_report")
def test_a_poller_sees_complete_status_files(
    small_result: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At every moment of a run status.json is strict JSON with stage, share done and, later, figures."""
    status, seen = tmp_path / "out.part" / "status.json", []

    def refuse(word: str) -> float:
        raise AssertionError(f"{word} is no JSON")

    def run(
        study: Study, *, seed: int, report: Callable[[Progress], None], checkpoint_store: CheckpointStore, **_: Any
    ) -> Result:
        for progress in (
            Progress("adapting", 0.0),
            Progress("sampling", 0.0, diagnosis(np.nan, np.nan), np.inf),
            Progress("sampling", 0.5, diagnosis(50.0, 1.1), 3.0),
        ):
            report(progress)
            seen.append(json.loads(status.read_text(encoding="utf-8"), parse_constant=refuse))
        assert not (tmp_path / "out").exists()
        return small_result

    monkeypatch.setattr("bayesterra.analysis.inference.run", run)
    run_study(small_result.study, out=tmp_path / "out", quiet=True)
    assert [s["stage"] for s in seen] == ["adapting", "sampling", "sampling"]
    assert seen[1]["r_hat"] is None
    assert datetime.fromisoformat(seen[2].pop("time")).utcoffset() == timedelta(0)
    assert seen[2] == {
        "stage": "sampling", "steps": 200, "done": 0.5, "seconds_left": 3.0, "ess": 50.0, "r_hat": 1.1,
        "pid": os.getpid(),
    }  # fmt: skip
    assert not (tmp_path / "out" / "status.json").exists()


@pytest.mark.usefixtures("plain_report")
def test_an_existing_result_is_not_touched_without_leave(
    quick: list[int], small_result: Result, tmp_path: Path
) -> None:
    """The error comes before any sampling; with --overwrite the new result takes the place."""
    out = tmp_path / "out"
    run_study(small_result.study, out=out, quiet=True)
    (out / "run.json").write_text("{}", encoding="utf-8")
    with pytest.raises(ResultError, match="exists already: add --overwrite"):
        run_study(small_result.study, out=out, quiet=True)
    assert (out / "run.json").read_text(encoding="utf-8") == "{}"
    assert len(quick) == 1
    run_study(small_result.study, out=out, overwrite=True, quiet=True)
    assert load_result(out).converged == small_result.converged


def test_a_run_without_support_leaves_no_folder(
    small_result: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """When the prior turns out to have no support, nothing is left behind, not even the beginnings."""

    def run(
        study: Study, *, seed: int, report: Callable[[Progress], None], checkpoint_store: CheckpointStore, **_: Any
    ) -> Result:
        report(Progress("adapting", 0.0))
        raise SupportError("no parameter set fits")

    monkeypatch.setattr("bayesterra.analysis.inference.run", run)
    with pytest.raises(SupportError, match="no parameter set fits"):
        run_study(small_result.study, out=tmp_path / "out", quiet=True)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("plain_report")
def test_saving_a_loaded_result_gives_the_same_folder(quick: list[int], small_result: Result, tmp_path: Path) -> None:
    """A result saved, read and saved again has the same tables, record and study, byte for byte."""
    run_study(small_result.study, out=tmp_path / "a", quiet=True)
    report = load_result(tmp_path / "a").save(tmp_path / "b")
    assert report == tmp_path / "b" / "report.html"
    for name in FILES - {"draws.nc", "SHA256SUMS"}:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name
    with pytest.raises(ResultError, match="exists already"):
        load_result(tmp_path / "a").save(tmp_path / "b")


SEGMENT = {"a": np.arange(3.0)}


@pytest.fixture
def stopped(quick: list[int], small_result: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where a run was to go that saved a segment and was interrupted."""

    def run(study: Study, *, checkpoint_store: CheckpointStore, **_: Any) -> Result:
        checkpoint_store.save("round-0001", SEGMENT)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("bayesterra.analysis.inference.run", run)
        with pytest.raises(KeyboardInterrupt, match=r"^$"):
            run_study(small_result.study, out=tmp_path / "out", seed=1)
    return tmp_path / "out"


@pytest.mark.usefixtures("plain_report")
def test_an_unfinished_run_is_not_lost_silently(stopped: Path, quick: list[int], small_result: Result) -> None:
    """Without a word on it a run refuses, naming both ways out; so does all that would take its place."""
    for attempt in (
        lambda: run_study(small_result.study, out=stopped),
        lambda: run_prior_study(small_result.study, out=stopped),
        lambda: small_result.save(stopped),
    ):
        with pytest.raises(ResultError, match="unfinished run: add --resume to go on, or --overwrite to"):
            attempt()
    assert quick == []
    assert (stopped.with_name("out.part") / "checkpoint" / "round-0001.segment").exists()
    run_study(small_result.study, out=stopped, overwrite=True, quiet=True)
    assert {path.name for path in stopped.parent.iterdir()} == {"out"}


@pytest.mark.usefixtures("plain_report")
def test_a_resumed_run_gets_what_was_saved(
    stopped: Path, small_result: Result, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is given the segment, says so on standard error, and ends with the files of any other run."""
    given = []

    def run(study: Study, *, checkpoint_store: CheckpointStore, **_: Any) -> Result:
        given.append(checkpoint_store.load("round-0001"))
        return small_result

    monkeypatch.setattr("bayesterra.analysis.inference.run", run)
    run_study(small_result.study, out=stopped, resume=True)
    np.testing.assert_equal(given, [SEGMENT])
    assert capsys.readouterr().err.strip() == "note: going on from 1 saved segment"  # older rich ends with a line more
    assert {path.name for path in stopped.iterdir()} == FILES


def test_a_run_of_another_seed_is_refused(stopped: Path, quick: list[int], small_result: Result) -> None:
    """The line says with which seed the run was begun; what was saved stays."""
    with pytest.raises(ResultError, match=r"out.part.* was begun with seed 1, not 2; add --overwrite"):
        run_study(small_result.study, out=stopped, seed=2, resume=True)
    assert quick == []
    assert (stopped.with_name("out.part") / "checkpoint" / "round-0001.segment").exists()


def test_an_error_after_the_sampling_keeps_what_was_saved(
    small_result: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk at the end of a long run costs nothing but the writing."""

    def run(study: Study, *, checkpoint_store: CheckpointStore, **_: Any) -> Result:
        checkpoint_store.save("round-0001", SEGMENT)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("bayesterra.analysis.inference.run", run)
    with pytest.raises(ResultError, match="cannot be written: No space left on device"):
        run_study(small_result.study, out=tmp_path / "out", quiet=True)
    assert (tmp_path / "out.part" / "checkpoint" / "round-0001.segment").exists()


@pytest.mark.usefixtures("plain_report")
def test_resuming_a_run_that_had_ended_reads_its_result(quick: list[int], small_result: Result, tmp_path: Path) -> None:
    """A kill after the last rename costs nothing; the result of another seed is not taken for it."""
    out = tmp_path / "out"
    run_study(small_result.study, out=out, seed=1, resume=True, quiet=True)
    (out / "checkpoint").mkdir()
    (out / "checkpoint" / "round-0001.segment").write_text("not yet removed", encoding="utf-8")
    again = run_study(small_result.study, out=out, seed=1, resume=True, quiet=True)
    assert quick == [1]
    assert {path.name for path in out.iterdir()} == FILES
    np.testing.assert_array_equal(again.values(), small_result.values())
    with pytest.raises(ResultError, match="exists already: add --overwrite"):
        run_study(small_result.study, out=out, seed=2, resume=True, quiet=True)
