"""Kills and other signals at moments drawn evenly over the time that an undisturbed process takes."""

from __future__ import annotations

import shutil
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from bench import Bench, Saving, nothing
from short_runs import quick_study
from trials import Process, Table, command, emptied, kept_replications, kept_segments, on_a_grid, one_study, rng_of

from bayesterra.checking.calibration import CalibrationRequest, calibrate_study
from bayesterra.runtime.checkpoints import Checkpoints
from bayesterra.runtime.engines import local_pool
from bayesterra.study.study import load_study

KILL, STOP, INTERRUPT = "kill -9", "SIGTERM", "SIGINT"
SIGNALS = {KILL: signal.SIGKILL, STOP: signal.SIGTERM, INTERRUPT: signal.SIGINT}
ROWS, REPLICATIONS, TASKS = 5, 30, 60


@dataclass(frozen=True)
class Disturbed:
    """Something to disturb: what is saved, by which signals, and how often."""

    saving: Saving
    trials: dict[str, int]
    twice: bool = False


def disturbed(made: Path) -> dict[str, Disturbed]:
    """What is disturbed, by name; ``made`` has two results."""
    study, one = quick_study(made / "study"), one_study(made / "study-of-one")
    rows = [_first_rows(one, n, made / f"rows-{n}.csv") for n in range(1, ROWS + 1)]
    job = CalibrationRequest(load_study(one), REPLICATIONS, seed=1, fit=on_a_grid)
    calibrate = ("calibrate", one, "-n", REPLICATIONS, "--workers", 1, "--quiet", "--resume")
    follow = [_into("follow", one, "--data", path, "--particles", 200, "--quiet", "--overwrite") for path in rows]
    design = ("design", one, "--slip", "0.2,0.4", "--quiet", "--overwrite")

    def old(name: str) -> Callable[[Path], None]:
        return lambda folder: shutil.copytree(made / name, folder / "out")

    def two_workers(folder: Path) -> int:
        calibrate_study(_with_workers(job), folder / "out", resume=True, quiet=True)
        return 0

    run = Saving(
        nothing,
        _into("run", study, "--quiet"),
        _into("run", study, "--quiet", "--resume"),
        code=3,
        kept=lambda folder: kept_segments(folder / "out"),
    )
    over = Saving(
        old("r2"),
        _into("run", study, "--quiet", "--overwrite"),
        stays=True,
        code=3,
        again=_into("run", study, "--quiet", "--overwrite", "--resume"),
    )
    return {
        "run": Disturbed(run, {KILL: 40, STOP: 5, INTERRUPT: 5}),
        "run, and its resumption": Disturbed(run, {KILL: 15}, twice=True),
        "run over an old result": Disturbed(over, {KILL: 20}),
        "calibrate": Disturbed(
            Saving(nothing, _into(*calibrate), kept=kept_replications),
            {KILL: 60, STOP: 5, INTERRUPT: 5},
        ),
        "calibrate with two workers": Disturbed(
            Saving(nothing, two_workers, kept=kept_replications), {KILL: 6, STOP: 2}
        ),
        "follow over an old stream": Disturbed(
            Saving(old("stream"), follow[-1], stays=True, interrupted=tuple(follow[:-1])),
            {KILL: 30, STOP: 3},
        ),
        "design over an old one": Disturbed(Saving(old("design"), _into(*design), stays=True), {KILL: 20}),
        "a store of tasks": Disturbed(
            Saving(nothing, _tasks, kept=_kept_tasks, out=False), {KILL: 300}, twice=True
        ),
    }  # fmt: skip


def prepare(made: Path) -> None:
    """Make the old stream and the old design that ``disturbed`` needs, of another seed."""
    one = one_study(made / "study-of-one")
    rows = _first_rows(one, ROWS, made / "rows.csv")
    stream = ("follow", one, "--data", rows, "--particles", 200, "--seed", 7, "--overwrite")
    design = ("design", one, "--slip", "0.3,0.5", "--overwrite")
    for name, arguments in (("stream", stream), ("design", design)):
        work = command(*arguments, "--out", made / name, "--quiet")
        assert Process.begun(work, made / "notes").code() == 0


def _first_rows(study: Path, number: int, to: Path) -> Path:
    """A file of the first rows of a study's measurements, without those that are not used."""
    header, *rows = study.with_name("measurements.csv").read_text(encoding="utf-8").splitlines()
    used = [row for row in rows if not row.endswith(",0")]
    to.write_text("\n".join([header, *used[:number], ""]), encoding="utf-8")
    return to


def _with_workers(job: CalibrationRequest) -> CalibrationRequest:
    return replace(job, engine=local_pool(2))


def _into(*arguments: object) -> Callable[[Path], int]:
    """A command whose result goes to ``out``."""
    return lambda folder: command(*arguments, "--out", folder / "out")()


def _tasks(folder: Path) -> int:
    store = Checkpoints.opened(folder, {"seed": 1}, "tasks")
    for number in sorted({*range(TASKS)} - {*store.tasks()}):
        time.sleep(0.002)
        store.add({number: {"number": number, "text": "x" * 300}})
    return 0


def _kept_tasks(folder: Path) -> set[str]:
    found = Checkpoints.opened(folder, {"seed": 1}, "tasks").tasks()
    return {f"task-{n}" for n, task in found.items() if task == {"number": n, "text": "x" * 300}}


def span_of(bench: Bench) -> float:
    """Seconds that an undisturbed process takes."""
    with emptied(bench.place):
        bench.fresh()
        started = time.perf_counter()
        bench.begun().code()
        return time.perf_counter() - started


def trial(bench: Bench, fault: str, where: str, number: str, span: float, *, twice: bool) -> list[object]:
    """Strike at a random moment (of a resumption too), judge; moment, outcome, detail."""
    rng = rng_of(fault, where, number)
    while True:
        moment = float(rng.uniform(0.0, span))
        with emptied(bench.place):
            bench.fresh()
            process = bench.begun()
            if not process.struck(moment, SIGNALS[fault]) or process.code() == bench.saving.code:
                continue  # it was quicker
            if twice:
                if problem := bench.lost(saved := set(process.saved)):
                    return [f"{moment:.3f} s", *problem]
                process = bench.begun_again()
                process.struck(float(rng.uniform(0.0, span)))
                process.code()
                if again := saved & set(process.saved):
                    return [f"{moment:.3f} s", "done again", " ".join(sorted(again))]
            return [f"{moment:.3f} s", *bench.judged(process, killed=True)]


def fill(table: Table, work: Path, made: Path, *, share: float = 1.0, only: tuple[str, ...] = ()) -> None:
    """Make the trials that the table lacks, or a share of them for a quick look."""
    prepare(made)
    for where, what in disturbed(made).items():
        plan = {fault: list(table.missing(fault, where, range(1, 1 + max(1, round(share * n)))))
                for fault, n in what.trials.items()}  # fmt: skip
        if not any(plan.values()) or (only and where not in only):
            continue
        bench = Bench.of(what.saving, work)
        span = span_of(bench)
        for fault, numbers in plan.items():
            for number in numbers:
                table.add(fault, where, number, *trial(bench, fault, where, number, span, twice=what.twice))
