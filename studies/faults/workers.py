"""Workers that are killed: processes of a pool on this machine, and of a Dask cluster on loopback."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import light
from trials import RIGHT, Table, emptied, living, rng_of

from bayesterra.runtime.checkpoints import Checkpoints

POOL, DASK = "kill -9 of a pool worker", "kill -9 of a Dask worker"
WHERE = "tasks into a store"
TRIALS = {POOL: 20, DASK: 10}
HERE = Path(__file__).parent
PATIENCE = 120.0


def begun(store: Path, scheduler: str = "") -> subprocess.Popen[str]:
    """A process that does the tasks, with a session of its own."""
    code = f"import light; light.main({str(store)!r}, {scheduler!r})"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE), *filter(None, sys.path)])}
    return subprocess.Popen(
        [sys.executable, "-c", code], env=environment, text=True, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def children(parent: int, sign: str) -> list[int]:
    """Living processes that a process has started and whose command line holds a sign."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            stat = (path / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
            line = (path / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:
            continue
        if int(stat[1]) == parent and stat[0] not in "ZX" and sign in line:
            found.append(int(path.name))
    return sorted(found)


def struck(process: subprocess.Popen[str], workers_of: list[int], sign: str, at: list[int]) -> int:
    """Kill a worker whenever so many tasks are saved; how many were."""
    assert process.stdout is not None
    kills = 0
    for saved, _ in enumerate(process.stdout, start=1):
        if kills < len(at) and saved >= at[kills]:
            there = [one for parent in workers_of for one in children(parent, sign)]
            if there:
                os.kill(there[saved % len(there)], signal.SIGKILL)
                kills += 1
    return kills


def trial(fault: str, number: str, folder: Path, cluster: tuple[str, list[int]] | None) -> list[object]:
    """Kill up to three workers at random, then look; moment, outcome, detail."""
    rng = rng_of(fault, WHERE, number)
    at = sorted(rng.choice(light.TASKS - 5, size=int(rng.integers(1, 4)), replace=False) + 1)
    process = begun(folder, cluster[0] if cluster else "")
    parents, sign = (cluster[1], "spawn_main") if cluster else ([process.pid], "spawn_main")
    kills = struck(process, parents, sign, [int(one) for one in at])
    said = process.communicate()[1].splitlines()
    moment = f"{kills} kills, after {', '.join(map(str, at))} tasks"
    if process.returncode:
        return [moment, "no right end", said[-1] if said else ""]
    store = Checkpoints.opened(folder, {"tasks": light.TASKS}, "tasks")
    found = {task: content["value"] for task, content in store.tasks().items()}
    if found != {task: light.value(task) for task in range(light.TASKS)}:
        return [moment, "wrong", f"{len(found)} of {light.TASKS}"]
    end = time.monotonic() + 20
    while (left := living(process.pid)) and time.monotonic() < end:
        time.sleep(0.05)
    return [moment, "orphans" if left else RIGHT, f"{len(left)} processes" if left else f"killed {kills}"]


@contextmanager
def dask(folder: Path) -> Iterator[tuple[str, list[int]]]:
    """A scheduler and two nannies with a worker each; its address, and the nannies' process numbers."""
    where, processes = folder / "scheduler.json", []
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE), *filter(None, sys.path)])}

    def start(what: str, *arguments: str) -> int:
        line = [sys.executable, "-m", f"distributed.cli.dask_{what}", "--no-dashboard", *arguments]
        with (folder / f"{what}.log").open("ab") as log:
            processes.append(
                subprocess.Popen(line, env=environment, stdout=log, stderr=log, cwd=folder, start_new_session=True)
            )
        return processes[-1].pid

    try:
        start("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(where))
        end = time.monotonic() + PATIENCE
        while not where.exists() or not where.read_text(encoding="utf-8").endswith("}"):
            assert time.monotonic() < end, "no scheduler"
            time.sleep(0.1)
        address = json.loads(where.read_text(encoding="utf-8"))["address"]
        nannies = [start("worker", address, "--nthreads", "1", "--host", "127.0.0.1") for _ in range(2)]
        while not all(children(nanny, "spawn_main") for nanny in nannies):
            assert time.monotonic() < end, "no workers"
            time.sleep(0.1)
        yield address, nannies
    finally:
        for process in reversed(processes):
            for one in living(process.pid):
                os.kill(one, signal.SIGKILL)
            process.wait()


def fill(table: Table, work: Path, made: Path, *, share: float = 1.0, only: tuple[str, ...] = ()) -> None:
    """Make the trials that the table lacks, or a share of them for a quick look."""
    for fault, number in TRIALS.items():
        numbers = list(table.missing(fault, WHERE, range(1, 1 + max(1, round(share * number)))))
        if not numbers or (only and fault not in only):
            continue
        if fault == POOL:
            for one in numbers:
                with emptied(work / "trial") as folder:
                    table.add(fault, WHERE, one, *trial(fault, one, folder, None))
        elif find_spec("distributed") is None:
            print("distributed is not installed: no trials of a Dask cluster")
        else:
            with emptied(work / "cluster") as place, dask(place) as cluster:
                for one in numbers:
                    with emptied(work / "trial") as folder:
                        table.add(fault, WHERE, one, *trial(fault, one, folder, cluster))
