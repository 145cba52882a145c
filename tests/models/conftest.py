"""Wheels and soils of the paper, random pairs over the prior box, independent evaluations of the forces."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import mpmath as mp
import numpy as np
import pytest
from scipy.integrate import quad

from bayesterra.models import Forces, Soil, Wheel, WheelSoilModel
from bayesterra.models.checks import FloatArray

# Ding et al. 2015, Table 1: radius, width, lug height (m), number of lugs, coefficient used with them.
WHEELS = {
    "Wh11": Wheel(0.135, 0.165, 0.015, 24, 0.75),
    "Wh12": Wheel(0.135, 0.165, 0.010, 24, 0.65),
    "Wh21": Wheel(0.135, 0.110, 0.015, 24, 0.75),
    "Wh22": Wheel(0.135, 0.110, 0.010, 24, 0.65),
    "Wh31": Wheel(0.15735, 0.165, 0.015, 30, 0.75),
    "Wh32": Wheel(0.15735, 0.165, 0.010, 30, 0.65),
}
G1 = Soil(Ks=2.5e6, n0=0.76, n1=1.30, c=250.0, phi=math.radians(31.9), K=0.012, c1=0.5, c2=-0.3)
# Table 10: K_s in kPa, n0, n1, c in kPa, phi in degrees, K in mm, c1, c2.
TABLE_10 = (
    (2499.0, 0.823, 1.257, 0.103, 30.9, 13.1, 0.388, -0.258),
    (2499.3, 0.913, 1.013, 0.218, 29.6, 11.3, 0.299, -0.083),
    (2499.3, 0.873, 1.059, 0.212, 31.1, 13.8, 0.443, -0.234),
    (2499.6, 0.933, 0.824, 0.236, 29.2, 10.6, 0.465, -0.204),
    (2499.0, 0.776, 1.266, 0.097, 30.5, 11.0, 0.400, -0.253),
    (2499.3, 0.849, 1.063, 0.268, 29.3, 10.1, 0.339, -0.017),
)


@dataclass(frozen=True)
class Pair:
    """One soil on one wheel at one slip and sinkage."""

    soil: Soil
    wheel: Wheel
    slip: float
    sinkage: float


@pytest.fixture(scope="session")
def wheels() -> dict[str, Wheel]:
    """Return the six wheels of Table 1."""
    return WHEELS


@pytest.fixture(scope="session")
def g1() -> Soil:
    """Return soil group G1, with K = 12 mm."""
    return G1


@pytest.fixture(scope="session")
def soils() -> list[Soil]:
    """Return G1 and the six soils that IM1 found (Table 10)."""
    scale = (1e3, 1, 1, 1e3, math.pi / 180, 1e-3, 1, 1)
    return [G1, *(Soil(*(v * u for v, u in zip(row, scale, strict=True))) for row in TABLE_10)]


@pytest.fixture(scope="session")
def box_pairs() -> Callable[..., list[Pair]]:
    """Return a function that draws pairs over the prior box, some of them at its faces and corners."""
    return draw_pairs


def draw_pairs(count: int, seed: int, *, corners: float = 0.0, leaving: bool = False) -> list[Pair]:
    """Draw pairs that the models are defined for; `corners` is the share of inputs near an end of range."""
    rng = np.random.default_rng(seed)
    pairs: list[Pair] = []
    while len(pairs) < count:
        x = rng.uniform(size=12)
        near = 10.0 ** rng.uniform(-4, -1, size=12)
        x = np.where(rng.uniform(size=12) < corners, np.where(rng.uniform(size=12) < 0.5, near, 1 - near), x)
        low = (0.1e6, 0, 0, 0, 0, 0.002, -1, -1, -0.9 if leaving else 0, 0, 0.0005, 0)
        high = (10e6, 2, 2, 5000, math.radians(50), 0.05, 1, 1, 0.9 if leaving else 0, 0.9, 0.1, 6)
        values = np.asarray(low) + x * (np.asarray(high) - np.asarray(low))
        ratio, exponent = values[6] + values[7] * values[9], values[1] + values[2] * values[9]
        if values[8] < ratio < 1 and exponent > 0:
            wheel = list(WHEELS.values())[min(int(values[11]), 5)]
            pairs.append(Pair(Soil(*map(float, values[:9])), wheel, float(values[9]), float(values[10])))
    return pairs


@pytest.fixture(scope="session")
def adaptive() -> Callable[[Pair, WheelSoilModel], FloatArray]:
    """Return F_N, F_DP, M_DR of M1 and F_DPtau + F_DPsigma, by adaptive quadrature of eq. (14)."""
    return integrate_adaptively


@pytest.fixture(scope="session")
def extended() -> Callable[[Pair, WheelSoilModel], FloatArray]:
    """Return F_N, F_DP, M_DR of M2 or M3 and F_DPtau + F_DPsigma, eqs. (18)-(26) with forty digits."""
    return close_with_forty_digits


def numbers(pair: Pair) -> list[float]:
    """Return the soil parameters as floats."""
    return [float(value) for value in pair.soil.as_array()]


def start_radius(pair: Pair, model: WheelSoilModel) -> float:
    """Return R_j, eq. (13), or its variants."""
    first, second = model.transition_slips
    share = min(1.0, max(0.0, (second - pair.slip) / (second - first)))
    share = {"transition": share, "rim": 0.0, "tip": 1.0}[model.shear_start]
    return pair.wheel.radius + pair.wheel.lug_height * share


def integrate_adaptively(pair: Pair, model: WheelSoilModel) -> FloatArray:
    """Integrate each part over the share of the way from its stress-free end to theta_m."""
    Ks, n0, n1, c, phi, K, c1, c2, c3 = numbers(pair)
    r, b, s = pair.wheel.radius, pair.wheel.width, pair.slip
    rs = float(pair.wheel.shearing_radius(phi))
    theta_1 = float(mp.acos((mp.mpf(r) - pair.sinkage) / r))
    start = float(mp.acos((mp.mpf(r) - pair.sinkage) / start_radius(pair, model)))
    theta_2, theta_m = c3 * theta_1, (c1 + c2 * s) * theta_1
    n = n0 if model.constant_exponent else n0 + n1 * s

    def stresses(share: float, front: bool) -> tuple[float, float, float]:
        d = (theta_1 - theta_m) * share
        rise = 2 * math.sin(d / 2) * math.sin(theta_1 - d / 2)  # cos(theta_1 - d) - cos(theta_1)
        sigma = Ks * (r * rise) ** n
        theta = theta_1 - d if front else theta_2 + (theta_m - theta_2) * share
        j = rs * ((start - theta) - (1 - s) * (math.sin(start) - math.sin(theta)))
        return theta, sigma, -(c + sigma * math.tan(phi)) * math.expm1(-j / K)

    def total(term: Callable[[float, float, float], float]) -> float:
        widths = {True: theta_1 - theta_m, False: theta_m - theta_2}
        return sum(
            width
            * float(
                quad(lambda u, f=front: term(*stresses(u, f)), 0, 1, epsabs=0, epsrel=1e-12, limit=400, full_output=1)[
                    0
                ]
            )
            for front, width in widths.items()
        )

    thrust = b * rs * total(lambda a, _, tau: tau * math.cos(a))
    resistance = b * r * total(lambda a, sigma, _: sigma * math.sin(a))
    normal = b * total(lambda a, sigma, tau: r * sigma * math.cos(a) + rs * tau * math.sin(a))
    moment = rs**2 * b * total(lambda _, __, tau: tau)
    return np.array([normal, thrust - resistance, moment, abs(thrust) + abs(resistance)])


def close_with_forty_digits(pair: Pair, model: WheelSoilModel) -> FloatArray:
    """Evaluate CM1 for M2, CM2 for M3."""
    with mp.workdps(40):
        Ks, n0, n1, c, phi, K, c1, c2, c3 = map(mp.mpf, numbers(pair))
        r, b, s, z = map(mp.mpf, (pair.wheel.radius, pair.wheel.width, pair.slip, pair.sinkage))
        rs = mp.mpf(float(pair.wheel.shearing_radius(float(phi))))
        t1, start = mp.acos((r - z) / r), mp.acos((r - z) / mp.mpf(start_radius(pair, model)))
        t2, tm = c3 * t1, (c1 + c2 * s) * t1
        n = n0 if model.constant_exponent else n0 + n1 * s
        sigma = Ks * r**n * (mp.cos(tm) - mp.cos(t1)) ** n
        path = rs * ((start - tm) - (1 - s) * (mp.sin(start) - mp.sin(tm)))
        X, Y = r * b * sigma, rs * b * (1 - mp.exp(-path / K)) * (c + sigma * mp.tan(phi))
        A = (mp.cos(tm) - mp.cos(t2)) / (tm - t2) + (mp.cos(tm) - mp.cos(t1)) / (t1 - tm)
        B = (mp.sin(tm) - mp.sin(t2)) / (tm - t2) + (mp.sin(tm) - mp.sin(t1)) / (t1 - tm)
        C, D = (t1 - t2) / 2, (t1 - t2) * mp.cos(tm) / 2
        normal, thrust = (A * X + B * Y, A * Y) if model.name == "M2" else (D * X, D * Y)
        return np.array([float(v) for v in (normal, thrust - B * X, rs * C * Y, abs(thrust) + abs(B * X))])


@pytest.fixture(scope="session")
def relative_errors() -> Callable[[Forces, FloatArray], FloatArray]:
    """Return a function that judges F_N and M_DR against themselves and F_DP against F_DPtau + F_DPsigma."""

    def judge(forces: Forces, reference: FloatArray) -> FloatArray:
        values = np.array([forces.normal, forces.drawbar_pull, forces.resistance_moment], dtype=np.float64)
        return np.abs(values - reference[:3]) / np.abs(reference[[0, 3, 2]])

    return judge
