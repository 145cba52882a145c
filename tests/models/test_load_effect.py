"""M2L: M2 with the load effect, eq. (42), against the printed equations and against M2."""

import math
from collections.abc import Callable
from dataclasses import astuple, replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from bayesterra.models import (
    LOAD_EFFECT_FIELDS,
    M1,
    M2,
    M2L,
    M3,
    Conditions,
    LoadEffectSoil,
    Soil,
    Status,
    Wheel,
    WheelSoilModel,
)
from bayesterra.models.checks import FloatArray

# Table 16, flat terrain: K_s, n0, n1, c, phi, K; c1 = 0.5, c2 = c3 = 0; c_P1, c_P2, c_DP, c_M.
TOYOURA = LoadEffectSoil(
    Ks=1.796e6, n0=0.63, n1=0.72, c=25.0, phi=math.radians(35.8), K=0.0105, c1=0.5, c2=0.0,
    cP1=-0.276, cP2=0.633, cDP=-0.304, cM=0.354,
)  # fmt: skip
MEAN = 64.0
SLIPS = np.array([0.05, 0.2, 0.4, 0.6])
LOADS = np.array([30.0, 64.0, 90.0, 120.0])


def printed(soil: LoadEffectSoil, wheel: Wheel, slip: float, z: float, normal: float) -> tuple[float, ...]:
    """Return F_N, F_DP, M_DR by (42a-c) as printed, with `normal` for F_N on the right-hand sides."""
    r, b, rs = wheel.radius, wheel.width, float(wheel.shearing_radius(float(soil.phi)))
    share = min(1.0, max(0.0, (0.5 - slip) / (0.5 - 0.15)))
    start = math.acos((r - z) / (r + wheel.lug_height * share))
    t1 = math.acos((r - z) / r)
    t2, tm = float(soil.c3) * t1, (float(soil.c1) + float(soil.c2) * slip) * t1
    A = (math.cos(tm) - math.cos(t2)) / (tm - t2) + (math.cos(tm) - math.cos(t1)) / (t1 - tm)
    B = (math.sin(tm) - math.sin(t2)) / (tm - t2) + (math.sin(tm) - math.sin(t1)) / (t1 - tm)
    C = (t1 - t2) / 2
    sigma = soil.Ks * r ** (soil.n0 + soil.n1 * slip) * (math.cos(tm) - math.cos(t1)) ** (soil.n0 + soil.n1 * slip)
    path = rs * ((start - tm) - (1 - slip) * (math.sin(start) - math.sin(tm)))
    E = 1 - math.exp(-path / float(soil.K))
    t, W = math.tan(float(soil.phi)), MEAN
    moment = (
        rs**2 * C * E * (b * soil.c + (1 + soil.cM * (W - normal) / W) * normal * t / (r * A))
        / (1 + rs * B * E * t / (r * A))
    )  # fmt: skip
    pull = (
        (moment * (A**2 + B**2) / (rs * A * C) - B * normal / A)
        * (1 + soil.cP1 + soil.cP2 * slip) * (1 + soil.cDP * (W - normal) / W)
    )  # fmt: skip
    return float(r * b * A * sigma + B * moment / (rs * C)), float(pull), float(moment)


@pytest.fixture(scope="module")
def wheel(wheels: dict[str, Wheel]) -> Wheel:
    """Return a wheel of the paper."""
    return wheels["Wh12"]


@pytest.fixture(scope="module")
def cloud() -> FloatArray:
    """Return parameter sets (20, 13) around Table 16, with a leaving angle and signs of c_M both ways."""
    rng = np.random.default_rng(5)
    theta = np.array(astuple(TOYOURA)) * np.exp(0.1 * rng.normal(size=(20, 13)))
    theta[:, 8] = rng.uniform(-0.1, 0.1, 20)
    theta[:, 9:] = rng.uniform(-0.6, 0.6, (20, 4))
    return theta


@pytest.mark.parametrize("cM", [0.354, -0.5])
@pytest.mark.parametrize("load", [30.0, 64.0, 110.0])
@pytest.mark.parametrize("slip", [0.05, 0.4])
def test_load_driven_solves_the_printed_equations(wheel: Wheel, slip: float, load: float, cM: float) -> None:
    """With F_N = W on the right-hand sides, (42a) gives the load back at the sinkage that M2L returns."""
    soil = replace(TOYOURA, c2=-0.1, c3=0.05, cM=cM)
    model = M2L(mean_load=MEAN)
    z = float(model.sinkage(soil, wheel, slip, load))
    expected = brentq(lambda x: printed(soil, wheel, slip, x, load)[0] - load, 1e-5, 0.9 * wheel.radius)
    assert z == pytest.approx(expected, rel=1e-8)
    forces = model.forces(soil, wheel, slip, z)
    _, pull, moment = printed(soil, wheel, slip, z, load)
    assert forces.normal == pytest.approx(load, rel=1e-9)
    assert forces.drawbar_pull == pytest.approx(pull, rel=1e-8)
    assert forces.resistance_moment == pytest.approx(moment, rel=1e-8)


def test_sinkage_driven_solves_for_the_normal_force(wheel: Wheel) -> None:
    """At a sinkage, F_N is the fixed point of (42a) with (42c)."""
    model = M2L(mean_load=MEAN)
    for cM in (0.6, -0.3):
        soil = replace(TOYOURA, cM=cM)
        for z in (0.001, 0.003):
            found = model.forces(soil, wheel, 0.3, z)
            assert printed(soil, wheel, 0.3, z, float(found.normal)) == pytest.approx(
                (found.normal, found.drawbar_pull, found.resistance_moment), rel=1e-10
            )


@pytest.mark.parametrize("mean", [10.0, 64.0, 500.0])
def test_without_coefficients_it_is_m2(mean: float, wheel: Wheel, box_pairs: Callable[..., list[Any]]) -> None:
    """With c_P1 = c_P2 = c_DP = c_M = 0 and any mean load, M2L is M2 to 1e-12 over the prior box."""
    pairs, model = box_pairs(200, 7, leaving=True), M2L(mean_load=mean)
    for pair in pairs:
        ours = model.forces(pair.soil, pair.wheel, pair.slip, pair.sinkage)
        m2 = M2().forces(pair.soil, pair.wheel, pair.slip, pair.sinkage)
        parts = M2().components(pair.soil, pair.wheel, pair.slip, pair.sinkage)
        size = abs(float(parts.F_DPtau)) + abs(float(parts.F_DPsigma))
        assert ours.normal == pytest.approx(m2.normal, rel=1e-12)
        assert ours.resistance_moment == pytest.approx(m2.resistance_moment, rel=1e-12)
        assert float(ours.drawbar_pull) == pytest.approx(float(m2.drawbar_pull), rel=0, abs=1e-12 * size)
    plain = Soil(*astuple(TOYOURA)[:9])
    np.testing.assert_allclose(
        model.sinkage(plain, wheel, SLIPS, LOADS), M2().sinkage(plain, wheel, SLIPS, LOADS), rtol=1e-12
    )


def test_at_the_mean_load_only_the_slip_terms_act(wheel: Wheel) -> None:
    """With F_N at the mean load, sinkage and moment are M2's, and the pull (1 + c_P1 + c_P2 s) times M2's."""
    z = M2L(mean_load=MEAN).sinkage(TOYOURA, wheel, SLIPS, MEAN)
    forces, m2 = (
        M2L(mean_load=MEAN).forces(TOYOURA, wheel, SLIPS, z),
        M2().forces(Soil(*astuple(TOYOURA)[:9]), wheel, SLIPS, z),
    )
    np.testing.assert_allclose(m2.normal, MEAN, rtol=1e-9)
    np.testing.assert_allclose(forces.resistance_moment, m2.resistance_moment, rtol=1e-9)
    factor = 1 - 0.276 + 0.633 * SLIPS
    np.testing.assert_allclose(forces.drawbar_pull, factor * m2.drawbar_pull, rtol=1e-8)


def test_batch_and_plain_interface_agree(wheel: Wheel, cloud: FloatArray) -> None:
    """The batch interface returns what the plain one does; a response has the forces at its sinkage."""
    model = M2L(mean_load=MEAN)
    conditions = Conditions.of(wheel, SLIPS)
    response, status = model.response_at(cloud, conditions, LOADS)
    assert np.all(status == Status.OK)
    forces, status = model.forces_at(cloud, conditions, response[..., 0])
    assert np.all(status == Status.OK)
    np.testing.assert_allclose(forces[..., 0], np.broadcast_to(LOADS, (20, 4)), rtol=1e-10)
    np.testing.assert_allclose(forces[..., 1:], response[..., 1:], rtol=1e-7, atol=1e-7)
    soil = LoadEffectSoil(*cloud[:, None, :].transpose(2, 0, 1))
    plain = model.forces(soil, wheel, SLIPS, response[..., 0])
    np.testing.assert_array_equal(forces[..., 1], plain.drawbar_pull)
    with pytest.raises(ValueError, match=r"'theta' must have shape \(n, 13\)"):
        model.forces_at(cloud[:, :9], conditions, 0.002)


def test_jacobian_equals_central_differences(wheel: Wheel, cloud: FloatArray) -> None:
    """Derivatives by all thirteen parameters and the sinkage agree with central differences."""
    model, conditions, depth = M2L(mean_load=MEAN), Conditions.of(wheel, SLIPS), 0.003
    jacobian = model.jacobian_at(cloud, conditions, np.full(4, depth))
    assert jacobian.shape == (20, 4, 3, 14)

    def forces(column: int, move: float) -> FloatArray:
        theta = cloud.copy()
        theta[:, min(column, 12)] += move * (column < 13)
        return model.forces_at(theta, conditions, np.full(4, depth + move * (column == 13)))[0]

    compare(jacobian, forces, [*np.abs(cloud).mean(axis=0), depth])


def test_response_jacobian_equals_central_differences(wheel: Wheel, cloud: FloatArray) -> None:
    """Derivatives of sinkage, pull and moment at constant load agree with central differences."""
    model, conditions = M2L(mean_load=MEAN), Conditions.of(wheel, SLIPS)
    jacobian = model.response_jacobian_at(cloud, conditions, LOADS)
    assert jacobian.shape == (20, 4, 3, 13)

    def response(column: int, move: float) -> FloatArray:
        theta = cloud.copy()
        theta[:, column] += move
        return model.response_at(theta, conditions, LOADS)[0]

    compare(jacobian, response, list(np.abs(cloud).mean(axis=0)))
    assert np.abs(jacobian[:, 0, 1, 9:]).min() > 0  # each of the four moves the pull
    assert np.all(jacobian[..., 0, 9:12] == 0)  # and only c_M the sinkage


def compare(jacobian: FloatArray, values: Callable[[int, float], FloatArray], sizes: list[float]) -> None:
    """Compare every column of a Jacobian with central differences of fourth order."""
    for column, size in enumerate(sizes):
        step = 1e-3 * (size if size > 0 else 0.1)
        ends = [values(column, factor * step) for factor in (-2, -1, 1, 2)]
        slope = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * step)
        assert np.isfinite(slope).all()
        scale = np.abs(jacobian[..., column]).max(axis=(0, 1))
        np.testing.assert_allclose(
            slope / np.where(scale > 0, scale, 1), jacobian[..., column] / np.where(scale > 0, scale, 1),
            rtol=0, atol=2e-6,
        )  # fmt: skip


def test_stresses_integrate_to_the_forces(wheel: Wheel) -> None:
    """The stresses that M2L returns give F_N and M_DR back; c_M is in the shear stress."""
    model, z, slip = M2L(mean_load=MEAN), 0.003, 0.3
    forces = model.forces(TOYOURA, wheel, slip, z)
    entrance = math.acos(1 - z / wheel.radius)
    r, rs, b = wheel.radius, float(wheel.shearing_radius()), wheel.width

    def total(term: Callable[[float, float, float], float]) -> float:
        def at(angle: float) -> float:
            sigma, tau = model.stresses(TOYOURA, wheel, slip, z, angle)
            return term(angle, float(sigma), float(tau))

        halves = ((0.0, entrance / 2), (entrance / 2, entrance))
        return sum(float(quad(at, *part, epsrel=1e-11)[0]) for part in halves)

    moment = rs**2 * b * total(lambda a, sigma, tau: tau)
    normal = b * total(lambda a, sigma, tau: r * sigma * math.cos(a) + rs * tau * math.sin(a))
    assert moment == pytest.approx(forces.resistance_moment, rel=1e-9)
    assert normal == pytest.approx(forces.normal, rel=1e-9)


def test_components_add_up(wheel: Wheel) -> None:
    """Components are those of (42): F_DP's carry its factors."""
    model = M2L(mean_load=MEAN)
    forces = model.forces(TOYOURA, wheel, SLIPS, 0.003)
    parts = model.components(TOYOURA, wheel, SLIPS, 0.003)
    np.testing.assert_allclose(parts.F_N, forces.normal, rtol=1e-12)
    np.testing.assert_allclose(parts.F_DP, forces.drawbar_pull, rtol=1e-10)


def test_where_no_normal_force_exists(wheel: Wheel) -> None:
    """With c_M < 0 and a deep wheel (42) has no normal force; a status, NaN, and an error say so."""
    model, conditions = M2L(mean_load=10.0), Conditions.of(wheel, np.array([0.4]))
    theta = np.array([astuple(replace(TOYOURA, cM=-1.0))])
    values, status = model.forces_at(theta, conditions, [0.03])
    assert status[0, 0] == Status.NORMAL_FORCE
    assert np.isnan(values).all()
    for only in (None, (), (9, 12), (1,)):
        assert np.isnan(model.jacobian_at(theta, conditions, [0.03], only)).all()
    with pytest.raises(ValueError, match=r"'sinkage' must have a normal force in eq. \(42\) \(got 0.03\)"):
        model.forces(replace(TOYOURA, cM=-1.0), wheel, 0.4, 0.03)
    # under a load the smaller root counts: up to some load there is an answer, beyond it none
    loads = np.geomspace(5.0, 1000.0, 40)
    rows = Conditions.of(wheel, np.full(40, 0.4))
    response, status = model.response_at(theta, rows, loads, every_row=True)
    answered = status[0] == Status.OK
    assert answered[0]
    assert not answered[-1]
    assert set(status[0][~answered]) == {Status.LOAD}
    assert np.all(np.diff(answered.astype(int)) <= 0)
    assert np.all(np.diff(response[0, answered, 0]) > 0)
    forces, status = model.forces_at(
        theta, Conditions.of(wheel, np.full(answered.sum(), 0.4)), response[0, answered, 0]
    )
    assert np.all(status == Status.OK)
    np.testing.assert_allclose(forces[0, :, 0], loads[answered], rtol=1e-9)


@pytest.mark.parametrize("model", [M1(), M2(), M3()], ids=lambda m: m.name)
def test_other_models_refuse_a_load_effect(model: WheelSoilModel, wheel: Wheel) -> None:
    """Models that do not know the coefficients take zeros only."""
    with pytest.raises(ValueError, match=rf"'cDP' must be 0 with {model.name}, as M2L alone knows"):
        model.forces(replace(TOYOURA, cP1=0.0, cP2=0.0, cM=0.0), wheel, 0.2, 0.003)
    zero = replace(TOYOURA, **dict.fromkeys(LOAD_EFFECT_FIELDS, 0.0))
    ours, plain = (model.forces(soil, wheel, 0.2, 0.003) for soil in (zero, Soil(*astuple(zero)[:9])))
    assert ours == plain


def test_mean_load_must_be_positive() -> None:
    """A vehicle has a weight."""
    with pytest.raises(ValueError, match=r"'mean_load' must be positive and finite \(got -1.0\)"):
        M2L(mean_load=-1.0)
