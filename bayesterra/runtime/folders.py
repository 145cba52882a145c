"""Folders that appear whole or not at all, in which nothing is touched that someone else put there."""

import ctypes
import os
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import BinaryIO

from bayesterra.errors import BayesterraError, ResultError, StudyError
from bayesterra.runtime import ownership
from bayesterra.runtime.reading import MEGABYTE, SUMS, read_text, sums_of


def check_free(folder: Path, *, overwrite: bool, mark: str = "run.json") -> None:
    """Make sure that a result may be written to ``folder``, before any work is spent on it.

    Nothing on the disk is changed. ``mark`` is the file by which a folder is known to be of the kind that may
    be replaced.

    Raises
    ------
    ResultError : it exists (and ``overwrite`` is not asked for), is a file, or cannot be made; or there is
        something in it, or in ``<folder>.part``, that the package did not write.
    """
    place = place_of(folder)
    if place.is_symlink():
        raise ResultError(f"'{folder}' is a link that leads back to itself: give another folder with --out")
    if place.exists() and not place.is_dir():
        raise ResultError(f"'{folder}' is a file: give another folder with --out")
    if place.exists() and not overwrite:
        raise ResultError(f"'{folder}' exists already: add --overwrite to replace it, or give --out")
    parent = place.resolve().parent
    if not parent.is_dir():
        raise ResultError(f"'{folder}' cannot be made: the folder '{parent}' does not exist")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise ResultError(f"'{folder}' cannot be made: no permission to write in '{parent}'")
    if place.exists() and any(place.iterdir()):
        _check_replaceable(folder, mark)
    _check_part(place)


def _check_replaceable(folder: Path, mark: str) -> None:
    """ResultError unless all in a folder was written by the package, as a result of the kind of ``mark``."""
    names = ownership.own_names(folder, finished=True)
    if mark not in names or not (folder / mark).exists():
        kind = "a result folder" if mark == "run.json" else f"a folder with {mark}"
        raise ResultError(f"'{folder}' is not {kind}: it is not replaced, give another with --out")
    if folder.samefile("."):
        raise ResultError(f"'{folder}' is the working directory: leave it first, or give another with --out")
    _check_all_ours(folder, names)


def _check_all_ours(folder: Path, names: frozenset[str]) -> None:
    for path in ownership.strangers(folder, names):
        raise ResultError(
            f"'{path}' was not written by bayesterra and is left alone: move it away, or give another folder with --out"
        )


def _check_part(place: Path) -> None:
    """ResultError where the folder to work in is there already and not, or not only, the package's."""
    part = part_of(place)
    for path in (part, part / ownership.WORK):
        if path.is_symlink():
            raise ResultError(f"'{path}' is a link to another folder: remove it, or give another with --out")
    if not part.exists() or _is_replaced(part, place):
        return
    if not ownership.is_work(part / ownership.WORK):
        raise ResultError(
            f"'{part}' was not made by bayesterra and is left alone: move it away, or give another with --out"
        )
    _check_all_ours(part, ownership.own_names(part, finished=False))


def place_of(folder: Path) -> Path:
    """The folder itself where its name is a link, or none, as that of ``.``; the link stays."""
    if folder.is_symlink() or folder.name in ("", ".."):
        return Path(os.path.realpath(folder))
    return folder


def part_of(folder: Path) -> Path:
    """Place where a folder is made before it takes its name."""
    place = place_of(folder)
    return place.parent / (place.name + ".part")


@contextmanager
def whole_folder(
    folder: Path,
    *,
    overwrite: bool = False,
    resume: bool = False,
    mark: str = "run.json",
    sums: bool = True,
    kind: str = ownership.RUN,
) -> Iterator[Path]:
    """Work in ``<folder>.part``; on success it takes the name of ``folder``, with checksums of its files.

    A program that is interrupted or killed leaves ``<folder>.part``; an error of the package or of the disk
    leaves it only where some work of it was saved. With ``overwrite`` an old folder keeps its name
    until the new one is complete, and an unfinished one makes room; with ``resume`` it keeps what was saved,
    if that is of this ``kind``. Without ``sums`` there are no checksums: for folders whose files are there to
    be edited. A link is kept, and all this is done to the folder that it leads to. Files in ``<folder>.part``
    are to be written with :func:`write_text` or :func:`write_bytes`, which keep account of them.

    Raises
    ------
    ResultError : see :func:`check_free`; another process works there; there is something unfinished, and
        what to do with it was not said; or the folder cannot be written. A refusal changes nothing.
    """
    check_free(folder, overwrite=overwrite, mark=mark)
    place, part = place_of(folder), part_of(folder)
    if part.exists() and _is_replaced(part, place):
        clear_up(place)
    fresh = _begin(part, place)
    with ownership.locked(part / ownership.WORK / "lock", f"'{part}'") as ours:
        try:
            _recover(place)
            check_free(folder, overwrite=overwrite, mark=mark)  # another run may just have ended
            _check_unfinished(part, kind, overwrite=overwrite, resume=resume)
        except ResultError:
            if fresh:
                _discard(part, place)
            raise
        ours.sign()
        clear_up(place)
        try:
            _clear(part, resume=resume)
            yield part
            if not ours():
                raise ResultError(f"'{part}' was removed or taken by another run while this one wrote to it")
            _close(part, sums=sums)
            _swap(part, place)
            tidy(place)
        except (OSError, BayesterraError) as error:
            if ours() and not ownership.unfinished(part)[1]:
                _give_up(part, place)
            if isinstance(error, BayesterraError):
                raise
            raise ResultError(f"'{part}' cannot be written: {error.strerror or error}") from error


def _begin(part: Path, place: Path) -> bool:
    """Make the folder to work in, at once with its mark; True where it was not there before."""
    if part.exists():
        return False
    made = _beside(place, "begun")
    try:
        (made / ownership.WORK).mkdir(parents=True)
        ownership.begin_mark(made / ownership.WORK)
        made.rename(part)
    except OSError as error:
        with suppress(OSError):
            ownership.remove_ours(made, ())
        if ownership.is_work(part / ownership.WORK):
            return False  # another process was quicker
        raise ResultError(f"'{part}' cannot be written: {error.strerror or error}") from error
    return True


def _check_unfinished(part: Path, kind: str, *, overwrite: bool, resume: bool) -> None:
    """ResultError where something was saved, and what to do with it was not said or cannot be done."""
    there, saved = ownership.unfinished(part)
    if saved and there not in (kind, "") and (resume or not overwrite):
        whose = "an older version" if there == ownership.TASKS else "another command"
        raise ResultError(
            f"'{part}' holds {saved} of {whose}: go on with that, give another folder with --out,"
            " or begin anew with --overwrite alone"
        )
    if saved and not (overwrite or resume):
        raise ResultError(f"'{part}' holds {saved}: add --resume to go on, or --overwrite to begin anew")


def tidy(place: Path) -> None:
    """Remove from a whole folder what served its making; a kill in the last moment leaves it there."""
    work = place / ownership.WORK
    if part_of(place).exists() and _is_replaced(part_of(place), place):
        return  # what tells that is still needed
    with suppress(OSError):
        if ownership.is_work(work) and not any(path.parent == work for path in ownership.strangers(place, ())):
            hidden = _beside(place, "removed")
            hidden.mkdir()
            work.rename(hidden / ownership.WORK)
            _remove_hidden(hidden, place)


def clear_up(folder: Path) -> None:
    """Remove all that runs left which were killed as their folders began, or had become whole."""
    place = place_of(folder)
    if ownership.is_work(place / ownership.WORK):
        # it may be just ending
        with suppress(ResultError), ownership.locked(place / ownership.WORK / "lock", f"'{place}'"):
            part = part_of(place)
            if part.exists() and _is_replaced(part, place):
                _discard(part, place)
            tidy(place)
    for old in _all_beside(place, "replaced") if place.exists() else ():
        if _is_ours(old):
            _discard(old, place)
    for kind in ("begun", "removed"):
        for hidden in _all_beside(place, kind):
            if _is_ours(hidden):
                _remove_hidden(hidden, place)


def _give_up(part: Path, place: Path) -> None:
    """Remove a folder in the making, but for what someone else has put there."""
    with suppress(OSError, ResultError):
        names = ownership.own_names(part, finished=False)
        if any(ownership.strangers(part, names)):
            ownership.remove_ours(part, names)
        else:
            _discard(part, place)


def _discard(old: Path, place: Path) -> None:
    """Remove a folder under a hidden name, so that a kill leaves nothing half removed in sight."""
    hidden = _beside(place, "removed")
    try:
        old.rename(hidden)
    except OSError:
        hidden = old
    _remove_hidden(hidden, place)


def _is_ours(hidden: Path) -> bool:
    """True where a folder with a hidden name is the package's, not one that happens to have such a name."""
    with suppress(OSError):  # empty, as a kill may leave it
        (hidden / ownership.WORK).rmdir()
    try:
        names = ownership.own_names(hidden, finished=(hidden / SUMS).exists())
        marked = (hidden / SUMS).exists() or ownership.is_work(hidden / ownership.WORK)
        return marked or not any(ownership.strangers(hidden, names))
    except (OSError, ResultError):
        return False


def _remove_hidden(hidden: Path, place: Path) -> None:
    """Remove a folder of ours with a hidden name; what is someone else's in it goes into the new folder."""
    with suppress(OSError, ResultError):
        finished = (hidden / SUMS).exists()
        names = ownership.own_names(hidden, finished=finished)
        for path in list(ownership.strangers(hidden, names)) if finished else ():
            kept = place / path.relative_to(hidden)
            if kept.parent.is_dir() and not os.path.lexists(kept):
                path.rename(kept)
        ownership.remove_ours(hidden, names)


def _clear(part: Path, *, resume: bool) -> None:
    """Remove what an earlier run left, but for lock and mark and, to resume, what it saved."""
    ownership.begin_mark(part / ownership.WORK)
    names = ownership.own_names(part, finished=False)
    work = part / ownership.WORK
    kept = {work} if resume else {work / "lock", work / ownership.MADE}
    ownership.remove_ours(part, names, kept=kept)
    (part / SUMS).unlink(missing_ok=True)


def _close(part: Path, *, sums: bool) -> None:
    """Add the checksums, and see that all of a finished folder is on the disk."""
    names = [name for name in ownership.own_names(part, finished=False) if (part / name).is_file()]
    if sums:
        write_text(part / SUMS, sums_of(part, set(names) - {SUMS}))
    folders = {(part / name).parent for name in names}
    for path in [*sorted(part / name for name in {*names, SUMS} if (part / name).is_file()), *folders]:
        to_disk(path)


def _swap(part: Path, place: Path) -> None:
    """Give ``part`` the name of ``place``, in one step where the system can; else :func:`_recover` mends a kill."""
    aside = _beside(place, "replaced")
    if place.exists():
        write_text(part / ownership.WORK / ownership.REPLACES, _identity(place))
    if place.exists() and _exchanged(part, place):
        to_disk(place.parent)
        _discard(part, place)
    elif place.exists():
        place.rename(aside)
        try:
            part.rename(place)
        except OSError:
            aside.rename(place)
            raise
        to_disk(place.parent)
        _discard(aside, place)
    else:
        part.rename(place)
        to_disk(place.parent)


def _is_replaced(part: Path, place: Path) -> bool:
    """True where ``part`` is the folder that ``place`` has replaced, by a run that was killed just then."""
    if not ownership.is_work(place / ownership.WORK) or ownership.is_work(part / ownership.WORK):
        return False
    try:
        return read_text(place / ownership.WORK / ownership.REPLACES, MEGABYTE) == _identity(part)
    except (OSError, ValueError):
        return False


def _identity(folder: Path) -> str:
    """Identity of a folder for as long as it is there, whatever its name."""
    status = folder.stat()
    return f"{status.st_dev} {status.st_ino}\n"


def _exchanged(folder: Path, other: Path) -> bool:
    """Let two folders exchange their names at once; True where the system and its disk can do that."""
    names = os.fsencode(folder), os.fsencode(other)
    swap, here = 2, -100  # RENAME_EXCHANGE and RENAME_SWAP; AT_FDCWD
    try:
        library = ctypes.CDLL(None)
        if sys.platform == "darwin":
            return bool(library.renamex_np(*names, swap) == 0)
        return bool(library.renameat2(here, names[0], here, names[1], swap) == 0)
    except (AttributeError, OSError, TypeError):  # a C library without that call
        return False


def _recover(place: Path) -> None:
    """Give an old folder its name back that had stepped aside for a run which was killed just then."""
    for aside in _all_beside(place, "replaced"):
        if not place.exists() and not any(ownership.strangers(aside, ownership.own_names(aside, finished=True))):
            aside.rename(place)


def _beside(place: Path, kind: str) -> Path:
    """A free name that no person would give."""
    name = f".{place.name}.{kind}-{os.getpid()}"
    names = (place.parent / (f"{name}-{number}" if number else name) for number in count())
    return next(path for path in names if not os.path.lexists(path))


def _all_beside(place: Path, kind: str) -> list[Path]:
    """Folders with such names; those that are being begun by living processes are left out."""
    name = re.compile(re.escape(f".{place.name}.{kind}-") + r"(\d+)(-\d+)?")
    folders = []
    for path in place.parent.iterdir():
        numbers = name.fullmatch(path.name)
        if not numbers or path.is_symlink() or not path.is_dir():
            continue
        if kind != "begun" or not _is_alive(int(numbers[1])):
            folders.append(path)
    return sorted(folders)


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        pass
    return True


def to_disk(path: Path) -> None:
    """Flush a file or folder to the disk, so that a renamed folder is never half empty."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def make_folder(path: Path, first: str) -> None:
    """Make a folder for files, the first of which is named, so that after a kill it is known as ours."""
    ownership.note(path / first)
    path.mkdir()


def write_text(path: Path, text: str) -> None:
    """Write a text file so that a reader sees the old or the new one, never a part."""
    write_bytes(path, text.encode("utf-8", errors="backslashreplace"))  # file names may hold half characters


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a file so that a reader sees the old or the new one, never a part."""
    ownership.note(path)
    temporary, file = _temporary(path)
    try:
        with file:
            file.write(content)
        to_disk(temporary)
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)  # on a full disk its room is needed
        raise


def _temporary(path: Path) -> tuple[Path, BinaryIO]:
    """A new file beside another one; never one that is there, nor one that a link leads to."""
    for number in count():
        temporary = path.with_name(f"{path.name}.new{number or ''}")
        with suppress(FileExistsError):
            return temporary, temporary.open("xb")
    raise AssertionError


def write_new(file: Path, text: str) -> None:
    """Write a study file that does not exist yet; StudyError where one does or none can be written."""
    if file.is_dir():
        raise StudyError(f"'{file}' is a folder: name a file in it, e.g. '{file / 'study.toml'}'")
    try:
        with file.open("x", encoding="utf-8") as handle:
            handle.write(text)
    except FileExistsError as error:
        raise StudyError(f"'{file}' exists already and is not overwritten: give another name") from error
    except OSError as error:
        raise StudyError(f"'{file}' cannot be written ({error.strerror})") from error


def write_new_files(contents: Mapping[Path, str]) -> None:
    """Write text files that do not exist yet, all of them or none.

    ResultError where one exists already, or cannot be written.
    """
    for path in contents:
        if os.path.lexists(path):
            raise ResultError(f"'{path}' exists already and is not overwritten: give another name with --out")
    begun, made = [], []
    try:
        for path, text in contents.items():
            temporary, file = _temporary(path)
            begun.append(temporary)
            with file:
                file.write(text.encode("utf-8", errors="backslashreplace"))
            to_disk(temporary)
        for temporary, path in zip(begun, contents, strict=True):
            os.link(temporary, path)  # which never replaces a file
            made.append(path)
    except OSError as error:
        for path in made:
            path.unlink()
        raise ResultError(f"'{next(iter(contents))}' cannot be written: {error.strerror or error}") from error
    finally:
        for temporary in begun:
            temporary.unlink(missing_ok=True)
