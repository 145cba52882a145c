"""Files that are damaged after they were written: what is read from them, and what resuming makes of them."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import pandas as pd
from numpy.random import Generator
from short_runs import quick_study
from trials import CLEAR, RIGHT, Process, Table, command, content, emptied, one_study, rng_of

from bayesterra.analysis.run import load_result, opened_for_design, opened_for_stream
from bayesterra.errors import BayesterraError
from bayesterra.follow.session import begin
from bayesterra.runtime.checkpoints import Checkpoints, pack
from bayesterra.runtime.folders import part_of
from bayesterra.runtime.netcdf import read_drawn
from bayesterra.runtime.ownership import WORK

FLIPPED, CUT, EMPTIED = "one bit flipped", "cut short", "made empty"
REMOVED, FOLDER, UNREADABLE = "removed", "a folder in its place", "not readable"
KINDS = (FLIPPED, CUT, EMPTIED, REMOVED, FOLDER, UNREADABLE)
NOBODY = 65534
TASKS = 10


@dataclass(frozen=True)
class Read:
    """A folder that is read.

    Attributes
    ----------
    folder : as it was written.
    read : what is read from a folder, as a digest.
    damages : trials of the kinds that are drawn at random, by kind; the others are made once per file.
    """

    folder: Path
    read: Callable[[Path], str]
    damages: dict[str, int]


def _result(folder: Path) -> str:
    found = load_result(folder)
    tables = [getattr(found, name).to_csv() for name in ("summary", "least_squares", "predictive")]
    draws = found.to_dataframe().to_numpy().tobytes()
    return _digest(draws, found.record, tables, found.study.fingerprint)


def _prior(folder: Path) -> str:
    found = read_drawn(folder)
    return _digest({name: draws.tobytes() for name, draws in found.draws.items()}, found.converged)


def _known(folder: Path) -> str:
    found: Any = opened_for_design(folder)
    return _digest(type(found).__name__, found.values().tobytes())


def _stream(folder: Path) -> str:
    found = begin(opened_for_stream(folder), pd.DataFrame())
    stream = found.stream
    state = {name: array.tobytes() for name, array in pack(stream.cloud).items()}
    return _digest(state, found.table, found.soil, len(stream), stream.log_evidence, stream.study.fingerprint)


def _store(folder: Path) -> str:
    """Tasks of a store: right where all that are there are."""
    found = Checkpoints.opened(folder, {"seed": 1}, "tasks").tasks()
    wrong = [n for n, task in found.items() if task != {"number": n, "text": "x" * 300}]
    return f"wrong: {wrong}" if wrong else "right"


def _digest(*parts: object) -> str:
    return sha256(repr(parts).encode()).hexdigest()


def reads(made: Path) -> dict[str, Read]:
    """Folders to damage, by name; ``made`` has a result and a stream."""
    store = made / "store"
    shutil.rmtree(store, ignore_errors=True)
    store.mkdir()
    tasks = Checkpoints.opened(store, {"seed": 1}, "tasks")
    for number in range(TASKS):
        tasks.add({number: {"number": number, "text": "x" * 300}})
    few, many = {FLIPPED: 12, CUT: 4}, {FLIPPED: 20, CUT: 10}
    return {
        "a result that is loaded": Read(made / "r1", _result, few),
        "a result whose posterior is a prior": Read(made / "r1", _prior, few),
        "a result that a design builds on": Read(made / "r1", _known, {}),
        "a stream that is taken up": Read(made / "stream", _stream, few),
        "a store of tasks that is read": Read(store, _store, many),
    }


def damage(path: Path, kind: str, rng: Generator) -> str:
    """Damage a file; where."""
    raw = bytearray(path.read_bytes()) if path.is_file() else bytearray(b"x")
    place = int(rng.integers(len(raw)))
    if kind == FLIPPED:
        raw[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(raw)
    elif kind in (CUT, EMPTIED):
        path.write_bytes(raw[: place if kind == CUT else 0])
    elif kind == UNREADABLE:
        path.chmod(0)
        return "as another user"
    else:
        path.unlink()
        if kind == FOLDER:
            path.mkdir()
    return f"byte {place} of {len(raw)}" if kind in (FLIPPED, CUT) else "once"


def _as_nobody(work: Callable[[], str]) -> str:
    """Read as a user who may do nothing; what comes of it, as the process says it."""
    end, begin_ = os.pipe()
    child = os.fork()
    if child == 0:
        if os.geteuid() == 0:
            os.setgroups([])
            os.setgid(NOBODY)
            os.setuid(NOBODY)
        os.write(begin_, work().encode())
        os._exit(0)
    os.close(begin_)
    with os.fdopen(end) as pipe:
        said = pipe.read()
    os.waitpid(child, 0)
    return said


def _attempt(read: Callable[[Path], str], folder: Path, expected: str, names: set[str]) -> str:
    """Read; outcome and detail, with ``|`` between."""
    try:
        return f"{RIGHT}|" if read(folder) == expected else "wrong|"
    except BayesterraError as error:
        text = str(error).replace(str(folder), "DIR")
        named = any(name in str(error) for name in names)
        return f"{CLEAR if named and chr(10) not in text else 'no clear error'}|{text}"
    except Exception as error:  # the fault is what is looked for here
        return f"no clear error|{type(error).__name__}: {str(error)[:80]}"


def read_trial(what: Read, expected: str, place: Path, name: str, kind: str, rng: Generator) -> list[str]:
    """Damage one file of a copy, and read; moment, outcome, detail."""
    with emptied(place):
        folder = place / "copy"
        shutil.copytree(what.folder, folder)
        place.chmod(0o755)
        where = damage(folder / name, kind, rng)
        attempt = partial(_attempt, what.read, folder, expected, {name, Path(name).name})
        outcome, _, detail = (_as_nobody(attempt) if kind == UNREADABLE else attempt()).partition("|")
        return [where, outcome, detail]


def fill(table: Table, work: Path, made: Path, *, share: float = 1.0, only: tuple[str, ...] = ()) -> None:
    """Make the trials that the table lacks, or a share of them for a quick look."""
    for where, what in reads(made).items():
        if only and where not in only:
            continue
        expected = what.read(what.folder)
        for path in sorted(path for path in what.folder.rglob("*") if path.is_file()):
            name = path.relative_to(what.folder).as_posix()
            for kind in KINDS:
                number = max(1, round(share * what.damages.get(kind, 1)))
                for trial in table.missing(kind, where, (f"{name} {n}" for n in range(1, number + 1))):
                    rng = rng_of(kind, where, trial)
                    table.add(kind, where, trial, *read_trial(what, expected, work / "trial", name, kind, rng))
    resumed(table, work, made, share, only)


def resumed(table: Table, work: Path, made: Path, share: float, only: tuple[str, ...]) -> None:
    """Damage what a killed run or calibration has saved, and resume it."""
    run = ("run", quick_study(made / "study"), "--quiet")
    calibrate = ("calibrate", one_study(made / "study-of-one"), "-n", 30, "--workers", 1, "--quiet")
    plan = {
        "a killed run that is resumed": (run, 5, 3, 24),
        "a killed calibration that is resumed": (calibrate, 15, 0, 40),
    }
    for where, (arguments, saved, code, trials) in plan.items():
        numbers = list(table.missing("damage", where, range(1, 1 + max(2, round(share * trials)))))
        if not numbers or (only and where not in only):
            continue
        with emptied(work / "trial") as place:
            command_of = partial(_begun, arguments, place / "out", work / "notes")
            assert command_of().code() == code
            after = content(place / "out")
        with emptied(work / "trial") as place:
            process = command_of()
            while len(process.saved) < saved:
                process.struck(0.01, 0)
            process.struck(0.0)
            process.code()
            killed = work / "killed"
            shutil.rmtree(killed, ignore_errors=True)
            part_of(place / "out").rename(killed)
        for number in numbers:
            with emptied(work / "trial") as place:
                row = _resumed(killed, command_of, place, code, after, rng_of("damage", where, number))
            table.add("damage", where, number, *row)


def _mend(said: str, damaged: Path, part: Path) -> Callable[[], str] | None:
    """What an error asks for, which gives the option to go on with; None where it names nothing to mend."""
    named = [path for path in part.rglob("*") if f"'{path}'" in said]
    if "move it away" in said and named:
        return lambda: _moved_away(*named)
    return (lambda: "--overwrite") if damaged.name in said else None


def _moved_away(*paths: Path) -> str:
    for path in paths:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    return "--resume"


def _begun(arguments: tuple[object, ...], out: Path, notes: Path, *more: str) -> Process:
    return Process.begun(command(*arguments, "--out", out, *more), notes)


def _resumed(
    killed: Path, begun: Callable[..., Process], place: Path, code: int, after: dict[str, str], rng: Generator
) -> list[str]:
    part, out = part_of(place / "out"), place / "out"
    shutil.copytree(killed, part)
    files = sorted(path for path in (part / WORK).iterdir() if path.name != "lock")
    path = files[int(rng.integers(len(files)))]
    kind = str(rng.choice([FLIPPED, FLIPPED, CUT, EMPTIED, FOLDER]))
    moment = f"{path.name}: {kind}, {damage(path, kind, rng)}"
    process, said = begun("--resume"), ""
    if process.code() == 2:
        said = process.error
        if not part.exists() or (mend := _mend(said, path, part)) is None:
            return [moment, "no clear error", said]
        process = begun(mend())
    if process.code() != code:
        return [moment, "no clear error", process.error]
    same = content(out) == after and {path.name for path in place.iterdir()} == {"out"}
    return [moment, (CLEAR if said else RIGHT) if same else "wrong", said.replace(str(place), "DIR")]
