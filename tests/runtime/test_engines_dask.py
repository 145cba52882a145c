"""A Dask cluster on loopback: two worker processes compute what one process does, also when one is killed."""

import asyncio
import signal
import sys
import time
from collections.abc import Callable
from concurrent import futures
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from distributed.cfexecutor import _cascade_future

import bayesterra as bt
from bayesterra.__main__ import main
from bayesterra.errors import EngineError
from bayesterra.runtime import engines as cluster_module
from bayesterra.runtime.engines import completed, dask_cluster, in_process
from bayesterra.study.study import Study

from .conftest import ROOT, Cluster
from .fits import on_a_grid
from .tasks import Deadly, Failing, Sums, run

pytestmark = [
    pytest.mark.usefixtures("importable"),
    pytest.mark.filterwarnings("ignore:unclosed:ResourceWarning"),  # distributed's, when a worker was killed
]
NUMBERS = range(12)
HELD = {"Ks": 2.5e6, "n0": 0.85, "n1": 1.06, "c": 268.0, "K": 0.0101, "c1": 0.339, "c2": -0.017}
ROWS = {"slip": [0.1, 0.2, 0.4], "load [N]": 80.0, "sinkage [mm]": [5.0, 7.5, 14.0]}


def calibrated(engine: bt.Engine, watch: Callable[[int], None] = lambda done: None) -> pd.DataFrame:
    """Ranks of replications of a study with one free parameter."""
    study = Study(
        pd.DataFrame(ROWS),
        {"Wh32": bt.Wheel(0.15735, 0.165, 0.010, 30, 0.65)},
        slip_reference="shearing",
        model="M2",
        priors={"set": "paper-box", **HELD},
        noise={"sinkage": 50e-3},
    )
    found = bt.calibrate(study, n=20, engine=engine, fit=on_a_grid, progress=lambda now: watch(now.done))
    return found.table.drop(columns="seconds")


@pytest.fixture(scope="module")
def local() -> pd.DataFrame:
    """The same in this process."""
    return calibrated(in_process())


def sums(task: Sums, engine: bt.Engine) -> dict[int, float]:
    """Outcomes by number."""
    return dict(completed(task, NUMBERS, engine))


def two_workers(engine: bt.Engine) -> None:
    """Wait until both workers are there."""
    end = time.monotonic() + 60
    while engine.workers < 2:
        assert time.monotonic() < end, "no second worker"
        time.sleep(0.1)


@pytest.mark.slow
def test_a_cluster_gives_what_one_process_gives(cluster: Cluster, local: pd.DataFrame, tmp_path: Path) -> None:
    """Every rank of a calibration, to the last digit; both workers took part; errors of tasks arrive."""
    with dask_cluster(cluster.address) as engine:
        two_workers(engine)
        pd.testing.assert_frame_equal(calibrated(engine), local, check_exact=True)
        task = Sums(tmp_path, seconds=0.05)
        assert sums(task, engine) == sums(Sums(tmp_path), in_process())
        assert len({name.split("-")[1] for name in task.runs}) == 3
        with pytest.raises(ArithmeticError, match="no sums today"):
            sums(Failing(tmp_path), engine)


def test_a_worker_killed_half_way_changes_nothing(cluster: Cluster, local: pd.DataFrame) -> None:
    """Its tasks are run again by the other worker; the ranks are those of one process."""
    worker = cluster.processes[-1]

    def kill(done: int) -> None:
        if done >= 10 and worker.poll() is None:
            worker.send_signal(signal.SIGKILL)
            worker.wait()

    with dask_cluster(cluster.address) as engine:
        two_workers(engine)
        pd.testing.assert_frame_equal(calibrated(engine, kill), local, check_exact=True)
    assert worker.returncode == -signal.SIGKILL


def test_a_task_that_kills_every_worker_is_named(cluster: Cluster, tmp_path: Path) -> None:
    """One line, once the scheduler has seen it kill as many workers as it allows."""
    for _ in range(4):
        cluster.start_worker()
    with (
        dask_cluster(cluster.address) as engine,
        pytest.raises(EngineError, match="task 3: every worker that took it died"),
    ):
        sums(Deadly(tmp_path), engine)


class Lost:
    """A future of distributed that had an answer until its worker died, just before it was handed over."""

    status = "lost"

    def __init__(self, answer: object) -> None:
        self._answer = answer

    async def _result(self, raiseit: bool = False) -> object:
        return self._answer


async def handed_over(future: Lost) -> futures.Future[Any]:
    """What the client's executor makes of it."""
    answer: futures.Future[Any] = futures.Future()
    await _cascade_future(future, answer)
    return answer


@pytest.mark.parametrize("answer", [3.0, (1.0, 2.0, 3.0)])
def test_an_answer_that_is_lost_on_its_way_is_asked_for_again(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answer: object
) -> None:
    """Its task runs again; an error of a task, also of the same kind, is the task's."""
    cluster.start_worker()
    with dask_cluster(cluster.address) as engine:
        submit, lost = engine.submit, [asyncio.run(handed_over(Lost(answer))) for _ in range(2)]
        monkeypatch.setattr(engine, "submit", lambda *task: lost.pop() if lost else submit(*task))
        assert sums(Sums(tmp_path), engine) == sums(Sums(tmp_path), in_process())
        assert not lost
        own = asyncio.run(handed_over(Lost((TypeError, TypeError("cannot unpack"), None))))
        with pytest.raises(TypeError, match="cannot unpack") as raised:
            own.result()
        for error in (raised.value, TypeError("never raised")):
            assert engine.meaning(error) is error


def test_who_has_another_version_is_named(cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before any work."""
    cluster.start_worker()
    monkeypatch.setattr(cluster_module, "_version", lambda name: "0.9")
    with pytest.raises(EngineError, match=r"the Dask scheduler has bayesterra \S+, here is 0.9: install the"):
        dask_cluster(cluster.address)


def test_a_scheduler_that_ends_is_an_error_not_a_wait(
    cluster: Cluster, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """What had ended is there; the error is one line and nothing else is told."""
    found: list[int] = []

    def note(number: int) -> None:
        found.append(number)
        cluster.processes[0].kill()

    cluster.start_worker()
    with dask_cluster(cluster.address) as engine, pytest.raises(EngineError, match=r"at 'tcp://.*' is gone"):
        run(Sums(tmp_path, seconds=0.3), engine, note, range(40))
    assert found
    time.sleep(0.5)
    assert capfd.readouterr().err == ""


def test_nobody_there_is_one_line_in_time(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """An address where no scheduler is, and one that is none."""
    for address in ("tcp://127.0.0.1:1", "nonsense"):
        began = time.monotonic()
        with pytest.raises(EngineError, match=f"no Dask scheduler answers at '{address}' within 1 s"):
            dask_cluster(address, timeout=1)
        assert time.monotonic() < began + 10
    assert capfd.readouterr().err == ""


def test_without_the_extra_its_name_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2 and one line."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    study = str(ROOT / "studies" / "hit-wh32")
    assert main(["calibrate", study, "-n", "20", "--scheduler", "tcp://127.0.0.1:1", "--out", "/nowhere/x"]) == 2
    assert capsys.readouterr().err == ("error: a Dask cluster needs an extra: pip install 'bayesterra[dask]'\n")
