"""Folders that appear whole or not at all."""

from __future__ import annotations

import ctypes
import glob
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bayesterra.checksums import SUMS, sums_of
from bayesterra.errors import BayesterraError, ResultError
from bayesterra.locking import locked

WORK = "checkpoint"
"""Folder in ``<folder>.part`` for what only serves the making: the lock, and what to resume from."""
SEGMENT = ".segment"
"""Ending of files that would be a loss (see :mod:`bayesterra.checkpoints`)."""


def check_free(folder: Path, *, overwrite: bool, mark: str = "run.json") -> None:
    """Make sure that a result may be written to ``folder``, before any work is spent on it.

    ``mark`` is the file by which a folder is known to be of the kind that may be replaced.

    Raises
    ------
    ResultError : it exists (and ``overwrite`` is not asked for), is a file, or cannot be made.
    """
    if folder.exists() and not folder.is_dir():
        raise ResultError(f"'{folder}' is a file: give another folder with --out")
    if folder.exists() and not overwrite:
        if (folder / WORK).is_dir() and (folder / SUMS).is_file():
            clear_up(folder)
        raise ResultError(f"'{folder}' exists already: add --overwrite to replace it, or give --out")
    parent = folder.resolve().parent
    if not parent.is_dir():
        raise ResultError(f"'{folder}' cannot be made: the folder '{parent}' does not exist")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise ResultError(f"'{folder}' cannot be made: no permission to write in '{parent}'")
    if folder.exists() and any(folder.iterdir()) and not (folder / mark).exists():
        kind = "a result folder" if mark == "run.json" else f"a folder with {mark}"
        raise ResultError(f"'{folder}' is not {kind}: it is not replaced, give another with --out")


def part_of(folder: Path) -> Path:
    """Where a folder is made before it takes its name."""
    return folder.with_name(folder.name + ".part")


def saved_segments(part: Path) -> str:
    """What would be lost with ``part``, in words; empty if nothing."""
    return "an unfinished run" if any((part / WORK).glob("*" + SEGMENT)) else ""


def check_no_links(part: Path) -> None:
    """ResultError where the folder of an unfinished run is a link, as what is removed there is elsewhere."""
    for path in (part, part / WORK):
        if path.is_symlink():
            raise ResultError(f"'{path}' is a link to another folder: remove it, or give another with --out")


@contextmanager
def whole_folder(
    folder: Path,
    *,
    overwrite: bool = False,
    resume: bool = False,
    mark: str = "run.json",
    sums: bool = True,
    unfinished: Callable[[Path], str] = saved_segments,
) -> Iterator[Path]:
    """Work in ``<folder>.part``; on success it takes the name of ``folder``, with checksums of its files.

    A program that is interrupted or killed leaves ``<folder>.part``; an error of the package or of the disk
    leaves it only where it holds something ``unfinished``. With ``overwrite`` an old folder keeps its name
    until the new one is complete, and an unfinished one makes room; with ``resume`` it keeps what was saved.
    Without ``sums`` there are no checksums: for folders whose files are there to be edited.

    Raises
    ------
    ResultError : see :func:`check_free`; another process works there; there is something unfinished, and
        what to do with it was not said; or the folder cannot be written.
    """
    check_free(folder, overwrite=overwrite, mark=mark)
    part = part_of(folder)
    check_no_links(part)
    with locked(part / WORK / "lock", f"'{part}'") as ours:
        try:
            _recover(folder)
            check_free(folder, overwrite=overwrite, mark=mark)  # another run may just have ended
            if (saved := unfinished(part)) and not (overwrite or resume):
                raise ResultError(
                    f"'{part}' holds {saved}: add --resume to go on, or --overwrite to begin anew"
                )
            _clear(part, resume=resume)
            yield part
            if not ours():
                raise ResultError(f"'{part}' was removed or taken by another run while this one wrote to it")
            _close(part, sums=sums)
            _swap(part, folder)
            tidy(folder)
        except (OSError, BayesterraError) as error:
            if ours() and not unfinished(part):
                shutil.rmtree(part, ignore_errors=True)
            if isinstance(error, BayesterraError):
                raise
            raise ResultError(f"'{part}' cannot be written: {error.strerror or error}") from error


def tidy(folder: Path) -> None:
    """Remove from a whole folder what served its making; a kill in the last moment leaves it there."""
    shutil.rmtree(folder / WORK, ignore_errors=True)


def clear_up(folder: Path) -> None:
    """Remove all that a run left which was killed after its folder had become whole."""
    tidy(folder)
    part = part_of(folder)
    if part.exists():  # the folder that this one has replaced, unless another run has begun since
        with suppress(ResultError), locked(part / WORK / "lock", f"'{part}'"):
            shutil.rmtree(part, ignore_errors=True)
    for old in _all_beside(folder, "removed"):
        shutil.rmtree(old, ignore_errors=True)


def _clear(part: Path, *, resume: bool) -> None:
    """Remove what an earlier run left, but for the lock and, to resume, what it saved."""
    for path in [*part.iterdir(), *(part / WORK).iterdir()]:
        if path in (part / WORK, part / WORK / "lock") or (resume and path.parent.name == WORK):
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def _close(part: Path, *, sums: bool) -> None:
    """Add the checksums, and see that all of a finished folder is on the disk."""
    if sums:
        write_text(part / SUMS, sums_of(part, without=WORK))
    for path in [*sorted(part.iterdir()), part]:
        to_disk(path)


def _swap(part: Path, folder: Path) -> None:
    """Give ``part`` the name of ``folder``, which is replaced in one step where the system can do that.

    Elsewhere the old folder steps aside first, and :func:`_recover` gives it its name back after a kill.
    """
    aside, removed = (_beside(folder, kind) for kind in ("replaced", "removed"))
    if folder.exists() and _exchanged(part, folder):
        try:
            part.rename(removed)
        except OSError:
            shutil.rmtree(part, ignore_errors=True)
    elif folder.exists():
        folder.rename(aside)
        try:
            part.rename(folder)
        except OSError:
            aside.rename(folder)
            raise
        aside.rename(removed)
    else:
        part.rename(folder)
    to_disk(folder.parent)
    for old in (*_all_beside(folder, "removed"), *_all_beside(folder, "replaced")):  # killed runs' included
        shutil.rmtree(old, ignore_errors=True)


def _exchanged(one: Path, other: Path) -> bool:
    """Let two folders exchange their names at once; whether the system and its disk can do that."""
    names = os.fsencode(one), os.fsencode(other)
    swap, here = 2, -100  # RENAME_EXCHANGE and RENAME_SWAP; AT_FDCWD
    try:
        library = ctypes.CDLL(None)
        if sys.platform == "darwin":
            return bool(library.renamex_np(*names, swap) == 0)
        return bool(library.renameat2(here, names[0], here, names[1], swap) == 0)
    except (AttributeError, OSError, TypeError):  # a C library without that call
        return False


def _recover(folder: Path) -> None:
    """Give an old folder its name back that had stepped aside for a run which was killed just then."""
    for aside in _all_beside(folder, "replaced"):
        if not folder.exists():
            aside.rename(folder)


def _beside(folder: Path, kind: str) -> Path:
    """A name that no person would give."""
    return folder.with_name(f".{folder.name}.{kind}-{os.getpid()}")


def _all_beside(folder: Path, kind: str) -> list[Path]:
    return sorted(folder.parent.glob(f".{glob.escape(folder.name)}.{kind}-*"))


def to_disk(path: Path) -> None:
    """Flush a file or folder to the disk, so that a renamed folder is never half empty."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_text(path: Path, text: str) -> None:
    """Write a text file so that a reader sees the old or the new one, never a part."""
    write_bytes(path, text.encode("utf-8", errors="backslashreplace"))  # file names may hold half characters


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file so that a reader sees the old or the new one, never a part."""
    temporary = path.with_name(path.name + ".new")
    try:
        temporary.unlink(missing_ok=True)
        with temporary.open("xb") as file:  # never through a link that someone put there
            file.write(content)
        to_disk(temporary)
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)  # on a full disk its room is needed
        raise
