"""Files that are no files, files elsewhere, and files that say they hold more than any memory does."""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

import h5py
import numpy as np
import pytest

from bayesterra.__main__ import main
from bayesterra.analysis.run import load_result
from bayesterra.checking.calibration import CalibrationRequest, calibrate_study
from bayesterra.errors import BayesterraError, ResultError, StudyError
from bayesterra.prediction.rover import read_rover
from bayesterra.runtime.checkpoints import Checkpoints
from bayesterra.runtime.folders import whole_folder, write_text
from bayesterra.runtime.netcdf import read_drawn
from bayesterra.runtime.ownership import WORK
from bayesterra.study.observations import read_table
from bayesterra.study.study import load_soil_test, load_study
from bayesterra.study.wheels import read_wheel

from . import targets

Captured = pytest.CaptureFixture[str]
MB = 2**20


@contextmanager
def in_time(seconds: int = 100) -> Iterator[None]:
    """Fail where something waits for what never comes."""

    def late(*_: object) -> None:
        raise targets.FailureError("it hangs")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@contextmanager
def in_memory(most: int) -> Iterator[None]:
    """Fail where more than ``most`` bytes are taken at a time."""
    tracemalloc.start()
    try:
        yield
        taken = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert taken < most, f"{taken / MB:.0f} MB"


def special(path: Path, kind: str) -> None:
    """Put something at a path that is no ordinary file."""
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "loop":
        path.symlink_to(path)
    elif kind == "nowhere":
        path.symlink_to(path.with_name("nowhere"))
    else:
        path.symlink_to(kind)


def small_study(folder: Path) -> Path:
    """The sound study of the seeds."""
    for name, content in zip(("study.toml", "measurements.csv"), parts("study"), strict=True):
        (folder / name).write_bytes(content)
    return folder


def parts(target: str, name: str = "sound") -> list[bytes]:
    """The files of a sound input."""
    return (targets.SEEDS / target / name).read_bytes().split(targets.BREAK)


READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "study": ("study.toml", lambda path: load_study(path.parent)),
    "table": ("measurements.csv", lambda path: load_study(path.parent)),
    "table alone": ("x.csv", read_table),
    "soil test": ("soiltest.toml", lambda path: load_soil_test(path.parent)),
    "wheel": ("wheel.toml", read_wheel),
    "rover": ("rover.toml", lambda path: read_rover(path, {}, 0.5)),
}


@pytest.mark.parametrize("kind", ["pipe", "folder", "loop", "nowhere", "/dev/zero", "/dev/stdin", "/proc/self/mem"])
@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_file_is_refused(reader: str, kind: str, tmp_path: Path) -> None:
    """Pipes, devices and links in a circle in place of files that people write."""
    small_study(tmp_path)
    name, read = READERS[reader]
    (tmp_path / name).unlink(missing_ok=True)
    special(tmp_path / name, kind)
    with in_time(), in_memory(50 * MB), pytest.raises(StudyError) as caught:
        read(tmp_path / name)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("kind", ["pipe", "folder", "loop", "/dev/zero"])
@pytest.mark.parametrize("name", ["run.json", "draws.nc", "summary.csv", "study.toml"])
def test_result_folders_of_no_files_are_refused(base: targets.Base, name: str, kind: str, tmp_path: Path) -> None:
    """The same in a result folder, whoever reads it."""
    folder = tmp_path / "r"
    shutil.copytree(base.folder, folder)
    (folder / name).unlink()
    special(folder / name, kind)
    for read in (load_result, read_drawn):
        if read is load_result or name in ("run.json", "draws.nc"):
            with in_time(), in_memory(100 * MB), pytest.raises(BayesterraError):
                read(folder)


@pytest.mark.parametrize(
    "file", ["../../../../etc/passwd", "/etc/passwd", "/dev/zero", ".", "", "a" * 5000, "a\\u0000b"]
)
def test_tables_elsewhere_are_read_as_tables_or_refused(file: str, tmp_path: Path) -> None:
    """Whatever file a study names, it is a table of measurements or the study is refused in a short line."""
    small_study(tmp_path)
    study = tmp_path / "study.toml"
    study.write_text(study.read_text().replace("measurements.csv", file))
    with in_time(), pytest.raises(StudyError) as caught:
        load_study(study)
    assert len(str(caught.value)) < 1600


def test_large_files_are_refused_unread(tmp_path: Path) -> None:
    """By their size: a sparse file of a terabyte costs nothing to make."""
    small_study(tmp_path)
    for name, words in (("measurements.csv", "larger than 32 MB"), ("study.toml", "larger than 4 MB")):
        with (tmp_path / name).open("wb") as file:
            file.truncate(2**40)
        with in_memory(10 * MB), pytest.raises(StudyError, match=words):
            load_study(tmp_path)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("a," * 2_000_000, "at most 1000 columns"),
        ("a\n" * 200_002, "at most 200000 rows"),
        ('"' + "a" * 2_000_000, "field larger than field limit"),
        ("a\n" + "b" * 20_000, "at most 10000 characters"),
        ("\x00" * 100_000, "at most 10000 characters"),
    ],
)
def test_tables_beyond_all_measure_are_refused(content: str, words: str, tmp_path: Path) -> None:
    """Columns, rows and cells have limits that no table of measurements reaches."""
    (tmp_path / "x.csv").write_text(content, encoding="utf-8")
    with in_time(), in_memory(300 * MB), pytest.raises(StudyError, match=words):
        read_table(tmp_path / "x.csv")


@pytest.mark.parametrize("opened", ["[", "{a=", "[[a"])
def test_deep_nesting_is_refused(opened: str, tmp_path: Path) -> None:
    """In TOML of all forms, and in JSON."""
    closed = f"[{'a.' * 100_000}a]" if opened == "[[a" else ""
    deep = closed or f"x = {opened * 100_000}"
    (tmp_path / "study.toml").write_text(deep)
    with in_time(), pytest.raises(StudyError, match=r"nested too deeply|must be TOML"):
        load_study(tmp_path)
    (tmp_path / "begun.json").write_text("[" * 100_000)
    assert Checkpoints.opened(tmp_path, {"seed": 1}).notes == ()


def test_absurd_sizes_in_draws_are_refused(base: targets.Base, tmp_path: Path) -> None:
    """A file of a few kilobytes that declares 10¹² draws, as variable, as coordinate and in its chunks."""
    for spoil in (_huge_variable, _huge_coordinate, _huge_chunks):
        folder = tmp_path / spoil.__name__
        shutil.copytree(base.folder, folder)
        with h5py.File(folder / "draws.nc", "a") as file:
            spoil(file["posterior"])
        for read in (load_result, read_drawn):
            with in_time(), in_memory(300 * MB), pytest.raises(BayesterraError, match="its size cannot hold"):
                read(folder)


def _huge_variable(group: h5py.Group) -> None:
    del group["c"]
    group.create_dataset("c", shape=(10**6, 10**6), dtype="f8", chunks=(1000, 1000))


def _huge_coordinate(group: h5py.Group) -> None:
    del group["draw"]
    group.create_dataset("draw", shape=(10**12,), dtype="i8", chunks=(1000,))


def _huge_chunks(group: h5py.Group) -> None:
    del group["c"]
    group.create_dataset("c", shape=(4, 120), maxshape=(None, None), dtype="f8", chunks=(2**14, 2**14))


@pytest.mark.parametrize("way", ["outer file", "virtual", "external link", "soft link", "object", "filter"])
def test_draws_that_are_elsewhere_are_refused(base: targets.Base, way: str, tmp_path: Path) -> None:
    """HDF5 may name other files, devices or programs in place of values; none of ours does."""
    folder = tmp_path / "r"
    shutil.copytree(base.folder, folder)
    with h5py.File(folder / "draws.nc", "a") as file:
        group = file["posterior"]
        del group["c"]
        if way == "outer file":
            group.create_dataset("c", shape=(4, 120), dtype="f8", external=[("/etc/passwd", 0, 4 * 120 * 8)])
        elif way == "virtual":
            layout = h5py.VirtualLayout(shape=(4, 120), dtype="f8")
            layout[:] = h5py.VirtualSource("/etc/passwd", "x", shape=(4, 120))
            group.create_virtual_dataset("c", layout)
        elif way == "object":
            group.create_dataset("c", data=np.array([file.ref] * 4, dtype=h5py.ref_dtype))
        elif way == "filter":
            group.create_dataset("c", data=np.zeros((4, 120)), chunks=(4, 120), scaleoffset=3)
        else:
            link = h5py.ExternalLink("/etc/passwd", "/x") if way == "external link" else h5py.SoftLink("/prior/c")
            group["c"] = link
    with in_time(), pytest.raises(ResultError, match=r"is damaged: 'c' (is a link|has its|asks|holds neither)"):
        load_result(folder)


def test_segments_that_unpack_to_more_are_damaged(tmp_path: Path) -> None:
    """A segment is as large as what it holds: a packed gigabyte of zeros, or a declared terabyte, is none."""
    bomb, declared = BytesIO(), BytesIO()
    header = BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    with ZipFile(bomb, "w", ZIP_DEFLATED) as packed, packed.open("x.npy", "w") as inner:
        inner.write(
            b"\x93NUMPY\x01\x00v\x00"
            + b"{'descr': '<f8', 'fortran_order': False, 'shape': (12500000,)}".ljust(117)
            + b"\n"
        )
        for _ in range(100):
            inner.write(bytes(MB))
    with ZipFile(declared, "w") as packed:
        packed.writestr("x.npy", header.getvalue())
    for content in (bomb.getvalue(), declared.getvalue()):
        whole = b'{"run": "x", "segment": "s"}\n' + content
        (tmp_path / "s.segment").write_bytes(sha256(whole).hexdigest().encode() + b"\n" + whole)
        with in_time(), in_memory(20 * MB):
            assert Checkpoints(tmp_path, "x").load("s") is None


def test_nothing_is_written_through_links(tmp_path: Path) -> None:
    """Links planted where a run will write lead it nowhere: what they point to stays as it is."""
    precious, out = tmp_path / "precious", tmp_path / "out"
    precious.mkdir()
    (precious / "thesis.tex").write_text("mine")
    part = tmp_path / "out.part"
    for place in (part, part / "checkpoint"):
        place.parent.mkdir(exist_ok=True)
        place.symlink_to(precious)
        with pytest.raises(ResultError, match="is a link to another folder"), whole_folder(out, resume=True):
            pass
        place.unlink()
    part.mkdir(exist_ok=True)
    (part / "checkpoint").mkdir()
    (part / "checkpoint" / "lock").symlink_to(precious / "thesis.tex")
    with pytest.raises(ResultError, match="was not made by bayesterra"), whole_folder(out, resume=True):
        pass
    (part / "checkpoint" / "a.segment").touch()
    for name in ("checkpoint/lock", "checkpoint/begun.json.new", "run.json.new", "run.json", "old"):
        (part / name).unlink(missing_ok=True)
        (part / name).symlink_to(precious / "thesis.tex")
        with (
            pytest.raises(ResultError, match=rf"{name}' was not written by bayesterra"),
            whole_folder(out, resume=True),
        ):
            pass
        assert (part / name).is_symlink()
        (part / name).unlink()
    with whole_folder(out, resume=True) as inner:
        (inner / "checkpoint" / "begun.json.new").symlink_to(precious / "thesis.tex")
        (inner / "run.json.new").symlink_to(precious / "thesis.tex")
        Checkpoints.opened(inner / "checkpoint", {"seed": 1})
        write_text(inner / "run.json", "{}")
    assert (precious / "thesis.tex").read_text() == "mine"
    assert os.listdir(precious) == ["thesis.tex"]
    assert not (out / "run.json").is_symlink()


def test_finished_tasks_are_not_written_through_links(tmp_path: Path) -> None:
    """A task that is a link elsewhere gives way to one of ours; what it led to stays as it is."""
    work, other = tmp_path / "work", tmp_path / "other"
    for folder in (work, other):
        folder.mkdir()
    Checkpoints.opened(other, {"seed": 2}, "replications").add({1: {"rank": 0.5}})
    before = (other / "task-1.segment").read_bytes()
    store = Checkpoints.opened(work, {"seed": 1}, "replications")
    (work / "task-1.segment").symlink_to(other / "task-1.segment")
    with pytest.raises(ResultError, match="was begun with another study, seed or version"):
        store.tasks()
    store.add({1: {"rank": 0.25}})
    assert store.tasks() == {1: {"rank": 0.25}}
    assert (other / "task-1.segment").read_bytes() == before


def test_absurd_inputs_on_the_command_line(base: targets.Base, tmp_path: Path) -> None:
    """With four gigabytes of memory in all, every command ends with 2 and one line, and leaves nothing."""
    small_study(tmp_path)
    bad = tmp_path / "bad.toml"
    bad.write_text((tmp_path / "study.toml").read_text().replace('"157.35 mm"', '"' + "9" * 400 + ' mm"'))
    result = tmp_path / "r"
    shutil.copytree(base.folder, result)
    (result / "run.json").write_text("[" * 100_000)
    asked = [
        ["check", str(bad)], ["fit", "/dev/zero"], ["simulate", str(tmp_path / ("a" * 5000))],
        ["calibrate", str(bad), "-n", "100"], ["identify", str(result)], ["design", str(result)],
        ["soiltest", "/dev/zero"], ["follow", str(tmp_path), "--data", "/dev/zero"],
    ]  # fmt: skip
    work = tmp_path / "work"
    work.mkdir()
    code = (
        "import json, sys\nfrom bayesterra.__main__ import main\n"
        "for asked in json.load(sys.stdin):\n    print(main(asked), flush=True)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=work, input=json.dumps(asked), capture_output=True, text=True,
        timeout=900, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (4096 * MB, 4096 * MB)),
    )  # fmt: skip
    assert done.stdout.split() == ["2"] * len(asked), done.stdout + done.stderr
    lines = done.stderr.splitlines()
    assert len(lines) == len(asked), done.stderr
    assert all(line.startswith("error: ") and len(line) < 1600 for line in lines)
    assert list(work.iterdir()) == []


def test_a_bug_is_a_line_and_a_file(monkeypatch: pytest.MonkeyPatch, capsys: Captured, tmp_path: Path) -> None:
    """What nobody foresaw ends with 1, one line, and a file with all about it; never with a traceback."""

    def broken(path: object, **options: object) -> None:
        raise KeyError("lost")

    monkeypatch.setattr("bayesterra.study.study.load_study", broken)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert main(["check", "x"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    (log,) = tmp_path.iterdir()
    assert line == f"error: this is a bug in bayesterra (KeyError): please report it with {log}"
    assert "KeyError: 'lost'" in log.read_text()


def test_calibrations_of_others_are_refused(tmp_path: Path) -> None:
    """Tasks of the right study that are no outcomes: a line, not a traceback."""
    study = load_study(small_study(tmp_path))
    job = CalibrationRequest(study, 20)
    part = tmp_path / "out.part" / WORK
    part.mkdir(parents=True)
    from bayesterra.checking.calibration import _made_with

    store = Checkpoints.opened(part, _made_with(job), "replications")
    store.add({1: {"task": 1, "status": "excellent", "ess": 1, "r_hat": 1, "seconds": 1}})
    with pytest.raises(ResultError, match="is damaged: no outcome of a replication"):
        calibrate_study(job, tmp_path / "out", resume=True, quiet=True)
