"""Laws of plate and shear tests, written out by hand and against central differences."""

import numpy as np
import pytest

from bayesterra.models.soil_tests import SOIL_TESTS

PLATE, SHEAR = SOIL_TESTS["plate"], SOIL_TESTS["shear"]


def test_mean_curves_are_those_of_bekker_and_of_janosi_and_hanamoto() -> None:
    """Written out by hand for one reading each, a negative k_c included."""
    plate = PLATE.log_stress(np.array([[-1e3, 9e5, 1.1]]), np.array([0.01]), np.array([0.03]))
    assert np.exp(plate[0, 0]) == pytest.approx((-1e3 / 0.03 + 9e5) * 0.01**1.1)
    soil, j, stress = np.array([[800.0, 0.5, 0.01]]), np.array([0.02]), np.array([5e3])
    strength = 800 + 5e3 * np.tan(0.5)
    assert np.exp(SHEAR.log_stress(soil, j, stress)[0, 0]) == pytest.approx(strength * (1 - np.exp(-2.0)))


def test_a_negative_modulus_is_physical_where_the_sum_is_positive() -> None:
    """Either modulus may be negative, but not the sum under any plate."""
    levels = np.array([0.03, 0.06])
    x = np.array([[-1e3, 9e5, 1.0], [1e5, -1e6, 1.0], [-5e4, 9e5, 1.0], [1e5, -2e6, 1.0]])
    assert PLATE.physical(x, levels).tolist() == [True, True, False, False]
    shears = np.array([[0.0, 0.5, 0.01], [-1.0, 0.5, 0.01], [0.0, 0.0, 0.01], [1.0, 0.5, 0.0]])
    assert SHEAR.physical(shears, np.array([5e3])).tolist() == [True, False, False, False]


TYPICAL = {
    "plate": ([-1e3, 9e5, 1.1], np.array([0.002, 0.01, 0.03]), np.array([0.03, 0.03, 0.06])),
    "shear": ([800.0, 0.5, 0.01], np.array([0.002, 0.01, 0.03]), np.array([5e3, 5e3, 2e4])),
}
"""Soil, paths and levels."""


@pytest.mark.parametrize("kind", SOIL_TESTS)
def test_sensitivities_are_derivatives_of_the_curve(kind: str) -> None:
    """Central differences."""
    model, (soil, path, level) = SOIL_TESTS[kind], TYPICAL[kind]
    x = np.array([soil])
    exact = model.slopes(x, path, level)[0]
    for i in range(3):
        step = 1e-6 * max(abs(x[0, i]), 1e-3) * np.eye(3)[i]
        ends = (model.log_stress(x + s * step, path, level)[0] for s in (1, -1))
        np.testing.assert_allclose(exact[:, i], np.subtract(*ends) / (2 * step[i]), rtol=1e-4, atol=1e-9)
