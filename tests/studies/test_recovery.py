"""Recovery of known soils: a quick case now, the stored study checked."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pandas as pd
import pytest

STUDY = Path(__file__).parents[2] / "studies" / "recovery"


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The study's script as a module."""
    return study_script("recovery")


@pytest.mark.slow
def test_one_case_is_remade(script: ModuleType) -> None:
    """M2 data are recovered now, in both drives, and not when noise on the sinkage is ignored."""
    cases = [("Wh22", "M2", "load", 0.0), ("Wh22", "M2", "sinkage", 0.0), ("Wh22", "M2", "sinkage", 0.0005)]
    table = script.recover(cases)
    assert table["converged"].all()
    assert table["inside_999"].tolist() == [True, True, False]


def test_the_stored_study_holds() -> None:
    """In the stored table every truth lies inside its 99.9 % region, but where sinkage noise was ignored."""
    table = pd.read_csv(STUDY / "recovery.csv")
    sound = (table["drive"] == "load") | (table["sinkage_noise_mm"] == 0)
    assert table["converged"].all()
    assert table.loc[sound, "inside_999"].all()
    assert set(table["model"]) == {"M1", "M2", "M3"}
    assert not table.loc[~sound, "inside_999"].all()
