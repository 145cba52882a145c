"""Folders that appear whole or not at all."""

from __future__ import annotations

import glob
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bayesterra.errors import BayesterraError, ResultError
from bayesterra.locking import locked

WORK = "checkpoint"
"""Folder in ``<folder>.part`` for what only serves the making: the lock, and segments to resume from."""
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


def unfinished(part: Path) -> bool:
    """Whether saved segments would be lost with ``part``."""
    return any((part / WORK).glob("*" + SEGMENT))


def check_no_links(part: Path) -> None:
    """ResultError where the folder of an unfinished run is a link, as what is removed there is elsewhere."""
    for path in (part, part / WORK):
        if path.is_symlink():
            raise ResultError(f"'{path}' is a link to another folder: remove it, or give another with --out")


@contextmanager
def whole_folder(
    folder: Path, *, overwrite: bool = False, resume: bool = False, mark: str = "run.json"
) -> Iterator[Path]:
    """Work in ``<folder>.part``; on success it takes the name of ``folder``.

    A program that is interrupted or killed leaves ``<folder>.part``; an error of the package or of the disk
    leaves it only where it holds saved segments. With ``overwrite`` an old folder keeps its name until the
    new one is complete, and an unfinished one makes room; with ``resume`` it keeps its segments.

    Raises
    ------
    ResultError : see :func:`check_free`; another process works there; there are saved segments, and what to
        do with them was not said; or the folder cannot be written.
    """
    check_free(folder, overwrite=overwrite, mark=mark)
    part = part_of(folder)
    check_no_links(part)
    with locked(part / WORK / "lock", f"'{part}'"):
        try:
            check_free(folder, overwrite=overwrite, mark=mark)  # another run may just have ended
            _clear(part, overwrite=overwrite, resume=resume)
            yield part
            for path in sorted(part.iterdir()):
                to_disk(path)
            _swap(part, folder)
            tidy(folder)
        except (OSError, BayesterraError) as error:
            if not unfinished(part):
                shutil.rmtree(part, ignore_errors=True)
            if isinstance(error, BayesterraError):
                raise
            raise ResultError(f"'{part}' cannot be written: {error.strerror or error}") from error


def tidy(folder: Path) -> None:
    """Remove from a whole folder what served its making; a kill in the last moment leaves it there."""
    shutil.rmtree(folder / WORK, ignore_errors=True)


def _clear(part: Path, *, overwrite: bool, resume: bool) -> None:
    """Remove what an earlier run left, but for the lock and, to resume, its segments."""
    if unfinished(part) and not (overwrite or resume):
        raise ResultError(
            f"'{part}' holds an unfinished run: add --resume to go on with it, or --overwrite to begin anew"
        )
    for path in [*part.iterdir(), *(part / WORK).iterdir()]:
        if path in (part / WORK, part / WORK / "lock") or (resume and path.parent.name == WORK):
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def settle(part: Path, folder: Path) -> None:
    """Give a finished ``<folder>.part``, all of whose files are on the disk, its final name.

    Raises
    ------
    ResultError : that cannot be done; ``part`` stays as it is.
    """
    try:
        _swap(part, folder)
    except OSError as error:
        raise ResultError(f"'{folder}' cannot be written: {error.strerror or error}") from error


def _swap(part: Path, folder: Path) -> None:
    """Give ``part`` the name of ``folder``; an old folder steps aside first and is removed last."""
    old = folder.with_name(f".{folder.name}.replaced-{os.getpid()}")  # no name that a person would give
    if folder.exists():
        shutil.rmtree(old, ignore_errors=True)
        folder.rename(old)
    try:
        part.rename(folder)
    except OSError:
        if old.exists():
            old.rename(folder)
        raise
    to_disk(folder.parent)
    for aside in folder.parent.glob(f".{glob.escape(folder.name)}.replaced-*"):  # killed runs' included
        shutil.rmtree(aside, ignore_errors=True)


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
    temporary.unlink(missing_ok=True)
    with temporary.open("xb") as file:  # never through a link that someone put there
        file.write(content)
    to_disk(temporary)
    temporary.replace(path)
