"""The stored study: what its tables say is what its README states."""

import json
from pathlib import Path

import pandas as pd
import pytest

STUDY = Path(__file__).parents[2] / "studies" / "benchmarks" / "scale-out"


TASKS = {"synthetic": 8000, "m2": 2000}


@pytest.mark.parametrize("name", TASKS)
def test_a_kill_half_way_repeated_and_lost_nothing(name: str) -> None:
    """What was in the store was not done again, and is what it was; the main process hardly grows."""
    found = json.loads((STUDY / f"{name}.json").read_text(encoding="utf-8"))
    tasks = TASKS[name]
    assert found["tasks"] == found["in_the_end"] == tasks
    assert found["in_the_store_at_the_kill"] + found["done_after_it"] == tasks
    assert found["changed_by_the_resume"] == 0
    assert abs(found["in_the_store_at_the_kill"] - tasks / 2) < 0.05 * tasks
    rows = pd.read_csv(STUDY / f"{name}.csv")
    assert rows["done"].max() == tasks
    for _, own in rows.groupby("process"):
        assert own["resident_mb"].max() - own["resident_mb"].min() < 20


def test_a_cluster_gave_what_one_process_gave() -> None:
    """Also with a worker killed half-way."""
    table = pd.read_csv(STUDY / "dask.csv").set_index("case")
    assert table["identical"].all()
    assert "two Dask workers, one killed half-way" in table.index
    long = table[table["tasks"] == table["tasks"].min()]["tasks_per_second_and_worker"]
    assert (long.filter(like="Dask").to_numpy() > 0.8 * long.filter(like="one").to_numpy()).all()
