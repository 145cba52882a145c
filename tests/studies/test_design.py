"""The stored study of following recommendations: one replication now, the tables checked."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from scipy.stats import beta

STUDY = Path(__file__).parents[2] / "studies" / "design"


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The study's script as a module."""
    return study_script("design")


@pytest.mark.slow
def test_the_first_addition_is_remade(script: ModuleType) -> None:
    """Replication 0 recommends the same slip and finds about the same ellipse."""
    stored = pd.read_csv(STUDY / "additions.csv").iloc[0]
    found = script.addition(0)
    assert found["slip"] == stored["slip"]
    assert found["area_ratio"] == pytest.approx(stored["area_ratio"], abs=0.1)


def test_the_recommended_addition_beats_the_median_one() -> None:
    """In 200 replications the ellipse of c and φ is smaller, with a lower 95 % bound above 75 %."""
    stored = pd.read_csv(STUDY / "additions.csv")
    wins = int((stored["area_ratio"] < 1).sum())
    assert len(stored) == 200
    assert beta.ppf(0.025, wins, len(stored) - wins + 1) > 0.75


def test_recommended_slips_shrink_the_ellipse_more_than_even_ones() -> None:
    """In 50 replications and more the mean log ratio of areas is below 0 by more than three errors."""
    ratios = np.log(pd.read_csv(STUDY / "slips.csv")["information_area_ratio"])
    assert len(ratios) >= 50
    assert ratios.mean() < -3 * ratios.std() / np.sqrt(len(ratios))


def test_the_estimator_was_checked_by_brute_force() -> None:
    """Every gain agrees within a tenth and three errors; about all parameters within three errors alone."""
    stored = pd.read_csv(STUDY / "estimator.csv")
    error = 3 * np.hypot(stored["gain_error"], stored["brute_force_error"])
    off = (stored["gain"] - stored["brute_force"]).abs()
    assert len(stored) == 20
    assert (off <= error + 0.1 * stored["brute_force"]).all()
    whole = stored["about"] == "c phi K"
    assert (off <= error)[whole].all()
