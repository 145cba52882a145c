"""The study of the load effect: curves, statements and simulated readings made again, findings held."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from bayesterra.study.study import load_study

STUDY = Path(__file__).parents[2] / "studies" / "paper" / "load-effect"


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """Return the study's script."""
    return study_script("paper/load-effect")


def test_curves_are_those_of_the_model(script: ModuleType) -> None:
    """The stored curves come out again; a wheel at the mean load has M2's sinkage and moment."""
    stored, made = pd.read_csv(STUDY / "curves.csv"), script.curves()
    assert list(stored["case"]) == list(made["case"])
    for column in ("slip", "sinkage [mm]", "drawbar_pull [N]", "resistance_moment [N m]", "load"):
        np.testing.assert_allclose(stored[column], made[column], rtol=1e-4, atol=1e-4)
    middle = stored[stored["load"] == 64].set_index(["case", "slip", "model"]).unstack("model")
    for column in ("sinkage [mm]", "resistance_moment [N m]"):
        np.testing.assert_allclose(middle[column]["M2L"], middle[column]["M2"], rtol=1e-4)


def test_statements_come_out_again(script: ModuleType) -> None:
    """Every stored statement is what the script finds now."""
    stored = pd.read_csv(STUDY / "statements.csv", dtype=str, keep_default_na=False)
    made = pd.DataFrame([vars(one) for one in script.statements()])
    pd.testing.assert_frame_equal(stored, made)
    assert stored["verdict"].value_counts().to_dict() == {"reproduced": 9, "differs": 1, "cannot be checked": 1}


def test_readings_are_simulated_by_the_script(script: ModuleType) -> None:
    """The shipped readings are labelled simulated and are those of seed 1."""
    study = load_study(STUDY)
    assert study.kind == "simulated"
    stored, made = pd.read_csv(STUDY / "measurements.csv"), script.simulated()
    np.testing.assert_allclose(stored[made.columns], made, rtol=1e-4)


def test_three_loads_tell_what_one_does_not() -> None:
    """Three loads determine the load effect about its truth; the mean load alone leaves c_DP and c_M open."""
    table = pd.read_csv(STUDY / "recovery.csv").set_index(["design", "parameter"])
    assert table["converged"].all()
    effects = ["cP1", "cP2", "cDP", "cM"]
    assert (table.loc["three loads"].loc[effects, "verdict"] == "determined").all()
    away = (table["median"] - table["truth"]).abs() / table["sd"]
    assert (away.loc["three loads"] < 3).all()
    assert table.loc["three loads"]["covered"].sum() >= 8
    alone = table.loc["the mean load alone"]
    assert (alone.loc[["cDP", "cM"], "verdict"] == "structurally not determined").all()
    assert (alone.loc[["cDP", "cM"], "contraction"].abs() < 0.1).all()
