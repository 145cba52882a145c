"""Outcomes by the names of their channels."""

import numpy as np
import pytest

from bayesterra.likelihood.forward import Outcomes

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
