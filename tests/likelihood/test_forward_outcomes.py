"""Outcomes by the names of their channels."""

import numpy as np
import pytest

from bayesterra.likelihood.forward import Forward, Outcomes
from bayesterra.models import M1, M2L, Conditions, Wheel, WheelSoilModel
from bayesterra.study.drive import Drive

NAMES = ("sinkage", "normal_force", "drawbar_pull")


def outcomes() -> Outcomes:
    """Two parameter sets in four rows; every value says its set, row and channel."""
    values = np.arange(24.0).reshape(2, 4, 3)
    return Outcomes(NAMES, values, np.array([0, 3]))


def test_a_channel_is_found_by_its_name() -> None:
    """One, several in another order, and none that is not there."""
    all_of = outcomes()
    for place, name in enumerate(NAMES):
        np.testing.assert_array_equal(all_of[name], all_of.values[:, :, place])
    chosen = all_of.of(("drawbar_pull", "sinkage"))
    np.testing.assert_array_equal(chosen, all_of.values[:, :, [2, 0]])
    with pytest.raises(ValueError, match="not in tuple"):
        all_of["resistance_moment"]


def test_adding_changes_one_channel_in_place() -> None:
    """An amount by set, or by set and row; other channels stay."""
    changed, before = outcomes(), outcomes()
    changed.add("normal_force", np.array([[0.5], [1.0]]))
    changed["sinkage"][1] += 7.0
    expected = before.values + np.array([[0.0, 0.5, 0.0], [7.0, 1.0, 0.0]])[:, None]
    np.testing.assert_array_equal(changed.values, expected)


def test_taken_sets_keep_names_and_status() -> None:
    """Also repeatedly."""
    taken = outcomes().take(np.array([1, 1, 0]))
    assert taken.names == NAMES
    assert taken.status.tolist() == [3, 3, 0]
    np.testing.assert_array_equal(taken["drawbar_pull"], outcomes()["drawbar_pull"][[1, 1, 0]])


@pytest.mark.parametrize("drive", list(Drive))
@pytest.mark.parametrize("model", [M1(), M2L(mean_load=75.0)], ids=lambda model: model.name)
def test_answers_and_slopes_are_those_of_the_model(model: WheelSoilModel, drive: Drive) -> None:
    """To what is given: to the last bit by the parameters, and by what is given as differences say."""
    rows = Conditions.of([Wheel(0.157, 0.165, shearing_radius_coefficient=0.65)] * 2, np.array([0.1, 0.4]))
    theta = np.array([[2.5e6, 0.76, 1.3, 250.0, 0.5568, 0.012, 0.5, -0.3, 0.0, 0.1, 0.1, 0.2, 0.1]])
    theta = theta[:, : len(model.parameters)]
    given = np.array([0.011, 0.02]) if drive.by_sinkage else np.array([70.0, 80.0])
    forward = Forward(model, drive, rows, given)
    answers, slopes = forward.slopes(theta, rows, given)
    run, by_theta = (
        (model.forces_at, model.jacobian_at)
        if drive is Drive.SINKAGE
        else (model.response_at, model.response_jacobian_at)
    )
    np.testing.assert_array_equal(answers, run(theta, rows, given)[0])
    assert answers.shape[-1] == forward.width == len(set(drive.outcomes) - {*drive.kept})
    np.testing.assert_array_equal(slopes[..., :-1], by_theta(theta, rows, given)[..., : theta.shape[1]])
    (up, _), (down, _) = (forward.answers(theta, rows, given * (1 + step)) for step in (1e-6, -1e-6))
    np.testing.assert_allclose(slopes[..., -1], (up - down) / (2e-6 * given[:, None]), rtol=1e-5, atol=1e-9)
