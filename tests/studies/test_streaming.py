"""The stored study of streams: what its README says, and that a part of it comes out again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

import bayesterra as bt

STORED = Path(__file__).parents[2] / "studies" / "streaming"


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The script of the study of streams."""
    return study_script("streaming")


def test_every_quantile_agrees_with_the_batch_within_four_errors() -> None:
    """All parameters, five quantiles, every seed; the evidence too."""
    table = pd.read_csv(STORED / "agreement.csv")
    assert set(table["parameter"]) == {"Ks", "n0", "n1", "c", "phi", "K", "c1", "c2"}
    assert {f"seed {seed}" for seed in (1, 2, 3)} <= set(table["run"])
    again = (table["stream"] - table["batch"]) / table["error"]
    assert np.allclose(again, table["errors_apart"], atol=0.05)
    assert table["errors_apart"].abs().max() < 4
    batch = pd.read_csv(STORED / "batch-evidence.csv").iloc[0]
    streams = pd.read_csv(STORED / "streams-evidence.csv")
    apart = (streams["log_evidence"] - batch["log_evidence"]) / np.hypot(streams["error"], batch["error"])
    assert apart.abs().max() < 4


def test_the_first_rows_come_out_again(script: ModuleType) -> None:
    """Fewer particles and another seed give the stored medians within a third of the stored bands."""
    stored = pd.read_csv(STORED / "rows.csv").set_index("row")
    plan = script.drive(script.ROWS, np.random.default_rng(2015))
    rows = script.driven(plan, script.TRUTH, seed=5).observations
    stream = bt.Stream(plan, seed=11, particles=400)
    for index in range(8):
        stream.learn(script.row(rows, index))
    found = stream.summary.set_index("parameter")
    for name in stream.names:
        columns = [f"{name}_{key}" for key in ("q05", "q50", "q95")]
        low, middle, high = stored.loc[[8], columns].to_numpy(dtype=np.float64)[0]
        median = float(found["median"].to_dict()[name])
        assert abs(median - middle) < (high - low) / 3


@pytest.mark.slow
def test_a_stored_delay_comes_out_again(script: ModuleType) -> None:
    """Five degrees of friction less are found as soon as stored, to a row; false alarms were rare."""
    delays = pd.read_csv(STORED / "delays.csv")
    stored = delays[(delays["model"] == "M2") & (delays["run"] == 1)].set_index("change")["delay"].to_dict()
    plan = script.drive(script.BEFORE + script.AFTER, np.random.default_rng((2, 1)), "M2")
    before = script.driven(plan, script.TRUTH, seed=1).observations
    changed = {**script.TRUTH, **script.CHANGES["phi - 5 deg"]}
    after = script.driven(plan, changed, seed=1).observations
    stream = bt.Stream(plan, seed=1, particles=script.PARTICLES)
    for index in range(script.BEFORE):
        stream.learn(script.row(before, index))
    found = next(
        number
        for number, index in enumerate(range(script.BEFORE, script.BEFORE + script.AFTER), start=1)
        if stream.learn(script.row(after, index)).alarm
    )
    assert abs(found - float(stored["phi - 5 deg"])) <= 1
    unchanged = pd.read_csv(STORED / "unchanged.csv")
    assert len(unchanged) >= 200
    assert unchanged["alarm"].notna().mean() <= 0.02
