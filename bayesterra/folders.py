"""Folders that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bayesterra.errors import BayesterraError, ResultError


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


@contextmanager
def whole_folder(folder: Path, *, overwrite: bool = False, mark: str = "run.json") -> Iterator[Path]:
    """Work in ``<folder>.part``; on success it takes the name of ``folder``.

    On an error of the package or of the disk nothing is left behind; a program that is interrupted or killed
    leaves ``<folder>.part``. With ``overwrite`` an old folder keeps its name until the new one is complete.

    Raises
    ------
    ResultError : see :func:`check_free`; or the folder cannot be written.
    """
    check_free(folder, overwrite=overwrite, mark=mark)
    part = folder.with_name(folder.name + ".part")
    try:
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir()
        yield part
        for path in sorted(part.iterdir()):
            _to_disk(path)
        _swap(part, folder)
    except (OSError, BayesterraError) as error:
        shutil.rmtree(part, ignore_errors=True)
        if isinstance(error, BayesterraError):
            raise
        raise ResultError(f"'{part}' cannot be written: {error.strerror or error}") from error


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
    _to_disk(folder.parent)
    shutil.rmtree(old, ignore_errors=True)


def _to_disk(path: Path) -> None:
    """Flush a file or folder to the disk, so that a renamed folder is never half empty."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_text(path: Path, text: str) -> None:
    """Write a text file so that a reader sees the old or the new one, never a part."""
    temporary = path.with_name(path.name + ".new")
    temporary.write_text(text, encoding="utf-8")
    _to_disk(temporary)
    temporary.replace(path)
