"""Files of rovers."""

from pathlib import Path

import pytest

from bayesterra.errors import StudyError
from bayesterra.models import Wheel
from bayesterra.prediction.rover import EARTH, read_rover

WHEELS = {"Wh32": Wheel(0.15735, 0.165, 0.010, 30, 0.65)}
FILE = """\
name = "small rover"
mass = { value = "32 kg", assumption = "weighed with empty tanks" }
wheelbase = "0.8 m"
wheel = "Wh32"
tow_height = { value = "20 cm", assumption = "read from a drawing" }
front_to_rear_speed = 1.05

[centre_of_gravity]
height = "300 mm"
ahead_of_rear_axle = { value = "0.4 m", assumption = "taken as midway" }
"""
OWN = """
[rear_wheel]
radius = { value = "100 mm", assumption = "seen on a photo" }
width = "80 mm"
lug_height = "10 mm"
lug_count = 24
"""


def written(folder: Path, text: str) -> Path:
    """A file of a rover."""
    path = folder / "rover.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_becomes_a_rover_that_names_its_assumptions(tmp_path: Path) -> None:
    """Values are SI, and every number that is an assumption says so; so does what was left out."""
    found = read_rover(written(tmp_path, FILE), WHEELS, 0.5)
    assert found.weight == pytest.approx(32 * EARTH)
    assert (found.wheelbase, found.centre_height, found.centre_ahead) == (0.8, 0.3, 0.4)
    assert found.tow_height == pytest.approx(0.2)
    assert found.wheels == (WHEELS["Wh32"],) * 2
    assert [str(one) for one in found.assumptions] == [
        "mass 32 kg is an assumption: weighed with empty tanks",
        "tow height 20 cm is an assumption: read from a drawing",
        "ahead of rear axle of the centre of gravity 0.4 m is an assumption: taken as midway",
        "gravity 9.80665 m/s² is an assumption: none is given, so the Earth's is taken",
    ]


def test_a_wheel_of_its_own(tmp_path: Path) -> None:
    """An axle may have its own wheel, whose shearing radius (2) gives at the study's friction angle."""
    text = FILE.replace('wheel = "Wh32"', 'front_wheel = "Wh32"') + OWN
    found = read_rover(written(tmp_path, text), WHEELS, 0.5)
    assert found.wheel_names == ("Wh32", "rear wheel")
    assert found.wheels[1].radius == 0.1
    expected = Wheel(0.1, 0.08, 0.01, 24).shearing_radius(0.5)
    assert found.wheels[1].shearing_radius() == pytest.approx(expected)
    assert "radius of the rear wheel 100 mm is an assumption: seen on a photo" in map(str, found.assumptions)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"0.8 m"', '"0.8 kg"', r"'wheelbase': the unit 'kg' is not a unit of length .* \(got '0.8 kg'\)"),
        ('"0.8 m"', "0.8", r"'wheelbase' needs a unit: .* \(got 0.8\)"),
        ('"0.8 m"', '"0.3 m"', r"'wheelbase' must exceed the radii of both wheels, 0.3147 m \(got 0.3\)"),
        ("wheelbase", "weelbase", r"unknown key 'weelbase' \(did you mean 'wheelbase'\?\)"),
        ('wheelbase = "0.8 m"\n', "", r"needs 'wheelbase'"),
        ("mass", "weight", r"'weight': the unit 'kg' is not a unit of force"),
        ('name = "small rover"', 'weight = "3 N"', r"needs either 'mass' or 'weight' \(got both\)"),
        ('mass = { value = "32 kg", assumption = "weighed with empty tanks" }\n', "", r"\(got neither\)"),
        ('"32 kg"', '"0 kg"', r"'weight' must be above 0 N \(got 0\)"),
        ("assumption", "asumption", r"'mass' must be a value or \{ .* \(got the keys asumption, value\)"),
        ('wheel = "Wh32"', 'wheel = "Wh31"', r"'wheel': unknown wheel 'Wh31' \(did you mean 'Wh32'\?\)"),
        ('wheel = "Wh32"\n', "", r"needs 'wheel', or 'front_wheel' and 'rear_wheel' \(e.g. wheel = \"Wh32\""),
        ('wheel = "Wh32"', "wheel = 3", r"'wheel' must be the name of a study's wheel or a table \(got 3\)"),
        ('wheel = "Wh32"', 'wheel = { radius = "1 m" }', r"\[wheel\] needs 'width'"),
        ("= 1.05", "= 3", r"'front_to_rear_speed' must lie between 0.5 and 2 \(got 3\)"),
        ('"0.4 m"', '"0.9 m"', r"ahead_of_rear_axle' must lie between the axles, 0 to 0.8 m"),
        ("[centre_of_gravity]", "[centre]", r"unknown key 'centre'"),
        ('height = "300 mm"', "", r"\[centre_of_gravity\] needs 'height'"),
    ],
)  # fmt: skip
def test_mistakes_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    """One line with the file, the key, the rule and the value."""
    assert old in FILE
    path = written(tmp_path, FILE.replace(old, new, 1))
    with pytest.raises(StudyError, match=message) as caught:
        read_rover(path, WHEELS, 0.5)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_no_file(tmp_path: Path) -> None:
    """A missing file is named as what was looked for."""
    with pytest.raises(StudyError, match=r"none.toml: no such rover file"):
        read_rover(tmp_path / "none.toml", WHEELS, 0.5)
