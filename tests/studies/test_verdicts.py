"""Problems with known verdicts: one noise of each now, the stored twenty checked."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pandas as pd
import pytest

from bayesterra.identifiability.verdicts import Evidence

STUDY = Path(__file__).parents[2] / "studies" / "identifiability" / "verdicts"
PROBLEMS = ("all determined", "c flat", "K_s-n0 ridge", "c1-c2 ridge", "only a sum", "one-sided")
PLATEAU = "one-sided by a plateau"


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The study's script as a module."""
    return study_script("identifiability/verdicts")


@pytest.mark.slow
@pytest.mark.parametrize("problem", [*PROBLEMS, PLATEAU])
def test_the_first_run_of_every_problem_is_right_and_as_stored(script: ModuleType, problem: str) -> None:
    """Every word and the open combination are the right ones, the figures behind them the stored ones."""
    found, combined = script.one(problem, 1)
    assert found["verdict"].tolist() == found["expected"].tolist()
    assert combined["right"].all()
    table = pd.read_csv(STUDY / "verdicts.csv")
    stored = table[(table["problem"] == problem) & (table["seed"] == 1)]
    assert found["contraction"].to_numpy() == pytest.approx(stored["contraction"].to_numpy(), abs=0.05)


def test_every_stored_run_is_right(script: ModuleType) -> None:
    """Twenty noises of six problems: all words, all combinations, and none near a threshold."""
    found, combined = (pd.read_csv(STUDY / f"{name}.csv") for name in ("verdicts", "combinations"))
    everything = script.overview(found, combined)
    assert (everything["runs"] == 20).all()
    assert everything.loc[PLATEAU, "words_right"] >= 18  # one noise in forty looks two-sided
    table = everything.loc[list(PROBLEMS)]
    assert list(script.PROBLEMS) == list(PROBLEMS)
    assert (table["words_right"] == 20).all()
    assert (table["combinations_right"] == 20).all()
    assert (table["converged"] == 20).all()
    assert table["margin"].min() > 0.05


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (Evidence(0.97), 0.07),
        (Evidence(0.1), 0.2),
        (Evidence(0.5, tie=-0.95, multiple=0.92, given_others=0.9), 0.15),
        (Evidence(0.5, tie=0.1, multiple=0.95, given_others=0.99), 0.05),
        (Evidence(0.5, profile="one-sided", excluded=0.3), 0.2),
    ],
)
def test_the_margin_is_the_smallest_change_of_the_word(script: ModuleType, found: Evidence, expected: float) -> None:
    """It is the distance to the nearest threshold behind which another word would stand."""
    assert script.margin(found) == pytest.approx(expected, abs=1e-9)
