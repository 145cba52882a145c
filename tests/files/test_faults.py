"""Faults done for real: a few of every kind here, all of them in ``studies/faults``."""

import csv
import os
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

STUDY = Path(__file__).parents[2] / "studies" / "faults"
KEPT = {"right", "clear error"}
PLACES = (
    "segments of a run",
    "a result in place of another",
    "a store of tasks",
    "calibrate",
    "follow over an old stream",
    "a result whose posterior is a prior",
    "a store of tasks that is read",
    "simulate",
)


def rows_of(path: Path) -> list[dict[str, str]]:
    """Trials of a table."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="processes and signals as Linux has them")
def test_a_few_of_every_fault(tmp_path: Path) -> None:
    """Each ends right or with one line of error, and loses nothing that was saved."""
    parts = ["points", "moments", "damage", "disks", "sharing", "owned"]
    if shutil.which("cc") is None:
        parts.remove("points")
    command = [sys.executable, str(STUDY / "run.py"), *parts, "--out", str(tmp_path), "--share", "0.04"]
    done = subprocess.run(
        [*command, *(f"--only={place}" for place in PLACES)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        capture_output=True,
        text=True,
        timeout=3600,
    )
    trials = [row for part in parts for row in rows_of(tmp_path / f"{part}.csv")]
    broken = [row for row in trials if row["outcome"] not in KEPT]
    assert not broken
    assert done.returncode == 0, done.stderr
    faults = Counter(row["fault"] for row in trials)
    assert faults["kill -9"] >= 10
    assert {"SIGTERM", "SIGINT", "one bit flipped", "cut short", "removed"} <= {*faults}
    assert {"limit on the size of files", "two processes in one folder", "read-only folder"} <= {*faults}
    if "points" in parts:
        assert faults["kill before a call"] >= 5
        assert faults["disk full from a call on"] >= 5
