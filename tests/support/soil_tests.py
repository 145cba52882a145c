"""Plate and shear tests on known soils, alone and beside a wheel, as studies."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

import bayesterra as bt
from bayesterra.models import M2
from bayesterra.stats.laws import Law
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study, soil_test_study

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
PLATE_COLUMNS = ["test", "plate_diameter [m]", "sinkage [m]", "pressure [Pa]"]
SHEAR_COLUMNS = ["test", "normal_stress [Pa]", "displacement [m]", "shear_stress [Pa]"]


def plate_table(
    radii: tuple[float, ...] = (0.03, 0.06), tests: int = 2, readings: int = 12, scatter: float = 0.05
) -> pd.DataFrame:
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
    return pd.DataFrame(rows, columns=pd.Index(PLATE_COLUMNS))


def shear_table(stresses: tuple[float, ...] = (5e3, 15e3), tests: int = 2) -> pd.DataFrame:
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
    return pd.DataFrame(rows, columns=pd.Index(SHEAR_COLUMNS))


def plates(
    radii: tuple[float, ...] = (0.03, 0.06), tests: int = 2, readings: int = 12, scatter: float = 0.05, **tables: Any
) -> Study:
    """A study of plates alone, as a soil-test file gives one."""
    given = {"test": "plate", "priors": PLATE_PRIORS, "sampling": SMALL}
    return soil_test_study({**given, **tables}, table=plate_table(radii, tests, readings, scatter))


def shear(stresses: tuple[float, ...] = (5e3, 15e3), tests: int = 2, **tables: Any) -> Study:
    """A study of shear tests alone."""
    given = {"test": "shear", "priors": SHEAR_PRIORS, "sampling": SMALL}
    return soil_test_study({**given, **tables}, table=shear_table(stresses, tests))


WHEEL = bt.Wheel(radius=0.157, width=0.165, lug_height=0.010, lug_count=30, shearing_radius_coefficient=0.65)
HELD = {"n1": 0.4, "K": 0.012, "c1": 0.5, "c2": 0.0}
NOISE = {"sinkage": 0.3e-3, "drawbar_pull": 0.3}
KNOWN = {"memory": 2.0, "seating": 0.1e-3, "sinkage_offset": 0.0}
"""Of the scatter of plates all but its size."""


def wheel_table(cohesion: float = 300.0) -> pd.DataFrame:
    """Five rows of a wheel on the same soil, through M2; ``cohesion`` in Pa."""
    rng, slip = np.random.default_rng(3), np.array([0.1, 0.1, 0.25, 0.4, 0.4])
    load, modulus = np.array([60.0, 80.0, 60.0, 60.0, 80.0]), SOIL["kc"] / WHEEL.width + SOIL["kphi"]
    soil = bt.Soil(Ks=modulus, n0=SOIL["n"], c=cohesion, phi=STRENGTH["phi"], c3=0.0, **HELD)
    z = M2().sinkage(soil, WHEEL, slip, load)
    pull = M2().forces(soil, WHEEL, slip, z).drawbar_pull
    noisy = (
        1e3 * (z + NOISE["sinkage"] * rng.standard_normal(5)),
        pull + NOISE["drawbar_pull"] * rng.standard_normal(5),
    )
    columns = dict(zip(("sinkage [mm]", "drawbar_pull [N]"), noisy, strict=True))
    return pd.DataFrame({"slip": slip, "load [N]": load, **columns})


def both(*, reference: bool = False, ring: bool = False, priors: dict[str, Any] | None = None, **tables: Any) -> Study:
    """A wheel and plates on one soil, tied by the moduli and n; on request with a ring, which has a K of its own."""
    moduli = {"kc": Law("uniform", lower=-2e4, upper=2e4), "kphi": Law("uniform", lower=2e5, upper=2e6)}
    stated = {n: PLATE_PRIORS[n] for n in ("reference_sinkage", "kc", "kphi")} if reference else moduli
    laws = {**stated, "n0": Law("uniform", lower=0.5, upper=1.8), "phi": Law("uniform", lower=0.35, upper=0.8)}
    tests = {"plates": {"test": "plate", "table": plate_table(), "tie": {"n": "n0"}, "noise": KNOWN}}
    if ring:
        tests["ring"] = {"test": "shear", "table": shear_table(), "tie": {"K": "K.ring"}, "noise": {"memory": 2.0}}
        laws |= {"K.ring": SHEAR_PRIORS["K"], "c": SHEAR_PRIORS["c"]}
    given: dict[str, Any] = {"model": "M2", "noise": NOISE, "sampling": {"target_ess": 400, "walkers": 32}}
    given["soil_tests"] = tests
    whole = {"c": 300.0, **HELD, **laws, **(priors or {})}
    return Study(
        wheel_table(STRENGTH["c"] if ring else 300.0), {"W": WHEEL}, slip_reference="shearing", kind="simulated",
        priors=whole, **{**given, **tables},
    )  # fmt: skip
