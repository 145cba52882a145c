"""What a drive gives, reads and knows of a row, beside the models that answer it."""

import json
import pickle

import numpy as np
import pytest

from bayesterra.study.drive import Drive
from bayesterra.study.observations import Observations

NAN = float("nan")


def rows(**columns: list[float]) -> Observations:
    """Three rows of one wheel."""
    values = {name: np.array(column) for name, column in columns.items() if name != "load"}
    load = np.array(columns.get("load", [NAN] * 3))
    return Observations(("A",) * 3, np.array([0.1, 0.2, 0.3]), load, values, {}, np.ones(3, np.bool_), (1, 2, 3))


def test_a_drive_is_its_text_at_the_edge() -> None:
    """Study files, records, messages and processes hold the text; inside it is one of three objects."""
    assert [str(drive) for drive in Drive] == ["load", "sinkage", "both"]
    assert json.dumps({"drive": Drive.SINKAGE}) == '{"drive": "sinkage"}'
    assert f"{Drive.BOTH}-driven" == "both-driven"
    assert Drive("load") is Drive.LOAD
    assert pickle.loads(pickle.dumps(Drive.BOTH)) is Drive.BOTH  # noqa: S301
    with pytest.raises(ValueError, match="'slip' is not a valid Drive"):
        Drive("slip")


@pytest.mark.parametrize(
    ("drive", "first", "kept"),
    [
        (Drive.LOAD, ("sinkage",), ()),
        (Drive.SINKAGE, ("normal_force",), ("sinkage",)),
        (Drive.BOTH, ("sinkage", "normal_force"), ("normal_force",)),
    ],
)
def test_outcomes_are_what_is_not_given(drive: Drive, first: tuple[str, ...], kept: tuple[str, ...]) -> None:
    """Pull and moment are outcomes of every drive; what the load is read by stays known of a left-out row."""
    assert drive.outcomes == (*first, "drawbar_pull", "resistance_moment")
    assert drive.kept == kept
    assert drive.reads_force == ("normal_force" in drive.outcomes)
    assert drive.latent_load == (drive.conditioned(rows()) == {})


def test_what_the_model_is_given() -> None:
    """The load as given, else the normal force, else the median of the others; or the sinkage."""
    table = rows(load=[80.0, NAN, NAN], normal_force=[70.0, 60.0, NAN], sinkage=[0.01, 0.02, NAN])
    for drive in (Drive.LOAD, Drive.BOTH):
        np.testing.assert_array_equal(drive.given(table), [80.0, 60.0, 70.0])
    np.testing.assert_array_equal(Drive.SINKAGE.given(table), [0.01, 0.02, NAN])
    ((name, column),) = Drive.LOAD.conditioned(table).items()
    assert name == "load"
    np.testing.assert_array_equal(column, [80.0, NAN, NAN])
    assert np.isnan(Drive.SINKAGE.conditioned(rows())["sinkage"]).all()


def test_a_latent_load_that_is_known_is_the_drive_by_load() -> None:
    """Curves and point estimates take it so."""
    assert [drive.with_load for drive in Drive] == [Drive.LOAD, Drive.SINKAGE, Drive.LOAD]
