"""Kill runs at random moments and resume them; started by a test, prints one JSON line per run.

A program of its own, because it forks: every run is a process that begins with everything imported and
compiled, so that the moments of death fall on the work and not on imports.
"""

import json
import os
import shutil
import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.random import Generator
from short_runs import make_runs_quick

from bayesterra.__main__ import main
from bayesterra.runtime.ownership import SEGMENT, WORK

OUT, PART = Path("out"), Path("out.part")
SEGMENTS = 9
"""Segments that a whole run saves."""


def begun(*options: str) -> int:
    """Start a run as a process of its own; returns its id."""
    child = os.fork()
    if child == 0:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os._exit(main(["run", "study.toml", "--out", str(OUT), *options]))
    return child


def ended(child: int) -> int:
    """Wait for a process; its exit code, below 0 if it was killed."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def killed(child: int, moment: float, wait_for: int = 0) -> bool:
    """Kill a process some seconds after ``wait_for`` segments stand; whether that came before its own end."""
    seen = os.WEXITED | os.WNOHANG | os.WNOWAIT
    while len(segments()) < wait_for and os.waitid(os.P_PID, child, seen) is None:
        time.sleep(0.001)
    time.sleep(moment)
    os.kill(child, signal.SIGKILL)
    return ended(child) == -signal.SIGKILL


def content(folder: Path) -> dict[str, bytes]:
    """Every draw and label of a result, bit for bit, and its summary."""
    with xr.open_datatree(folder / "draws.nc", engine="h5netcdf") as tree:
        groups = {name: tree[name].load() for name in ("posterior", "sample_stats", "posterior_predictive")}
        found = {f"{g}/{n}": v.to_numpy().tobytes() for g, data in groups.items() for n, v in data.items()}
    return {**found, "summary": (folder / "summary.csv").read_bytes()}


def removed(*folders: Path) -> None:
    """Remove folders."""
    for folder in folders:
        shutil.rmtree(folder, ignore_errors=True)


def segments() -> list[Path]:
    """Saved segments of the run in hand."""
    return sorted((PART / WORK).glob("*" + SEGMENT))


def damaged(rng: Generator) -> str | None:
    """Cut off a segment or flip one of its bits; which one it was."""
    if not segments():
        return None
    path = segments()[rng.integers(len(segments()))]
    raw = bytearray(path.read_bytes())
    if rng.random() < 0.5:
        raw = raw[: rng.integers(len(raw))]
    else:
        raw[rng.integers(len(raw))] ^= 1 << int(rng.integers(8))
    path.write_bytes(raw)
    return path.name


def one_run(span: float, plan: int, wait_for: int, rng: Generator, expected: dict[str, bytes]) -> dict[str, Any] | None:
    """Kill a run at a random moment, resume it to its end, compare; None if it was too quick to be killed.

    ``plan`` 1: its resumption is killed as well; 2: one of its segments is damaged. ``wait_for`` above 0: the
    moment falls within 0.1 s after so many segments stand.
    """
    moments = rng.uniform(0.0, span, 2 if plan == 1 else 1).tolist()
    if wait_for:
        moments[0] = rng.uniform(0.0, 0.1)
    if not killed(begun(), moments[0], wait_for):
        removed(OUT, PART)
        return None
    found = {"moments": moments, "segments": len(segments()), "stood": OUT.exists()}
    found["damaged"] = damaged(rng) if plan == 2 else None
    for moment in moments[1:]:
        killed(begun("--resume"), moment)
    found |= {"code": ended(begun("--resume")), "same": content(OUT) == expected}
    found |= {"part": PART.exists(), "files": sorted(path.name for path in OUT.iterdir())}
    removed(OUT, PART)
    return found


def kill_all(number: int, seed: int) -> None:
    """Kill ``number`` runs: every other one while segments are saved, the rest at any moment of a run's time.

    Waiting for a segment keeps the stages of death apart on machines of any speed.
    """
    rng = np.random.default_rng(seed)
    make_runs_quick()
    main(["run", "study.toml", "--out", "undisturbed", "--quiet"])  # this also compiles what is compiled
    expected, started = content(Path("undisturbed")), time.perf_counter()
    code, span = ended(begun()), time.perf_counter() - started
    print(json.dumps({"span": span, "code": code, "same": content(OUT) == expected}), flush=True)  # noqa: T201
    removed(OUT)
    done = 0
    while done < number:
        wait_for = done // 2 % SEGMENTS + 1 if done % 2 else 0
        if (found := one_run(span, done % 3, wait_for, rng, expected)) is not None:
            print(json.dumps(found), flush=True)  # noqa: T201
            done += 1


if __name__ == "__main__":
    kill_all(int(sys.argv[1]), int(sys.argv[2]))
