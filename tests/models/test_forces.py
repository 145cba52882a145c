"""Forces of the three models at a given sinkage, against independent evaluations of the paper's equations."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mpmath as mp
import numpy as np
import pytest

from bayesterra.models import M1, M2, M3, MODELS, Forces, Soil, Wheel, WheelSoilModel
from bayesterra.models.checks import FloatArray

SLIPS = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
Draw = Callable[..., list[Any]]
Reference = Callable[..., FloatArray]
Judge = Callable[[Forces, FloatArray], FloatArray]
OPTIONS: list[dict[str, Any]] = [
    {}, {"transition_slips": (0.1, 0.5)}, {"shear_start": "rim"}, {"shear_start": "tip"},
    {"constant_exponent": True},
]  # fmt: skip


@pytest.mark.parametrize(("seed", "corners"), [(1, 0.0), (2, 0.3), (3, 0.7)])
def test_m1_agrees_with_adaptive_quadrature(
    box_pairs: Draw, adaptive: Reference, relative_errors: Judge, seed: int, corners: float
) -> None:
    """M1 is within 1e-9 of adaptive quadrature of (14) over the prior box, its faces and its corners."""
    model = M1()
    for pair in box_pairs(40, seed, corners=corners):
        forces = model.forces(pair.soil, pair.wheel, pair.slip, pair.sinkage)
        assert np.max(relative_errors(forces, adaptive(pair, model))) < 1e-9, pair


def test_m1_agrees_with_adaptive_quadrature_with_a_leaving_angle(
    box_pairs: Draw, adaptive: Reference, relative_errors: Judge
) -> None:
    """M1 is within 1e-9 of adaptive quadrature with c3 between -0.9 and 0.9 too."""
    model = M1()
    for pair in box_pairs(40, 4, corners=0.2, leaving=True):
        forces = model.forces(pair.soil, pair.wheel, pair.slip, pair.sinkage)
        assert np.max(relative_errors(forces, adaptive(pair, model))) < 1e-9, pair


@pytest.mark.parametrize("options", OPTIONS, ids=str)
@pytest.mark.parametrize("name", ["M1", "M2", "M3"])
def test_options_follow_the_equations(
    box_pairs: Draw, adaptive: Reference, extended: Reference, relative_errors: Judge,
    name: str, options: dict[str, Any],
) -> None:  # fmt: skip
    """Transition slips, R_j = r, R_j = R and a constant exponent enter where (5) and (13) say."""
    model = MODELS[name](**options)
    reference = adaptive if name == "M1" else extended
    for pair in box_pairs(6, 5):
        firm = replace(pair, soil=replace(pair.soil, n0=pair.soil.n0 + 0.3))
        forces = model.forces(firm.soil, firm.wheel, firm.slip, firm.sinkage)
        assert np.max(relative_errors(forces, reference(firm, model))) < 1e-9, firm


@pytest.mark.parametrize("model", [M2(), M3()], ids=lambda m: m.name)
@pytest.mark.parametrize(("seed", "corners"), [(1, 0.0), (2, 0.3), (3, 0.7)])
def test_closed_forms_agree_with_extended_precision(
    box_pairs: Draw, extended: Reference, relative_errors: Judge,
    model: WheelSoilModel, seed: int, corners: float,
) -> None:  # fmt: skip
    """M2 and M3 are within 1e-10 of CM1 and CM2 with forty digits over the prior box and with c3."""
    for pair in box_pairs(150, seed, corners=corners, leaving=seed == 2):
        forces = model.forces(pair.soil, pair.wheel, pair.slip, pair.sinkage)
        assert np.max(relative_errors(forces, extended(pair, model))) < 1e-10, pair


@pytest.mark.parametrize("model", [M1(), M2(), M3()], ids=lambda m: m.name)
def test_components_sum_to_forces(model: WheelSoilModel, g1: Soil, wheels: dict[str, Wheel]) -> None:
    """The components add up to F_N and F_DP."""
    forces = model.forces(g1, wheels["Wh32"], SLIPS, 0.01)
    parts = model.components(g1, wheels["Wh32"], SLIPS, 0.01)
    np.testing.assert_allclose(parts.F_N, forces.normal, rtol=1e-14)
    np.testing.assert_allclose(parts.F_DP, forces.drawbar_pull, rtol=0, atol=1e-13 * np.max(parts.F_DPtau))


def test_components_are_the_integrals_they_name(g1: Soil, wheels: dict[str, Wheel]) -> None:
    """Each component of M1 is the integral of its stress over its part of the arc, eq. (15)."""
    model, wheel = M1(), wheels["Wh32"]
    parts = model.components(g1, wheel, 0.3, 0.02)
    theta_1 = float(np.arccos(1 - 0.02 / wheel.radius))
    theta_m = (0.5 - 0.3 * 0.3) * theta_1

    nodes, weights = np.polynomial.legendre.leggauss(200)

    def integral(stress: int, weight: Callable[[FloatArray], FloatArray], low: float, high: float) -> float:
        theta = low + (high - low) * (nodes + 1) / 2
        values = np.asarray(model.stresses(g1, wheel, 0.3, 0.02, theta)[stress])
        return float(wheel.width * (high - low) / 2 * np.sum(weights * values * weight(theta)))

    r, rs = wheel.radius, float(wheel.shearing_radius(0.5))
    front, rear = (theta_m, theta_1), (0.0, theta_m)
    expected = [(0, np.cos, r), (1, np.sin, rs), (1, np.cos, rs), (0, np.sin, r)]
    got = [
        (parts.F_Nsigma1, parts.F_Nsigma2), (parts.F_Ntau1, parts.F_Ntau2),
        (parts.F_DPtau1, parts.F_DPtau2), (parts.F_DPsigma1, parts.F_DPsigma2),
    ]  # fmt: skip
    for (stress, weight, arm), (first, second) in zip(expected, got, strict=True):
        assert first == pytest.approx(arm * integral(stress, weight, *front), rel=1e-6)
        assert second == pytest.approx(arm * integral(stress, weight, *rear), rel=1e-6)


def test_shear_share_of_the_normal_force(g1: Soil, wheels: dict[str, Wheel]) -> None:
    """F_Ntau / W of the six wheels at 80 N and s = 0.6 is that of Table 4, recomputed."""
    shares = []
    for wheel in wheels.values():
        sinkage = M1().sinkage(g1, wheel, 0.6, 80.0)
        shares.append(100 * float(M1().components(g1, wheel, 0.6, sinkage).F_Ntau) / 80.0)
    np.testing.assert_allclose(shares, [16.3, 15.8, 18.0, 17.4, 15.0, 14.5], atol=0.06)


def test_m3_drops_the_shear_share(g1: Soil, wheels: dict[str, Wheel]) -> None:
    """M3 has no F_Ntau (CM2)."""
    np.testing.assert_array_equal(M3().components(g1, wheels["Wh11"], SLIPS, 0.01).F_Ntau, np.zeros(7))


def test_a_wheel_without_lugs(box_pairs: Draw, adaptive: Reference, relative_errors: Judge) -> None:
    """Without lugs r_s = R_j = r, and neither (2) nor the number of lugs matters."""
    bare = Wheel(radius=0.15, width=0.12)
    assert bare.shearing_radius(0.5) == 0.15
    for pair in box_pairs(5, 6):
        forces = M1().forces(pair.soil, bare, pair.slip, pair.sinkage)
        assert np.max(relative_errors(forces, adaptive(replace(pair, wheel=bare), M1()))) < 1e-9


def test_broadcasting(g1: Soil, wheels: dict[str, Wheel]) -> None:
    """Soil fields, slip and sinkage broadcast by NumPy's rules, and a single pair gives floats."""
    soil = replace(g1, K=np.array([0.01, 0.02, 0.03])[:, None, None])
    slips, depths = np.array([0.1, 0.4])[:, None], np.array([0.005, 0.01, 0.02, 0.04])
    forces = M1().forces(soil, wheels["Wh21"], slips, depths)
    assert np.shape(forces.normal) == (3, 2, 4)
    single = M1().forces(replace(g1, K=0.02), wheels["Wh21"], 0.4, 0.02)
    assert isinstance(single.drawbar_pull, float)
    assert np.asarray(forces.drawbar_pull)[1, 1, 2] == single.drawbar_pull
    assert np.shape(M2().sinkage(soil, wheels["Wh21"], slips, 50.0)) == (3, 2, 1)


def test_results_do_not_depend_on_neighbours(g1: Soil, wheels: dict[str, Wheel]) -> None:
    """A pair's forces and sinkage are the same to the last bit alone and among others."""
    rng = np.random.default_rng(2)
    soil = replace(g1, n0=rng.uniform(0.1, 1.5, 50), K=rng.uniform(0.002, 0.05, 50))
    together = M1().forces(soil, wheels["Wh11"], 0.2, 0.03)
    sinkages = np.asarray(M1().sinkage(soil, wheels["Wh11"], 0.2, 80.0))
    for i in (0, 17, 49):
        alone = replace(g1, n0=np.asarray(soil.n0)[i], K=np.asarray(soil.K)[i])
        assert M1().forces(alone, wheels["Wh11"], 0.2, 0.03).drawbar_pull == np.asarray(together.drawbar_pull)[i]
        assert M1().sinkage(alone, wheels["Wh11"], 0.2, 80.0) == sinkages[i]


def test_shear_coefficient_from_friction_broadcasts(g1: Soil, wheels: dict[str, Wheel]) -> None:
    """With lambda_s from (2) each soil has its own shearing radius."""
    wheel = replace(wheels["Wh11"], shearing_radius_coefficient=None)
    phi = np.array([0.4, 0.6])
    forces = M1().forces(replace(g1, phi=phi), wheel, 0.3, 0.02)
    for i in range(2):
        radius = np.asarray(wheel.shearing_radius(phi))[i]
        fixed = replace(wheel, shearing_radius_coefficient=float(radius - 0.135) / 0.015)
        expected = M1().forces(replace(g1, phi=phi[i]), fixed, 0.3, 0.02).resistance_moment
        assert np.asarray(forces.resistance_moment)[i] == pytest.approx(expected, rel=1e-12)


def test_stresses_meet_at_the_maximum_stress_angle(g1: Soil, wheels: dict[str, Wheel]) -> None:
    """All models have sigma_m of (18) at theta_m, zero stress at both ends, and zero off the arc."""
    wheel = wheels["Wh12"]
    theta_1 = float(np.arccos(1 - 0.02 / 0.135))
    theta_m = (0.5 - 0.3 * 0.2) * theta_1
    peak = float(2.5e6 * (mp.mpf(0.135) * (mp.cos(theta_m) - mp.cos(theta_1))) ** (0.76 + 1.3 * 0.2))
    for model in (M1(), M2(), M3()):
        sigma, tau = model.stresses(g1, wheel, 0.2, 0.02, np.array([-0.1, 0.0, theta_m, theta_1, 1.5]))
        np.testing.assert_allclose(sigma, [0, 0, peak, 0, 0], rtol=1e-9, atol=1e-3)
        assert np.asarray(tau)[2] > 0
