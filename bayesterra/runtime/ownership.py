"""Ownership of files and folders: locks, and what in a folder the package wrote itself.

A folder in the making carries a mark, which lists what is written there before it is written; a finished one
has ``SHA256SUMS``. Everything else in them is someone else's.
"""

import os
import re
import stat
import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath

from bayesterra.errors import ResultError
from bayesterra.runtime.reading import MEGABYTE, SUMS, listed, read_bytes, read_json, read_text


class Lock:
    """A held lock: called, it tells whether its file is still where it was."""

    def __init__(self, handle: int, path: Path) -> None:
        self._handle, self._path = handle, path

    def __call__(self) -> bool:
        """True where the file is still where it was."""
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


WORK = "checkpoint"
"""Folder in ``<folder>.part`` for what only serves the making: the lock, and what to resume from."""
BEGUN, SEGMENT, TASK = "begun.json", ".segment", "task-"
"""What the work was begun with; ending of files that would be a loss, and beginning of those that are tasks
(see :mod:`bayesterra.runtime.checkpoints`)."""
RUN = "run"
"""Kind of work that is no number of tasks."""
TASKS = "tasks.sqlite"
"""File in which earlier versions kept finished tasks."""
MADE, REPLACES = "made.txt", "replaces.txt"
"""The mark in ``WORK``; and, while an old folder is being replaced, which one that is."""

_HEAD = "bayesterra makes the folder above this one, and has written there:\n"
_TEMPORARY = re.compile(r"\.new\d*$")
_AT_WORK = re.compile(
    rf"(lock|{re.escape(BEGUN)}|{re.escape(MADE)}|{re.escape(REPLACES)}|.*{re.escape(SEGMENT)}"
    rf"|{re.escape(TASKS)}(-wal|-shm|-journal)?)(\.new\d*)?"
)
_NOBODYS = {".DS_Store"}
"""Files that a file manager leaves in every folder that someone looks at."""
_OLDER = frozenset(read_text(Path(__file__).with_name("older_names.txt"), MEGABYTE).split())
"""Names that versions wrote whose folders had no mark yet, or no checksums."""


def begin_mark(work: Path) -> None:
    """Put the mark into a folder for work that may hold an earlier one, or what an older version left."""
    if not _is_mark(work / MADE):
        older = "".join(f"{name}\n" for name in sorted(_OLDER) if _is_file(work.parent / name))
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_NOFOLLOW", 0)
        with os.fdopen(os.open(work / MADE, flags, 0o644), "wb") as file:
            file.write((_HEAD + older).encode())


def note(path: Path) -> None:
    """Note in the mark of a folder in the making that a file will be written there; elsewhere do nothing."""
    for folder in list(path.parents)[:2]:
        mark = folder / WORK / MADE
        name = path.relative_to(folder).as_posix()
        if path.parent == folder / WORK or not _is_mark(mark):
            continue
        before = _text(mark)
        if name not in before.splitlines():
            gap = "" if before.endswith("\n") else "\n"  # after a kill the last line may be a half one
            with mark.open("ab") as file:
                file.write(f"{gap}{name}\n".encode())
        return


def is_work(work: Path) -> bool:
    """True where a folder named ``checkpoint`` is the package's; earlier versions left no mark in it."""
    if work.is_symlink() or not work.is_dir():
        return False
    older = (work / BEGUN, work / TASKS, *work.glob("*" + SEGMENT))
    begun = _is_file(work / MADE) and _HEAD.startswith(_text(work / MADE))  # killed as it was written
    return begun or _is_mark(work / MADE) or _is_lock(work / "lock") or any(map(_is_file, older))


def kind_of(work: Path) -> str:
    """Kind of the work that was begun in a folder ``checkpoint``; empty where that cannot be read."""
    try:
        return str(read_json(work / BEGUN).get("kind", RUN))
    except (OSError, ValueError, AttributeError):
        return ""


def unfinished(part: Path) -> tuple[str, str]:
    """Kind of the work that would be lost with ``<folder>.part``, and what is saved of it, in words."""
    work = part / WORK
    if (work / TASKS).exists():
        return TASKS, "finished tasks"
    names = [path.name for path in work.glob("*" + SEGMENT)]
    tasks = sum(name.startswith(TASK) for name in names)
    kind = kind_of(work) if names else ""
    words = f"{tasks} finished {kind or 'tasks'}" if tasks else "an unfinished run" if names else ""
    return kind, words


def own_names(folder: Path, *, finished: bool) -> frozenset[str]:
    """Names of what the package has written into a folder, relative to it; errors as :func:`listed`."""
    names = listed(folder)
    if finished:
        return _OLDER if names is None else frozenset((*names, SUMS))
    mark = folder / WORK / MADE
    return frozenset(names or ()) | (frozenset(_text(mark).splitlines()[1:]) if _is_mark(mark) else _OLDER)


def strangers(folder: Path, names: Collection[str]) -> Iterator[Path]:
    """Strangers in a folder: files of other names, links, and folders without files of the package."""
    inner = {str(parent) for name in names for parent in PurePosixPath(name).parents}
    for path in sorted(folder.iterdir()):
        yield from _strange(path, path.name, names, inner)


def _strange(path: Path, name: str, names: Collection[str], inner: Collection[str]) -> Iterator[Path]:
    if path.is_dir() and not path.is_symlink():
        at_work = name == WORK and is_work(path)
        if not at_work and name not in inner:
            yield path
            return
        for below in sorted(path.iterdir()):
            if not at_work:
                yield from _strange(below, f"{name}/{below.name}", names, inner)
            elif not (_AT_WORK.fullmatch(below.name) and _is_file(below)):
                yield below
    elif os.path.lexists(path) and not (_is_file(path) and {name, _TEMPORARY.sub("", name)} & {*names, *_NOBODYS}):
        yield path


def remove_ours(folder: Path, names: Collection[str], kept: Collection[Path] = ()) -> None:
    """Remove what is the package's from a folder, but for files and folders that are to be kept.

    Where nothing else is in it the folder goes too; its marks go last.
    """
    marks = [folder / SUMS, folder / WORK / MADE]
    others, folders = {*strangers(folder, names), *kept}, []
    for place, below, files in os.walk(folder):
        below[:] = [name for name in below if Path(place, name) not in others]
        folders.append(Path(place))
        for path in (Path(place, name) for name in files):
            if path not in others and path not in marks:
                path.unlink(missing_ok=True)
    for mark in marks if not others else ():
        mark.unlink(missing_ok=True)
    for path in reversed(folders):
        with suppress(OSError):  # something that stays is in it
            path.rmdir()


def _is_mark(path: Path) -> bool:
    return _text(path).startswith(_HEAD)


def _is_lock(path: Path) -> bool:
    """True for a lock: nothing, or the number of a process."""
    try:
        return _is_file(path) and re.fullmatch(rb"\d*\n?", read_bytes(path, MEGABYTE)) is not None
    except OSError:
        return False


def _is_file(path: Path) -> bool:
    """True for an ordinary file that is no link."""
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False


def _text(mark: Path) -> str:
    try:
        return read_bytes(mark, MEGABYTE).decode("utf-8", "replace") if _is_file(mark) else ""
    except OSError:
        return ""
