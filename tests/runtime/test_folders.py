"""Folders that appear whole or not at all."""

import json
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from hashlib import sha256
from pathlib import Path

import pytest

from bayesterra.errors import ResultError, SupportError
from bayesterra.runtime.checkpoints import Checkpoints
from bayesterra.runtime.folders import check_free, part_of, tidy, whole_folder, write_text
from bayesterra.runtime.ownership import locked
from bayesterra.runtime.reading import check_sums
from bayesterra.runtime.status import Status, job_folder


def result_folder(path: Path) -> Path:
    """A folder that looks like an old result."""
    path.mkdir()
    (path / "run.json").write_text("old", encoding="utf-8")
    return path


def names(path: Path) -> set[str]:
    """Names of all files and folders in a folder."""
    return {entry.name for entry in path.iterdir()}


def fail(folder: Path, error: BaseException, *, overwrite: bool = False) -> None:
    """Begin to make a folder and fail."""
    with whole_folder(folder, overwrite=overwrite) as part:
        write_text(part / "status.json", "{}")
        raise error


def make(folder: Path) -> None:
    """Make a new result in place of an old one."""
    with whole_folder(folder, overwrite=True) as part:
        write_text(part / "run.json", "new")


def test_the_folder_appears_when_all_is_done(tmp_path: Path) -> None:
    """Work goes on in DIR.part; DIR does not exist before the end, and DIR.part not after it."""
    with whole_folder(tmp_path / "out") as part:
        assert part == tmp_path / "out.part"
        write_text(part / "a.txt", "a")
        assert names(tmp_path) == {"out.part"}
    assert names(tmp_path) == {"out"}
    assert (tmp_path / "out" / "a.txt").read_text(encoding="utf-8") == "a"


@pytest.mark.parametrize(
    ("error", "seen"), [(SupportError("no"), SupportError), (OSError(28, "No space left"), ResultError)]
)
def test_a_failed_run_leaves_nothing(error: Exception, seen: type[Exception], tmp_path: Path) -> None:
    """An error of the input or of the disk leaves neither a result nor its beginnings."""
    with pytest.raises(seen, match=r"^no$|cannot be written: No space left"):
        fail(tmp_path / "out", error)
    assert names(tmp_path) == set()


def test_an_interrupted_run_leaves_its_part(tmp_path: Path) -> None:
    """Ctrl-C leaves DIR.part and no DIR."""
    with pytest.raises(KeyboardInterrupt, match=r"^$"):
        fail(tmp_path / "out", KeyboardInterrupt())
    assert names(tmp_path) == {"out.part"}


def test_an_existing_folder_asks_for_overwrite(tmp_path: Path) -> None:
    """Without leave nothing is replaced, before any work is done."""
    result_folder(tmp_path / "out")
    with pytest.raises(ResultError, match="exists already: add --overwrite"):
        check_free(tmp_path / "out", overwrite=False)
    assert (tmp_path / "out" / "run.json").read_text(encoding="utf-8") == "old"


def test_overwrite_keeps_the_old_result_until_the_new_one_stands(tmp_path: Path) -> None:
    """While the new result is made, and after a failure, the old one is there whole."""
    old = result_folder(tmp_path / "out")
    with pytest.raises(SupportError, match=r"^no$"):
        fail(old, SupportError("no"), overwrite=True)
    assert names(tmp_path) == {"out"}
    assert (old / "run.json").read_text(encoding="utf-8") == "old"
    with whole_folder(old, overwrite=True) as part:
        write_text(part / "run.json", "new")
        assert (old / "run.json").read_text(encoding="utf-8") == "old"
    assert names(tmp_path) == {"out"}
    assert (old / "run.json").read_text(encoding="utf-8") == "new"


def test_the_old_result_comes_back_when_the_new_one_cannot_take_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If the last rename fails, the old result has its name and its content again."""
    old, rename = result_folder(tmp_path / "out"), Path.rename
    monkeypatch.setattr("bayesterra.runtime.folders._exchanged", lambda one, other: False)

    def refuse(path: Path, target: Path) -> Path:
        if path.name == "out.part":
            raise OSError(5, "Input/output error")
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", refuse)
    with pytest.raises(ResultError, match=r"cannot be written: Input/output error"):
        make(old)
    assert names(tmp_path) == {"out"}
    assert (old / "run.json").read_text(encoding="utf-8") == "old"


def test_overwrite_spares_what_lies_beside(tmp_path: Path) -> None:
    """A folder that a user keeps as out.old is not in the way and not removed."""
    old = result_folder(tmp_path / "out")
    result_folder(tmp_path / "out.old")
    with whole_folder(old, overwrite=True) as part:
        write_text(part / "run.json", "new")
    assert names(tmp_path) == {"out", "out.old"}
    assert (tmp_path / "out.old" / "run.json").read_text(encoding="utf-8") == "old"


def test_overwrite_replaces_results_only(tmp_path: Path) -> None:
    """A folder with other things in it is never replaced; an empty one may be."""
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("years of work", encoding="utf-8")
    with pytest.raises(ResultError, match="is not a result folder: it is not replaced"):
        check_free(tmp_path / "thesis", overwrite=True)
    (tmp_path / "empty").mkdir()
    check_free(tmp_path / "empty", overwrite=True)


def test_impossible_places_are_said(tmp_path: Path) -> None:
    """A file in the way and a missing parent are named."""
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(ResultError, match="file' is a file"):
        check_free(tmp_path / "file", overwrite=True)
    with pytest.raises(ResultError, match=r"the folder '.*nowhere' does not exist"):
        check_free(tmp_path / "nowhere" / "out", overwrite=False)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission_is_said(tmp_path: Path) -> None:
    """A parent that may not be written to is named."""
    tmp_path.chmod(0o500)
    with pytest.raises(ResultError, match="no permission to write"):
        check_free(tmp_path / "out", overwrite=False)


def test_remains_of_an_earlier_run_do_not_mix_in(tmp_path: Path) -> None:
    """A new run starts from an empty DIR.part, whatever a killed one had begun to write there."""

    def begin() -> None:
        with whole_folder(tmp_path / "out") as part:
            (part / "state").mkdir()
            for name in ("stale.csv", "state/stale.txt"):
                write_text(part / name, "half")
            (part / "stale.csv.new").write_text("a quarter", encoding="utf-8")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        begin()
    assert names(tmp_path / "out.part") == {"checkpoint", "state", "stale.csv", "stale.csv.new"}
    with whole_folder(tmp_path / "out") as part:
        write_text(part / "a.txt", "a")
        assert names(part) == {"checkpoint", "a.txt"}
    assert names(tmp_path / "out") == {"a.txt", "SHA256SUMS"}


def test_a_text_file_is_replaced_at_once(tmp_path: Path) -> None:
    """A reader finds the old text or the new one; a temporary file never stays."""
    path = tmp_path / "status.json"
    write_text(path, "old")
    with path.open(encoding="utf-8") as reader:
        write_text(path, "new")
        assert reader.read() == "old"
    assert path.read_text(encoding="utf-8") == "new"
    assert names(tmp_path) == {"status.json"}


def test_two_runs_do_not_write_into_one_folder(tmp_path: Path) -> None:
    """The second is refused with the first one's process, even if it may overwrite, and leaves no trace."""
    with whole_folder(tmp_path / "out") as part:
        write_text(part / "run.json", "a")
        for overwrite, resume in ((False, False), (True, False), (False, True)):
            with (
                pytest.raises(ResultError, match=rf"being written by another run \(process {os.getpid()}\)"),
                whole_folder(tmp_path / "out", overwrite=overwrite, resume=resume),
            ):
                pass
        assert (part / "run.json").read_text(encoding="utf-8") == "a"
    assert names(tmp_path / "out") == {"run.json", "SHA256SUMS"}
    with whole_folder(tmp_path / "out", overwrite=True) as part:  # the lock went with the first one
        write_text(part / "run.json", "b")


def test_a_result_that_appeared_meanwhile_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where another run ends between the check and the lock, its result stays."""

    def late(path: Path, place: str) -> AbstractContextManager[Callable[[], bool]]:
        result_folder(tmp_path / "out")
        return locked(path, place)

    monkeypatch.setattr("bayesterra.runtime.ownership.locked", late)
    with pytest.raises(ResultError, match="exists already"), whole_folder(tmp_path / "out"):
        pass
    assert names(tmp_path) == {"out"}


def test_resuming_keeps_segments_only(tmp_path: Path) -> None:
    """What else a killed run left, half a table say, does not come into the result."""
    work = tmp_path / "out.part" / "checkpoint"
    work.mkdir(parents=True)
    (work / "round-0001.segment").write_text("saved", encoding="utf-8")
    (work.parent / "summary.csv").write_text("half", encoding="utf-8")
    with whole_folder(tmp_path / "out", resume=True) as part:
        assert (part / "checkpoint" / "round-0001.segment").read_text(encoding="utf-8") == "saved"
        assert names(part) == {"checkpoint"}
        write_text(part / "run.json", "new")
    assert names(tmp_path / "out") == {"run.json", "SHA256SUMS"}


def test_what_a_kill_in_the_last_moment_leaves_is_cleared(tmp_path: Path) -> None:
    """An old result that was being removed when its run was killed goes with the next one that is whole."""
    result_folder(tmp_path / ".out.removed-12345")
    result_folder(tmp_path / ".outer.removed-12345")
    with whole_folder(tmp_path / "out") as part:
        write_text(part / "run.json", "new")
    assert names(tmp_path) == {"out", ".outer.removed-12345"}


def test_an_old_result_that_had_stepped_aside_comes_back(tmp_path: Path) -> None:
    """A kill between the two renames, where the system cannot do both at once, loses no old result."""
    result_folder(tmp_path / ".out.replaced-12345")
    with pytest.raises(ResultError, match="out' exists already"), whole_folder(tmp_path / "out"):
        pass
    assert names(tmp_path) == {"out"}
    assert (tmp_path / "out" / "run.json").read_text(encoding="utf-8") == "old"
    make(tmp_path / "out")
    assert (tmp_path / "out" / "run.json").read_text(encoding="utf-8") == "new"
    assert names(tmp_path) == {"out"}


def test_a_folder_that_another_run_took_is_left_to_it(tmp_path: Path) -> None:
    """Removed from under a run and begun anew by another one, DIR.part is neither finished nor removed."""
    part = tmp_path / "out.part"

    def lose() -> None:
        with whole_folder(tmp_path / "out"):
            shutil.rmtree(part)
            part.mkdir()
            write_text(part / "a.txt", "of the other run")

    with pytest.raises(ResultError, match=r"out\.part' was removed or taken by another run while"):
        lose()
    assert names(tmp_path) == {"out.part"}
    assert names(part) == {"a.txt"}


def test_a_finished_folder_carries_checksums(tmp_path: Path) -> None:
    """They are those of sha256sum, of all files at any depth but those that only served the making."""
    with whole_folder(tmp_path / "out") as part:
        write_text(part / "run.json", "new")
        (part / "state").mkdir()
        write_text(part / "state" / "a b.txt", "deep")
    digests = {name: sha256(text).hexdigest() for name, text in ((1, b"new"), (2, b"deep"))}
    lines = (tmp_path / "out" / "SHA256SUMS").read_text(encoding="utf-8").splitlines()
    assert lines == [f"{digests[1]}  run.json", f"{digests[2]}  state/a b.txt"]
    check_sums(tmp_path / "out", "run.json", "state/a b.txt", "never there")


def test_a_file_that_is_not_as_it_was_written_is_named(tmp_path: Path) -> None:
    """Changed, missing, unreadable or unlisted: an error each; without checksums nothing is known."""
    out = tmp_path / "out"
    make(out)
    write_text(out / "more.txt", "later")
    with pytest.raises(ResultError, match=r"out/more\.txt' is damaged or was changed \(see its checksum in"):
        check_sums(out, "run.json", "more.txt")
    (out / "run.json").unlink()
    with pytest.raises(ResultError, match=r"out/run\.json' is missing"):
        check_sums(out, "run.json")
    (out / "run.json").mkdir()
    with pytest.raises(ResultError, match=r"out/run\.json' cannot be read: Is a directory"):
        check_sums(out, "run.json")
    (out / "SHA256SUMS").unlink()
    check_sums(out, "run.json")
    (out / "SHA256SUMS").mkdir()
    with pytest.raises(ResultError, match=r"out/SHA256SUMS' cannot be read: Is a directory"):
        check_sums(out, "run.json")


def everything(folder: Path) -> dict[str, str]:
    """Content of all files below a folder, and the targets of its links."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        found[name] = os.readlink(path) if path.is_symlink() else path.read_text() if path.is_file() else ""
    return found


def killed(folder: Path, *, overwrite: bool = False) -> Path:
    """Begin a folder with one saved segment and leave it as a kill would; returns the segment."""

    def begin() -> None:
        with whole_folder(folder, overwrite=overwrite) as part:
            Checkpoints.opened(part / "checkpoint", {"seed": 1}).save("one", {})
            write_text(part / "run.json", "half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        begin()
    return part_of(folder) / "checkpoint" / "one.segment"


def refused(folder: Path, message: str) -> None:
    """All ways to make a folder are refused, and nothing changes."""
    before = everything(folder.parent)
    for overwrite, resume in ((False, False), (True, False), (False, True), (True, True)):
        with pytest.raises(ResultError, match=message), whole_folder(folder, overwrite=overwrite, resume=resume):
            pass
        assert everything(folder.parent) == before


@pytest.mark.parametrize("name", ["out.part/notes.txt", "out.part/checkpoint/notes.txt", "out.part"])
def test_a_users_own_part_is_never_touched(name: str, tmp_path: Path) -> None:
    """A folder or file of that name which lacks the mark is neither removed, replaced nor written into."""
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / name).write_text("mine")
    refused(tmp_path / "out", r"out\.part' was not made by bayesterra and is left alone: move it away, or give")


def test_an_empty_part_of_a_user_is_not_taken(tmp_path: Path) -> None:
    """Not even that."""
    (tmp_path / "out.part").mkdir()
    refused(tmp_path / "out", r"out\.part' was not made by bayesterra")


@pytest.mark.parametrize(
    "name", ["notes.txt", "checkpoint/notes.txt", "figures/notes.txt", "run.json.bak", "summary.csv", "report.html"]
)
def test_a_users_file_in_an_unfinished_folder_is_never_touched(name: str, tmp_path: Path) -> None:
    """It is named in one line; the segments stay too. Once it is away all goes on."""
    segment = killed(tmp_path / "out")
    (segment.parents[1] / name).parent.mkdir(exist_ok=True)
    (segment.parents[1] / name).write_text("mine")
    refused(tmp_path / "out", "out.part/.*' was not written by bayesterra and is left alone: move it away")
    shutil.move(segment.parents[1] / name, tmp_path / "elsewhere")
    shutil.rmtree(segment.parents[1] / "figures", ignore_errors=True)
    with whole_folder(tmp_path / "out", resume=True) as part:
        assert segment.exists()
        assert names(part) == {"checkpoint"}


@pytest.mark.parametrize("name", ["notes.txt", "checkpoint/notes.txt", "state/notes.txt", "plan.csv"])
def test_a_users_file_in_a_finished_folder_is_never_touched(name: str, tmp_path: Path) -> None:
    """What the checksums do not list is not replaced, whatever its name, nor is a folder named checkpoint."""
    make(tmp_path / "out")
    (tmp_path / "out" / name).parent.mkdir(exist_ok=True)
    (tmp_path / "out" / name).write_text("mine")
    refused(tmp_path / "out", r"was not written by bayesterra and is left alone|exists already: add --overwrite")
    with pytest.raises(ResultError, match="was not written by bayesterra"):
        make(tmp_path / "out")


def test_a_users_file_that_comes_while_a_folder_is_made_is_kept(tmp_path: Path) -> None:
    """In the folder in the making it stays, also after an error; in the old one it goes over into the new."""
    make(tmp_path / "out")
    with whole_folder(tmp_path / "out", overwrite=True) as part:
        write_text(part / "run.json", "newer")
        (part / "a.txt").write_text("mine")
        (tmp_path / "out" / "b.txt").write_text("mine")
    assert names(tmp_path / "out") == {"run.json", "SHA256SUMS", "a.txt", "b.txt"}
    assert (tmp_path / "out" / "SHA256SUMS").read_text().split()[1::2] == ["run.json"]

    def lose() -> None:
        with whole_folder(tmp_path / "other") as part:
            write_text(part / "run.json", "new")
            (part / "a.txt").write_text("mine")
            raise SupportError("no")

    with pytest.raises(SupportError, match=r"^no$"):
        lose()
    assert everything(tmp_path / "other.part").keys() == {"a.txt", "checkpoint", "checkpoint/made.txt"}


def test_users_folders_with_hidden_names_are_never_touched(tmp_path: Path) -> None:
    """Not even those that are named as if a killed run had left them."""
    for name in (".out.removed-7", ".out.removed-mine", ".out.replaced-7", ".out.begun-0"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "notes.txt").write_text("mine")
    before = everything(tmp_path)
    make(tmp_path / "out")
    make(tmp_path / "out")
    shutil.rmtree(tmp_path / "out")
    assert everything(tmp_path) == before


@pytest.mark.parametrize("left", ["lock", "begun.json", "one.segment"])
def test_folders_without_the_mark_are_known_by_what_older_versions_left(left: str, tmp_path: Path) -> None:
    """What was saved before there was a mark can be resumed."""
    segment = killed(tmp_path / "out")
    for path in list(segment.parent.iterdir()):
        if path.name not in (left, "one.segment"):
            path.unlink()
    with whole_folder(tmp_path / "out", resume=True):
        assert segment.exists()


def test_a_refusal_after_two_kills_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A kill before the last tidying, then one of a run over it: what that saved is gone on with."""
    with monkeypatch.context() as patch:
        patch.setattr("bayesterra.runtime.folders.tidy", lambda place: None)
        make(tmp_path / "out")
    assert (tmp_path / "out" / "checkpoint").is_dir()
    with monkeypatch.context() as patch:
        patch.setattr("bayesterra.runtime.folders.clear_up", lambda place: None)
        segment = killed(tmp_path / "out", overwrite=True)
    before = everything(tmp_path)
    for resume in (False, True):
        with (
            pytest.raises(ResultError, match="exists already: add --overwrite"),
            whole_folder(tmp_path / "out", resume=resume),
        ):
            pass
    assert everything(tmp_path) == before
    with whole_folder(tmp_path / "out", resume=True, overwrite=True) as part:
        assert segment.exists()
        write_text(part / "run.json", "newer")
    assert everything(tmp_path).keys() == {"out", "out/run.json", "out/SHA256SUMS"}


def test_an_old_folder_under_the_name_of_the_new_one_is_cleared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A kill just after two folders changed names: the next run knows the old one, and removes no other."""
    make(tmp_path / "out")
    with monkeypatch.context() as patch:
        patch.setattr("bayesterra.runtime.folders._discard", lambda old, place: None)
        make(tmp_path / "out")
    assert names(tmp_path) == {"out", "out.part"}
    tidy(tmp_path / "out")
    assert (tmp_path / "out" / "checkpoint").exists()
    shutil.copytree(tmp_path, tmp_path.with_name("copy"))
    make(tmp_path / "out")
    assert names(tmp_path) == {"out"}
    with pytest.raises(ResultError, match=r"out\.part' was not made by bayesterra"):
        make(tmp_path.with_name("copy") / "out")
    shutil.rmtree(tmp_path.with_name("copy"))


@pytest.mark.parametrize("begun", [True, False])
def test_a_folder_that_is_a_link_is_written_where_it_leads(begun: bool, tmp_path: Path) -> None:
    """The link stays; its target is the old folder, then the new one; nothing is left beside either."""
    (tmp_path / "disk").mkdir()
    (tmp_path / "here").mkdir()
    if begun:
        make(tmp_path / "disk" / "result")
    (tmp_path / "here" / "out").symlink_to(Path("..") / "disk" / "result")
    with whole_folder(tmp_path / "here" / "out", overwrite=begun) as part:
        assert part == tmp_path / "disk" / "result.part"
        write_text(part / "run.json", "newer")
    assert names(tmp_path / "here") == {"out"}
    assert (tmp_path / "here" / "out").is_symlink()
    assert names(tmp_path / "disk") == {"result"}
    assert (tmp_path / "disk" / "result" / "run.json").read_text() == "newer"
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(ResultError, match="loop' is a link that leads back to itself"):
        make(tmp_path / "loop")


def test_places_without_a_name_are_refused_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The working directory is neither replaced as a result nor taken for one."""
    make(tmp_path / "out")
    monkeypatch.chdir(tmp_path / "out")
    assert part_of(Path()) == tmp_path / "out.part"
    for name, message in ((".", "is the working directory: leave it first"), ("..", "is not a result folder")):
        with pytest.raises(ResultError, match=message):
            make(Path(name))
    with pytest.raises(ResultError, match="'/' is not a result folder"):
        make(Path("/"))


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="Linux")
def test_a_place_where_nothing_can_be_made_is_said(tmp_path: Path) -> None:
    """In /proc even root cannot make a folder, and is told so at once."""
    with pytest.raises(ResultError, match=r"cannot be (written|made)"):
        make(Path("/proc/nothing"))


def test_what_another_command_saved_is_not_removed(tmp_path: Path) -> None:
    """Finished tasks are not lost to a run of that name, nor segments to a calibration, nor what is older."""
    segment = killed(tmp_path / "out")
    before = everything(tmp_path)
    for resume in (False, True):
        with (
            pytest.raises(ResultError, match="holds an unfinished run of another command"),
            whole_folder(tmp_path / "out", resume=resume, kind="replications"),
        ):
            pass
    assert everything(tmp_path) == before
    begun = segment.with_name("begun.json")
    begun.write_text(begun.read_text().replace('"run",', '"replications",'))
    segment.rename(segment.with_name("task-1.segment"))
    before = everything(tmp_path)
    for resume in (False, True):
        with (
            pytest.raises(ResultError, match="holds 1 finished replications of another command"),
            whole_folder(tmp_path / "out", resume=resume),
        ):
            pass
    assert everything(tmp_path) == before
    segment.with_name("task-1.segment").rename(segment.with_name("tasks.sqlite"))
    before = everything(tmp_path)
    for kind in ("run", "replications"):
        with (
            pytest.raises(ResultError, match="holds finished tasks of an older version: go on with that,"),
            whole_folder(tmp_path / "out", resume=True, kind=kind),
        ):
            pass
    assert everything(tmp_path) == before


def test_checksums_are_read_like_all_else(tmp_path: Path) -> None:
    """Pipes, devices and links to nothing are named, and neither wait nor fill the memory."""
    out = tmp_path / "out"
    make(out)
    for path in (out / "run.json", out / "SHA256SUMS"):
        kept = path.read_bytes()
        for plant in (os.mkfifo, lambda path: path.symlink_to("/dev/zero")):
            path.unlink()
            plant(path)
            with pytest.raises(ResultError, match=rf"{path.name}' cannot be read: it is a device or a pipe"):
                check_sums(out, "run.json")
        path.unlink()
        path.symlink_to("/nowhere")
        with pytest.raises(ResultError, match=r"run\.json' is missing|SHA256SUMS' cannot be read: it is a link to n"):
            check_sums(out, "run.json")
        path.unlink()
        path.write_bytes(kept)
    check_sums(out, "run.json")


def test_a_large_file_is_not_read_at_once(tmp_path: Path) -> None:
    """The checksum of 600 MB takes little memory."""
    make(tmp_path / "out")
    with (tmp_path / "out" / "run.json").open("wb") as file:
        file.truncate(600 * 2**20)
    program = (
        "import resource, sys; from pathlib import Path; from bayesterra.runtime.reading import sha256_of;"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss; sha256_of(Path(sys.argv[1]));"
        "sys.exit(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before > 100_000)"
    )
    command = [sys.executable, "-c", program, str(tmp_path / "out" / "run.json")]
    assert subprocess.run(command, check=False, timeout=900).returncode == 0


def test_the_status_is_renewed_while_nothing_is_noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The last stage and steps stay with a newer time, every version is whole, and it ends with the work."""
    monkeypatch.setattr("bayesterra.runtime.status.BEAT", 0.02)
    seen = list[dict[str, object]]()
    before = threading.active_count()
    with Status(tmp_path) as status:
        status.note("adapting", 0.0, steps=3, now=True)
        for _ in range(200):
            seen.append(json.loads((tmp_path / "status.json").read_text(encoding="utf-8")))
            time.sleep(0.002)
    assert threading.active_count() == before
    assert {(one["stage"], one["steps"], one["pid"]) for one in seen} == {("adapting", 3, os.getpid())}
    times = [str(one["time"]) for one in seen]
    assert times == sorted(times)
    assert len(set(times)) >= 4


def test_what_is_noted_from_several_threads_is_never_torn(tmp_path: Path) -> None:
    """Notes and renewals take turns: the file is one of what was noted, and the last one stays."""
    with Status(tmp_path) as status, ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda i: status.note(str(i), 0.0, now=True), range(40)))
        status.note("last", 1.0, now=True)
    assert json.loads((tmp_path / "status.json").read_text(encoding="utf-8"))["stage"] == "last"
    assert names(tmp_path) == {"status.json"}


def test_a_status_has_the_keys_of_every_command(tmp_path: Path) -> None:
    """What nobody knows is null or missing; the rate is that of the stage; the file goes with the work."""
    with job_folder(tmp_path / "out") as (part, status):
        seen = []
        for done, steps in ((0.0, None), (0.0, 10), (0.5, 20)):
            status.note("sampling", done, float("inf"), steps=steps, now=True)
            seen.append(json.loads((part / "status.json").read_text(encoding="utf-8")))
            time.sleep(0.02)
        status.note("writing", 1.0, 2.0, steps=20, now=True, ess=100.0, r_hat=float("nan"))
        last = json.loads((part / "status.json").read_text(encoding="utf-8"))
        write_text(part / "run.json", "{}")
    base = {"stage", "done", "seconds_left", "time", "pid"}
    assert [set(one) - base for one in (*seen, last)] == [
        set(), {"steps"}, {"steps", "rate"}, {"steps", "ess", "r_hat"}
    ]  # fmt: skip
    assert seen[2]["seconds_left"] is None
    assert 0 < seen[2]["rate"] <= 10 / 0.02
    assert (last["seconds_left"], last["ess"], last["r_hat"]) == (2.0, 100.0, None)
    assert names(tmp_path / "out") == {"run.json", "SHA256SUMS"}
