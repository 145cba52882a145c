"""Faults at every call of the operating system that changes a file, one by one, while something is saved.

``failing.c`` counts those calls below a folder and kills the process at the k-th of them, or lets it find the
disk full or in error; this is done for every k. Then the saving is repeated without a fault.
"""

from __future__ import annotations

import ctypes
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from bench import Bench, Saving, nothing
from trials import HIT, Process, Table, emptied, kept_replications, on_a_grid, one_study

import bayesterra as bt
from bayesterra.analysis.run import load_result
from bayesterra.checking.calibration import CalibrationRequest, calibrate_study
from bayesterra.checking.ranks import Calibration
from bayesterra.runtime.checkpoints import Checkpoints
from bayesterra.study.study import load_study

KINDS = {
    "kill before a call": 1,
    "kill within a write, or after a call": 2,
    "disk full from a call on": 3,
    "input/output error at a call": 4,
}
TASKS = 6


def make_saving_quick() -> None:
    """Work out once what would be the same in every trial and touches no file."""
    known: dict[Any, Any] = {}
    netcdf, power = xr.DataTree.to_netcdf, vars(Calibration)["power"].func

    def to_netcdf(self: xr.DataTree, *_: Any, **how: Any) -> Any:
        if id(self) not in known:
            known[id(self)] = self, netcdf(self, **how)
        return known[id(self)][1]

    def power_of(self: Calibration) -> Any:
        if len(self.table) not in known:
            known[len(self.table)] = power(self)
        return known[len(self.table)]

    type.__setattr__(xr.DataTree, "to_netcdf", to_netcdf)
    type.__setattr__(Calibration, "power", property(power_of))


def savings(made: Path) -> dict[str, Saving]:
    """What is saved, by name; ``made`` has two results."""
    make_saving_quick()
    second = load_result(made / "r2")
    streams = [_stream(made, rows) for rows in (1, 2)]
    study = load_study(one_study(made / "study-of-one"))
    job = CalibrationRequest(study, 20, seed=2, fit=on_a_grid)

    def save_result(folder: Path, overwrite: bool = False) -> int:
        second.save(folder / "out", overwrite=overwrite)
        return 0

    def save_stream(folder: Path) -> int:
        streams[1].save(folder / "out", overwrite=True)
        return 0

    def calibrate(folder: Path) -> int:
        calibrate_study(job, folder / "out", resume=True, quiet=True)
        return 0

    return {
        "a result": Saving(nothing, save_result),
        "a result in place of another": Saving(
            lambda folder: shutil.copytree(made / "r1", folder / "out"),
            partial(save_result, overwrite=True), stays=True,
        ),
        "a stream in place of another": Saving(
            lambda folder: streams[0].save(folder / "out"), save_stream, stays=True
        ),
        "segments of a run": Saving(
            lambda folder: (folder / "checkpoint").mkdir(), _segments, kept=_kept_segments, out=False
        ),
        "a store of tasks": Saving(nothing, _tasks, kept=_kept_tasks, out=False),
        "a calibration": Saving(nothing, calibrate, kept=kept_replications),
    }  # fmt: skip


def _stream(made: Path, rows: int) -> bt.Stream:
    stream = bt.Stream(load_study(one_study(made / "study-of-one")), particles=128)
    for _, row in pd.read_csv(HIT / "measurements.csv").iloc[1 : rows + 1].drop(columns="use").iterrows():
        stream.add(row)
    return stream


def _segments(folder: Path) -> int:
    run = Checkpoints.opened(folder / "checkpoint", {"seed": 1})
    for number in range(TASKS):
        if run.load(f"round-{number}") is None:
            run.save(f"round-{number}", {"a": np.full(3000, float(number))})
    return 0


def _kept_segments(folder: Path) -> set[str]:
    run = Checkpoints.opened(folder / "checkpoint", {"seed": 1})
    found = {f"round-{n}": run.load(f"round-{n}") for n in range(TASKS)}
    return {n for n, s in found.items() if s and (s["a"] == float(n[-1])).all() and len(s["a"]) == 3000}


def _tasks(folder: Path) -> int:
    store = Checkpoints.opened(folder, {"seed": 1}, "tasks")
    for number in {*range(TASKS)} - {*store.tasks()}:
        store.add({number: {"number": number, "text": "x" * 3000}})
    return 0


def _kept_tasks(folder: Path) -> set[str]:
    found = Checkpoints.opened(folder, {"seed": 1}, "tasks").tasks()
    return {f"task-{n}" for n, task in found.items() if task == {"number": n, "text": "x" * 3000}}


def _library() -> ctypes.CDLL:
    return ctypes.CDLL(None)


def arm(place: Path, call: int, kind: int) -> None:
    """From now on count the calls below a place, and let one of them fail."""
    _library().arm(str(place).encode() + b"/", ctypes.c_long(call), kind)


def counted(save: Callable[[], int], place: Path, work: Path, code: int = 0) -> int:
    """How many calls there are in undisturbed work, of that exit code."""

    def count() -> int:
        ended = save()
        (work / "count").write_text(str(_library().counted()), encoding="utf-8")
        return ended

    assert Process.begun(count, work / "notes", partial(arm, place, 0, 0)).code() == code
    return int((work / "count").read_text(encoding="utf-8"))


def calls(saving: Saving, work: Path) -> int:
    """How many calls there are in an undisturbed saving."""
    with emptied(work / "trial") as place:
        saving.prepare(place)
        return counted(lambda: saving.save(place), place, work)


def trial(bench: Bench, call: int, kind: int) -> tuple[str, str]:
    """Fail at one call, look, repeat, look again; outcome and detail."""
    with emptied(bench.place):
        bench.fresh()
        process = bench.begun(partial(arm, bench.place, call, kind))
        return bench.judged(process, killed=kind < 3)


def fill(table: Table, work: Path, made: Path, *, share: float = 1.0, only: tuple[str, ...] = ()) -> None:
    """Make the trials that the table lacks: at every call, or at a share of them for a quick look."""
    every = max(1, round(1 / share))
    for name, saving in savings(made).items():
        if only and name not in only:
            continue
        with emptied(work / "trial") as place:  # in this process, for what is computed or imported once
            saving.prepare(place)
            saving.save(place)
        bench, number = Bench.of(saving, work), calls(saving, work)
        for fault, kind in KINDS.items():
            for call in table.missing(fault, name, range(1 + (kind - 1) % every, number + 1, every)):
                table.add(fault, name, call, f"{call} of {number}", *trial(bench, int(call), kind))
