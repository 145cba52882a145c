"""Quantities with units."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesterra.errors import StudyError
from bayesterra.study.units import column_header, factor, quantity, text


@pytest.mark.parametrize(
    ("value", "dimension", "expected"),
    [
        ("32 deg", "rad", np.radians(32)),
        ("0.5 rad", "rad", 0.5),
        ("2 mm", "m", 0.002),
        ("2mm", "m", 0.002),
        ("0.1 N m", "N m", 0.1),
        ("0.1 N*m", "N m", 0.1),
        ("2500 kPa", "Pa", 2.5e6),
        ("2.5e3 kPa", "Pa", 2.5e6),
        ("-1.5 kN", "N", -1500.0),
        (" 80 N ", "N", 80.0),
        ("30 %", "", 0.3),
        ("0.65", "", 0.65),
        (3, "", 3.0),
        (np.float64(0.5), "", 0.5),
    ],
)
def test_quantities_become_si(value: object, dimension: str, expected: float) -> None:
    """Text with a unit of the right dimension is converted to SI; pure numbers are taken as they are."""
    assert quantity(value, dimension, "x") == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("value", "dimension", "message"),
    [
        (32, "rad", r"'phi' needs a unit: text with a unit, e\.g\. \"32 deg\" \(got 32\)"),
        ("32", "rad", r"'phi' needs a unit.*\(got '32'\)"),
        ("32 dge", "rad", r"'phi': unknown unit 'dge' \(got '32 dge'\)"),
        ("32 mm", "rad", r"'phi': the unit 'mm' is not a unit of angle.*\(got '32 mm'\)"),
        ("32 deg", "", r"'phi': the unit 'deg' is not a unit of pure number"),
        ("0.5 mm/mm", "rad", r"the unit 'mm/mm' is not a unit of angle"),
        ("32,5 deg", "rad", r"'phi' must be text with a unit.*\(got '32,5 deg'\)"),
        ("nan deg", "rad", r"'phi' must be text with a unit.*\(got 'nan deg'\)"),
        ("2 to 3 mm", "m", r"unknown unit 'to 3 mm'"),
        ("0.3 Nm", "N m", r"'Nm'"),
        ("2500 kPa/m^N", "Pa", r"unknown unit 'kPa/m\^N'"),
        (float("inf"), "", r"'phi' must be finite \(got inf\)"),
        (True, "", r"'phi' must be a number \(got True\)"),
        ([1], "m", r"'phi' must be text with a unit"),
    ],
)
def test_wrong_quantities_are_named(value: object, dimension: str, message: str) -> None:
    """A missing, unknown or wrong unit is refused with name, expectation and value in one line."""
    with pytest.raises(StudyError, match=message) as caught:
        quantity(value, dimension, "phi")
    assert "\n" not in str(caught.value)


def test_bare_numbers_are_si_only_where_allowed() -> None:
    """From Python a number is an SI value; in files the same number is refused."""
    assert quantity(0.165, "m", "width", bare=True) == 0.165
    with pytest.raises(StudyError, match="'width' needs a unit"):
        quantity(0.165, "m", "width")


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("sinkage [mm]", ("sinkage", "mm")),
        (" drawbar_pull  [ N ] ", ("drawbar_pull", "N")),
        ("slip", ("slip", None)),
        ("sinkage []", ("sinkage", "")),
        ("sinkage (mm)", ("sinkage", "mm")),
        ("drawbar (pull) [N]", ("drawbar (pull)", "N")),
        ("sinkage [mm", ("sinkage [mm", None)),
    ],
)
def test_headers_are_split_into_name_and_unit(header: str, expected: tuple[str, str | None]) -> None:
    """The unit is what stands in the brackets at the end; a malformed header stays whole."""
    assert column_header(header) == expected


@given(st.floats(1e-9, 1e9), st.sampled_from(["m", "Pa", "rad", "N", "N m", ""]))
def test_written_quantities_are_read_back(value: float, dimension: str) -> None:
    """What is written in field units is read back to the last digit."""
    assert quantity(text(value, dimension), dimension, "x") == value


def test_quantities_are_written_in_field_units() -> None:
    """Readable numbers stay readable."""
    assert [text(0.0101, "m"), text(268.0, "Pa"), text(1.5, "N"), text(0.8, "")] == [
        "10.1 mm",
        "0.268 kPa",
        "1.5 N",
        0.8,
    ]
    assert text(float(np.radians(29.3)), "rad") == "29.3 deg"


def test_an_angular_speed_has_an_angle() -> None:
    """1/min would be a sixth of what was meant; turns, degrees and radians count."""
    for unit, value in (("rpm", np.pi / 30), ("turn/s", 2 * np.pi), ("deg/s", np.pi / 180), ("rad/min", 1 / 60)):
        assert factor(unit, "rad/s") == pytest.approx(value, rel=1e-12)
    for unit in ("1/min", "Hz", "1/s"):
        with pytest.raises(
            StudyError, match=rf"'{unit}' is not a unit of angular speed \(e\.g\. \"1 rad/s, 10 rpm or 1 turn"
        ):
            factor(unit, "rad/s")
    for unit, si, kind in (("m rad/s", "m/s", "m/s"), ("N m/rad", "N m", "torque"), ("1/rad", "", "pure number")):
        with pytest.raises(StudyError, match=rf"'{unit}' is not a unit of {kind} \(e\.g\. "):
            factor(unit, si)
