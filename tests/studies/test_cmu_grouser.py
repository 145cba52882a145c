"""The shipped measurements of the CMU grouser wheel, read with each of its two published geometries."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bayesterra.study.study import load_study

STUDY = Path(__file__).parents[2] / "studies" / "cmu-grouser"


@pytest.mark.parametrize(
    ("file", "radius", "width", "first_slip"),
    [("study.toml", 0.058, 0.050, 1 - 58 / 63 * (1 - 0.00333)), ("wide.toml", 0.0575, 0.060, 0.00333)],
)
def test_both_geometries_read_the_same_driving_rows(file: str, radius: float, width: float, first_slip: float) -> None:
    """Thirteen driving rows are fitted; sinkage counts from the tips, slip moves with its radius."""
    study = load_study(STUDY / file)
    wheel, rows = study.wheels["grouser"], study.observations.used()
    assert (wheel.radius, wheel.width, wheel.lug_count) == (radius, width, 24)
    assert (study.drive, study.load_range, len(rows)) == ("both", (10.0, 40.0), 13)
    assert "sinkage_offset" in study.prior.names
    assert_allclose(rows.slip[0], first_slip, atol=1e-12)
    assert_allclose(rows.values["sinkage"][0], 0.015782 - 0.005, atol=1e-12)
    assert tuple(study.noise) == ("sinkage", "normal_force", "drawbar_pull")


def test_the_table_keeps_the_braking_rows() -> None:
    """All 27 published trials are in the file; those with negative slip are not fitted."""
    table = np.genfromtxt(STUDY / "measurements.csv", delimiter=",", skip_header=1)
    assert table.shape == (27, 5)
    assert ((table[:, 0] >= 0) == (table[:, 4] == 1)).all()


def test_many_rows_outside_the_model_make_one_note() -> None:
    """The braking rows are counted, and the first says what keeps it out."""
    (note, *_) = load_study(STUDY / "wide.toml").notes
    assert note.startswith("row left out, as its 'use' is 0: 'slip' must lie in [0, 1)")
    assert note.endswith("13 more rows likewise")
