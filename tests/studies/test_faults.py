"""The stored trials of faults: what the README says of them is what they say."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

STUDY = Path(__file__).parents[2] / "studies" / "faults"
KEPT = {"right", "clear error"}
Load = Callable[[str], ModuleType]


def test_stored_trials_keep_the_promise(study_script: Load) -> None:
    """At least 500 kills and every kind of fault; none lost anything or gave another result."""
    run: Any = study_script("faults")
    trials = run.trials_of(STUDY)
    assert set(trials["outcome"]) == KEPT
    kills = trials[trials["fault"].str.startswith("kill")]
    assert len(kills) >= 500
    assert (kills["where"] == "a store of tasks").sum() >= 100
    assert {"run", "calibrate", "follow over an old stream", "design over an old one"} <= set(kills["where"])
    assert set(trials["part"]) == set(run.PARTS)
    lives = trials[trials["part"] == "renames"]
    assert len(lives) >= 200
    assert lives["fault"].str.startswith("kill").all()
    assert set(lives["outcome"]) == {"right"}
    own = trials[trials["part"] == "owned"]
    assert {"run", "run --resume", "run --prior-only", "simulate", "predict", "calibrate"} <= set(own["where"])
    assert not trials.duplicated(["fault", "where", "trial"]).any()


def test_the_table_is_that_of_the_stored_trials(study_script: Load) -> None:
    """README and trials say the same."""
    run: Any = study_script("faults")
    text = (STUDY / "README.md").read_text(encoding="utf-8")
    trials = run.trials_of(STUDY)
    assert run.words(run.counted(trials)) in text
    assert f"{len(trials)} trials" in text
