"""Wheels of Ding et al. (2015), Table 1, and the soils that Table 10 has for each of them."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from bayesterra.models import Wheel

WHEELS: Mapping[str, Wheel] = MappingProxyType(
    {
        "Wh11": Wheel(0.135, 0.165, 0.015, 24, 0.75),
        "Wh12": Wheel(0.135, 0.165, 0.010, 24, 0.65),
        "Wh21": Wheel(0.135, 0.110, 0.015, 24, 0.75),
        "Wh22": Wheel(0.135, 0.110, 0.010, 24, 0.65),
        "Wh31": Wheel(0.15735, 0.165, 0.015, 30, 0.75),
        "Wh32": Wheel(0.15735, 0.165, 0.010, 30, 0.65),
    }
)
"""The wheels of Table 1, with the shearing-radius coefficients of Section 3.1."""
TABLE_10 = Path(__file__).parents[1] / "paper" / "identification" / "printed-table-10.csv"


def _soil(row: Mapping[str, str]) -> Mapping[str, float]:
    return MappingProxyType(
        {
            "Ks": float(row["Ks_kPa"]) * 1e3,
            "n0": float(row["n0"]),
            "n1": float(row["n1"]),
            "c": float(row["c_kPa"]) * 1e3,
            "phi": float(np.radians(float(row["phi_deg"]))),
            "K": float(row["K_mm"]) * 1e-3,
            "c1": float(row["c1"]),
            "c2": float(row["c2"]),
        }
    )


def _printed() -> Mapping[str, Mapping[str, float]]:
    with TABLE_10.open(encoding="utf-8", newline="") as file:
        return MappingProxyType({row["wheel"]: _soil(row) for row in csv.DictReader(file)})


SOILS: Mapping[str, Mapping[str, float]] = _printed()
"""Soil by wheel, SI, as IM1 identifies it."""
MEAN_COHESION = {"c": 190.0, "phi": float(np.radians(30.1))}
"""Means of c and φ over Table 10, SI: one soil under all wheels."""
ABOUT_WH32: Mapping[str, float] = MappingProxyType(
    {
        "Ks": 2.5e6,
        "n0": 0.85,
        "n1": 1.06,
        "c": 268.0,
        "phi": float(np.radians(29.3)),
        "K": 0.0101,
        "c1": 0.339,
        "c2": -0.017,
    }
)
"""The soil of wheel Wh32, rounded."""
