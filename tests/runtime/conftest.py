"""Engines, and a Dask cluster of two worker processes on loopback, started here."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@dataclass
class Cluster:
    """A scheduler and workers, each a process of its own.

    Attributes
    ----------
    address : of the scheduler.
    """

    folder: Path
    address: str = ""
    processes: list["subprocess.Popen[bytes]"] = field(default_factory=list)

    def start(self, command: str, *arguments: str) -> "subprocess.Popen[bytes]":
        """Start a part of it, which can import the tasks of the tests."""
        line = [sys.executable, "-m", f"distributed.cli.dask_{command}", "--no-dashboard", *arguments]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
        log = (self.folder / f"{command}-{len(self.processes)}.log").open("wb")
        with log:
            process = subprocess.Popen(line, env=environment, stdout=log, stderr=log, cwd=self.folder)
        self.processes.append(process)
        return process

    def start_scheduler(self) -> None:
        """Start the scheduler and wait for its address."""
        where = self.folder / "scheduler.json"
        self.start("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(where))
        end = time.monotonic() + 60
        while not self.address:
            assert time.monotonic() < end, "no scheduler"
            time.sleep(0.05)
            try:
                self.address = json.loads(where.read_text())["address"]
            except (OSError, ValueError):
                continue

    def start_worker(self) -> "subprocess.Popen[bytes]":
        """Start a worker that nobody starts again when it dies."""
        return self.start("worker", self.address, "--nthreads", "1", "--no-nanny", "--death-timeout", "30")

    def stop(self) -> None:
        """End all processes."""
        for process in self.processes:
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A scheduler and two workers."""
    made = Cluster(tmp_path_factory.mktemp("cluster"))
    try:
        made.start_scheduler()
        made.start_worker()
        made.start_worker()
        yield made
    finally:
        made.stop()


@pytest.fixture
def importable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let worker processes import ``tests.runtime.tasks``."""
    monkeypatch.syspath_prepend(str(ROOT))
