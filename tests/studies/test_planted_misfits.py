"""Planted misfits: two runs now, the stored study checked."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pandas as pd
import pytest

STUDY = Path(__file__).parents[2] / "studies" / "misfit" / "planted"


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The study's script as a module."""
    return study_script("misfit/planted")


@pytest.mark.slow
def test_the_first_runs_are_remade(script: ModuleType) -> None:
    """Run 0 without and with a misfit comes out as stored."""
    stored = pd.read_csv(STUDY / "results.csv").set_index(["case", "run"])
    for case in ("nothing", "lugs ignored"):
        found = script.one((case, 0))
        assert found["alarm"] == stored.loc[(case, 0), "alarm"]
        assert found["overall_p"] == pytest.approx(stored.loc[(case, 0), "overall_p"], abs=0.1)


def test_the_stored_study_holds(script: ModuleType) -> None:
    """Misfits of the kinds that matter are found in nine runs of ten; sound tables alarm in one of twenty."""
    alarms = pd.read_csv(STUDY / "results.csv").groupby("case")["alarm"]
    runs, rate = alarms.size().to_dict(), alarms.mean().to_dict()
    assert runs == dict.fromkeys(script.CASES, 50)
    assert rate["nothing"] <= 0.05
    plain = ["exponent held constant", "lugs ignored", "pull offset 5 N", "sinkage offset 15 mm"]
    assert min(rate[name] for name in plain) >= 0.9
