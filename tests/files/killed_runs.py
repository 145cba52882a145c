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
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import xarray as xr
from numpy.random import Generator

from bayesterra.__main__ import main
from bayesterra.analysis import inference
from bayesterra.analysis import page as analysis_pages
from bayesterra.analysis.result import RunRecord
from bayesterra.likelihood.posterior import draw_cut_prior
from bayesterra.report.failures import Failures
from bayesterra.runtime.ownership import SEGMENT, WORK
from bayesterra.sampling import sampler
from bayesterra.sampling.adaptation import AdaptationOptions

OUT, PART = Path("out"), Path("out.part")


def make_quick() -> None:
    """Short rounds, a small adaptation, few draws of the prior, and little but files after the sampling."""
    small = partial(AdaptationOptions, particles=128, sweeps=1, components=2, refinements=(2,))
    prior = partial(draw_cut_prior, batch=256)
    vars(sampler).update(WARM_UP_STEPS=10, ROUND_STEPS=6, AdaptationOptions=small, draw_cut_prior=prior)
    vars(inference).update(PRIOR_DRAWS=500, CURVE_DRAWS=50, MODE_DRAWS=200, draw_cut_prior=prior)
    vars(inference).update(fit_all=lambda _: ({}, ()), validate=lambda *_: SimpleNamespace(record=dict))
    type.__setattr__(RunRecord, "check", lambda content, name: None)  # which now lacks the checks
    page = SimpleNamespace(html=lambda: "report\n", failures=Failures())
    vars(analysis_pages)["page"] = lambda _: page


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


def killed(child: int, moment: float) -> bool:
    """Kill a process after so many seconds; whether that came before its own end."""
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


def one_run(span: float, plan: int, rng: Generator, expected: dict[str, bytes]) -> dict[str, Any] | None:
    """Kill a run at a random moment, resume it to its end, compare; None if it was too quick to be killed.

    ``plan`` 1: its resumption is killed as well; 2: one of its segments is damaged.
    """
    moments = rng.uniform(0.0, span, 2 if plan == 1 else 1).tolist()
    if not killed(begun(), moments[0]):
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
    """Kill ``number`` runs, each at a moment uniform over the time of an undisturbed one."""
    rng = np.random.default_rng(seed)
    make_quick()
    main(["run", "study.toml", "--out", "undisturbed", "--quiet"])  # this also compiles what is compiled
    expected, started = content(Path("undisturbed")), time.perf_counter()
    code, span = ended(begun()), time.perf_counter() - started
    print(json.dumps({"span": span, "code": code, "same": content(OUT) == expected}), flush=True)  # noqa: T201
    removed(OUT)
    done = 0
    while done < number:
        if (found := one_run(span, done % 3, rng, expected)) is not None:
            print(json.dumps(found), flush=True)  # noqa: T201
            done += 1


if __name__ == "__main__":
    kill_all(int(sys.argv[1]), int(sys.argv[2]))
