"""Values outside a model's range are refused in one line that names them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bayesterra.models import M1, MODELS, Conditions, Soil, Wheel


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"Ks": 0.0}, r"'Ks' must be positive \(got 0\)"),
        ({"K": -0.01}, r"'K' must be positive \(got -0.01\)"),
        ({"c": -1.0}, r"'c' must not be negative \(got -1\)"),
        ({"phi": -0.1}, r"'phi' must not be negative \(got -0.1\)"),
        ({"phi": 1.6}, r"'phi' must be below pi/2 rad \(got 1.6\)"),
        ({"n0": np.nan}, r"'n0' must be finite \(got nan\)"),
        ({"c1": "half"}, r"'c1' must be a number or an array of numbers \(got 'half'\)"),
        ({"K": np.array([0.01, 0.0])}, r"'K' must be positive \(got 0, row 1\)"),
        ({"K": np.array([[0.01, 0.0]])}, r"'K' must be positive \(got 0, row \(0, 1\)\)"),
    ],
)
def test_impossible_soils(g1: Soil, change: dict[str, Any], message: str) -> None:
    """A soil names the parameter, the rule, the value and its row."""
    with pytest.raises(ValueError, match=message):
        replace(g1, **change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"radius": 0.0}, r"'radius' must be positive \(got 0\)"),
        ({"width": -0.1}, r"'width' must be positive \(got -0.1\)"),
        ({"lug_height": -0.01}, r"'lug_height' must not be negative \(got -0.01\)"),
        ({"lug_count": 2.5}, r"'lug_count' must be a whole number \(got 2.5\)"),
        ({"lug_count": -1}, r"'lug_count' must not be negative \(got -1\)"),
        ({"shearing_radius_coefficient": 1.5}, r"'shearing_radius_coefficient' must lie in \[0, 1\] \(got 1.5\)"),
    ],
)
def test_impossible_wheels(wheels: dict[str, Wheel], change: dict[str, Any], message: str) -> None:
    """A wheel names the dimension, the rule and the value."""
    with pytest.raises(ValueError, match=message):
        replace(wheels["Wh11"], **change)


def test_shear_coefficient_where_its_equation_fails() -> None:
    """Short lugs drive equation (2) below zero: the error says so and what to do."""
    wheel = Wheel(radius=0.135, width=0.165, lug_height=0.005, lug_count=24)
    message = r"'shearing_radius_coefficient' from equation \(2\) must lie in \[0, 1\]; give .* instead \(got -0.2"
    with pytest.raises(ValueError, match=message):
        wheel.shearing_radius(0.0)


@pytest.mark.parametrize(
    ("slip", "sinkage", "message"),
    [
        (-0.1, 0.01, r"'slip' must lie in \[0, 1\) \(got -0.1\)"),
        (1.0, 0.01, r"'slip' must lie in \[0, 1\) \(got 1\)"),
        (np.nan, 0.01, r"'slip' must be finite \(got nan\)"),
        (0.1, 0.0, r"'sinkage' must be positive \(got 0\)"),
        (0.1, 0.2, r"'sinkage' must be below the wheel radius 0.135 m \(got 0.2\)"),
        (0.1, [0.01, 0.2], r"'sinkage' must be below the wheel radius 0.135 m \(got 0.2, row 1\)"),
    ],
)
@pytest.mark.parametrize("name", ["M1", "M2", "M3"])
def test_inputs_out_of_range(
    g1: Soil, wheels: dict[str, Wheel], name: str, slip: float, sinkage: float, message: str
) -> None:
    """Slip and sinkage outside the model's range are refused by forces, components and stresses."""
    model = MODELS[name]()
    with pytest.raises(ValueError, match=message):
        model.forces(g1, wheels["Wh11"], slip, sinkage)
    with pytest.raises(ValueError, match=message):
        model.components(g1, wheels["Wh11"], slip, sinkage)
    with pytest.raises(ValueError, match=message):
        model.stresses(g1, wheels["Wh11"], slip, sinkage, 0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"n0": -1.0}, r"'n0 \+ n1 s' must be positive \(got -0.74\)"),
        ({"c1": 1.2}, r"'c1 \+ c2 s' must lie between c3 and 1, and c3 in \[-1, 1\) \(got 1.14\)"),
        ({"c3": 0.5}, r"'c1 \+ c2 s' must lie between c3 and 1, and c3 in \[-1, 1\) \(got 0.44\)"),
        ({"c3": -1.1}, r"'c1 \+ c2 s' must lie between c3 and 1, and c3 in \[-1, 1\) \(got 0.44\)"),
    ],
)
def test_soil_and_slip_that_do_not_go_together(
    g1: Soil, wheels: dict[str, Wheel], change: dict[str, Any], message: str
) -> None:
    """Exponent and maximum-stress angle are checked at the slip given, by forces, sinkage and stresses."""
    soil, wheel = replace(g1, **change), wheels["Wh11"]
    with pytest.raises(ValueError, match=message):
        M1().forces(soil, wheel, 0.2, 0.01)
    with pytest.raises(ValueError, match=message):
        M1().sinkage(soil, wheel, 0.2, 80.0)
    with pytest.raises(ValueError, match=message):
        M1().stresses(soil, wheel, 0.2, 0.01, 0.1)


def test_constant_exponent_ignores_slip_in_its_check(g1: Soil, wheels: dict[str, Wheel]) -> None:
    """With a constant exponent only n0 has to be positive."""
    soil = replace(g1, n1=-20.0)
    model = M1(constant_exponent=True)
    assert model.forces(soil, wheels["Wh11"], 0.2, 0.01).normal > 0
    assert np.asarray(model.stresses(soil, wheels["Wh11"], 0.2, 0.01, 0.1)[0]) > 0
    with pytest.raises(ValueError, match=r"'n0 \+ n1 s' must be positive \(got -0.5\)"):
        model.forces(replace(soil, n0=-0.5), wheels["Wh11"], 0.2, 0.01)


def test_loads_must_be_positive(g1: Soil, wheels: dict[str, Wheel]) -> None:
    """A load of zero or less has no sinkage."""
    with pytest.raises(ValueError, match=r"'load' must be positive \(got 0, row 1\)"):
        M1().sinkage(g1, wheels["Wh11"], 0.2, np.array([80.0, 0.0]))


@pytest.mark.parametrize("slips", [(0.5, 0.1), (0.2, 0.2), (-0.1, 0.5), (0.1, 1.5)])
def test_transition_slips_must_rise(slips: tuple[float, float]) -> None:
    """Transition slips rise within [0, 1]."""
    with pytest.raises(ValueError, match=r"'transition_slips' must rise within \[0, 1\] \(got \("):
        M1(transition_slips=slips)


def test_unknown_shear_start() -> None:
    """The shear's start has three names."""
    with pytest.raises(ValueError, match=r"'shear_start' must be one of transition, rim, tip \(got 'middle'\)"):
        M1(shear_start="middle")  # type: ignore[arg-type]  # the point of the test


def test_conditions_check_their_rows(wheels: dict[str, Wheel]) -> None:
    """Rows need a slip in range, a wheel each, and phi where (2) asks for it."""
    with pytest.raises(ValueError, match=r"'slip' must lie in \[0, 1\) \(got 1.2, row 1\)"):
        Conditions.of(wheels["Wh11"], [0.1, 1.2])
    with pytest.raises(ValueError, match=r"'wheels' must be one wheel or one per row \(2\) \(got 1\)"):
        Conditions.of([wheels["Wh11"]], [0.1, 0.2])
    bare = replace(wheels["Wh11"], shearing_radius_coefficient=None)
    with pytest.raises(ValueError, match=r"'phi' must be given for a wheel without shearing_radius_coefficient"):
        Conditions.of(bare, [0.1])
    assert Conditions.of(bare, [0.1], phi=0.5568).shearing_radius[0] == pytest.approx(0.135 + 0.744 * 0.015, abs=1e-5)


def test_one_name_for_the_package() -> None:
    """The folder refuses to be imported under a second name."""
    import runpy
    from pathlib import Path

    import bayesterra

    with pytest.raises(ImportError, match=r"import this package as 'bayesterra.models', not 'models'"):
        runpy.run_path(str(Path(bayesterra.models.__file__)), run_name="models")


def test_importing_the_models_does_not_import_numba() -> None:
    """The command line starts in a blink: numba comes with the first evaluation."""
    import subprocess
    import sys

    code = "import bayesterra.models, sys; sys.exit('numba' in sys.modules or 'scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
