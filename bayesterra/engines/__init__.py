"""Where independent tasks are computed: in this process, in a pool of processes, or on a Dask cluster.

A task is a function of a number that returns the same whatever computes it; so results do not depend on the
engine. :func:`completed` runs a task for many numbers on any :class:`Engine`.
"""

from bayesterra.engines.base import Engine, WorkerDied
from bayesterra.engines.cluster import dask_cluster
from bayesterra.engines.local import in_process, local_pool, usable_processors
from bayesterra.engines.running import chosen, completed, ended

__all__ = [
    "Engine",
    "WorkerDied",
    "chosen",
    "completed",
    "dask_cluster",
    "ended",
    "in_process",
    "local_pool",
    "usable_processors",
]
