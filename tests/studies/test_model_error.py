"""The stored tables of studies/misfit/model-error: made and summed up as it says, and saying what it says."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

STUDY = Path(__file__).parents[2] / "studies" / "misfit" / "model-error"


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """Its run.py."""
    return study_script("misfit/model-error")


def covered(table: str, part: str, arm: str, **where: str) -> float:
    """Share inside 90 % in a stored summary, over what is asked for."""
    rows = pd.read_csv(STUDY / f"{table}.csv")
    for column, value in {"part": part, "arm": arm, **where}.items():
        rows = rows[rows[column] == value]
    weight = rows["readings" if table == "predictive" else "intervals"]
    return float((rows["covered90"] * weight).sum() / weight.sum())


def test_summaries_are_those_of_the_stored_cases(script: ModuleType) -> None:
    """From predictions.csv and parameters.csv."""
    for name, found in script.summaries().items():
        stored = pd.read_csv(STUDY / f"{name}.csv")
        pd.testing.assert_frame_equal(found, stored, check_dtype=False, rtol=1e-3, atol=1e-3)


def test_the_readings_are_made_again(script: ModuleType) -> None:
    """Of a case of each part, those that were predicted."""
    stored = pd.read_csv(STUDY / "predictions.csv")
    for part in script.ARMS:
        rows = stored[(stored["part"] == part) & (stored["arm"] == "ignored") & (stored["wheel"] == "Wh11")]
        rows = rows[(rows["channel"] == "drawbar_pull") & (rows["seed"] == 1)]
        made = script.simulated(part, "Wh11", 1, {}).observations
        exact, observed = made.values["drawbar_pull"][~made.use], rows["observed"].to_numpy()
        answered = ~np.isnan(observed)  # at the greatest slip hardly any draw carries the load
        assert answered.mean() > 0.9
        assert_allclose(observed[answered], exact[answered], rtol=2e-4)


def test_every_fit_converged() -> None:
    """With effective draws enough for 90 % intervals."""
    fits = pd.read_csv(STUDY / "fits.csv")
    assert fits["converged"].all()
    assert fits["ess"].min() > 500
    assert not fits.duplicated(["part", "wheel", "seed", "arm"]).any()


def test_what_the_study_says() -> None:
    """c, φ and K are surely wrong without a discrepancy and inside with one; so is the pull."""
    for name in ("c", "phi", "K"):
        assert covered("coverage", "model", "ignored", parameter=name) == 0.0
        assert covered("coverage", "model", "stated", parameter=name) == 1.0
        assert covered("coverage", "model", "estimated", parameter=name) == 1.0
    pull = {"channel": "drawbar_pull", "where": "fitted slips"}
    assert covered("predictive", "precise", "ignored", **pull) < 0.5
    assert covered("predictive", "precise", "stated", **pull) > 0.8
    assert covered("predictive", "slip", "ignored", where="fitted slips") < 0.55
    assert covered("predictive", "slip", "modelled", where="fitted slips") > 0.85
    trades = pd.read_csv(STUDY / "trades.csv")
    stated = trades[(trades["arm"] == "stated") & (trades["channel"] == "drawbar_pull")]
    assert stated["share"].min() > 0.6
    assert np.isfinite(stated["share"]).all()
