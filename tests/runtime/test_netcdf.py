"""Writing of draws under an interruption."""

import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from bayesterra.runtime.netcdf import labelled_tree, write_tree


def test_an_interruption_lets_the_file_in_memory_end_and_writes_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cut in two, HDF5 objects print tracebacks as they go; the interruption is raised after them."""
    real, ended = xr.DataTree.to_netcdf, list[int]()

    def interrupted(*arguments: Any, **options: Any) -> Any:
        time.sleep(0.2)  # a thread that has just begun is not waited for
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.2)
        content = real(*arguments, **options)
        ended.append(len(content))
        return content

    monkeypatch.setattr(xr.DataTree, "to_netcdf", interrupted)
    tree = labelled_tree({"posterior": xr.Dataset({"c": (("chain", "draw"), np.zeros((2, 5)))})})
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a process in the background ignores it
    try:
        with pytest.raises(KeyboardInterrupt):
            write_tree(tree, tmp_path / "draws.nc")
    finally:
        signal.signal(signal.SIGINT, before)
    assert ended
    assert not [*tmp_path.iterdir()]
