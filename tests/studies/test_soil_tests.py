"""The study of soil tests: cheap parts computed again, the stored rest checked."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from bayesterra.study.study import load_soil_test

STUDY = Path(__file__).parents[2] / "studies" / "soil-tests"


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The study's script as a module."""
    return study_script("soil-tests")


def stored(name: str) -> pd.DataFrame:
    """A result of the study."""
    return pd.read_csv(STUDY / f"{name}.csv")


@pytest.mark.parametrize("name", ["grc1", "cmu", "cullinan"])
def test_the_shipped_files_can_be_read(name: str) -> None:
    """All tests of the published sets are there."""
    (test,) = load_soil_test(STUDY / f"{name}.toml").soil_tests.values()
    assert len(test.readings.tests) == {"grc1": 15, "cmu": 18, "cullinan": 4}[name]


@pytest.mark.parametrize("name", ["grc1", "cmu"])
def test_intervals_cover_new_tests_and_those_of_usual_practice_do_not(script: ModuleType, name: str) -> None:
    """Recomputed for usual practice; both as stored."""
    (test,) = load_soil_test(STUDY / f"{name}.toml").soil_tests.values()
    readings = test.readings
    again = pd.DataFrame(script.scored(name, "independent", pd.DataFrame(script.usual_predictions(readings))))
    rows = {(row["file"], row["likelihood"], row["of"]): row for row in stored("naive").to_dict("records")}
    for row in again.to_dict("records"):
        kept = rows[name, "independent", row["of"]]
        assert row["inside_90"] == kept["inside_90"] < 0.5 * kept["tests"]
    levels = rows[name, "stated", "level"]
    assert levels["chance_of_so_few"] > 0.05
    assert levels["uniform_p"] > 0.05


def test_two_radii_give_the_moduli_back_and_one_does_not() -> None:
    """Twenty known soils each: words, and how often the intervals hold the truth."""
    table = stored("recovery")
    assert table["converged"].all()
    moduli = table[table["parameter"].isin(["kc", "kphi"])]
    assert len(moduli) == 80
    assert (moduli.loc[moduli["radii"] == 2, "verdict"] == "determined").sum() >= 39  # once weakly, at 0.89
    assert (moduli.loc[moduli["radii"] == 1, "verdict"] == "structurally not determined").all()
    two = table[table["radii"] == 2].groupby("parameter")["covered"].sum()
    assert (two >= 15).all()  # of 20 at 90 %: fewer has a chance of 1 %
    assert (table.loc[(table["radii"] == 1) & (table["parameter"] == "Ks"), "covered"].sum()) >= 15


def test_wheels_of_two_widths_agree_with_plates_of_two_radii() -> None:
    """The words of real wheel studies through M2."""
    table = stored("wheels")
    assert set(table.loc[table["widths"] == "two", "verdict"]) == {"determined"}
    assert set(table.loc[table["widths"] == "one", "verdict"]) == {"structurally not determined"}


def test_the_force_on_a_pushed_wheel_is_the_integral(script: ModuleType) -> None:
    """For n = 1 it has a closed form, b R² K (θ1 − sin θ1 cos θ1)."""
    soil, radius, width = np.array([[2e3, 1e6, 1.0]]), 0.06, 0.05
    z = np.array([[0.004, 0.02]])
    angle = np.arccos(1 - z / radius)
    expected = width * radius**2 * (2e3 / width + 1e6) * (angle - np.sin(angle) * np.cos(angle))
    np.testing.assert_allclose(script.wheel_force(soil, z, width, radius, width), expected, rtol=1e-5)


def test_whether_plates_predict_the_wheel_hangs_on_how_the_wheel_is_read() -> None:
    """Stored: measured over predicted force spans more than a factor of ten."""
    ratios = stored("insertion_summary")["measured_over_predicted"]
    assert ratios.max() > 10 * ratios.min()
    assert ratios.between(0.8, 1.25).sum() == 1
