"""The command follow: rows from a file or standard input, tables and a figure at their end."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any

import numpy as np
import pandas as pd
import pytest

import bayesterra as bt
from bayesterra.__main__ import main
from bayesterra.follow import session
from bayesterra.follow import stream as stream_module
from bayesterra.follow.session import FollowedStream
from bayesterra.report.blocks import Text
from bayesterra.runtime.checkpoints import Checkpoints
from bayesterra.study.canonical import write_study
from tests.support.folder import Write

Captured = pytest.CaptureFixture[str]
QUICK = ["--particles", "150"]


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Streams without figures, for tests that are not about them."""
    monkeypatch.setattr(FollowedStream, "figures", lambda following: {})


@pytest.fixture(scope="module")
def folder(script: ModuleType, plan: bt.Study, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study whose file of measurements is missing, as before a drive, and rows of a soil that changes."""
    folder = tmp_path_factory.mktemp("follow")
    write_study(plan, folder)
    (folder / "measurements.csv").unlink()
    soft = {**script.TRUTH, "phi": script.TRUTH["phi"] - np.radians(6.0)}
    before, after = (bt.simulate(plan, truth, seed=9) for truth in (script.TRUTH, soft))
    pd.concat([before[:16], after[16:]]).to_csv(folder / "rows.csv", index=False)
    before[:8].to_csv(folder / "first.csv", index=False)
    before[8:12].to_csv(folder / "second.csv", index=False)
    return folder


def test_follow_prints_a_line_per_row_and_begins_anew_after_an_alarm(
    folder: Path, tmp_path: Path, capsys: Captured
) -> None:
    """The alarm names the row; the tables go on with another soil; exit code 0."""
    out = tmp_path / "s"
    asked = ["--data", str(folder / "rows.csv"), "--out", str(out), "--restart", *QUICK]
    assert main(["follow", str(folder), *asked]) == 0
    printed = capsys.readouterr().out
    assert "  24  slip" in printed
    assert "the soil seems to have changed at row 1" in printed
    assert "begun anew there" in printed
    assert "soil 2 since row 1" in printed
    table = pd.read_csv(out / "updates.csv")
    assert table["row"].tolist() == list(range(1, 25))
    assert table["soil"].iloc[[0, -1]].tolist() == [1, 2]
    assert abs(table["alarm"].dropna().iloc[0] - 17) <= 1
    assert (out / "rows.png").read_bytes().startswith(b"\x89PNG")
    stream = bt.load_stream(out)
    assert stream.offset == table["alarm"].dropna().iloc[0] - 1
    assert main(["follow", str(folder), *asked]) == 2
    assert "add --overwrite" in capsys.readouterr().err


@pytest.mark.usefixtures("undrawn")
def test_a_stream_goes_on_from_its_folder_and_from_standard_input(
    folder: Path, tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two sessions end where one would; a row that cannot be used is left out and said so."""
    first, second, whole = tmp_path / "first", tmp_path / "second", tmp_path / "whole"
    given = ["follow", str(folder), "--quiet", *QUICK]
    assert main([*given, "--data", str(folder / "first.csv"), "--out", str(first)]) == 0
    lines = (folder / "second.csv").read_text().splitlines()
    lines.insert(2, lines[1].replace("0.", "1.", 1))  # a slip above 1
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(lines) + "\n"))
    assert main(["follow", str(first), "--data", "-", "--out", str(second), "--quiet"]) == 0
    captured = capsys.readouterr()
    assert "left out: 'slip' must lie in [0, 1)" in captured.err
    assert "12 rows, 1 left out" in captured.out
    said = "No change of soil was found (at most 0.0001 false alarms per row, on average over the prior)."
    assert said in " ".join(captured.out.split())
    joined = (folder / "first.csv").read_text() + "\n".join((folder / "second.csv").read_text().split("\n")[1:])
    (tmp_path / "joined.csv").write_text(joined)
    assert main([*given, "--data", str(tmp_path / "joined.csv"), "--out", str(whole)]) == 0
    assert np.array_equal(bt.load_stream(second).cloud.x, bt.load_stream(whole).cloud.x)
    assert pd.read_csv(second / "updates.csv")["row"].tolist() == list(range(1, 13))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("slip,load [N]\n", "must hold a header and at least one row"),
        ("slip,load [N],sinkage\n0.1,80,5\n", "column 'sinkage' needs a unit, e.g. 'sinkage [mm]'"),
        ("slip,load [N],sinkage [mm]\n0.1,80\n", "every row must have 3 cells (got 2, row 1)"),
        ("slip,load [N],normal_force [N],sinkage [mm]\n1.1,80,80,5\n", "'slip' must lie in [0, 1) (got 1.1"),
    ],
)
def test_what_cannot_be_followed_is_said_in_one_line(
    folder: Path, tmp_path: Path, capsys: Captured, content: str, message: str
) -> None:
    """Exit code 2, one line on standard error, and no folder."""
    (tmp_path / "rows.csv").write_text(content)
    out = tmp_path / "s"
    assert main(["follow", str(folder), "--data", str(tmp_path / "rows.csv"), "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert message in error
    assert error.count("\n") == 1
    assert not out.exists()


@pytest.mark.usefixtures("undrawn")
def test_what_was_learned_survives_a_broken_file(folder: Path, tmp_path: Path, capsys: Captured) -> None:
    """Rows up to the broken one are written; the error is said."""
    lines = (folder / "first.csv").read_text().splitlines()
    (tmp_path / "rows.csv").write_text("\n".join([*lines[:4], "0.1,80"]) + "\n")
    out = tmp_path / "s"
    given = ["--data", str(tmp_path / "rows.csv"), "--out", str(out), "--quiet", *QUICK]
    assert main(["follow", str(folder), *given]) == 2
    assert "(got 2, row 4)" in capsys.readouterr().err
    assert len(bt.load_stream(out)) == 3


def test_an_interruption_at_any_line_leaves_the_stream_as_before_the_row(plan: bt.Study, folder: Path) -> None:
    """Rows, particles, evidence, detector and table stand together: all with the row, or all without it."""
    stream = bt.Stream(plan, seed=3, particles=150)
    following = FollowedStream(stream)
    table = pd.read_csv(folder / "rows.csv", dtype=str)
    for number in range(9):
        following.take(table.iloc[[number]], restart=False)
    stood, interrupted = _standing(following), 0
    while _interrupted_at(interrupted, lambda: following.take(table.iloc[[9]], restart=False)):
        assert _standing(following) == stood, interrupted
        interrupted += 1
    assert interrupted > 30
    assert len(following.table) == len(following.stream) == 10


def _standing(following: FollowedStream) -> list[object]:
    stream = following.stream
    watch = stream.watch
    numbers = stream.log_evidence, stream.log_evidence_error, watch.candidates.log_statistic, watch.basis
    clouds = stream.cloud.x.tobytes(), stream.cloud.weights.tobytes()
    return [len(stream), stream.rows.digest, *numbers, *clouds, len(following.table), following.soil]


def _interrupted_at(moment: int, work: Callable[[], object]) -> bool:
    """Do some work, but interrupt it at that line of the modules of streams; whether it came so far."""
    lines = 0

    def trace(frame: FrameType, event: str, _: object) -> Callable[..., Any] | None:
        nonlocal lines
        if frame.f_code.co_filename not in (session.__file__, stream_module.__file__):
            return None
        if event == "line":
            lines += 1
            if lines > moment:
                sys.settrace(None)
                raise KeyboardInterrupt
        return trace

    sys.settrace(trace)
    try:
        work()
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(None)
    return False


@pytest.mark.usefixtures("undrawn")
def test_a_kill_as_the_state_begins_leaves_a_folder_to_go_on_in(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder of the particles is known as ours before a file is in it: the next stream may clear it."""
    lines = (folder / "first.csv").read_text().splitlines()
    (tmp_path / "rows.csv").write_text("\n".join(lines[:3]) + "\n")
    out, asked = tmp_path / "s", ["--data", str(tmp_path / "rows.csv"), *QUICK]

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoints, "opened", killed)
        assert main(["follow", str(folder), "--out", str(out), *asked]) == 130
    assert (tmp_path / "s.part" / "state").is_dir()
    assert main(["follow", str(folder), "--out", str(out), *asked]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rows.csv", "s"]


def test_a_model_that_does_not_predict_is_said_to_be_wrong_first(plan: bt.Study, folder: Path) -> None:
    """Counted before it is told that no change was found, which it then cannot mean."""
    stream = bt.Stream(plan, seed=3, particles=150)
    following = FollowedStream(stream)
    table = pd.read_csv(folder / "rows.csv", dtype=str)
    for number in range(6):
        following.take(table.iloc[[number]], restart=False)
    outside, of = following.misses
    places = [float(str(row[name])) for row in following.table for name in row if name.endswith("_pit")]
    assert (outside, of) == (sum(not 0.05 <= place <= 0.95 for place in places), len(places))
    assert outside < 0.4 * of
    assert not any(isinstance(block, Text) and block.tone for block in following.overview())
    for row in following.table:
        row |= {name: 0.999 for name in row if name.endswith("_pit")}
    told = [block for block in following.overview() if isinstance(block, Text)]
    assert told[0].tone == "bad"
    assert told[0].text == (
        f"The model does not predict these rows: {of} of {of} readings lie outside the 90 % bands expected of them."
        " It is wrong for them, or the noise is stated too small."
    )
    assert "by a model that does not predict that says nothing" in told[-1].text


FORCES = "slip,normal_force [N],sinkage [mm],drawbar_pull [N]\n0.1,40,4.0,9.0\n0.3,160,15,32\n"


@pytest.mark.parametrize(
    ("head", "key", "taken"),
    [
        ('model = "M2"\ndrive = "both"', "load_range", False),
        pytest.param('model = "M2"\ndrive = "both"', "load_range", True, marks=pytest.mark.slow),
        ('model = "M2L"', "mean_load", True),
    ],
)
def test_what_a_study_leaves_to_its_table_comes_from_all_of_it(head: str, key: str, taken: bool, write: Write) -> None:
    """Not from the first row; where the table is missing the key is asked for."""
    table = FORCES if "both" in head else FORCES.replace("normal_force", "load")
    path = write(('title = "Small study"', head), ("sinkage =", 'normal_force = "1 N"\nsinkage ='), table=table)
    rows = pd.read_csv(path.parent / "measurements.csv", dtype=str)
    stream, whole = session.begin(path, rows.iloc[[0]]).stream, bt.load_study(path)
    assert (stream.study.load_range, stream.study.model) == (whole.load_range, whole.model)
    bare = rows.iloc[[0]].drop(columns=rows.columns[1]) if key == "load_range" else rows.iloc[[0]]
    following = session.begin(path.parent, bare)
    assert following.stream.study.model == whole.model
    assert not taken or following.take(bare, restart=False).update is not None
    (path.parent / "measurements.csv").unlink()
    with pytest.raises(bt.StudyError, match=rf"^'{key}' must be given to follow rows, as no whole table tells it"):
        session.begin(path, rows.iloc[[0]])


@pytest.mark.usefixtures("undrawn")
def test_rows_have_the_numbers_of_their_file_and_a_restart_is_not_forgotten(
    folder: Path, tmp_path: Path, capsys: Captured
) -> None:
    """Rows that are passed over count; a stream that went on after an alarm does not say that none was."""
    (header, first, *rest) = (folder / "rows.csv").read_text().splitlines()
    cells = zip(header.split(","), first.split(","), strict=True)
    passed = ",".join("0" if name == "use" else cell for name, cell in cells)
    bad = first.replace("0.", "1.", 1)
    (tmp_path / "rows.csv").write_text("\n".join([header, passed, passed, first, bad, *rest[:-1]]) + "\n")
    (tmp_path / "last.csv").write_text("\n".join([header, rest[-1]]) + "\n")
    out = tmp_path / "s"
    asked = ["--out", str(out), "--restart", "--overwrite"]
    assert main(["follow", str(folder), "--data", str(tmp_path / "rows.csv"), *asked, *QUICK]) == 0
    printed = capsys.readouterr()
    assert "row 2) (row 4 of the file)" in printed.err
    since = int(pd.read_csv(out / "updates.csv")["alarm"].dropna().iloc[0])
    assert f"begin anew from row {since} (row {since + 3} of the file); begun anew there" in printed.out
    assert "slip on the radius 'shearing', sinkage from 'rim'" in " ".join(printed.out.split())
    assert main(["follow", str(out), "--data", str(tmp_path / "last.csv"), *asked]) == 0
    printed = capsys.readouterr()
    assert f"soil 2 since row {since}" in printed.out
    assert "No change of soil was found" not in printed.out
