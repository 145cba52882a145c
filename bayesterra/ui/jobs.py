"""Jobs: commands of the command line, each a process of its own, one after the other, kept on the disk."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import secrets
import signal
import sys
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from zlib import crc32

from bayesterra.errors import BayesterraError, StudyError, in_short, printable
from bayesterra.runtime.folders import part_of
from bayesterra.runtime.ownership import unfinished
from bayesterra.runtime.reading import SUMS, read_json, read_text
from bayesterra.runtime.status import STATUS_FILE
from bayesterra.ui.folder import Folder, checked_entry, write_record

QUEUE = "queue.json"
WAITING, RUNNING, DONE, FAILED, STOPPED = "waiting", "running", "done", "failed", "stopped"
NOT_CONVERGED, INTERRUPTED = 3, 130
VERBS = {
    "run": "result", "soiltest": "result", "compare": "comparison", "design": "design",
    "identify": "identifiability", "holdout": "holdout", "calibrate": "calibration",
}  # fmt: skip
"""Commands that a job may be, and what their folders are called by."""
OPTIONS = re.compile(r"--(seed|number|load|about)=[\w .,]{1,60}|--overwrite|--prior-only")
"""Options that a job may have, each with its value."""
RESUMABLE = ("run", "design", "calibrate")
"""Commands that go on with what was saved."""
STALE = 20.0
"""Seconds after which a status that nobody writes again is that of a process that is gone."""
PATIENCE = 30.0
"""Seconds that an interrupted command has to put its work down."""
POLL = 1.0
TAKEN = "is being written by another run"
"""Words of a command whose folder another process holds."""


@dataclass(frozen=True)
class Job:
    """A command on an entry of the folder, and how far it is."""

    verb: str
    subject: tuple[str, ...]
    out: str
    options: tuple[str, ...] = ()
    number: str = field(default_factory=lambda: secrets.token_hex(6))
    state: str = WAITING
    said: str = ""
    """Last words of a command that failed."""

    @property
    def how(self) -> str:
        """Options in words."""
        return ", ".join(option.removeprefix("--").replace("-", " ").replace("=", " ") for option in self.options)

    def command(self, folder: Folder) -> list[str]:
        """Arguments of the command line."""
        place = folder.root / checked_entry(self.out)
        folder.inside(place)
        folder.inside(part_of(place))
        subject = [str(folder.root / name) for name in self.subject]
        resume = ["--resume"] if self.verb in RESUMABLE and unfinished(part_of(place))[1] else []
        quiet = [] if self.verb == "compare" else ["--quiet"]
        if self.verb not in VERBS or not all(OPTIONS.fullmatch(each) for each in self.options):
            raise StudyError("this job is not one that this page makes")
        return [self.verb, *subject, "--out", str(place), *self.options, *quiet, *resume]


@dataclass(frozen=True)
class Progress:
    """Content of a status file."""

    stage: str
    done: float
    seconds_left: float | None
    steps: int | None
    ess: float | None
    r_hat: float | None

    @property
    def left(self) -> str:
        """Time left in words."""
        if self.seconds_left is None:
            return ""
        return f"{self.seconds_left / 60:.0f} min left" if self.seconds_left > 90 else f"{self.seconds_left:.0f} s left"


class Queue:
    """Jobs of a folder. All methods but :meth:`progress` belong to the thread of the server's loop."""

    def __init__(self, folder: Folder) -> None:
        self._folder, self._wake = folder, asyncio.Event()
        self._process: asyncio.subprocess.Process | None = None
        self._ending = False
        self._jobs: list[Job] = list(_read(folder.hidden / QUEUE))

    @property
    def jobs(self) -> tuple[Job, ...]:
        """All jobs, in the order in which they came."""
        return tuple(self._jobs)

    @property
    def states(self) -> str:
        """Digest of the list, by which a page knows that it is the one it shows."""
        return f"{crc32(repr([(job.number, job.state) for job in self._jobs]).encode()):08x}"

    def add(self, job: Job) -> None:
        """Put a job at the end of the queue."""
        self._jobs.append(job)
        self._changed()

    def stop(self, number: str) -> None:
        """Interrupt a job at work, which saves what it has; take one that waits from the queue."""
        job = self._job(number)
        if job.state == WAITING:
            self._set(job, STOPPED)
        elif job.state == RUNNING:
            self._set(job, STOPPED)
            self._interrupt(job)

    def resume(self, number: str) -> None:
        """Let a job that was stopped, or failed, begin again from what it saved."""
        job = self._job(number)
        if job.state in (STOPPED, FAILED):
            self._set(job, WAITING, "")

    def forget(self, number: str) -> None:
        """Take a job that is not at work from the list; what it wrote stays."""
        job = self._job(number)
        if job.state != RUNNING:
            self._jobs.remove(job)
            self._changed()

    def progress(self, job: Job) -> Progress | None:
        """How far a job is; None where it says nothing."""
        status = _status(self._folder, job)
        if not status:
            return None
        steps = status.get("steps")
        return Progress(
            str(status.get("stage", "")), _number(status.get("done")) or 0.0, _number(status.get("seconds_left")),
            steps if isinstance(steps, int) else None, _number(status.get("ess")), _number(status.get("r_hat")),
        )  # fmt: skip

    def saved(self, job: Job) -> bool:
        """True where a job that ended early left work that it can go on from."""
        return job.verb in RESUMABLE and bool(unfinished(part_of(self._folder.root / job.out))[1])

    async def work(self) -> None:
        """Do one job after the other, for ever; those first that a server before this one left at work."""
        while True:
            self._wake.clear()
            todo = [job for job in self._jobs if job.state == RUNNING] or [j for j in self._jobs if j.state == WAITING]
            if not todo:
                await self._wake.wait()
                continue
            try:
                await self._do(todo[0])
            except (OSError, BayesterraError) as error:
                self._end(todo[0].number, FAILED, str(error))

    async def close(self) -> None:
        """Interrupt the job at work, and wait until it has put its work down; the next server goes on with it."""
        self._ending = True
        process = self._process
        if process is not None and process.returncode is None:
            process.send_signal(signal.SIGINT)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(process.wait(), PATIENCE)

    async def _do(self, job: Job) -> None:
        while _is_at_work(self._folder, job):  # of a server that was killed
            await asyncio.sleep(POLL)
        if job.state == RUNNING and _is_finished(self._folder, job):
            return self._end(job.number, DONE)
        for name in job.subject:
            self._folder.opened(name)
        if self._state(job.number) == STOPPED:
            return None
        job = self._set(job, RUNNING)
        command = [sys.executable, "-P", "-m", "bayesterra", *job.command(self._folder)]
        self._process = await asyncio.create_subprocess_exec(
            *command, cwd=self._folder.root, stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE, start_new_session=True,
        )  # fmt: skip
        _, errors = await self._process.communicate()
        code, self._process = self._process.returncode, None
        if self._ending or self._state(job.number) != RUNNING:  # stopped meanwhile, perhaps to go on again
            return None
        if code in (0, NOT_CONVERGED):
            return self._end(job.number, DONE)
        lines = errors.decode(errors="replace").strip().splitlines()
        if any(TAKEN in line for line in lines):  # a process of a server before this one has just begun
            return await asyncio.sleep(POLL)
        said = in_short(printable(lines[-1].removeprefix("error: ")), 600) if lines else f"it ended with code {code}"
        self._end(job.number, STOPPED if code in (INTERRUPTED, -signal.SIGINT) else FAILED, said)
        return None

    def _interrupt(self, job: Job) -> None:
        if self._process is not None and self._process.returncode is None:
            self._process.send_signal(signal.SIGINT)
        elif _is_at_work(self._folder, job):
            os.kill(int(_status(self._folder, job)["pid"]), signal.SIGINT)

    def _job(self, number: str) -> Job:
        for job in self._jobs:
            if job.number == number:
                return job
        raise StudyError("this job is not in the list any more")

    def _state(self, number: str) -> str:
        return next((job.state for job in self._jobs if job.number == number), STOPPED)

    def _end(self, number: str, state: str, said: str = "") -> None:
        for job in self._jobs:
            if job.number == number:
                self._set(job, state, said)
                return

    def _set(self, job: Job, state: str, said: str = "") -> Job:
        changed = replace(job, state=state, said=said)
        self._jobs = [changed if each.number == job.number else each for each in self._jobs]
        self._changed()
        return changed

    def _changed(self) -> None:
        write_record(self._folder.hidden / QUEUE, json.dumps([asdict(job) for job in self._jobs], indent=1) + "\n")
        self._wake.set()


def _read(path: Path) -> list[Job]:
    try:
        content = read_json(path)
        return [
            Job(**{**each, "subject": tuple(each["subject"]), "options": tuple(each["options"])}) for each in content
        ]
    except (OSError, ValueError, TypeError, KeyError):
        return []  # none yet, or not one that we wrote: jobs can be started again


def _status(folder: Folder, job: Job) -> dict[str, Any]:
    try:
        content = read_json(part_of(folder.root / job.out) / STATUS_FILE)
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _is_finished(folder: Folder, job: Job) -> bool:
    place = folder.root / job.out
    return (place / SUMS).is_file() and not part_of(place).exists()


def _is_at_work(folder: Folder, job: Job) -> bool:
    """True where a process that this server did not start works on a job."""
    status = _status(folder, job)
    try:
        age = (datetime.now(UTC) - datetime.fromisoformat(str(status["time"]))).total_seconds()
        return age < STALE and _is_ours(int(status["pid"]))
    except (KeyError, ValueError, TypeError, OSError):
        return False


def _is_ours(process: int) -> bool:
    """True where a process that is alive is a command of the package: what a file says is not enough."""
    return process > 1 and "bayesterra" in read_text(Path("/proc") / str(process) / "cmdline", 2**16).split("\0")


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) else None
