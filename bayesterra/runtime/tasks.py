"""Finished tasks of a job that is at work, or was interrupted, as a table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from bayesterra.errors import ResultError, checked_path
from bayesterra.runtime.checkpoints import Checkpoints, digest, identity_in
from bayesterra.runtime.folders import part_of
from bayesterra.runtime.ownership import BEGUN, RUN, SEGMENT, TASK, TASKS, WORK, kind_of


def read_tasks(path: str | Path) -> pd.DataFrame:
    """Read the tasks that an unfinished calibration or design has finished, also while it runs.

    Parameters
    ----------
    path : the folder ``<out>.part`` that it works in, the folder ``<out>`` that it will be, or the folder
        ``checkpoint`` itself.

    Returns
    -------
    pandas.DataFrame
        One row per task, by number; mappings, such as ranks, as columns of their own. ``attrs["made_with"]``
        says with what.

    Raises
    ------
    ResultError : there are no such tasks, or what they were made with is damaged.
    """
    work = _work_at(checked_path("bt.read_tasks", path, "a folder of tasks"))
    identity = identity_in(work)
    if identity is None:
        raise ResultError(f"'{work / BEGUN}' is damaged")
    tasks = Checkpoints(work, digest(identity)).tasks()
    rows = [{"task": task, **_flat(content)} for task, content in tasks.items()]
    table = pd.DataFrame(rows, columns=None if rows else ["task"])
    table.attrs["made_with"] = identity
    return table


def finished_tasks(work: Path) -> int:
    """Number of finished tasks in the folder ``checkpoint`` of a job; 0 where there are none."""
    return sum(1 for _ in work.glob(f"{TASK}*{SEGMENT}"))


def _work_at(path: Path) -> Path:
    for work in (path, path / WORK, part_of(path) / WORK):
        if (work / TASKS).is_file():
            raise ResultError(f"'{work / TASKS}' was written by an older version: read it with that version")
        if (work / BEGUN).is_file() and kind_of(work) != RUN:
            return work
    raise ResultError(f"'{path}' holds no finished tasks: none was saved there, or all are in the result")


def _flat(content: Mapping[str, Any]) -> dict[str, Any]:
    """A row of a table: mappings become columns."""
    inner = {
        name: value for part in content.values() if isinstance(part, dict) for name, value in part.items()
    }
    return {name: value for name, value in content.items() if not isinstance(value, dict)} | inner
