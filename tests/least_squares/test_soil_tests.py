"""Usual least-squares practice with soil tests."""

import numpy as np
import pandas as pd
import pytest

from bayesterra.least_squares.soil_tests import fit, rows_of_tests
from bayesterra.study.soil_tests import Readings
from bayesterra.study.study import Study, soil_test_study
from tests.support.soil_tests import SHEAR_PRIORS, SOIL, STRENGTH, plates, shear, shear_table


def readings(study: Study) -> Readings:
    """Readings of the one series of a study."""
    (test,) = study.soil_tests.values()
    return test.readings


def test_least_squares_recover_exact_soils_and_say_what_they_cannot_separate() -> None:
    """Without scatter both methods return the soil; with one level they say which sum they know."""
    found = fit(readings(plates(scatter=0.0))).values
    for method in ("regression", "nonlinear"):
        assert found[method] == pytest.approx(SOIL, rel=1e-5)
    for values in fit(readings(shear(tests=1))).values.values():
        assert values == pytest.approx(STRENGTH, rel=0.3)
    alone = fit(readings(plates((0.03,), scatter=0.0)))
    assert alone.values["nonlinear"] == pytest.approx({"n": 1.1})
    assert alone.notes == (
        "plates of one radius: k_c and k_φ cannot be separated, k_c/b + k_φ = 866.7 kPa/m^n at b = 30 mm",
    )
    assert "one normal stress: c and φ cannot be separated, c + σ tan φ =" in fit(readings(shear((15e3,)))).notes[0]


def test_rows_are_in_field_units_beside_what_is_known() -> None:
    """Named after method and series; true values stand beside them."""
    rows = list(rows_of_tests(plates(scatter=0.0, truth={"n": 1.1})))
    assert [row[0] for row in rows[:3]] == ["regression, plate"] * 3
    assert rows[1][1:3] == ("kphi", "kPa/m^N")
    assert rows[1][3] == pytest.approx(900.0, rel=1e-5)
    assert rows[2][3:5] == pytest.approx((1.1, 1.1), rel=1e-6)


def test_one_curve_is_fitted_by_its_own_readings() -> None:
    """A single reading under another stress is no curve, and no part of one."""
    table = shear_table((10e3,), tests=1)
    table["shear_stress [Pa]"] = 6e3 * -np.expm1(-table["displacement [m]"] / 0.01)
    lone = pd.DataFrame([("lone", 40e3, 0.03, 23e3)], columns=table.columns)
    study = soil_test_study(
        {"test": "shear", "priors": SHEAR_PRIORS}, table=pd.concat([table, lone], ignore_index=True)
    )
    found = fit(readings(study)).values
    for method in ("regression", "nonlinear"):
        assert found[method]["K"] == pytest.approx(0.01, rel=1e-4)
