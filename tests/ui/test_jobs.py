"""Jobs of a queue: one after the other, stopped, resumed, kept on the disk, and never anything else."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from datetime import UTC, datetime
from pathlib import Path

import pytest

from bayesterra.errors import StudyError
from bayesterra.ui import jobs
from bayesterra.ui.folder import Folder
from bayesterra.ui.jobs import Job, Queue


async def until(queue: Queue, number: str, *states: str) -> Job:
    """Work until a job is in one of some states."""
    work = asyncio.create_task(queue.work())
    for _ in range(600):
        job = next(job for job in queue.jobs if job.number == number)
        if job.state in states:
            break
        await asyncio.sleep(0.05)
    work.cancel()
    return job


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Jobs that take no time: in place of the package a program that says what it was told."""
    code = "import sys, time; print('error: ' + ' '.join(sys.argv[1:3]), file=sys.stderr); sys.exit(2)"
    real = asyncio.create_subprocess_exec

    async def other(*command: str, **how: object) -> object:
        assert command[1:4] == ("-P", "-m", "bayesterra")
        return await real(sys.executable, "-c", code, *command[4:], **how)  # type: ignore[arg-type]

    monkeypatch.setattr(asyncio, "create_subprocess_exec", other)


@pytest.mark.usefixtures("quick")
def test_a_job_that_fails_says_why_and_is_kept(folder: Path) -> None:
    """Its last words stand in the list, also after the next start."""
    queue = Queue(Folder(folder))
    job = Job("run", ("hit-wh32",), "out", ("--seed=3",))
    queue.add(job)
    ended = asyncio.run(until(queue, job.number, jobs.FAILED))
    assert ended.said == f"run {folder / 'hit-wh32'}"
    again = Queue(Folder(folder))
    assert again.jobs == queue.jobs
    again.resume(job.number)
    assert again.jobs[0].state == jobs.WAITING
    again.stop(job.number)
    assert again.jobs[0].state == jobs.STOPPED
    again.forget(job.number)
    assert Queue(Folder(folder)).jobs == ()


@pytest.mark.parametrize(
    "changed",
    [
        {"verb": "simulate"},
        {"options": ["--allow-code"]},
        {"options": ["--out=/tmp/x"]},
        {"out": "../x"},
        {"out": "/x"},
    ],
)
def test_a_queue_from_elsewhere_starts_nothing_else(folder: Path, changed: dict[str, object]) -> None:
    """The file of the queue may come with a folder: what it says is checked like all else."""
    content = {"verb": "run", "subject": ["hit-wh32"], "out": "out", "options": [], "number": "1", "state": "waiting"}
    (folder / ".bayesterra-ui").mkdir()
    (folder / ".bayesterra-ui" / "queue.json").write_text(json.dumps([{**content, **changed}]))
    queue = Queue(Folder(folder))
    with pytest.raises(StudyError):
        queue.jobs[0].command(Folder(folder))
    assert asyncio.run(until(queue, "1", jobs.FAILED)).said


def test_a_status_file_names_no_process_to_be_interrupted(folder: Path) -> None:
    """A process counts as a job only where it is a command of the package."""
    part = folder / "out.part"
    part.mkdir()
    job = Job("run", ("hit-wh32",), "out", state=jobs.RUNNING)
    now = datetime.now(UTC).isoformat()
    for process in (-1, 0, 1, os.getpid()):
        (part / "status.json").write_text(json.dumps({"pid": process, "time": now, "stage": "x", "done": 0.5}))
        assert not jobs._is_at_work(Folder(folder), job)
    progress = Queue(Folder(folder)).progress(job)
    assert progress is not None
    assert progress.done == 0.5


def test_a_broken_queue_is_an_empty_one(folder: Path) -> None:
    """Jobs can be started again."""
    (folder / ".bayesterra-ui").mkdir()
    for content in ("", "[1]", "{}", '[{"verb": 1}]'):
        (folder / ".bayesterra-ui" / "queue.json").write_text(content)
        assert Queue(Folder(folder)).jobs == ()
