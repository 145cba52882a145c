"""Runs that are killed, by the signal that no process can answer, and resumed."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from short_runs import quick_study

from tests.support.choice import ALL

KILLS, NOT_CONVERGED = 20 if ALL else 8, 3


@pytest.mark.slow
def test_a_killed_run_resumes_to_the_same_draws(tmp_path: Path) -> None:
    """After random kills, further ones while resuming, and damage, all draws are there bit for bit."""
    quick_study(tmp_path)
    done = subprocess.run(
        [sys.executable, str(Path(__file__).parent / "killed_runs.py"), str(KILLS), "1"],
        cwd=tmp_path,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        capture_output=True,
        text=True,
        timeout=3600,
    )
    assert done.returncode == 0, done.stderr
    undisturbed, *runs = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert undisturbed["same"]
    assert len(runs) == KILLS
    for run in runs:
        assert run["same"], run
        assert run["code"] == NOT_CONVERGED, run
        assert not run["part"], run
        assert run["files"] == runs[0]["files"], run
    assert "report.html" in runs[0]["files"]
    assert "checkpoint" not in runs[0]["files"]
    assert len({run["segments"] for run in runs}) > KILLS // 6  # death came at many stages
    assert "Traceback" not in done.stderr
