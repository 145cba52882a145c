"""Engines of this machine: the same outcomes, whoever computes and whatever dies."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from bayesterra.errors import EngineError
from bayesterra.runtime import engines as running_module
from bayesterra.runtime.engines import (
    Engine,
    InProcess,
    LocalPool,
    chosen,
    completed,
    ended,
    in_process,
    local_pool,
    usable_processors,
)

from .tasks import Deadly, Failing, Sums, processors, run

pytestmark = pytest.mark.usefixtures("importable")
NUMBERS = range(12)


def outcomes(task: Callable[[int], float], engine: Engine, short: bool = False) -> dict[int, float]:
    """All outcomes by number."""
    with engine:
        return dict(completed(task, NUMBERS, engine, short=short))


@pytest.fixture
def right(tmp_path: Path) -> dict[int, float]:
    """What one process computes."""
    folder = tmp_path / "right"
    folder.mkdir()
    return outcomes(Sums(folder), in_process())


def test_a_pool_computes_what_one_process_does(tmp_path: Path, right: dict[int, float]) -> None:
    """To the last digit, each number once, in more than one process and not in this one."""
    task = Sums(tmp_path, seconds=0.05)
    assert outcomes(task, local_pool(2)) == right
    runs = [name.split("-") for name in task.runs if "-" in name]
    assert sorted(int(number) for number, _ in runs) == list(NUMBERS)
    workers = {process for _, process in runs}
    assert len(workers) == 2
    assert str(os.getpid()) not in workers


def test_a_task_whose_worker_was_killed_is_run_again(tmp_path: Path, right: dict[int, float]) -> None:
    """Two workers die at one task; nothing is lost, and what the others do is not done twice."""
    task = Deadly(tmp_path / "runs", 0.05, times=2)
    task.folder.mkdir()
    assert outcomes(task, local_pool(2)) == right
    begun = [int(name.split("-")[0]) for name in task.runs]
    assert sorted(begun) == sorted([*NUMBERS, 3, 3])


def test_a_task_that_always_kills_its_worker_is_named(tmp_path: Path) -> None:
    """One line, after three workers; what had ended was handed over."""
    task = Deadly(tmp_path)
    found: list[int] = []
    with local_pool(2) as engine, pytest.raises(EngineError, match="task 3: every worker that took it died"):
        run(task, engine, found.append, NUMBERS)
    assert len([name for name in task.runs if name.startswith("3-")]) == 3
    assert 1 in found  # it stood before number 3


def test_a_worker_that_dies_between_tasks_is_replaced(tmp_path: Path, right: dict[int, float]) -> None:
    """Killed while it waits for the next task."""
    task = Sums(tmp_path)
    with local_pool(1) as engine:
        first = dict(completed(task, range(6), engine))
        (worker,) = {name.split("-")[1] for name in task.runs if "-" in name}
        os.kill(int(worker), signal.SIGKILL)
        second = dict(completed(task, range(6, 12), engine))
    assert first | second == right


@pytest.mark.parametrize("make", [in_process, lambda: local_pool(2)])
def test_errors_of_a_task_are_raised_after_what_is_there(make: Callable[[], Engine], tmp_path: Path) -> None:
    """As they are; the others are handed over first."""
    found: list[int] = []
    with make() as engine, pytest.raises(ArithmeticError, match="no sums today"):
        run(Failing(tmp_path), engine, found.append, NUMBERS)
    assert 1 in found  # it stood before number 3


def test_short_work_needs_no_workers(tmp_path: Path, right: dict[int, float], monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers are started only when work is left after a while; the outcomes are the same."""
    task = Sums(tmp_path, seconds=0.02)
    assert outcomes(task, local_pool(2), short=True) == right
    assert {name.split("-")[1] for name in task.runs if "-" in name} == {str(os.getpid())}
    monkeypatch.setattr(running_module, "PATIENCE", 0.05)
    other = Sums(tmp_path / "other", seconds=0.02)
    other.folder.mkdir()
    assert outcomes(other, local_pool(2), short=True) == right
    workers = {name.split("-")[1] for name in other.runs}
    assert str(os.getpid()) in workers
    assert len(workers) > 1


def test_what_waits_is_handed_over_together(tmp_path: Path) -> None:
    """A caller that is slow gets all that ended meanwhile at once."""
    sizes = []
    with local_pool(2) as engine:
        for batch in ended(Sums(tmp_path), NUMBERS, engine):
            sizes.append(len(batch))
            time.sleep(0.1)
    assert sum(sizes) == len(NUMBERS)
    assert max(sizes) > 1


def test_a_pool_that_ends_at_once_leaves_no_thread(tmp_path: Path) -> None:
    """A thread of an executor that ends beside the interpreter may write to what the interpreter has closed."""
    task = Sums(tmp_path, seconds=60)
    with suppress(ArithmeticError), local_pool(2) as engine:
        for number in range(4):
            engine.submit(task, number)
        while len(task.runs) < 2:
            time.sleep(0.02)
        raise ArithmeticError
    assert not [thread for thread in threading.enumerate() if "Manager" in type(thread).__name__]


def test_what_cannot_be_handed_over_is_said(tmp_path: Path) -> None:
    """A function inside a function."""
    with local_pool(2) as engine, pytest.raises(EngineError, match="cannot be handed to other processes"):
        list(completed(lambda number: number, NUMBERS, engine))


def test_a_worker_has_one_processor() -> None:
    """A worker samples on one thread, as there are as many workers as processors; this process keeps all."""
    before = usable_processors()
    assert set(outcomes(processors, local_pool(2)).values()) == {1}
    assert usable_processors() == before


def test_options_of_a_command_choose_the_engine() -> None:
    """All processors unless told otherwise; one needs no pool."""
    assert isinstance(chosen(1, None), InProcess)
    assert chosen(3, None).workers == 3
    assert chosen(None, None).workers == usable_processors()
    with pytest.raises(EngineError, match=r"'workers' must be at least 1 \(got 0\)"):
        local_pool(0)
    with pytest.raises(EngineError, match="leave it out with '--scheduler'"):
        chosen(2, "tcp://127.0.0.1:8786")
    assert isinstance(local_pool(), LocalPool)


SCRIPT = """
import sys
from pathlib import Path
from bayesterra.runtime.engines import local_pool
from bayesterra.runtime.engines import completed
from tests.runtime.tasks import Sums

if __name__ == "__main__":
    import signal
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with local_pool(2) as engine:
        task = Sums(Path(sys.argv[1]), seconds=float(sys.argv[2]))
        for number, value in completed(task, range(40), engine):
            print(number, flush=True)
"""


@pytest.mark.parametrize("seconds", ["0.2", "60"])
def test_ctrl_c_ends_everything_at_once_and_quietly(seconds: str, tmp_path: Path) -> None:
    """The whole process group gets Ctrl-C, as in a terminal: one traceback, and no process is left."""
    runs = tmp_path / "runs"
    runs.mkdir()
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    process = subprocess.Popen(
        [sys.executable, str(script), str(runs), seconds],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, start_new_session=True,
    )  # fmt: skip
    end = time.monotonic() + 60
    while len(list(runs.iterdir())) < 2:
        assert time.monotonic() < end, "no progress"
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)
    _, told = process.communicate(timeout=120)
    assert process.returncode != 0
    assert told.count("Traceback") == 1
    assert told.rstrip().endswith("KeyboardInterrupt")
    for worker in {int(path.name.split("-")[1]) for path in runs.iterdir()}:
        assert not Path(f"/proc/{worker}").exists() or "Z" in Path(f"/proc/{worker}/stat").read_text().split()[2]
