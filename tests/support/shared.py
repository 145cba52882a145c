"""Dear set-ups, made once for all processes of a test session."""

from __future__ import annotations

import os
import pickle
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from fcntl import LOCK_EX, flock
from pathlib import Path
from typing import TypeVar

import pytest

T = TypeVar("T")


@dataclass(frozen=True)
class Shared:
    """A folder of pickled objects that the processes of one session see.

    ``shared(name, make)`` is what ``make()`` gives. The first process that asks makes it, others wait and
    read; all have a copy of their own.
    """

    folder: Path

    def __call__(self, name: str, make: Callable[[], T]) -> T:
        """Copy of the object of this name."""
        file = self.folder / f"{name}.pickle"
        with file.with_suffix(".lock").open("w", encoding="utf-8") as lock:
            flock(lock, LOCK_EX)
            if not file.exists():
                content = pickle.dumps(make())
                file.write_bytes(content)
        copy: T = pickle.loads(file.read_bytes())  # noqa: S301 - written a moment ago by this session
        return copy

    def folder_of(self, name: str, fill: Callable[[Path], object], copy: Path) -> Path:
        """Copy of the folder of this name, which ``fill`` writes into once."""

        def filled() -> Path:
            folder = self.folder / name
            folder.mkdir()
            fill(folder)
            return folder

        shutil.copytree(self(name, filled), copy, dirs_exist_ok=True)
        return copy


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Shared:
    """The objects of this session; test processes have a folder each in a common one."""
    base = tmp_path_factory.getbasetemp()
    return Shared(base.parent if "PYTEST_XDIST_WORKER" in os.environ else base)
