"""Checksums of the files of a folder, in the form that ``sha256sum -c`` reads."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path

from bayesterra.errors import ResultError

SUMS = "SHA256SUMS"
"""File in a finished folder: one line per file with its SHA-256."""


def sums_of(folder: Path, *, without: str = "") -> str:
    """Text of ``SHA256SUMS`` for all files below a folder, but for those in its subfolder ``without``."""
    names = [path.relative_to(folder) for path in sorted(folder.rglob("*")) if path.is_file()]
    kept = [name for name in names if name.parts[0] not in (without, SUMS)]
    return "".join(f"{_sum(folder / name)}  {name.as_posix()}\n" for name in kept)


def check_sums(folder: Path, *names: str) -> None:
    """Make sure that files are as they were written; of folders without ``SHA256SUMS`` nothing is known.

    Raises
    ------
    ResultError : a file is missing or not what it was, or cannot be read; the message names it.
    """
    known = _known(folder)
    for name in names if known is not None else ():
        path = folder / name
        try:
            found = _sum(path) if path.exists() else None
        except OSError as error:
            raise ResultError(f"'{path}' cannot be read: {error.strerror or error}") from error
        if known is not None and found != known.get(name):
            why = "is missing" if found is None else "is damaged or was changed"
            raise ResultError(f"'{path}' {why} (see its checksum in {SUMS})")


def _known(folder: Path) -> dict[str, str] | None:
    """Checksum by name; None where the folder has none, as those of older versions."""
    path = folder / SUMS
    try:
        lines = path.read_bytes().decode("utf-8", "replace").splitlines()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise ResultError(f"'{path}' cannot be read: {error.strerror or error}") from error
    pairs = (line.partition("  ") for line in lines)
    return {name: digest for digest, _, name in pairs}


def _sum(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()
