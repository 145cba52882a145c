"""A lock that one process holds and that ends with it, however it ends."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

from bayesterra.errors import ResultError


@contextmanager
def locked(path: Path, place: str) -> Iterator[Callable[[], bool]]:
    """Hold the lock of a file, which is made with its folders; the file may move or vanish meanwhile.

    What is yielded tells whether the file is still where it was. The operating system gives the lock back
    when the process ends, so a killed one is in nobody's way.

    Raises
    ------
    ResultError : another process (or thread) holds the lock of ``place``, or the file cannot be made.
    """
    handle = _held(path, place)
    try:
        yield partial(_is_at, handle, path)
    finally:
        os.close(handle)


def _held(path: Path, place: str) -> int:
    while True:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)
        except FileNotFoundError:
            continue  # its holder has just given the folder its final name
        except OSError as error:
            raise ResultError(f"{place} cannot be written: {error.strerror}") from error
        _take(handle, place)
        if _is_at(handle, path):
            with suppress(OSError):  # it only serves a message
                os.truncate(handle, 0)
                os.write(handle, f"{os.getpid()}\n".encode())
            return handle
        os.close(handle)  # likewise: what we hold is no longer what others would ask for


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
