"""Readings that stand in for the paper's unpublished ones: made by M1 from Table 10, and HIT's of Wh32."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from paper_wheels import WHEELS

import bayesterra as bt
from bayesterra.models import M1, Soil

STUDIES = Path(__file__).parents[1]
SLIPS = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.6])
"""Slips of Section 3.1, taken on the shearing radius, which the print leaves open."""
LOAD = 80.0
"""N, the load of Section 5.2."""
TRANSITION = (0.1, 0.5)
"""s_j1 and s_j2 of Section 5.2."""
NOISE: Mapping[str, float] = {
    "normal_force": 2.0, "sinkage": 1e-3, "drawbar_pull": 1.5, "resistance_moment": 0.3,
}  # fmt: skip
"""Standard deviations, SI: those of studies/hit-wh32 and studies/recovery/drives, which are estimates."""
NAMES = ("Ks", "n0", "n1", "c", "phi", "K", "c1", "c2")
SCALES: Mapping[str, float] = {"Ks": 1e3, "c": 1e3, "phi": float(np.radians(1)), "K": 1e-3}
"""SI value of one field unit (kPa/m^N, kPa, degrees, mm)."""
COLUMNS = {"Ks": "Ks_kPa", "c": "c_kPa", "phi": "phi_deg", "K": "K_mm"}
OUTCOMES = ("sinkage", "drawbar_pull", "resistance_moment")
FORCES = ("normal_force", "drawbar_pull", "resistance_moment")
SYMBOLS = {"sinkage": "z", "normal_force": "F_N", "drawbar_pull": "F_DP", "resistance_moment": "M_DR"}


def printed(number: int) -> pd.DataFrame:
    """Table 10 or 14 by wheel, columns ``NAMES`` in field units."""
    table = pd.read_csv(STUDIES / "paper" / "identification" / f"printed-table-{number}.csv").set_index("wheel")
    return table.rename(columns={column: name for name, column in COLUMNS.items()})[list(NAMES)]


def soil_of(values: Mapping[str, float]) -> Soil:
    """Soil from field units."""
    return Soil(**{name: float(values[name]) * SCALES.get(name, 1.0) for name in NAMES})


def field_values(soil: Soil) -> dict[str, float]:
    """Parameters of a soil in field units."""
    return {name: float(getattr(soil, name)) / SCALES.get(name, 1.0) for name in NAMES}


SOILS: Mapping[str, Soil] = {str(wheel): soil_of(row) for wheel, row in printed(10).iterrows()}
"""Table 10."""


def readings(wheel: str, seed: int | None = None) -> pd.DataFrame:
    """Readings by M1 with the soil of Table 10, the sinkage solved from 80 N; without noise if no seed.

    The normal force is the load, as in the paper, whose load "is equal to the average measured normal force".
    """
    soil, rig = SOILS[wheel], WHEELS[wheel]
    model = M1(transition_slips=TRANSITION)
    depth = np.asarray(model.sinkage(soil, rig, SLIPS, LOAD))
    forces = model.forces(soil, rig, SLIPS, depth)
    values = np.column_stack([depth, forces.drawbar_pull, forces.resistance_moment])
    if seed is not None:
        rng = np.random.default_rng([seed, list(WHEELS).index(wheel)])
        values = values + rng.standard_normal(values.shape) * [NOISE[name] for name in OUTCOMES]
    return _table(SLIPS, np.full(len(SLIPS), LOAD), values)


def _table(slip: Any, load: Any, values: Any) -> pd.DataFrame:
    columns = ("sinkage [m]", "drawbar_pull [N]", "resistance_moment [N m]")
    return pd.DataFrame({"slip": slip, "load [N]": load, **dict(zip(columns, values.T, strict=True))})


def hit_readings() -> pd.DataFrame:
    """The rows of studies/hit-wh32 that its fit uses; digitised."""
    rows = bt.load_study(STUDIES / "hit-wh32").observations.used()
    return _table(rows.slip, rows.load, np.column_stack([rows.values[name] for name in OUTCOMES]))


def study(
    wheel: str,
    data: pd.DataFrame,
    *,
    model: str = "M1",
    drive: str = "load",
    kind: str = "simulated",
    hold: Mapping[str, float] | None = None,
    options: Mapping[str, Any] | None = None,
    priors: Mapping[str, Any] | None = None,
    **tables: Any,
) -> bt.Study:
    """Study of one wheel on some readings, flat priors within the bounds of IM1.

    Parameters
    ----------
    drive : with ``sinkage`` the load stands as a reading of the normal force.
    hold : parameters held, SI, in least squares and prior alike.
    options, priors : replace single model options and priors.
    """
    channels = OUTCOMES if drive == "load" else FORCES
    if drive == "sinkage":
        data = data.rename(columns={"load [N]": "normal_force [N]"})
    return bt.Study(
        data,
        {wheel: WHEELS[wheel]},
        title=f"{wheel}, {model}, drive '{drive}'",
        kind=kind,
        model=model,
        drive=drive,
        slip_reference="shearing",
        noise={name: NOISE[name] for name in channels},
        priors={"set": "paper-box", **(priors or {}), **(hold or {})},
        model_options={"transition_slips": list(TRANSITION), **(options or {})},
        **tables,
    )
