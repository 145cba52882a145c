"""The tutorial's figure of the parameters."""

import pytest
from scripts import STUDIES, loaded

from bayesterra.study.result import Result


def test_strip_has_a_row_per_parameter(small_result: Result) -> None:
    """The parameter strip has axes over each prior's range."""
    axes = loaded(STUDIES / "tutorial" / "parameter_strip.py").parameter_strip(small_result)
    assert axes.shape == (len(small_result.names),)
    assert axes[list(small_result.names).index("phi")].get_xlim() == pytest.approx((0.0, 50.0))
