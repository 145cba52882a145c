"""Responses of parameter set i in row i alone."""

import numpy as np
import pytest

from bayesterra.models import M1, M2, M2L, M3, Conditions, Status, Wheel, WheelSoilModel

WHEEL = Wheel(0.15735, 0.165, 0.010, 30, 0.65)
SOIL = [2.5e6, 0.849, 1.063, 268.0, 0.51, 0.0101, 0.339, -0.017, 0.0]


@pytest.mark.parametrize("model", [M1(), M2(), M3(), M2L(mean_load=70.0)])
def test_pairs_are_the_diagonal(model: WheelSoilModel) -> None:
    """Pairs are the diagonal of every set in every row, statuses included."""
    theta = np.tile([*SOIL, -0.3, 0.6, -0.4, 0.3][: len(model.parameters)], (4, 1))
    theta[:, 4] *= [0.8, 1.0, 1.2, 1.0]
    conditions = Conditions.of(WHEEL, [0.05, 0.2, 0.4, 0.6])
    load = np.array([60.0, 80.0, 100.0, 1e7])
    values, status = model.response_of_pairs(theta, conditions, load)
    every, codes = model.response_at(theta, conditions, load, every_row=True)
    np.testing.assert_array_equal(values, every[np.arange(4), np.arange(4)])
    assert status.tolist() == np.diagonal(codes).tolist() == [0, 0, 0, Status.LOAD]


def test_a_mean_load_per_pair_takes_the_place_of_the_option() -> None:
    """M2L answers as with that option; the other models do not know one."""
    theta, conditions = np.array([[*SOIL, -0.3, 0.6, -0.4, 0.3]] * 2), Conditions.of(WHEEL, [0.2, 0.2])
    load, means = np.array([80.0, 80.0]), np.array([60.0, 90.0])
    found, _ = M2L(mean_load=1.0).response_of_pairs(theta, conditions, load, mean_load=means)
    for i, mean in enumerate(means):
        expected, _ = M2L(mean_load=mean).response_of_pairs(theta, conditions, load)
        np.testing.assert_array_equal(found[i], expected[i])
    assert found[0, 1] != found[1, 1]
    plain, _ = M2().response_of_pairs(theta[:, :9], conditions, load)
    same, _ = M2().response_of_pairs(theta[:, :9], conditions, load, mean_load=means)
    np.testing.assert_array_equal(plain, same)
