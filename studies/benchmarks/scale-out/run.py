"""What thousands of tasks cost beside their own work, on one machine and on a Dask cluster.

Usage: python run.py [PART ...]. Parts: synthetic, m2, dask, summary (default: all). Finished parts are only
summarised; an interrupted one begins anew. Tables are written beside this script.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import SeedSequence, default_rng

import bayesterra as bt
from bayesterra.checking.calibration import CalibrationRequest, calibrate, calibrate_study
from bayesterra.checking.short_runs import Fitted
from bayesterra.likelihood.posterior import draw_cut_prior
from bayesterra.runtime.checkpoints import Checkpoints, finished_tasks
from bayesterra.runtime.engines import ended
from bayesterra.runtime.folders import part_of
from bayesterra.runtime.ownership import WORK
from bayesterra.runtime.status import job_folder

HERE = Path(__file__).parent
WORKERS = 2
TASKS = {"synthetic": 8000, "m2": 2000}
EVERY = {"synthetic": 400, "m2": 100}
"""Tasks between two rows of a table."""
DASK_TASKS = {5000: 150, 100_000: 40}
"""Tasks by the draws of the prior that each of them weighs: short and long ones."""
SLIPS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.6)
NOISE = {"sinkage": 20e-3, "drawbar_pull": 30.0, "resistance_moment": 6.0}
"""Standard deviations, SI: twenty times those of studies/calibration, so that a cheap fit is a right one."""
PRIOR_DRAWS, ENOUGH = 5000, 100.0
"""Draws of the prior that a fit weighs, and effective ones from which it counts as converged."""


def study() -> bt.Study:
    """The study of studies/calibration with coarse readings: M2, all eight parameters free."""
    table = pd.DataFrame(
        {"slip": SLIPS, "load [N]": 80.0, "sinkage [mm]": 5.0, "drawbar_pull [N]": 10.0, "resistance_moment [N m]": 3.0}
    )
    return bt.Study(
        table,
        {"Wh32": bt.Wheel(0.15735, 0.165, 0.010, 30, shearing_radius_coefficient=0.65)},
        title="Cheap calibration of M2",
        model="M2",
        slip_reference="shearing",
        kind="simulated",
        source="studies/benchmarks/scale-out/run.py",
        priors={"set": "paper-box"},
        noise=NOISE,
    )


@dataclass(frozen=True)
class WeighedPrior:
    """Draws of the cut prior by their likelihood: right for coarse readings, and cheap."""

    draws: int = PRIOR_DRAWS

    def __call__(self, simulated: bt.Study, seed: SeedSequence) -> Fitted:
        """Sample the posterior of a study."""
        drawing, choosing = (default_rng(stream) for stream in seed.spawn(2))
        target = bt.posterior(simulated)
        x = draw_cut_prior(target, self.draws, drawing).x
        log = target.log_prior_and_likelihood(x)[1]
        weights = np.exp(log - log.max())
        weights /= weights.sum()
        effective = float(1 / np.square(weights).sum())
        return Fitted(x[choosing.choice(len(x), 1000, p=weights)], effective, 1.0, effective >= ENOUGH)


@dataclass(frozen=True)
class Synthetic:
    """A task that is over at once, with an outcome of the size of a replication's."""

    seed: int = 1

    def __call__(self, task: int) -> dict[str, Any]:
        """Draw sixteen numbers."""
        values = default_rng(SeedSequence(self.seed, spawn_key=(task,))).random(16)
        return {"task": task, "status": "converged", "ranks": {f"q{i}": v for i, v in enumerate(values)}}


def resident() -> tuple[float, float]:
    """Resident memory of this process now and at its peak, MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6


def stored(part: Path) -> float:
    """Size of the finished tasks, MB."""
    return sum(path.stat().st_size for path in (part / WORK).glob("task-*")) / 1e6


class Watch:
    """Notes time, memory and size of the store as tasks end; one line per row, so that a kill loses none."""

    def __init__(self, name: str, out: Path) -> None:
        self._every, self._part, self._rows = EVERY[name], part_of(out), out.parent
        self._next, self._began = 0, time.perf_counter()

    def __call__(self, done: int, new: int) -> None:
        """``done`` tasks are in the store, ``new`` of them from this process."""
        if done < self._next:
            return
        self._next = (done // self._every + 1) * self._every
        seconds = time.perf_counter() - self._began
        with (self._rows / "rows.csv").open("a", encoding="utf-8") as file:
            now, peak = resident()
            file.write(f"{os.getpid()},{done},{new},{seconds:.2f},{now:.1f},{peak:.1f},{stored(self._part):.3f}\n")


def work(name: str, out: Path, n: int) -> None:
    """Do what is missing of a part, in this process and two others."""
    watch, known = Watch(name, out), finished_tasks(part_of(out) / WORK)
    with bt.local_pool(WORKERS) as engine:
        if name == "m2":
            job = CalibrationRequest(study(), n, engine=engine, fit=WeighedPrior())
            calibrate_study(job, out, resume=True, quiet=True, watch=lambda now: watch(now.done, now.done - known))
            return
        with job_folder(out, mark="tasks.json", kind="tasks", resume=True) as (part, _):
            store = Checkpoints.opened(part / WORK, {"seed": 1}, "tasks")
            there = store.tasks()
            missing = [task for task in range(1, n + 1) if task not in there]
            done = n - len(missing)
            watch(done, 0)
            for batch in ended(Synthetic(), missing, engine):
                store.add(dict(batch))
                done += len(batch)
                watch(done, done - known)
            (part / "tasks.json").write_text(json.dumps(store.tasks()), encoding="utf-8")


def through_the_store(name: str, n: int) -> None:
    """Run a part in a process of its own, kill that half-way without warning, and let another one go on."""
    out = HERE / "unfinished" / name / "out"
    shutil.rmtree(out.parent, ignore_errors=True)
    out.parent.mkdir(parents=True)
    store = part_of(out) / WORK
    command = [sys.executable, __file__, "work", name, str(out), str(n)]
    first = subprocess.Popen(command, start_new_session=True)
    while finished_tasks(store) < n // 2:
        if first.poll() is not None:
            raise RuntimeError(f"the work on {name} ended before it was killed")
        time.sleep(0.05)
    os.killpg(first.pid, signal.SIGKILL)  # workers too, as when a machine stops
    first.wait()
    before = bt.read_tasks(out)
    subprocess.run(command, check=True)
    after = final(name, out)
    rows = pd.read_csv(out.parent / "rows.csv", names=ROW)
    second = rows[rows["process"] != first.pid]
    counts = {
        "tasks": n,
        "in_the_store_at_the_kill": len(before),
        "done_after_it": int(second["new"].max()),
        "in_the_end": len(after),
        "changed_by_the_resume": changed(before.set_index("task"), after.loc[before["task"]]),
    }
    rows["process"] = np.where(rows["process"] == first.pid, "killed", "resumed")
    rows.to_csv(HERE / f"{name}.csv", index=False)
    (HERE / f"{name}.json").write_text(json.dumps(counts, indent=1) + "\n", encoding="utf-8")
    shutil.rmtree(HERE / "unfinished")


ROW = ["process", "done", "new", "seconds", "resident_mb", "peak_mb", "store_mb"]


def changed(before: pd.DataFrame, after: pd.DataFrame) -> int:
    """Tasks of which any number, processor seconds included, differs by more than a file's last digit."""
    numbers = before.select_dtypes("number").columns.intersection(after.columns)
    same = np.isclose(before[numbers], after[numbers], rtol=1e-5, atol=1e-12, equal_nan=True)
    return int((~same).any(axis=1).sum())


def final(name: str, out: Path) -> pd.DataFrame:
    """All outcomes of a finished part by task."""
    if name == "m2":
        return pd.read_csv(out / "ranks.csv").set_index("task")
    content = json.loads((out / "tasks.json").read_text(encoding="utf-8"))
    return pd.DataFrame([{"task": one["task"], **one["ranks"]} for one in content.values()]).set_index("task")


@contextmanager
def cluster(folder: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A Dask scheduler and two workers on loopback: its address, and the processes of the workers."""
    processes: list[subprocess.Popen[bytes]] = []

    def start(what: str, *arguments: str) -> None:
        command = [sys.executable, "-m", f"distributed.cli.dask_{what}", "--no-dashboard", *arguments]
        processes.append(subprocess.Popen(command, stderr=subprocess.DEVNULL, cwd=folder))

    try:
        where = folder / "scheduler.json"
        start("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(where))
        while not where.exists() or not where.read_text():
            time.sleep(0.1)
        address = json.loads(where.read_text())["address"]
        for _ in range(WORKERS):
            start("worker", address, "--nthreads", "1", "--no-nanny")
        yield address, processes[1:]
    finally:
        for process in processes:
            process.kill()
            process.wait()


def timed(
    engine: bt.Engine, draws: int, watch: Callable[[int], None] = lambda done: None
) -> tuple[pd.DataFrame, dict[str, float]]:
    """A calibration's table; the seconds that it took and the processor seconds of its tasks."""
    began = time.perf_counter()
    found = calibrate(
        study(), n=DASK_TASKS[draws], engine=engine, fit=WeighedPrior(draws), progress=lambda now: watch(now.done)
    )
    took = time.perf_counter() - began
    seconds = {"seconds": took, "processor_seconds_per_task": float(found.table["seconds"].mean())}
    return found.table.drop(columns="seconds"), seconds


def on_dask() -> None:
    """One process, two Dask workers, the same again, and two workers of which one is killed half-way."""
    rows: list[dict[str, Any]] = []
    with TemporaryDirectory() as scratch, cluster(Path(scratch)) as (address, workers):
        engine, here = bt.dask_cluster(address), bt.in_process()
        while engine.workers < WORKERS:
            time.sleep(0.2)
        for one in (engine, here):  # everything is imported and compiled
            calibrate(study(), n=20, engine=one, fit=WeighedPrior())

        def kill(done: int) -> None:
            if done >= DASK_TASKS[PRIOR_DRAWS] // 2:
                workers[0].kill()

        cases: list[tuple[str, bt.Engine, int, Callable[[int], None] | None]] = [
            ("one process", here, 1, None),
            ("two Dask workers", engine, WORKERS, None),
            ("one process again", here, 1, None),
            ("two Dask workers again", engine, WORKERS, None),
        ]
        for draws in sorted(DASK_TASKS, reverse=True):
            last = [("two Dask workers, one killed half-way", engine, WORKERS, kill)]
            right, _ = timed(here, draws)
            for case, one, number, watch in cases + (last if draws == PRIOR_DRAWS else []):
                table, took = timed(one, draws, watch or (lambda done: None))
                rate = len(table) / took["seconds"] / number
                head = {"case": case, "workers": number, "tasks": len(table)}
                found = {**head, "identical": table.equals(right), **took, "tasks_per_second_and_worker": rate}
                rows.append(found)
        engine.shutdown()
    pd.DataFrame(rows).to_csv(HERE / "dask.csv", index=False, float_format="%.4g")


def summary() -> None:
    """Print the tables of the README."""
    for name in TASKS:
        if not (HERE / f"{name}.csv").is_file():
            continue
        rows = pd.read_csv(HERE / f"{name}.csv")
        print(name, json.loads((HERE / f"{name}.json").read_text(encoding="utf-8")))
        for process, own in rows.groupby("process"):
            first, last = own[own["new"] > 0].iloc[0], own.iloc[-1]  # from the first outcome of a worker on
            rate = (last["new"] - first["new"]) / (last["seconds"] - first["seconds"])
            sizes = f"peak {last['peak_mb']:.0f} MB, store {last['store_mb']:.2f} MB"
            print(f"  {process}: {rate:.1f} tasks/s, {sizes}")
        print(rows.to_string(index=False))
    if (HERE / "dask.csv").is_file():
        print(pd.read_csv(HERE / "dask.csv").to_string(index=False))


def main(arguments: list[str]) -> None:
    """Run parts."""
    if arguments[:1] == ["work"]:
        return work(arguments[1], Path(arguments[2]), int(arguments[3]))
    for part in arguments or ["synthetic", "m2", "dask"]:
        if part == "dask" and not (HERE / "dask.csv").is_file():
            on_dask()
        if part in TASKS and not (HERE / f"{part}.csv").is_file():
            through_the_store(part, TASKS[part])
    return summary()


if __name__ == "__main__":
    main(sys.argv[1:])
