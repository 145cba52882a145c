"""The stored study of rovers: what rests on printed parameters is remade, the rest is checked."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

STUDY = Path(__file__).parents[2] / "studies" / "rover"


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The study's script as a module."""
    return study_script("rover")


def test_states_on_printed_parameters_are_remade(script: ModuleType) -> None:
    """Every slip, load and sinkage of the assumed rover on Table 16's soils."""
    stored = pd.read_csv(STUDY / "printed-parameters.csv")
    rover = script.el_dorado()
    drives = [script.drive(rover, model, row) for row in ("slope", "flat") for model in script.MODELS]
    remade = script.printed_table(drives)
    pd.testing.assert_frame_equal(remade, stored, rtol=2e-4, atol=1e-9, check_dtype=False)
    assert (remade["outcome"] == "held").sum() > 20


def test_all_numbers_of_the_assumed_rover_say_so(script: ModuleType) -> None:
    """The paper prints none, so each number of the file is an assumption."""
    assert len(script.el_dorado().assumptions) == 11


def test_statements_are_judged_by_their_numbers() -> None:
    """No verdict without a reason; the words of the issue's table."""
    stored = pd.read_csv(STUDY / "statements.csv", keep_default_na=False)
    assert set(stored["verdict"]) <= {"reproduced", "differs", "cannot be checked"}
    assert (stored["why"] != "").all()
    assert (stored["ours"] != "").all()
    readme = (STUDY / "README.md").read_text(encoding="utf-8")
    assert all(ours in readme for ours in stored["ours"])


def test_bands_and_greatest_slope_agree() -> None:
    """More slope or tow needs more slip; the share that climbs a slope is one less the share that cannot."""
    bands = pd.read_csv(STUDY / "bands.csv").query("quantity == 'slip' and axle == 'rear'")
    free = bands[bands["tow [N]"] == 0]
    assert (np.diff(free["q50"]) >= 0).all()
    climb = pd.read_csv(STUDY / "climb.csv").set_index("slope [deg]")["probability"]
    for row in free.to_dict("records"):
        expected = 1 - row["cannot"] - (row["unanswered"] if row["slope [deg]"] > 14 else 0)
        assert climb[row["slope [deg]"]] == pytest.approx(expected, abs=0.01)
