"""A lock that one process holds and that ends with it, however it ends."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bayesterra.errors import ResultError


class Lock:
    """A held lock: called, it tells whether its file is still where it was."""

    def __init__(self, handle: int, path: Path) -> None:
        self._handle, self._path = handle, path

    def __call__(self) -> bool:
        """Whether the file is still where it was."""
        return _is_at(self._handle, self._path)

    def sign(self) -> None:
        """Write this process into the file, for the message that others get."""
        with suppress(OSError):
            os.truncate(self._handle, 0)
            os.write(self._handle, f"{os.getpid()}\n".encode())


@contextmanager
def locked(path: Path, place: str) -> Iterator[Lock]:
    """Hold the lock of a file, which is made in an existing folder; it may move or vanish meanwhile.

    The operating system gives the lock back when the process ends, so a killed one is in nobody's way.

    Raises
    ------
    ResultError : another process (or thread) holds the lock of ``place``, or the file cannot be made.
    """
    handle = _held(path, place)
    try:
        yield Lock(handle, path)
    finally:
        os.close(handle)


def _held(path: Path, place: str) -> int:
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)
    except FileNotFoundError as error:
        raise _gone(place) from error
    except OSError as error:
        raise ResultError(f"{place} cannot be written: {error.strerror}") from error
    _take(handle, place)
    if not _is_at(handle, path):  # what we hold is no longer what others would ask for
        os.close(handle)
        raise _gone(place)
    return handle


def _gone(place: str) -> ResultError:
    return ResultError(f"{place} was removed, or finished by another run, just now: begin again")


def _take(handle: int, place: str) -> None:
    if sys.platform == "win32":
        return
    import fcntl

    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = os.read(handle, 20).decode(errors="replace").strip()
        os.close(handle)
        process = f" (process {holder})" if holder.isdigit() else ""
        raise ResultError(
            f"{place} is being written by another run{process}: wait for it, or give another folder"
        ) from None
    except OSError:
        pass  # a file system without locks must not keep anyone from working


def _is_at(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False
