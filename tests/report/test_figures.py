"""Helpers of figures."""

import pytest
from matplotlib import pyplot

from bayesterra.report.figures import limit_y


def test_one_value_has_an_axis_too() -> None:
    """A range, a single value and zero: a constant is drawn without a warning."""
    _, ax = pyplot.subplots()
    for low, high, expected in ((1.0, 3.0, (0.8, 3.2)), (5.0, 5.0, (4.5, 5.5)), (0.0, 0.0, (-1.0, 1.0))):
        limit_y(ax, low, high, 0.1)
        assert ax.get_ylim() == pytest.approx(expected)
    pyplot.close("all")
