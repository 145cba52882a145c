"""Checksums of the files of a folder, in the form that ``sha256sum -c`` reads."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from bayesterra.errors import ResultError
from bayesterra.reading import MEGABYTE, read_bytes, sha256_of

SUMS = "SHA256SUMS"
"""File in a finished folder: one line per file with its SHA-256."""
MOST_SUMS = 4 * MEGABYTE


def sums_of(folder: Path, names: Iterable[str]) -> str:
    """Text of ``SHA256SUMS`` for files of a folder."""
    return "".join(f"{sha256_of(folder / name)}  {name}\n" for name in sorted(names))


def check_sums(folder: Path, *names: str) -> None:
    """Make sure that files are as they were written; of folders without ``SHA256SUMS`` nothing is known.

    Raises
    ------
    ResultError : a file is missing or not what it was, or cannot be read; the message names it.
    """
    known = listed(folder)
    for name in names if known is not None else ():
        path = folder / name
        try:
            found = sha256_of(path) if path.exists() else None
        except OSError as error:
            raise ResultError(f"'{path}' cannot be read: {error.strerror or error}") from error
        if known is not None and found != known.get(name):
            why = "is missing" if found is None else "is damaged or was changed"
            raise ResultError(f"'{path}' {why} (see its checksum in {SUMS})")


def listed(folder: Path) -> dict[str, str] | None:
    """Checksums of a folder by name of file; None where it has none, as those of older versions.

    Raises
    ------
    ResultError : they are there, and cannot be read.
    """
    path = folder / SUMS
    try:
        lines = read_bytes(path, MOST_SUMS).decode("utf-8", "replace").splitlines()
    except (FileNotFoundError, NotADirectoryError) as error:
        if path.is_symlink():
            raise ResultError(f"'{path}' cannot be read: it is a link to nothing") from error
        return None
    except OSError as error:
        raise ResultError(f"'{path}' cannot be read: {error.strerror or error}") from error
    pairs = (line.partition("  ") for line in lines)
    return {name: digest for digest, _, name in pairs}
