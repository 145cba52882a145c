"""Determined directions of the parameter groups: one case now, the stored study checked."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

STUDY = Path(__file__).parents[2] / "studies" / "identifiability"
CASE = "Wh32, twice the noise"


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The study's script as a module."""
    return study_script("identifiability")


@pytest.mark.slow
def test_a_case_is_remade(script: ModuleType) -> None:
    """Contractions of all directions come out as stored, the best within four of their two Monte Carlo errors."""
    found = script.tables(CASE, 1)["directions"]
    table = pd.read_csv(STUDY / "directions.csv")
    stored = table[(table["case"] == CASE) & (table["seed"] == 1)]
    assert found["scope"].tolist() == stored["scope"].tolist()
    assert found["contraction"].to_numpy() == pytest.approx(stored["contraction"].to_numpy(), abs=0.1)
    best = found["rank"].to_numpy() == 1
    apart = (found["contraction"].to_numpy() - stored["contraction"].to_numpy())[best]
    errors = np.hypot(found["error"].to_numpy(), stored["error"].to_numpy())[best]
    assert (np.abs(apart) < 4 * errors).all()


def test_the_stored_study_holds() -> None:
    """K_s repeats its prior everywhere; two bearing and two shearing directions, no contact-angle one."""
    groups, verdicts = (pd.read_csv(STUDY / f"{name}.csv") for name in ("groups", "verdicts"))
    assert groups["converged"].all()
    assert (groups["kind"] == "simulated").sum() == (~groups["case"].str.startswith("HIT")).sum()
    assert (verdicts.loc[verdicts["parameter"] == "Ks", "verdict"] == "repeats its prior").all()
    plain = groups[~groups["case"].str.contains("noise|c3") & (groups["view"] == "marginal")]
    assert plain["case"].nunique() == 7
    for group, determined in {"P_I": 2, "P_II": 2, "P_III": 0}.items():
        assert (plain.loc[plain["scope"] == group, "determined"] == determined).all()
    sparse = groups[(groups["case"] == "Wh32, a tenth of the noise") & (groups["view"] == "marginal")]
    assert sparse.set_index("scope").loc["P_III", "determined"] == 2


def test_every_true_value_lies_in_its_interval_even_with_a_wrong_c3() -> None:
    """No true value falls outside its 95 % interval of the profile likelihood, open sides left open."""
    table = pd.read_csv(STUDY / "verdicts.csv")
    known = table[table["truth"].notna()]
    assert known["case"].str.contains("held at 0").any()
    assert not ((known["truth"] < known["lower_95"]) | (known["truth"] > known["upper_95"])).any()


def test_every_case_is_drawn(script: ModuleType) -> None:
    """Every case has its row in the figure, simulated ones by that word."""
    figure = script.draw(pd.read_csv(STUDY / "directions.csv"))
    labels = [text.get_text() for text in figure.axes[0].get_yticklabels()]
    assert len(labels) == 1 + len(script.CASES)
    assert all(label.startswith("simulated ") for label in labels if not label.startswith("HIT"))
