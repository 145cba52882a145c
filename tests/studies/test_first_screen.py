"""What the first screen says of faults: a run now, the stored study checked."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pandas as pd
import pytest

from tests.support.choice import some

STUDY = Path(__file__).parents[2] / "studies" / "misfit" / "first-screen"
PASS = ("wheel half as wide", "readings of M2 under M1")


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The study's script as a module."""
    return study_script("misfit/first-screen")


@pytest.mark.slow
@pytest.mark.parametrize("case", some(["M1, one load", "loads in kilograms"], 1))
def test_the_first_run_is_remade(script: ModuleType, case: str) -> None:
    """Grades, exit code and sentence come out as stored."""
    results = pd.read_csv(STUDY / "results.csv")
    (stored,) = results[(results["case"] == case) & (results["run"] == 0)].to_dict("records")
    found = script.one((case, 0))
    for name in ("sampling", "fit", "prediction", "soil", "exit", "warnings", "sentence"):
        assert found[name] == stored[name], name


def test_the_stored_study_holds(script: ModuleType) -> None:
    """Sound studies: bad twice at most, doubtful 15 times; faults that readings can show are seen."""
    results = pd.read_csv(STUDY / "results.csv")
    table = script.table_of(results)
    assert table["runs"].to_dict() == dict.fromkeys(script.CASES, 30)
    assert not table["not converged"].any()
    sound = table.loc[list(script.SOUND)].sum()
    assert sound["runs"] == 300
    assert sound["bad"] <= 2
    assert sound["doubtful or bad"] - sound["bad"] <= 15
    alarms = table["doubtful or bad"]
    assert alarms["loads in kilograms"] == table.loc["loads in kilograms", "warned"] == 30
    assert alarms["noise stated at a third"] == 30
    assert alarms["pull halved beyond slip 0.3"] >= 25
    assert (alarms[list(PASS)] <= 1).all()  # as sound ones: no reading tells them apart
    assert (table["exit 4"] == table["bad"]).all()


def test_the_sentence_goes_with_the_grades() -> None:
    """Bad: do not use; doubtful: with care; else what the intervals hold for."""
    results = pd.read_csv(STUDY / "results.csv")
    cards = results[["sampling", "fit", "prediction", "soil"]]
    bad, doubtful = ((cards == grade).any(axis=1) for grade in ("bad", "doubtful"))
    assert results["sentence"].str.startswith("Do not use").equals(bad)
    assert results["sentence"].str.startswith("Use with care").equals(doubtful & ~bad)


def test_the_readme_shows_the_stored_table(script: ModuleType) -> None:
    """Every row of the README is counted from the results."""
    table = script.table_of(pd.read_csv(STUDY / "results.csv"))
    lines = (STUDY / "README.md").read_text(encoding="utf-8").splitlines()
    shown = [[cell.strip() for cell in line.strip("|").split("|")[1:]] for line in lines if line.startswith("| ")][1:]
    sound = table.loc[list(script.SOUND)].sum()
    for cells, (_, row) in zip(shown, [*table.loc[list(script.FAULTS)].iterrows(), ("sound", sound)], strict=True):
        bad, either = row["bad"], row["doubtful or bad"]
        assert list(map(int, cells)) == [row["runs"] - either, either - bad, bad, row["warned"], row["exit 4"]]
