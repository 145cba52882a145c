"""Plate and shear tests on known soils."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bayesterra.soiltests import analysis
from bayesterra.soiltests.analysis import SoilTestResult, analyse
from bayesterra.soiltests.checks import none_left_out
from bayesterra.soiltests.study import SoilTest, soil_test
from bayesterra.stats.laws import Law
from bayesterra.study.schema import SamplingOptions
from tests.support.adaptation import little_leaving_out
from tests.support.shared import Shared

SOIL = {"kc": -1.0e3, "kphi": 900e3, "n": 1.1}
STRENGTH = {"c": 800.0, "phi": float(np.radians(31.0)), "K": 0.009}
PLATE_PRIORS: dict[str, Any] = {
    "reference_sinkage": 0.010,
    "kc": Law("uniform", lower=-1e3, upper=1e3),
    "kphi": Law("uniform", lower=-50e3, upper=50e3),
    "n": Law("uniform", lower=0.3, upper=2.0),
}
SHEAR_PRIORS = {
    "c": Law("uniform", lower=0.0, upper=5e3),
    "phi": Law("uniform", lower=0.0, upper=float(np.radians(50.0))),
    "K": Law("loguniform", lower=0.002, upper=0.05),
}
SMALL = SamplingOptions(target_ess=400)


def plates(
    radii: tuple[float, ...] = (0.03, 0.06), tests: int = 2, readings: int = 12, scatter: float = 0.05, **tables: Any
) -> SoilTest:
    """Plate tests that scatter as the likelihood says: deviations along the curve, zeros apart by 0.1 mm."""
    rng, rows = np.random.default_rng(5), []
    z = np.geomspace(2e-3, 30e-3, readings)
    together = np.exp(-np.abs(np.subtract.outer(np.log(z), np.log(z))) / 2.0)
    for radius in radii:
        for number in range(tests):
            shift = np.exp(scatter * np.linalg.cholesky(together) @ rng.standard_normal(readings))
            depth = z + 2e-3 * scatter * rng.standard_normal()
            p = (SOIL["kc"] / radius + SOIL["kphi"]) * depth ** SOIL["n"] * shift
            rows += [(f"{radius} {number}", 2 * radius, a, b) for a, b in zip(z, p, strict=True)]
    table = pd.DataFrame(rows, columns=["test", "plate_diameter [m]", "sinkage [m]", "pressure [Pa]"])
    given = {"test": "plate", "data": {"file": "readings.csv"}, "priors": PLATE_PRIORS, "sampling": SMALL}
    return soil_test(table, {**given, **tables})


def shear(stresses: tuple[float, ...] = (5e3, 15e3), tests: int = 2, **tables: Any) -> SoilTest:
    """Shear curves that scatter by 2 %, along each curve as the likelihood says."""
    rng, rows = np.random.default_rng(5), []
    j = np.geomspace(1e-3, 60e-3, 15)
    together = np.exp(-np.abs(np.subtract.outer(np.log(j), np.log(j))) / 2.0)
    for stress in stresses:
        for number in range(tests):
            strength = STRENGTH["c"] + stress * np.tan(STRENGTH["phi"])
            shift = 0.02 * np.linalg.cholesky(together) @ rng.standard_normal(len(j))
            tau = strength * -np.expm1(-j / STRENGTH["K"]) * np.exp(shift)
            rows += [(f"{stress} {number}", stress, a, b) for a, b in zip(j, tau, strict=True)]
    columns = ["test", "normal_stress [Pa]", "displacement [m]", "shear_stress [Pa]"]
    given = {"test": "shear", "data": {"file": "readings.csv"}, "priors": SHEAR_PRIORS, "sampling": SMALL}
    return soil_test(pd.DataFrame(rows, columns=columns), {**given, **tables})


@pytest.fixture(scope="session")
def analysed(shared: Shared) -> Callable[[str], SoilTestResult]:
    """Results of these tests by kind, each analysed once; tests are left out of ``plates`` only."""
    made: dict[str, Callable[[], SoilTest]] = {
        "plates": plates,
        "one plate": lambda: plates((0.03,)),
        "shear": shear,
        "one stress": lambda: shear((15e3,)),
    }

    def result(kind: str) -> SoilTestResult:
        with little_leaving_out(), pytest.MonkeyPatch.context() as patch:
            if kind != "plates":
                patch.setattr(analysis, "leave_out", lambda posterior, *_: none_left_out(posterior.readings.kind))
            return analyse(made[kind](), seed=1)

    return lambda kind: shared(f"soil test, {kind}", lambda: result(kind))
