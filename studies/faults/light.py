"""Tasks that are quick to do and to import, by a pool or a cluster, into a store; see ``workers.py``."""

from __future__ import annotations

import sys
import time
from hashlib import sha256
from pathlib import Path

TASKS = 60
SECONDS = 0.03


def value(number: int) -> str:
    """What task ``number`` must give."""
    return sha256(f"task {number}".encode()).hexdigest()


def work(number: int) -> str:
    """Do a task."""
    time.sleep(SECONDS)
    return value(number)


def main(store: str, scheduler: str = "") -> None:
    """Do the tasks that a store lacks, and save each as it ends; a line per saved task."""
    import light

    from bayesterra.runtime.checkpoints import Checkpoints
    from bayesterra.runtime.engines import completed, dask_cluster, local_pool

    engine = dask_cluster(scheduler) if scheduler else local_pool(2)
    tasks = Checkpoints.opened(Path(store), {"tasks": TASKS}, "tasks")
    with engine:
        missing = sorted({*range(TASKS)} - {*tasks.tasks()})
        for number, found in completed(light.work, missing, engine):
            tasks.add({number: {"value": found}})
            sys.stdout.write(f"{number}\n")
            sys.stdout.flush()
