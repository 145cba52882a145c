"""The error figure, tables and printed fits."""

from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd
import pytest

from bayesterra.least_squares.fit import fit
from bayesterra.least_squares.results import error_figure, print_fits, report_table
from bayesterra.models import Soil
from bayesterra.study.study import Study

Printed = Mapping[str, Mapping[str, Soil]]


def test_error_figure_is_relative_to_the_largest_reading() -> None:
    """Equation (16): the largest misfit over the largest reading, in percent, whatever the signs."""
    assert error_figure(np.array([-50.0, 10.0]), np.array([-50.0, 12.0])) == pytest.approx(4.0)


def test_error_figure_skips_what_was_not_measured() -> None:
    """A missing reading counts for nothing, and without any reading there is no figure."""
    assert error_figure(np.array([np.nan, 10.0]), np.array([9e9, 11.0])) == pytest.approx(10.0)
    assert np.isnan(error_figure(np.array([np.nan]), np.array([1.0])))
    assert np.isnan(error_figure(np.array([0.0]), np.array([1.0])))


@pytest.fixture(scope="module")
def without_torque(
    make_paper_study: Callable[..., Study], make_table: Callable[..., pd.DataFrame], printed: Printed
) -> Study:
    """Wheel Wh32 without a resistance moment, with a published value."""
    soil = printed["IM1"]["Wh32"]
    data = make_table("M1", "Wh32", soil).drop(columns="resistance_moment [N m]")
    published = {"source": "a table", "phi": soil.phi}
    return make_paper_study("M1", "Wh32", soil, data=data, published=published, title="No torque")


def test_table_has_the_columns_of_the_csv_file(without_torque: Study) -> None:
    """Rows are in field units, errors in percent, and what was not identified is NaN."""
    table = report_table(fit(without_torque, ("IM1",)), without_torque)
    assert list(table.columns) == ["method", "parameter", "unit", "value", "published", "credible_level"]
    rows = table.set_index("parameter")
    value, published, unit = (dict(rows[column]) for column in ("value", "published", "unit"))
    assert (unit["Ks"], unit["error_normal_force"]) == ("kPa/m^N", "%")
    assert value["Ks"] == pytest.approx(2499.3)
    assert published["phi"] == pytest.approx(29.3)
    assert np.isnan([value["phi"], value["error_resistance_moment"], *rows["credible_level"]]).all()
    assert "c3" not in rows.index


def test_printed_table_marks_held_and_missing_parameters(
    without_torque: Study, capsys: pytest.CaptureFixture[str]
) -> None:
    """Held values have a '=', what is missing a dash and its reason, and published values stand beside."""
    print_fits(fit(without_torque, ("IM1", "IM3")), without_torque)
    printed = capsys.readouterr().out
    assert "= 2499" in printed
    assert "29.3" in printed
    assert "P_II (c, φ, K) was not identified: no row has driving resistance moment" in printed
    assert "IM3: " in printed
