"""Sinkage under a load."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bayesterra.models import M1, M2, M3, Soil, Wheel, WheelSoilModel

Draw = Callable[..., list[Any]]
MODELS = pytest.mark.parametrize("model", [M1(), M2(), M3()], ids=lambda m: m.name)


@MODELS
@pytest.mark.parametrize(("seed", "corners"), [(1, 0.0), (2, 0.3), (3, 0.7)])
def test_sinkage_gives_the_load_back(box_pairs: Draw, model: WheelSoilModel, seed: int, corners: float) -> None:
    """F_N at the solved sinkage is the load to 1e-10 over the prior box, and no larger sinkage was taken."""
    for pair in box_pairs(200, seed, corners=corners):
        load = float(model.forces(pair.soil, pair.wheel, pair.slip, pair.sinkage).normal)
        sinkage = model.sinkage(pair.soil, pair.wheel, pair.slip, load)
        again = model.forces(pair.soil, pair.wheel, pair.slip, sinkage).normal
        assert again == pytest.approx(load, rel=1e-10)
        assert sinkage <= pair.sinkage * (1 + 1e-6)


@MODELS
@pytest.mark.parametrize("load", [1e-6, 0.1, 1e3, 2e3])
def test_extreme_loads(g1: Soil, wheels: dict[str, Wheel], model: WheelSoilModel, load: float) -> None:
    """Tiny loads and loads that bury the wheel almost to its axle are solved too."""
    sinkage = model.sinkage(g1, wheels["Wh31"], 0.1, load)
    assert model.forces(g1, wheels["Wh31"], 0.1, sinkage).normal == pytest.approx(load, rel=1e-10)


@MODELS
def test_every_soil_of_the_paper_carries_80_newtons(
    soils: list[Soil], wheels: dict[str, Wheel], model: WheelSoilModel
) -> None:
    """G1 and the soils of Table 10 carry 80 N on all six wheels at slips up to 0.6, deeper with more slip."""
    slips = np.linspace(0, 0.6, 13)
    for soil in soils:
        for wheel in wheels.values():
            sinkage = np.asarray(model.sinkage(soil, wheel, slips, 80.0))
            np.testing.assert_allclose(model.forces(soil, wheel, slips, sinkage).normal, 80.0, rtol=1e-10)
            assert np.all(np.diff(sinkage) > 0)
            assert 0.001 < sinkage[0] < sinkage[-1] < 0.07


def test_the_smaller_of_two_sinkages(wheels: dict[str, Wheel]) -> None:
    """Where F_N of M3 falls again, the smaller sinkage is returned, and a load above the peak refused."""
    soil = Soil(Ks=1e6, n0=0.2, n1=0.0, c=0.0, phi=0.5, K=0.01, c1=0.95, c2=0.0)
    wheel = wheels["Wh11"]
    depths = np.linspace(0.001, 0.134, 400)
    normal = np.asarray(M3().forces(soil, wheel, 0.1, depths).normal)
    peak = int(np.argmax(normal))
    assert peak < 350
    load = 0.5 * (normal[peak] + normal[-1])
    sinkage = M3().sinkage(soil, wheel, 0.1, load)
    assert sinkage < depths[peak]
    assert M3().forces(soil, wheel, 0.1, sinkage).normal == pytest.approx(load, rel=1e-10)
    near_peak = M3().sinkage(soil, wheel, 0.1, normal[peak] * (1 - 1e-9))
    assert near_peak == pytest.approx(depths[peak], rel=0.02)
    with pytest.raises(ValueError, match=r"'load' must be carried by a sinkage below the wheel radius \(got "):
        M3().sinkage(soil, wheel, 0.1, normal[peak] * 1.001)


def test_normal_force_of_m1_rises_with_sinkage(box_pairs: Draw) -> None:
    """F_N of M1 rises with sinkage all the way to the radius over the prior box, so its sinkage is unique."""
    for pair in box_pairs(150, 7, corners=0.3):
        depths = np.concatenate([np.geomspace(1e-6, 0.02, 20), np.linspace(0.03, 0.99999, 40)]) * pair.wheel.radius
        normal = M1().forces(pair.soil, pair.wheel, pair.slip, depths).normal
        assert np.all(np.diff(normal) > 0), pair


def test_a_load_that_nothing_carries(g1: Soil, wheels: dict[str, Wheel]) -> None:
    """A load beyond F_N at z = r is an error that names the load and its row."""
    heaviest = float(M1().forces(g1, wheels["Wh11"], 0.1, 0.135 * (1 - 1e-7)).normal)
    assert M1().sinkage(g1, wheels["Wh11"], 0.1, 0.999 * heaviest) < 0.135
    with pytest.raises(ValueError, match=r"'load' must be carried .* \(got .*, row 1\)"):
        M1().sinkage(g1, wheels["Wh11"], 0.1, np.array([80.0, 1.01 * heaviest]))


def test_softer_soil_means_more_sinkage(g1: Soil, wheels: dict[str, Wheel]) -> None:
    """Sinkage grows as K_s falls."""
    moduli = np.geomspace(10e6, 0.1e6, 9)
    assert np.all(np.diff(M1().sinkage(replace(g1, Ks=moduli), wheels["Wh22"], 0.2, 80.0)) > 0)
