"""Folders that are not one's own: two processes in one, one that is removed, one that is read-only."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from bench import Bench
from damage import NOBODY
from moments import disturbed, span_of
from trials import CLEAR, RIGHT, Process, Table, content, emptied, rng_of, sums_hold

TWO, GONE, TAKEN = ("two processes in one folder", "folder removed while it is written", "folder removed and taken")
READ_ONLY = "read-only folder"
NOTED = 0.02
"""Seconds for the note on a task that was saved just before its folder went."""
TRIALS = {
    TWO: {"run": 5, "calibrate": 10, "follow over an old stream": 8, "design over an old one": 4},
    GONE: {"run": 6, "calibrate": 12},
    TAKEN: {"calibrate": 10},
    READ_ONLY: {"run": 1, "calibrate": 1, "follow over an old stream": 1, "a store of tasks": 1},
}


def two(bench: Bench, moment: float, span: float) -> list[object]:
    """Begin a second process some time after the first; one of them at least ends right."""
    bench.fresh()
    first = bench.begun()
    time.sleep(moment)
    second = bench.begun_again()
    codes, said = (first.code(), second.code()), []
    for process, code in zip((first, second), codes, strict=True):
        if code == bench.saving.code:
            continue
        if code != 2 or process.error.startswith("not one line"):
            return ["no clear error", f"{code} {process.error}"]
        said.append(process.error)
    if len(said) == 2:
        return ["both failed", " ".join(said)]
    return _whole(bench, said)


def gone(bench: Bench, moment: float, span: float) -> list[object]:
    """Remove the folder of work from under a process; what it saves from then on must be there."""
    bench.fresh()
    process = bench.begun()
    time.sleep(moment)
    while (bench.place / "out.part").exists():  # a file that comes while it goes leaves a part of it
        shutil.rmtree(bench.place / "out.part", ignore_errors=True)
    time.sleep(NOTED)
    return [*bench.judged(process, killed=False, removed=frozenset(process.saved))]


def taken(bench: Bench, moment: float, span: float) -> list[object]:
    """Remove the folder from under a process and begin another one in its place."""
    bench.fresh()
    first = bench.begun()
    time.sleep(moment)
    shutil.rmtree(bench.place / "out.part", ignore_errors=True)
    second = bench.begun_again()
    codes, said = (first.code(), second.code()), []
    for process, code in zip((first, second), codes, strict=True):
        if code != bench.saving.code:
            if code != 2 or process.error.startswith("not one line"):
                return ["no clear error", f"{code} {process.error}"]
            said.append(process.error)
    if len(said) == 2:  # then a third one finds nothing in its way
        problem = bench.ended(set()) if bench.saving.kept is None else None
        third = bench.begun_again()
        if problem or third.code() != bench.saving.code:
            return ["not to be repeated", third.error]
    return _whole(bench, said)


def read_only(bench: Bench, moment: float, span: float) -> list[object]:
    """Work as a user who may not write there."""
    bench.fresh()
    before = sorted(path.name for path in bench.place.iterdir())
    bench.place.chmod(0o555)
    process = Process.begun(lambda: bench.saving.save(bench.place), bench.notes, _nobody)
    code = process.code()
    bench.place.chmod(0o755)
    if code != 2 or process.error.startswith("not one line"):
        return ["no clear error", f"{code} {process.error}"]
    if sorted(path.name for path in bench.place.iterdir()) != before:
        return ["remains", ""]
    return [CLEAR, process.error]


def _nobody() -> None:
    if os.geteuid() == 0:
        os.setgroups([])
        os.setgid(NOBODY)
        os.setuid(NOBODY)


def _whole(bench: Bench, said: list[str]) -> list[object]:
    """The result stands, whole and right, and nothing else does."""
    out = bench.place / "out"
    if not out.exists() or content(out) != bench.after or not sums_hold(out):
        return ["wrong", " ".join(said)]
    remains = {path.name for path in bench.place.iterdir()} - {"out"}
    remains |= {path.name for path in out.iterdir()} & {"checkpoint", "status.json"}
    return ["remains", " ".join(sorted(remains))] if remains else [CLEAR if said else RIGHT, " ".join(said)]


FAULTS: dict[str, Callable[[Bench, float, float], list[object]]] = {
    TWO: two, GONE: gone, TAKEN: taken, READ_ONLY: read_only,
}  # fmt: skip


def fill(table: Table, work: Path, made: Path, *, share: float = 1.0, only: tuple[str, ...] = ()) -> None:
    """Make the trials that the table lacks, or a share of them for a quick look."""
    jobs = disturbed(made)
    for where in dict.fromkeys(where for plan in TRIALS.values() for where in plan):
        plan = {fault: list(table.missing(fault, where, range(1, 1 + max(1, round(share * p[where])))))
                for fault, p in TRIALS.items() if where in p}  # fmt: skip
        if not any(plan.values()) or (only and where not in only):
            continue
        with emptied(work / "trial") as place:  # what is imported late must be there for one without rights
            jobs[where].saving.prepare(place)
            silent(partial(jobs[where].saving.save, place))
        bench = Bench.of(jobs[where].saving, work)
        span = span_of(bench)
        for fault, numbers in plan.items():
            for number in numbers:
                moment = float(rng_of(fault, where, number).uniform(0.0, span))
                with emptied(bench.place):
                    found = FAULTS[fault](bench, moment, span)
                text = str(found[1]).replace(str(bench.place), "DIR")
                table.add(fault, where, number, f"{moment:.3f} s", found[0], text)


def silent(work: Callable[[], int]) -> None:
    """Work in this process, without a word."""
    import contextlib
    import io

    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        work()
