"""Designs on other engines and in pieces: the same estimates, none judged twice, and readable on the way."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import bayesterra as bt
from bayesterra.__main__ import main
from bayesterra.design.choosing import Progress, choose
from bayesterra.design.recommendation import design_into, design_request
from bayesterra.errors import ResultError
from bayesterra.runtime import engines as running_module
from bayesterra.runtime.engines import in_process, local_pool

HIT = Path(__file__).parents[2] / "studies" / "hit-wh32"
WISHES: dict[str, Any] = {"about": ["phi"], "slips": [0.1, 0.3, 0.5], "number": 2}


@pytest.fixture(autouse=True)
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """As many draws as make a quick design."""
    monkeypatch.setattr("bayesterra.design.recommendation.DRAWS", 250)


def stop_at(judged: int) -> Callable[[Progress], None]:
    """A watcher that interrupts."""

    def watch(progress: Progress) -> None:
        if progress.judged == judged:
            raise KeyboardInterrupt

    return watch


@pytest.mark.slow
def test_every_engine_gives_the_same_design(monkeypatch: pytest.MonkeyPatch) -> None:
    """Table and plan, to the last digit; the pool is used though the work is short."""
    monkeypatch.setattr(running_module, "PATIENCE", 0.0)
    question = design_request(bt.load_study(HIT), **WISHES)
    with in_process() as here, local_pool(2) as there:
        one, other = (choose(**vars(question), engine=engine) for engine in (here, there))
        assert not there.starting
    pd.testing.assert_frame_equal(one.table, other.table, check_exact=True)
    pd.testing.assert_frame_equal(one.plan, other.plan, check_exact=True)


def test_an_interrupted_design_goes_on_where_it_was(tmp_path: Path) -> None:
    """Nothing is judged twice, the folder is that of an undisturbed one, and the store tells on the way."""
    out, seen = tmp_path / "out", list[int]()
    with pytest.raises(KeyboardInterrupt):
        design_into(bt.load_study(HIT), out, quiet=True, watch=stop_at(5), **WISHES)
    status = json.loads((tmp_path / "out.part" / "status.json").read_text())
    assert (status["stage"], status["steps"]) == ("judging for drive 1", 5)
    table = bt.read_tasks(out)
    assert list(table["task"]) == [0, 1, 2, 3, 4]
    assert np.shape(table["replicates"][0]) == (21, 3)
    assert table.attrs["made_with"]["number"] == 2
    with pytest.raises(ResultError, match="holds 5 finished candidates: add --resume to go on, or --overwr"):
        design_into(bt.load_study(HIT), out, quiet=True, **WISHES)
    with pytest.raises(ResultError, match="was begun with seed 1, not 2; add --overwrite in place of"):
        design_into(bt.load_study(HIT), out, quiet=True, resume=True, seed=2, **WISHES)
    with pytest.raises(ResultError, match="was begun with another list of candidates"):
        design_into(bt.load_study(HIT), out, quiet=True, resume=True, **WISHES | {"slips": [0.1, 0.3, 0.45]})
    design_into(bt.load_study(HIT), out, quiet=True, resume=True, watch=lambda now: seen.append(now.judged), **WISHES)
    assert seen[:2] == [3, 5]  # the first three are there, then two of the next
    assert {path.name for path in out.parent.iterdir()} == {"out"}
    design_into(bt.load_study(HIT), tmp_path / "other", quiet=True, **WISHES)
    for name in ("design.csv", "plan.csv", "design.json"):
        assert (out / name).read_bytes() == (tmp_path / "other" / name).read_bytes()
    assert {path.name for path in out.iterdir()} == {path.name for path in (tmp_path / "other").iterdir()}


def test_the_command_resumes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The options of the command reach the work."""
    out = tmp_path / "out"
    command = ["design", str(HIT), "--about", "phi", "--slip", "0.1,0.3", "--out", str(out)]
    with pytest.raises(KeyboardInterrupt):
        design_into(bt.load_study(HIT), out, quiet=True, watch=stop_at(1), about=["phi"], slips=[0.1, 0.3])
    assert main([*command, "--workers", "1"]) == 2
    assert "holds 1 finished candidates: add --resume" in capsys.readouterr().err
    assert main([*command, "--workers", "1", "--resume"]) == 0
    assert (out / "report.html").is_file()
