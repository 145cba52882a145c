"""Numbers in the report have the precision that their intervals support."""

import math

import pytest

from bayesterra.report import numbers


@pytest.mark.parametrize(
    ("low", "high", "step"),
    [(14.9, 37.2, 1.0), (0.64, 1.07, 0.01), (1477.0, 9999.0, 100.0), (-0.33, 0.97, 0.1), (0.0, 1e-4, 1e-5)],
)
def test_resolution_is_a_power_of_ten_between_one_and_ten_percent_of_the_width(
    low: float, high: float, step: float
) -> None:
    """The last digit shown is worth one to ten per cent of the interval."""
    assert numbers.resolution(low, high) == pytest.approx(step)
    assert 0.01 <= step / (high - low) <= 0.1 + 1e-12


def test_a_friction_angle_is_shown_without_decimals_that_mean_nothing() -> None:
    """29.1834 deg known to within 15 to 37 is 29."""
    assert numbers.rounded(29.1834, numbers.resolution(15.02, 36.99)) == "29"
    assert numbers.interval(15.02, 36.99) == "15–37"


def test_intervals_with_negative_ends_say_to() -> None:
    """A dash beside a minus sign cannot be read."""
    assert numbers.interval(-0.331, 0.467) == "−0.33 to 0.47"


def test_large_numbers_are_grouped_and_minus_is_a_minus() -> None:
    """Five digits and more stand in groups of three; zero has no sign."""
    assert numbers.rounded(-12345.6, 1.0) == "−12\u202f346"
    assert numbers.rounded(-0.0004, 0.01) == "0.00"


@pytest.mark.parametrize("value", [math.nan, math.inf, None])
def test_unknown_numbers_are_a_dash(value: float | None) -> None:
    """Nothing that is not a number is printed as one."""
    assert numbers.plain(value) == numbers.rounded(value, 1.0) == numbers.share(value) == "–"


def test_an_interval_without_width_falls_back_to_three_digits() -> None:
    """A point is shown to three significant digits."""
    assert numbers.interval(0.012345, 0.012345) == "0.0123–0.0123"


def test_shares_are_only_called_all_or_none_when_they_are() -> None:
    """Rounding never turns nearly all draws into all of them."""
    assert [numbers.share(x) for x in (0.0, 0.0001, 0.5, 0.9964, 0.99996, 1.0)] == [
        "0 %", "< 0.1 %", "50 %", "99.6 %", "> 99.9 %", "100 %",
    ]  # fmt: skip


def test_extreme_p_values_are_bounded() -> None:
    """A p value is never shown as exactly 0 or 1."""
    assert [numbers.probability(p) for p in (0.0, 0.0123, 0.9999)] == ["< 0.01", "0.01", "> 0.99"]


def test_columns_share_their_decimals() -> None:
    """Readings of one column have the decimals of the most exact one."""
    assert numbers.column([4.5, 5.0, math.nan, -6.25]) == ["4.50", "5.00", "–", "−6.25"]
