"""The stored study: its ranks give the verdicts that its README states."""

import json
from pathlib import Path

import pandas as pd
import pytest

from bayesterra.checking.ranks import rank_test
from bayesterra.checking.short_runs import ShortRuns, settings_of

STUDY = Path(__file__).parents[2] / "studies" / "calibration"
WRONG = {f"m2-{name}-ignored" for name in ("rounding", "curve", "tails")} | {"m2-noise-halved", "m2-jacobian-dropped"}
CASES = sorted(path.parent.name for path in STUDY.glob("*/calibration.json"))


@pytest.mark.parametrize("case", CASES)
def test_stored_ranks_give_the_stored_verdict(case: str) -> None:
    """Right posteriors pass and wrong ones fail, by p values that follow from the ranks in the file."""
    table = pd.read_csv(STUDY / case / "ranks.csv")
    record = json.loads((STUDY / case / "calibration.json").read_text(encoding="utf-8"))
    assert record["calibrated"] == (case not in WRONG)
    assert record["replications"] == len(table)
    for row in record["tests"]:
        if row["verdict"] != "constant":
            ranks = table[row["quantity"]].dropna().to_numpy()
            assert rank_test(len(ranks)).p_value(ranks) == pytest.approx(row["p_value"], abs=1e-4)


def test_settings_keep_the_names_under_which_they_are_stored() -> None:
    """One that was interrupted goes on where its settings are the same: they are compared by name and value."""
    stored = json.loads((STUDY / "m2" / "calibration.json").read_text(encoding="utf-8"))["settings"]
    settings = {"ranked_among": stored["ranked_among"], **settings_of(ShortRuns())}
    assert settings.keys() == stored.keys()
    for part in ("short", "adaptation", "long", "long_adaptation"):
        assert settings[part].keys() >= stored[part].keys()
