"""A calibration that is killed or interrupted in a process of its own, for real."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest

from bayesterra.runtime.checkpoints import finished_tasks
from tests.support.choice import some

CODE = """
import signal, sys, time
sys.path.insert(0, sys.argv[1])
import conftest
from pathlib import Path
from bayesterra.checking.calibration import CalibrationRequest, calibrate_study

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore Ctrl-C

def exact(study, seed):
    time.sleep(0.03)
    return conftest.exact(study, seed)

study = conftest.make("phi")
calibrate_study(CalibrationRequest(study, 160, seed=2, fit=exact), Path(sys.argv[2]), resume=True, quiet=True)
"""


def started(out: Path) -> "subprocess.Popen[bytes]":
    """A process that begins or goes on with a calibration."""
    command = [sys.executable, "-c", CODE, str(Path(__file__).parents[1] / "checking"), str(out)]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.Popen(command, env=env, stderr=subprocess.DEVNULL, start_new_session=True)


def wait_for(process: "subprocess.Popen[bytes]", store: Path, tasks: int) -> None:
    """Wait until so many tasks are saved."""
    end = time.monotonic() + 120
    while finished_tasks(store) < tasks:
        assert process.poll() is None, "it has ended before"
        assert time.monotonic() < end, "no progress"
        time.sleep(0.01)


@pytest.mark.slow
@pytest.mark.parametrize("sign", some([signal.SIGKILL, signal.SIGINT], 1))
def test_a_killed_calibration_loses_nothing_that_was_saved(sign: signal.Signals, tmp_path: Path) -> None:
    """Stopped twice on its way, it ends with the ranks of an undisturbed run."""
    out, store = tmp_path / "out", tmp_path / "out.part" / "checkpoint"
    for tasks in (7, 31):
        process = started(out)
        wait_for(process, store, tasks)
        process.send_signal(sign)
        assert process.wait(timeout=300) != 0
        assert not out.exists()
        assert finished_tasks(store) >= tasks
    assert started(out).wait(timeout=900) == 0
    assert started(tmp_path / "other").wait(timeout=900) == 0
    first, second = (pd.read_csv(tmp_path / name / "ranks.csv").drop(columns="seconds") for name in ("out", "other"))
    pd.testing.assert_frame_equal(first, second)
    assert {path.name for path in tmp_path.iterdir()} == {"out", "other"}
