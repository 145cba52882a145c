"""What the parts of this study share: processes to do harm to, quick jobs for them, and tables to go on with.

Processes are forks of one that has everything imported and compiled, so that a fault falls on the work and
not on imports. Each leads a session of its own, so that whatever outlives it is found.
"""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import SeedSequence, default_rng
from shipped import FILES
from short_runs import HELD, PAGE, make_runs_quick, put, quick_study

from bayesterra.__main__ import main
from bayesterra.checking import calibration_page
from bayesterra.checking.short_runs import Fitted, ShortRuns
from bayesterra.errors import BayesterraError, ResultError
from bayesterra.likelihood.posterior import posterior
from bayesterra.models import warm_up
from bayesterra.runtime.checkpoints import Checkpoints, read_tasks
from bayesterra.runtime.folders import part_of
from bayesterra.runtime.ownership import SEGMENT, WORK

HIT = FILES["hit-wh32"].parent
COLUMNS = ("fault", "where", "trial", "moment", "outcome", "detail")
RIGHT, CLEAR = "right", "clear error"
"""Outcomes that keep the promise; every other one breaks it."""
SEED = 2026


def one_study(folder: Path) -> Path:
    """The same with one free parameter, whose posterior :func:`on_a_grid` draws."""
    file = quick_study(folder)
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace(HELD, f"{HELD}c1 = 0.339\n", 1), encoding="utf-8")
    return file


def on_a_grid(study: Any, seed: SeedSequence) -> Fitted:
    """Independent draws of the only free parameter from its posterior on a grid, in some 10 ms."""
    target = posterior(study)
    (law,) = study.prior.laws.values()
    middles = np.linspace(*law.range, 200)
    density = target.log_density(middles[:, None])
    weights = np.exp(density - density.max())
    return Fitted(default_rng(seed).choice(middles, 500, p=weights / weights.sum())[:, None], 500.0, 1.0, True)


def make_results(made: Path) -> None:
    """Make two results of the quick study, ``r1`` and ``r2``, of different seeds."""
    study = quick_study(made / "study")
    for seed in (1, 2):
        work = command("run", study, "--out", made / f"r{seed}", "--seed", seed, "--quiet")
        assert Process.begun(work, made / "notes").code() in (0, 3)


def make_quick() -> None:
    """Quick runs, calibrations of one parameter on a grid, and everything compiled."""
    make_runs_quick()
    put(calibration_page, calibration_page=lambda _: PAGE)
    type.__setattr__(ShortRuns, "__call__", lambda self, study, seed: on_a_grid(study, seed))
    warm_up()


@dataclass
class Process:
    """A process of a trial.

    Attributes
    ----------
    id : of the process and of its session.
    folder : where it leaves what it says (``said``) and what it was told is saved (``saved``).
    """

    id: int
    folder: Path

    @classmethod
    def begun(cls, work: Callable[[], int], notes: Path, before: Callable[[], None] = lambda: None) -> Process:
        """Fork a process that does some work; ``before`` is called in it just before that."""
        shutil.rmtree(notes, ignore_errors=True)
        notes.mkdir(parents=True)
        sys.stdout.flush()
        sys.stderr.flush()
        before_fork = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # it waits for the session
        child = os.fork()
        if child == 0:
            try:
                _in_session(notes)
                code = _outcome(work, before)
                with suppress(OSError):  # disks are full here
                    (notes / "modules").write_text("\n".join(sys.modules), encoding="utf-8")
                os._exit(code)
            finally:  # whatever happens, nothing of the parent's is cleaned up here
                os._exit(71)
        signal.pthread_sigmask(signal.SIG_SETMASK, before_fork)
        return cls(child, notes)

    def import_the_same(self) -> None:
        """Import what it has imported, so that no fault falls on an import in the processes after it."""
        for name in (self.folder / "modules").read_text(encoding="utf-8").split("\n"):
            if name not in sys.modules:
                with suppress(ImportError):
                    import_module(name)

    def struck(self, moment: float, sign: int = signal.SIGKILL) -> bool:
        """Send a signal after so many seconds; whether the process was still there."""
        time.sleep(moment)
        gone, status = os.waitpid(self.id, os.WNOHANG)
        if gone:
            self._code = os.waitstatus_to_exitcode(status)
            return False
        os.kill(self.id, sign)
        return True

    def code(self) -> int:
        """Wait for its end: exit code, below 0 the signal that killed it."""
        if not hasattr(self, "_code"):
            self._code = os.waitstatus_to_exitcode(os.waitpid(self.id, 0)[1])
        return self._code

    @property
    def saved(self) -> list[str]:
        """What it was told is saved, in this order."""
        path = self.folder / "saved"
        return path.read_text(encoding="utf-8").split() if path.exists() else []

    @property
    def error(self) -> str:
        """Its one line of error; a description of what is wrong with it where it is not one."""
        lines = (self.folder / "said").read_text(encoding="utf-8").splitlines()
        errors = [line for line in lines if not line.startswith("note: ")]
        if len(errors) == 1 and errors[0].startswith("error: "):
            return errors[0]
        return f"not one line: {errors[-1][:80] if errors else 'nothing'}"

    def orphans(self, patience: float = 20.0) -> list[int]:
        """Processes of its session that are still there after it has ended, and some time on top."""
        end = time.monotonic() + patience
        while (left := living(self.id)) and time.monotonic() < end:
            time.sleep(0.05)
        return left


def _in_session(notes: Path) -> None:
    """Begin a session of its own, whose words and acknowledgements go to files."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    os.setsid()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(os.open(notes / "said", os.O_WRONLY | os.O_CREAT), 2)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    tell_what_is_saved(os.open(notes / "saved", os.O_WRONLY | os.O_CREAT | os.O_APPEND))


def _outcome(work: Callable[[], int], before: Callable[[], None]) -> int:
    try:
        before()
        return work()
    except BayesterraError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:  # just before the command line had begun, or when it had ended
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGINT)
        raise
    except BaseException:  # the fault is what is looked for here
        traceback.print_exc()
        return 70


def tell_what_is_saved(told: int) -> None:
    """From now on note every segment and task once the call that saves it has returned."""
    save, add = Checkpoints.save, Checkpoints.add

    def told_save(self: Checkpoints, name: str, segment: Any) -> None:
        save(self, name, segment)
        os.write(told, f"{name}\n".encode())

    def told_add(self: Checkpoints, finished: Any) -> None:
        add(self, finished)
        os.write(told, "".join(f"task-{task}\n" for task in finished).encode())

    type.__setattr__(Checkpoints, "save", told_save)
    type.__setattr__(Checkpoints, "add", told_add)


def living(leader: int) -> list[int]:
    """Living processes of a session."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, session = path.read_text(encoding="utf-8").rpartition(")")[2].split()[:4]
        except (OSError, ValueError):
            continue
        if int(session) == leader and state not in "ZX":
            found.append(int(path.parent.name))
    return found


def command(*arguments: object) -> Callable[[], int]:
    """The work of a command line."""
    return partial(main, [str(argument) for argument in arguments])


def kept_segments(out: Path) -> set[str] | None:
    """Sound segments of a run into ``out``; None where the run has ended and needs them no more."""
    if out.exists():
        return None
    work = part_of(out) / WORK
    found = {path.name.removesuffix(SEGMENT): path for path in work.glob("*" + SEGMENT)}
    parts = {name: path.read_bytes().partition(b"\n") for name, path in found.items()}
    return {name for name, (digest, _, rest) in parts.items() if sha256(rest).hexdigest().encode() == digest}


def kept_replications(folder: Path) -> set[str] | None:
    """Replications that are saved, of a calibration into ``out`` of a folder; None where that has ended."""
    if (folder / "out").exists():
        return None
    try:
        return {f"task-{number}" for number in read_tasks(part_of(folder / "out"))["task"]}
    except ResultError:  # there is none yet
        return set()


VOLATILE = {"made", "seconds"}
_KNOWN: dict[str, str] = {}


def content(folder: Path) -> dict[str, str]:
    """Digest of every file of a whole folder, but for times of day and what served the making."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name != "SHA256SUMS" and not name.startswith("checkpoint/"):
            found[name] = _digest(path)
    return found


def _digest(path: Path) -> str:
    """Digest of what a file says, once for every content."""
    raw = sha256(path.read_bytes()).hexdigest()
    if raw not in _KNOWN:
        _KNOWN[raw] = sha256(_timeless(path)).hexdigest()
    return _KNOWN[raw]


def _timeless(path: Path) -> bytes:
    """What a file says, without times and durations."""
    if path.suffix == ".json":
        return json.dumps(_without_times(json.loads(path.read_text(encoding="utf-8"))), sort_keys=True).encode()
    if path.suffix == ".nc":
        import xarray as xr

        with xr.open_datatree(path, engine="h5netcdf") as tree:
            return b"".join(
                f"{node.path}/{name}".encode() + values.to_numpy().tobytes()
                for node in tree.subtree
                for name, values in sorted(node.to_dataset().variables.items())
                if values.dtype.kind in "biuf"
            )
    if path.suffix == ".csv":
        rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
        kept = [i for i, name in enumerate(rows[0]) if name not in ("seconds", "milliseconds")]
        return "\n".join(",".join(row[i] for i in kept) for row in rows).encode()
    return path.read_bytes()


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_times(item) for key, item in value.items() if key not in VOLATILE}
    return [_without_times(item) for item in value] if isinstance(value, list) else value


def sums_hold(folder: Path) -> bool:
    """Whether all files of a folder are as its checksums say, and all are listed."""
    lines = (folder / "SHA256SUMS").read_text(encoding="utf-8").splitlines()
    known = {name: digest for digest, _, name in (line.partition("  ") for line in lines)}
    there = {p.relative_to(folder).as_posix(): p for p in folder.rglob("*") if p.is_file()}
    there = {n: p for n, p in there.items() if n != "SHA256SUMS" and not n.startswith("checkpoint/")}
    return known == {name: sha256(path.read_bytes()).hexdigest() for name, path in there.items()}


def everything(folder: Path) -> dict[str, bytes | str | None]:
    """All that is below a folder: content of files, targets of links, and None for folders."""
    return {
        path.relative_to(folder).as_posix(): os.readlink(path) if path.is_symlink()
        else path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }  # fmt: skip


@dataclass
class Table:
    """Trials that have been made, one row each; a row is on the disk once it is added."""

    path: Path
    rows: list[dict[str, str]] = field(default_factory=list)

    @classmethod
    def opened(cls, path: Path) -> Table:
        """Go on with a table, or begin one."""
        if not path.exists():
            path.write_text(",".join(COLUMNS) + "\n", encoding="utf-8")
        with path.open(encoding="utf-8", newline="") as file:
            return cls(path, list(csv.DictReader(file)))

    def missing(self, fault: str, where: str, trials: Iterable[object]) -> Iterator[str]:
        """Trials that are still to be made."""
        made = {row["trial"] for row in self.rows if (row["fault"], row["where"]) == (fault, where)}
        return (str(trial) for trial in trials if str(trial) not in made)

    def add(self, fault: str, where: str, trial: object, moment: object, outcome: str, detail: str = "") -> None:
        """Note a trial."""
        row = dict(zip(COLUMNS, map(str, (fault, where, trial, moment, outcome, detail)), strict=True))
        self.rows.append(row)
        with self.path.open("a", encoding="utf-8", newline="") as file:
            csv.DictWriter(file, COLUMNS, lineterminator="\n").writerow(row)
        if outcome not in (RIGHT, CLEAR):
            print(f"! {fault}, {where}, {trial}: {outcome} ({detail})", flush=True)


def rng_of(fault: str, where: str, trial: object) -> np.random.Generator:
    """Random numbers of a trial, whichever others are made."""
    key = sha256(f"{fault}/{where}/{trial}".encode()).digest()[:8]
    return default_rng(SeedSequence([SEED, int.from_bytes(key, "little")]))


@contextmanager
def emptied(folder: Path) -> Iterator[Path]:
    """A folder for one trial, empty before and after."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
