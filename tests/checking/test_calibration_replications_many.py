"""Many posteriors in one process: nothing is compiled anew, and memory does not grow."""

import resource
from pathlib import Path

import pytest
from numba.core.event import install_recorder

from bayesterra.checking.calibration import Replication
from bayesterra.checking.short_runs import ShortRuns

from .conftest import MakeStudy


def resident() -> float:
    """Resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="reads the memory from /proc")
def test_thirty_posteriors_compile_nothing_and_leave_nothing(make_small: MakeStudy, quick: ShortRuns) -> None:
    """After the first few, posteriors of other readings cost no compilation and less than 5 MB in all."""
    replication = Replication(make_small("K"), 1, quick)
    for task in range(1, 9):
        replication(task)
    before = resident()
    with install_recorder("numba:compile") as recorder:
        for task in range(9, 39):
            assert replication(task).status == "converged"
    assert not recorder.buffer
    assert resident() - before < 5.0
