"""Which drives are considered, and what cannot be asked for."""

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

from bayesterra.design.candidates import SLIPS, candidates
from bayesterra.design.recommendation import recommend
from bayesterra.errors import StudyError
from bayesterra.study.study import Study

Make = Callable[..., Study]


def test_the_default_grid_goes_somewhat_beyond_what_was_driven(two_free: Study) -> None:
    """Slips from 0.1 to 0.5 and a quarter of that range beyond, under the study's load, all channels."""
    grid = candidates(two_free)
    slips = [float(one.slip[0]) for one in grid]
    assert len(grid) == SLIPS
    assert [min(slips), max(slips)] == pytest.approx([0.0, 0.6])
    assert {float(one.load[0]) for one in grid} == {80.0}
    assert {one.channels for one in grid} == {("sinkage", "drawbar_pull", "resistance_moment")}


def test_many_loads_become_three(unmeasured: Make) -> None:
    """Of more than four loads the lowest, the median and the highest are considered."""
    table = pd.DataFrame({"slip": 0.3, "load [N]": [20.0, 30.0, 40.0, 60.0, 90.0]})
    grid = candidates(unmeasured(data=table), slips=[0.3])
    assert [float(one.load[0]) for one in grid] == [20.0, 40.0, 90.0]


def test_a_new_sensor_is_tried_on_new_and_on_old_rows(unmeasured: Make) -> None:
    """Each drive comes without and with it; last, it alone on the rows of the study driven again."""
    study = unmeasured(noise={"sinkage": 0.002, "drawbar_pull": 3.0})
    grid = candidates(study, slips=[0.2, 0.4], sensors=["resistance_moment = 0.2 N m"])
    assert [one.channels[-1] for one in grid[:4]] == ["drawbar_pull"] * 2 + ["resistance_moment"] * 2
    assert grid[-1].channels == ("resistance_moment",)
    assert grid[-1].repeats
    assert grid[-1].slip.tolist() == [0.1, 0.3, 0.5]
    assert grid[-1].noise[0].sd == 0.2


def test_a_sensor_more_tells_more(unmeasured: Make) -> None:
    """The same drive with the torque sensor has the greater gain."""
    study = unmeasured(noise={"drawbar_pull": 3.0})
    found = recommend(study, slips=[0.4], channels=["resistance_moment=0.3 N m"])
    without, with_torque, _ = (one.values[0] for one in found.ranking.estimates)
    assert with_torque > without + 0.1


@pytest.mark.slow
def test_the_same_seed_gives_the_same_table(two_free: Study) -> None:
    """Ranking and errors depend on the seed alone."""
    first, second = (recommend(two_free, slips=[0.1, 0.5], about=["phi"], seed=3).table for _ in range(2))
    pd.testing.assert_frame_equal(first, second)
    other = recommend(two_free, slips=[0.1, 0.5], about=["phi"], seed=4).table
    assert not np.allclose(first["gain [bit]"], other["gain [bit]"])


def test_the_table_says_what_was_known_before(two_free: Study) -> None:
    """A flat φ over 20 degrees has a standard deviation of 20/√12 before, and less after."""
    row = recommend(two_free, slips=[0.5], about=["phi"]).table.iloc[0]
    assert row["sd_phi [deg]"] == pytest.approx(20 / np.sqrt(12), rel=0.03)
    assert row["sd_phi [deg] after"] < 0.9 * row["sd_phi [deg]"]
    assert row["chosen"] == 1


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"about": ["pi"]}, r"unknown parameter 'pi' \(did you mean 'phi'\?\)"),
        ({"about": ["c"]}, "'c' is fixed at 268: no drive tells more about it"),
        ({"channels": ["torque"]}, "unknown channel 'torque' .known: sinkage, drawbar_pull"),
        ({"channels": ["drawbar_pul"]}, "did you mean 'drawbar_pull'"),
        ({"channels": ["sinkage=1 mm"]}, "'sinkage' is read already"),
        ({"loads": ["-5 N"]}, "'load' must be above 0 .got -5 N"),
        ({"loads": ["90 kN"]}, "no drive that was asked for has an answer for enough draws"),
        ({"slips": [1.2]}, r"'slip' must lie in \[0, 1\) .got 1.2"),
        ({"wheels": ["Wh23"]}, "'Wh23' is neither a wheel of the study nor a file .did you mean 'Wh32'"),
        ({"number": 0}, "'number' must lie in 1 to 12 .got 0"),
        ({"by": "entropy"}, "'by' must be information or sd .got 'entropy'"),
    ],
)
def test_what_cannot_be_asked_for(two_free: Study, asked: dict[str, object], message: str) -> None:
    """Each mistake is one sentence that says what must hold and what was got."""
    with pytest.raises(StudyError, match=message) as caught:
        recommend(two_free, **asked)  # type: ignore[arg-type]  # wrong values are the point
    assert "\n" not in str(caught.value)


def test_a_new_channel_needs_its_noise(unmeasured: Make) -> None:
    """The message shows how to give it."""
    study = unmeasured(noise={"drawbar_pull": 3.0})
    with pytest.raises(StudyError, match=r'"resistance_moment=0\.15 N m"'):
        recommend(study, channels=["resistance_moment"])


def test_nothing_free_is_said(unmeasured: Make) -> None:
    """A study that fixes everything has nothing to learn."""
    with pytest.raises(StudyError, match="nothing is free"):
        recommend(unmeasured(()))


def test_a_tied_parameter_is_named_by_its_root(unmeasured: Make) -> None:
    """Asking about c2, tied to c1, leads to c1."""
    study = unmeasured(("phi",), priors={**_fixed(), "c2": "c1"})
    with pytest.raises(StudyError, match="'c2' is tied to 'c1': ask about that"):
        recommend(study, about=["c2"])


def _fixed() -> dict[str, object]:
    known: dict[str, object] = {"Ks": 2.5e6, "n0": 0.85, "n1": 1.06, "c": 268.0, "phi": 0.511, "K": 0.0101}
    return {**known, "c1": {"dist": "uniform", "lower": 0.1, "upper": 0.5}, "c3": 0.0}
