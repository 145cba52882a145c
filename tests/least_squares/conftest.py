"""Noise-free model data of the wheels and parameters of Ding et al. 2015."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bayesterra.models import MODELS, Soil, Wheel
from bayesterra.study.study import Study

SLIPS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)

WHEELS = {
    "Wh11": Wheel(0.135, 0.165, 0.015, 24, 0.75),
    "Wh12": Wheel(0.135, 0.165, 0.010, 24, 0.65),
    "Wh21": Wheel(0.135, 0.110, 0.015, 24, 0.75),
    "Wh22": Wheel(0.135, 0.110, 0.010, 24, 0.65),
    "Wh31": Wheel(0.15735, 0.165, 0.015, 30, 0.75),
    "Wh32": Wheel(0.15735, 0.165, 0.010, 30, 0.65),
}
"""Table 1, with the λ_s of Section 3.1."""

TABLE_10 = {
    "Wh11": (2499.0, 0.823, 1.257, 0.103, 30.9, 13.1, 0.388, -0.258),
    "Wh12": (2499.3, 0.913, 1.013, 0.218, 29.6, 11.3, 0.299, -0.083),
    "Wh21": (2499.3, 0.873, 1.059, 0.212, 31.1, 13.8, 0.443, -0.234),
    "Wh22": (2499.6, 0.933, 0.824, 0.236, 29.2, 10.6, 0.465, -0.204),
    "Wh31": (2499.0, 0.776, 1.266, 0.097, 30.5, 11.0, 0.400, -0.253),
    "Wh32": (2499.3, 0.849, 1.063, 0.268, 29.3, 10.1, 0.339, -0.017),
}
TABLE_14 = {
    "Wh11": (2499.0, 0.772, 1.293, 0.183, 27.7, 11.2, 0.458, -0.416),
    "Wh12": (2499.2, 0.866, 1.054, 0.344, 25.5, 10.1, 0.353, -0.265),
    "Wh21": (2499.2, 0.828, 1.097, 0.601, 25.9, 10.6, 0.471, -0.361),
    "Wh22": (2499.6, 0.914, 0.824, 0.740, 24.2, 9.0, 0.386, -0.159),
    "Wh31": (2498.7, 0.727, 1.302, 0.500, 26.1, 9.2, 0.460, -0.395),
    "Wh32": (2499.2, 0.805, 1.124, 0.193, 26.0, 8.6, 0.365, -0.204),
}
"""K_s (kPa/m^N), n0, n1, c (kPa), phi (deg), K (mm), c1, c2."""


def _soil(row: tuple[float, ...]) -> Soil:
    Ks, n0, n1, c, phi, K, c1, c2 = row
    return Soil(1e3 * Ks, n0, n1, 1e3 * c, float(np.radians(phi)), 1e-3 * K, c1, c2)


@pytest.fixture(scope="session")
def printed() -> Mapping[str, Mapping[str, Soil]]:
    """Soils of Tables 10 (IM1) and 14 (IM3) by wheel; IM2 printed no table, so Table 10 stands in."""
    table_10 = {wheel: _soil(row) for wheel, row in TABLE_10.items()}
    table_14 = {wheel: _soil(row) for wheel, row in TABLE_14.items()}
    return {"IM1": table_10, "IM2": table_10, "IM3": table_14}


def table(model: str, wheel: Wheel, soil: Soil, slips: tuple[float, ...] = SLIPS) -> pd.DataFrame:
    """Noise-free measurements of a wheel under 80 N."""
    slip = np.array(slips)
    chosen = MODELS[model]()
    sinkage = chosen.sinkage(soil, wheel, slip, 80.0)
    forces = chosen.forces(soil, wheel, slip, sinkage)
    return pd.DataFrame(
        {
            "slip": slip,
            "load [N]": np.full(slip.shape, 80.0),
            "sinkage [m]": sinkage,
            "drawbar_pull [N]": forces.drawbar_pull,
            "resistance_moment [N m]": forces.resistance_moment,
        }
    )


MakeStudy = Callable[..., Study]


@pytest.fixture(scope="session")
def make_paper_study() -> MakeStudy:
    """Study of one wheel of Table 1 on noise-free data, or on ``data``."""

    def make(model: str, wheel: str, soil: Soil, *, data: pd.DataFrame | None = None, **options: object) -> Study:
        given: dict[str, Any] = {
            "noise": {"sinkage": 1e-3, "drawbar_pull": 1.5, "resistance_moment": 0.3, "normal_force": 1.0},
            "priors": {"set": "paper-box"},
            "least_squares": {"hold": {"Ks": soil.Ks}},
            "slip_reference": "shearing",
            **options,
        }
        frame = table(model, WHEELS[wheel], soil) if data is None else data
        return Study(frame, {wheel: WHEELS[wheel]}, model=model, **given)

    return make


@pytest.fixture(scope="session")
def make_table() -> Callable[..., pd.DataFrame]:
    """Noise-free measurements of a wheel of Table 1 under 80 N."""

    def make(model: str, wheel: str, soil: Soil, slips: tuple[float, ...] = SLIPS) -> pd.DataFrame:
        return table(model, WHEELS[wheel], soil, slips)

    return make
