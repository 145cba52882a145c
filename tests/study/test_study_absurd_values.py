"""Values that no wheel, soil or instrument has: refused in a line that names place, value and bound."""

from collections.abc import Callable
from typing import Any

import pandas as pd
import pytest

import bayesterra as bt

FIXED = {"set": "paper-box", "Ks": 2.5e6, "n0": 0.85, "n1": 1.06, "c": 268.0, "K": 0.01, "c1": 0.3, "c2": 0.0}


def study(wheel: Any = None, noise: Any = 1e-3, **columns: Any) -> bt.Study:
    """Two rows in which columns were replaced; only φ is free."""
    rows = pd.DataFrame(
        {"slip": [0.1, 0.2], "load [N]": 80.0, "sinkage [mm]": [5.0, 7.0], "drawbar_pull [N]": [10.0, 20.0]}
    )
    return bt.Study(
        rows.assign(**{name.replace("_[", " ["): column for name, column in columns.items()}),
        {"W": wheel or bt.Wheel(0.157, 0.165)},
        slip_reference="shearing",
        model="M2",
        noise={"sinkage": noise, "drawbar_pull": 1.0},
        priors=FIXED,
    )


@pytest.mark.parametrize(
    ("name", "value", "bound"),
    [
        *(("drawbar_pull", value, "800000") for value in (1e6, 1e9, 1e160, 1e300, -1e300)),
        *(("load", value, r"1e\+12") for value in (2e12, 1e160, 1e300, -1e300)),
    ],
)
def test_readings_beyond_every_wheel(name: str, value: float, bound: str) -> None:
    """The line names column, row, value and bound; a run would be drowned by one such reading."""
    got = f"{value:g}".replace("+", r"\+")
    with pytest.raises(bt.StudyError, match=rf"'{name}' must lie within ±{bound} N \(got {got} N, row 2\)"):
        study(**{f"{name}_[N]": [80.0, value]})


def test_what_stands_on_the_bound_is_taken() -> None:
    """And rows that are not in the fit are left out, as with every other problem."""
    assert len(study(**{"drawbar_pull_[N]": [10.0, 8e5]}).observations) == 2
    left = study(**{"drawbar_pull_[N]": [10.0, 1e300]}, use=[1, 0])
    assert len(left.observations) == 1
    assert "'drawbar_pull' must lie within" in " ".join(left.notes)


def test_a_giant_wheel_carries_more() -> None:
    """The bound on pulls grows with the loads of the table."""
    taken = study(bt.Wheel(100.0, 50.0), **{"load_[N]": [1e8, 1e9], "drawbar_pull_[N]": [1e7, 1e8]})
    assert taken.observations.load[1] == 1e9


def test_a_sinkage_far_above_the_ground() -> None:
    """A wheel that hangs in the air by more than its radius is a mistake."""
    with pytest.raises(bt.StudyError, match=r"'sinkage' must lie within ±157 mm \(got -1e\+300 mm, row 2\)"):
        study(**{"sinkage_[mm]": [5.0, -1e300]})


REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "noise": (lambda: study(noise=1e-300), r"noise of 'sinkage' must be at least 1e-15 in SI units"),
    "sd": (
        lambda: study(**{"sinkage_sd_[mm]": [1.0, 1e-300]}),
        r"'sinkage_sd' must be at least 1e-12 mm \(got 1e-300 mm, row 2\)",
    ),
    "wheel": (lambda: bt.Wheel(1e300, 0.1), r"'radius' must lie between 1e-6 and 1000 m \(got 1e\+300\)"),
    "width": (lambda: bt.Wheel(0.1, 1e-300), r"'width' must lie between 1e-6 and 1000 m \(got 1e-300\)"),
    "wheel table": (
        lambda: study({"radius": 1e300, "width": 0.1}),
        r"'radius' must lie between 1e-6 and 1000 m \(got 1e\+300\)",
    ),
    "range": (
        lambda: bt.Law("uniform", lower=-1e308, upper=1e308),
        r"'lower' must lie within ±1e\+30 \(got -1e\+308\)",
    ),
    "scale": (lambda: bt.Law("norm", {"scale": 1e300}), r"'scale' must lie within ±1e\+30 \(got 1e\+300\)"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_other_absurd_values(name: str) -> None:
    """Before anything overflows; warnings are errors here."""
    call, message = REFUSED[name]
    with pytest.raises(ValueError, match=message):
        call()
