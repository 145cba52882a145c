"""Finished tasks of jobs that have not ended."""

from pathlib import Path


def finished_tasks(work: Path) -> int:
    """How many are kept in the folder ``checkpoint`` of a job."""
    return len(list(work.glob("task-*.segment")))
