"""Runs that are killed, by the signal that no process can answer, and resumed."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HIT = Path(__file__).parents[2] / "studies" / "hit-wh32"
HELD = 'n0 = 0.85\nn1 = 1.06\nKs = "2500 kPa"\nK = "10 mm"\nc = "0.3 kPa"\nc2 = 0.0\n'
SHORT = "\n[sampling]\ntarget_ess = 2000\nwalkers = 32\nmax_steps = 30\n"
KILLS, NOT_CONVERGED = 20, 3


def small_study(folder: Path) -> None:
    """The HIT study with model M2 and two free parameters, stopped by its step budget."""
    text = (HIT / "study.toml").read_text(encoding="utf-8")
    changes = {
        'model = "M1"': 'model = "M2"',
        'set = "paper-box"\n': f'set = "paper-box"\n{HELD}',
        'hold = { Ks = "2500 kPa" }': 'methods = ["joint"]',
    }
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    (folder / "study.toml").write_text(text + SHORT, encoding="utf-8")
    shutil.copy(HIT / "measurements.csv", folder)


@pytest.mark.slow
def test_a_killed_run_resumes_to_the_same_draws(tmp_path: Path) -> None:
    """After 20 random kills, further ones while resuming, and damage, all draws are there bit for bit."""
    small_study(tmp_path)
    done = subprocess.run(
        [sys.executable, str(Path(__file__).parent / "killed_runs.py"), str(KILLS), "1"],
        cwd=tmp_path,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=600,
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
    assert len({run["segments"] for run in runs}) > 3  # death came at many stages
    assert "Traceback" not in done.stderr
