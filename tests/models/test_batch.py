"""The batch interface: flat arrays, status codes, and exact derivatives."""

import re
from collections.abc import Callable
from dataclasses import astuple, replace
from functools import partial
from typing import Any

import mpmath as mp
import numpy as np
import pytest

from bayesterra.models import M1, M2, M3, MODELS, SOIL_FIELDS, Conditions, Soil, Status, Wheel, WheelSoilModel
from bayesterra.models.checks import FloatArray

Draw = Callable[..., list[Any]]
ALL = pytest.mark.parametrize("model", [M1(), M2(), M3()], ids=lambda m: m.name)
SLIPS = np.array([0.05, 0.2, 0.4, 0.6])


@pytest.fixture(scope="module")
def conditions(wheels: dict[str, Wheel]) -> Conditions:
    """Return four rows on four wheels."""
    return Conditions.of([wheels[name] for name in ("Wh11", "Wh12", "Wh21", "Wh32")], SLIPS)


@pytest.fixture(scope="module")
def cloud(g1: Soil) -> FloatArray:
    """Return parameter sets (40, 9) around G1, with a leaving angle."""
    rng = np.random.default_rng(3)
    theta = np.array(astuple(g1)) * np.exp(0.1 * rng.normal(size=(40, 9)))
    theta[:, 8] = rng.uniform(-0.1, 0.1, 40)
    return theta


@ALL
def test_forces_at_equals_forces(
    model: WheelSoilModel, cloud: FloatArray, conditions: Conditions, wheels: dict[str, Wheel]
) -> None:
    """The batch interface and the plain one return the same numbers."""
    forces, status = model.forces_at(cloud, conditions, np.full(4, 0.02))
    assert forces.shape == (40, 4, 3)
    assert status.shape == (40, 4)
    assert status.dtype == np.int8
    plain = model.forces(Soil(*cloud.T), wheels["Wh21"], SLIPS[2], 0.02)
    expected = np.stack([plain.normal, plain.drawbar_pull, plain.resistance_moment], axis=-1)
    np.testing.assert_array_equal(forces[:, 2], expected)


@ALL
def test_response_at_equals_sinkage_and_forces(
    model: WheelSoilModel, cloud: FloatArray, conditions: Conditions
) -> None:
    """The response holds the sinkage of the load, and the forces there."""
    loads = np.array([35.0, 80.0, 80.0, 150.0])
    response, status = model.response_at(cloud, conditions, loads)
    forces, _ = model.forces_at(cloud, conditions, response[..., 0])
    assert np.all(status == Status.OK)
    np.testing.assert_allclose(forces[..., 0], np.broadcast_to(loads, (40, 4)), rtol=1e-10)
    np.testing.assert_allclose(response[..., 1], forces[..., 1], rtol=0, atol=2e-9 * loads.max())
    np.testing.assert_allclose(response[..., 2], forces[..., 2], rtol=1e-9)


@ALL
def test_jacobian_equals_central_differences(model: WheelSoilModel, cloud: FloatArray, conditions: Conditions) -> None:
    """Derivatives of the forces by all nine parameters and the sinkage agree with central differences."""
    depth = np.array([0.01, 0.015, 0.02, 0.03])
    jacobian = model.jacobian_at(cloud, conditions, depth)
    assert jacobian.shape == (40, 4, 3, 10)
    scale = np.abs(jacobian).max(axis=(0, 1))
    scale[scale == 0] = 1.0  # F_N of M3 does not know c, phi and K
    for column in range(10):
        step = 1e-4 * (np.abs(cloud[:, column]).mean() if column < 9 else 0.01)
        ends = []
        for factor in (-2, -1, 1, 2):
            theta = cloud.copy()
            theta[:, min(column, 8)] += factor * step * (column < 9)
            ends.append(model.forces_at(theta, conditions, depth + factor * step * (column == 9))[0])
        slope = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * step)
        np.testing.assert_allclose(jacobian[..., column] / scale[:, column], slope / scale[:, column], atol=2e-7)


@ALL
@pytest.mark.parametrize("only", [(2,), (7,), (0, 1, 3, 4, 5), ()])
def test_some_columns_of_the_jacobian_are_those_of_all(
    model: WheelSoilModel, cloud: FloatArray, conditions: Conditions, only: tuple[int, ...]
) -> None:
    """To the last bit, where pairs of several rules and two without an answer stand side by side; others may be 0."""
    depth = np.array([0.01, 0.015, 0.5, 0.03])
    whole, some = model.jacobian_at(cloud, conditions, depth), model.jacobian_at(cloud, conditions, depth, only)
    np.testing.assert_array_equal(some[..., list(only)], whole[..., list(only)])
    np.testing.assert_array_equal(np.isnan(some), np.isnan(whole))
    assert not np.nan_to_num(some[..., 9:]).any()
    assert np.isnan(whole).any()


def test_jacobian_of_closed_forms_is_exact(
    g1: Soil, wheels: dict[str, Wheel], conditions: Conditions, extended: Callable[..., FloatArray],
    box_pairs: Draw,
) -> None:  # fmt: skip
    """Derivatives of M2 agree to 1e-9 with differences taken in forty digits."""
    pair = replace(box_pairs(1, 1)[0], soil=g1, wheel=wheels["Wh11"], slip=0.3, sinkage=0.02)
    one = Conditions.of(wheels["Wh11"], 0.3)
    jacobian = M2().jacobian_at(np.array([astuple(g1)]), one, 0.02)[0, 0]
    for column, name in enumerate(SOIL_FIELDS):
        value = float(getattr(g1, name))
        step = 1e-4 * (abs(value) or 1.0)
        ends = [extended(replace(pair, soil=replace(g1, **{name: value + k * step})), M2())[:3] for k in (-2, -1, 1, 2)]
        slope = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * step)
        np.testing.assert_allclose(jacobian[:, column], slope, rtol=1e-8, atol=1e-9 * np.abs(slope).max())


@ALL
def test_response_jacobian_equals_central_differences(
    model: WheelSoilModel, cloud: FloatArray, conditions: Conditions
) -> None:
    """Derivatives of z, F_DP and M_DR at constant load agree with differences of solved responses."""
    jacobian = model.response_jacobian_at(cloud, conditions, 80.0)
    assert jacobian.shape == (40, 4, 3, 9)
    scale = np.abs(jacobian).max(axis=(0, 1))
    scale[scale == 0] = 1.0  # F_N of M3 does not know c, phi and K
    for column in range(9):
        step = 1e-3 * np.abs(cloud[:, column]).mean()
        ends = []
        for factor in (-2, -1, 1, 2):
            theta = cloud.copy()
            theta[:, column] += factor * step
            ends.append(model.response_at(theta, conditions, 80.0)[0])
        slope = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * step)
        np.testing.assert_allclose(jacobian[..., column] / scale[:, column], slope / scale[:, column], atol=1e-6)


@pytest.mark.parametrize(
    ("change", "status"),
    [
        ({"n0": -0.5, "n1": 0.0}, Status.EXPONENT),
        ({"n0": 0.0, "n1": 0.0}, Status.EXPONENT),
        ({"c1": 1.0, "c2": 0.0}, Status.CONTACT_ANGLE),
        ({"c1": 0.1, "c2": -1.0}, Status.CONTACT_ANGLE),
        ({"c1": 0.1, "c2": 0.0, "c3": 0.2}, Status.CONTACT_ANGLE),
        ({"c3": -1.5}, Status.CONTACT_ANGLE),
        ({"Ks": 1.0, "c": 0.0}, Status.LOAD),
    ],
)
@ALL
def test_status_names_what_failed(
    model: WheelSoilModel, g1: Soil, wheels: dict[str, Wheel], change: dict[str, float], status: Status
) -> None:
    """Each way out of the model's range has its code and NaN results, and does not touch the other sets."""
    theta = np.array([astuple(g1), astuple(replace(g1, **change)), astuple(g1)])
    values, codes = model.response_at(theta, Conditions.of(wheels["Wh11"], SLIPS), 80.0)
    np.testing.assert_array_equal(codes[[0, 2]], Status.OK)
    assert codes[1, 3] == status
    assert np.all(np.isnan(values[1, 3]))
    np.testing.assert_array_equal(np.isnan(values), np.repeat((codes != 0)[..., None], 3, axis=-1))


def test_a_set_that_fails_in_one_row(g1: Soil, wheels: dict[str, Wheel]) -> None:
    """A set whose contact angle fails at the highest slip is refused in all, unless `every_row` is set."""
    theta = np.array([astuple(replace(g1, c1=0.1, c2=-0.3))])
    conditions = Conditions.of(wheels["Wh11"], SLIPS)
    assert np.all(M1().forces_at(theta, conditions, 0.01)[1] == Status.CONTACT_ANGLE)
    forces, status = M1().forces_at(theta, conditions, 0.01, every_row=True)
    np.testing.assert_array_equal(status[0], [0, 0, Status.CONTACT_ANGLE, Status.CONTACT_ANGLE])
    np.testing.assert_array_equal(np.isnan(forces[0, :, 0]), [False, False, True, True])
    assert np.all(M1().response_at(theta, conditions, 80.0, every_row=True)[1][0, :2] == Status.OK)


def test_sinkage_outside_the_wheel(cloud: FloatArray, wheels: dict[str, Wheel]) -> None:
    """Sinkages outside (0, r), and NaN, have a status of their own; the derivatives are NaN there."""
    conditions = Conditions.of(wheels["Wh11"], np.full(4, 0.2))
    depth = np.array([0.0, 0.01, 0.135, np.nan])
    forces, status = M1().forces_at(cloud, conditions, depth)
    np.testing.assert_array_equal(status[0], [Status.SINKAGE, 0, Status.SINKAGE, Status.SINKAGE])
    np.testing.assert_array_equal(np.isnan(forces[0, :, 1]), [True, False, True, True])
    np.testing.assert_array_equal(np.isnan(M1().jacobian_at(cloud, conditions, depth)[0, :, 0, 0]), [1, 0, 1, 1])


@pytest.mark.parametrize("name", ["M1", "M2", "M3"])
def test_never_nan_with_status_ok(name: str, wheels: dict[str, Wheel]) -> None:
    """Anywhere in a box wider than the prior, a result is finite exactly where its status is OK."""
    rng = np.random.default_rng(4)
    low = np.array([1.0, -1, -1, 0, 0, 0.0005, -1, -1, -1.2])
    high = np.array([20e6, 3, 3, 2e4, 1.5, 0.2, 1, 1, 1.2])
    theta = low + rng.uniform(size=(4000, 9)) * (high - low)
    theta[:, 8] *= rng.uniform(size=4000) < 0.3
    conditions = Conditions.of(wheels["Wh31"], np.array([0.0, 0.3, 0.95]))
    model = MODELS[name]()
    depth = rng.uniform(-0.01, 0.17, size=(4000, 3))
    load = 10.0 ** rng.uniform(-3, 4, size=(4000, 3))
    for values, status in (
        model.forces_at(theta, conditions, depth, every_row=True),
        model.response_at(theta, conditions, load, every_row=True),
    ):
        np.testing.assert_array_equal(np.isfinite(values), np.repeat((status == 0)[..., None], 3, axis=-1))
        assert len(np.unique(status)) == 4
    solved, status = model.response_at(theta, conditions, load, every_row=True)
    good = status == 0
    again = model.forces_at(theta, conditions, solved[..., 0], every_row=True)[0]
    np.testing.assert_allclose(again[good][:, 0], load[good], rtol=1e-10)


def test_theta_of_any_layout(cloud: FloatArray, conditions: Conditions) -> None:
    """Fortran order and read-only parameter sets give the same forces; a wrong shape is an error."""
    expected = M1().forces_at(cloud, conditions, 0.02)[0]
    frozen = cloud.copy()
    frozen.flags.writeable = False
    np.testing.assert_array_equal(M1().forces_at(np.asfortranarray(cloud), conditions, 0.02)[0], expected)
    np.testing.assert_array_equal(M1().forces_at(frozen, conditions, 0.02)[0], expected)
    with pytest.raises(ValueError, match=r"'theta' must have shape \(n, 9\) \(got \(40, 8\)\)"):
        M1().forces_at(cloud[:, :8], conditions, 0.02)


def test_empty_batches(conditions: Conditions) -> None:
    """No parameter sets give empty results."""
    values, status = M1().response_at(np.empty((0, 9)), conditions, 80.0)
    assert values.shape == (0, 4, 3)
    assert status.shape == (0, 4)


def _nth(function: Callable[[float], tuple[float, ...]], place: int, x: float) -> float:
    return function(x)[place]


def test_elementary_functions() -> None:
    """The kernels' own exp, log, sine, versine and arc cosine are good to a few units in the last place."""
    from bayesterra.models.kernels import compiled
    from bayesterra.models.kernels import elementary as own

    @compiled
    def of(x: float) -> tuple[float, ...]:
        return own.exp(x), own.exp_minus_1(x), own.log(x), own.sin(x), own.versine(x), own.angle_of_versine(x)

    exp, exp_minus_1, log, sin, versine, angle_of_versine = (partial(_nth, of, place) for place in range(6))
    x = np.concatenate([np.linspace(-700, 700, 400), np.geomspace(1e-18, 1, 200), -np.geomspace(1e-18, 1, 200)])
    for value in x:
        assert exp(value) == pytest.approx(np.exp(value), rel=2e-13 if abs(value) > 1 else 1e-15)
        assert exp_minus_1(value) == pytest.approx(np.expm1(value), rel=2e-13 if abs(value) > 1 else 1e-15)
    for value in np.geomspace(1e-300, 1e300, 500):
        assert log(value) == pytest.approx(np.log(value), rel=1e-15, abs=1e-15)
    for value in np.concatenate([np.linspace(-np.pi / 2, np.pi / 2, 500), np.geomspace(1e-12, 1, 100)]):
        assert sin(value) == pytest.approx(np.sin(value), rel=1e-15)
        assert versine(value) == pytest.approx(2 * np.sin(value / 2) ** 2, rel=2e-15, abs=1e-30)
    with mp.workdps(40):
        for value in np.geomspace(1e-16, 1, 300):
            assert angle_of_versine(value) == pytest.approx(float(mp.acos(1 - mp.mpf(value))), rel=2e-15)
    assert exp(-1e9) == pytest.approx(0.0, abs=1e-300)


def test_kernels_are_written_for_vectors() -> None:
    """LLVM turns the integration loop, exp and log included, into vector code."""
    import numba

    from bayesterra.models.kernels import integral
    from bayesterra.models.kernels.compiler import FAST

    source = integral.integrate.py_func  # type: ignore[attr-defined]  # a numba dispatcher
    kernel = numba.njit(fastmath=FAST, error_model="numpy")(source)
    kernel(np.ones(8 * 64), 0)
    code = kernel.inspect_llvm(kernel.signatures[0])
    assert re.findall(r"= fdiv [a-z ]*<\d+ x double>", code)
    assert not re.findall(r"= fdiv [a-z ]*double", code)
    vectors, scalars = (len(re.findall(rf"= fmul [a-z ]*{kind}", code)) for kind in (r"<\d+ x double>", "double"))
    assert vectors > 50
    older = numba.__version__.startswith("0.61.")  # as quick, but with more code for the last nodes one by one
    assert vectors > (0.5 if older else 2) * scalars
