"""Files that come from outside: ordinary ones, of a bounded size, with checksums where they have them."""

import errno
import json
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any

from bayesterra.errors import BayesterraError, ResultError

MEGABYTE = 2**20
MOST_TOML = 4 * MEGABYTE
MOST_TABLE = 32 * MEGABYTE
MOST_JSON = 64 * MEGABYTE
MOST_SEGMENT = 1024 * MEGABYTE
DEEPEST = 50
"""Tables within tables: the deepest file of our own has six."""

UNREADABLE = (
    OSError, EOFError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, AssertionError,
    BufferError, MemoryError, RuntimeError,
)  # fmt: skip
"""Errors of libraries on content that is not of the form which they expect; RuntimeError has RecursionError
and NotImplementedError under it."""


@contextmanager
def damage(kind: type[BayesterraError], place: object, said: str = "'{}' is damaged: {}") -> Iterator[None]:
    """Turn whatever reading a damaged file raises into one line of the given kind: ``'<place>' is damaged``.

    Only for content that a program wrote: what a person wrote deserves to hear what is wrong with it.
    """
    try:
        yield
    except BayesterraError:
        raise
    except UNREADABLE as error:
        raise kind(said.format(place, reason(error))) from error


def reason(error: BaseException) -> str:
    """Message of a library's error, in one line that is never empty."""
    if isinstance(error, MemoryError):
        return "it asks for more memory than there is"
    lines = (error.strerror or "" if isinstance(error, OSError) else str(error)).splitlines()
    text = next((line.strip() for line in lines if line.strip()), type(error).__name__)
    return f"{text} is missing" if isinstance(error, KeyError) else text


def read_bytes(path: Path, most: int) -> bytes:
    """Content of an ordinary file.

    OSError where it cannot be read, is a device, a pipe or a folder, or has more than ``most`` bytes.
    """
    content = bytearray()
    for block in _blocks(path, most):  # not all at once: that would reserve what the size only claims
        content += block
    return bytes(content)


def sha256_of(path: Path) -> str:
    """SHA-256 of an ordinary file, which need not fit into the memory; OSError as :func:`read_bytes`."""
    digest = sha256()
    for block in _blocks(path, None):
        digest.update(block)
    return digest.hexdigest()


def _blocks(path: Path, most: int | None) -> Iterator[bytes]:
    """Content of an ordinary file, block by block, up to ``most`` or the size that it has at first."""
    # without O_NONBLOCK a pipe without a writer would hold us here for ever
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with os.fdopen(handle, "rb") as file:
        status, size = os.fstat(handle), 0
        limit = status.st_size if most is None else most
        check_ordinary(status, path, limit)
        while block := file.read(MEGABYTE):
            size += len(block)
            if size > limit:  # it grew meanwhile, or its size was a lie, as in /proc
                growing = OSError(errno.EFBIG, "it grows while it is read", str(path))
                raise growing if most is None else _too_large(path, limit)
            yield block


def check_ordinary(status: os.stat_result, path: Path, most: int) -> None:
    """OSError unless it is an ordinary file of at most ``most`` bytes."""
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is a device or a pipe, not a file", str(path))
    if status.st_size > most:
        raise _too_large(path, most)


def _too_large(path: Path, most: int) -> OSError:
    return OSError(errno.EFBIG, f"it is larger than {most // MEGABYTE} MB", str(path))


def read_text(path: Path, most: int) -> str:
    """Text of an ordinary UTF-8 file, without a byte order mark; OSError as :func:`read_bytes`."""
    return read_bytes(path, most).decode("utf-8-sig")


def read_json(path: Path) -> Any:
    """Content of a JSON file; OSError as :func:`read_bytes`, ValueError as :func:`parsed_json`."""
    return parsed_json(read_text(path, MOST_JSON))


def parsed_json(text: str) -> Any:
    """Content of a JSON text; ValueError where it is none, or nested deeper than ``DEEPEST``."""
    try:
        content = json.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    check_depth(content)
    return content


def check_depth(content: Any) -> None:
    """ValueError where lists and tables are nested deeper than ``DEEPEST``: little else survives them."""
    level = [content]
    for _ in range(DEEPEST):
        level = [item for parent in level for item in _items(parent)]
        if not level:
            return
    raise ValueError("it is nested too deeply")


def _items(content: Any) -> list[Any]:
    inner = content.values() if isinstance(content, dict) else content if isinstance(content, list) else ()
    return [item for item in inner if isinstance(item, dict | list)]


SUMS = "SHA256SUMS"
"""File in a finished folder: one line per file with its SHA-256."""
MOST_SUMS = 4 * MEGABYTE


def sums_of(folder: Path, names: Iterable[str]) -> str:
    """Text of ``SHA256SUMS`` for files of a folder."""
    return "".join(f"{sha256_of(folder / name)}  {name}\n" for name in sorted(names))


def check_sums(folder: Path, *names: str) -> None:
    """Make sure that files are as they were written; of folders without ``SHA256SUMS`` nothing is known.

    ResultError where a file is missing or not what it was, or cannot be read; the message names it.
    """
    sums = listed(folder)
    for name in names if sums is not None else ():
        path = folder / name
        try:
            digest = sha256_of(path) if path.exists() else None
        except OSError as error:
            raise ResultError(f"'{path}' cannot be read: {error.strerror or error}") from error
        if sums is not None and digest != sums.get(name):
            why = "is missing" if digest is None else "is damaged or was changed"
            raise ResultError(f"'{path}' {why} (see its checksum in {SUMS})")


def listed(folder: Path) -> dict[str, str] | None:
    """Checksums of a folder by name of file; None where it has none, as those of older versions.

    ResultError where they are there, and cannot be read.
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
