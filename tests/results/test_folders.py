"""Folders that appear whole or not at all."""

import os
import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager
from hashlib import sha256
from pathlib import Path

import pytest

from bayesterra.checksums import check_sums
from bayesterra.errors import ResultError, SupportError
from bayesterra.folders import check_free, whole_folder, write_text
from bayesterra.locking import locked


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
    monkeypatch.setattr("bayesterra.folders._exchanged", lambda one, other: False)

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
    """A new run starts from an empty DIR.part."""
    (tmp_path / "out.part").mkdir()
    (tmp_path / "out.part" / "stale.csv").write_text("", encoding="utf-8")
    with whole_folder(tmp_path / "out") as part:
        write_text(part / "a.txt", "a")
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


def test_a_result_that_appeared_meanwhile_is_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where another run ends between the check and the lock, its result stays."""

    def late(path: Path, place: str) -> AbstractContextManager[Callable[[], bool]]:
        result_folder(tmp_path / "out")
        return locked(path, place)

    monkeypatch.setattr("bayesterra.folders.locked", late)
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
