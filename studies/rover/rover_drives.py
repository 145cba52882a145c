"""Rovers of assumed dimensions on the soils of Table 16 of Ding et al. (2015)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray
from bayesterra.models import M2, M2L, Wheel
from bayesterra.models.statics import OUTCOMES, Greatest, Outcome, SoftGround, Sought, State, greatest, states_at, sweep
from bayesterra.parameters import soil_array
from bayesterra.prediction.outlook import DEGREE
from bayesterra.prediction.rover import Rover, read_rover

HERE = Path(__file__).parent
SLOPES = np.array([0.0, 3, 6, 9, 12, 15])
"""Degrees; those of the paper."""
TOWS = np.array([0.0, 10, 20, 30, 35, 40, 50, 60, 70])
"""N; those of the paper."""
MODELS = ("M2L", "M2")
"""(42) with Table 16's coefficients, and the same soil without them."""
SOUGHT: dict[str, Sought] = {"flat": "tow", "slope": "slope"}
"""What is asked on the soil of each row of Table 16."""
WEIGHTS = (150.0, 260.0, 400.0)
RADII = (0.08, 0.10, 0.13)
HEIGHTS = (0.15, 0.25, 0.35)
"""Weights, N, wheel radii and heights of the centre of gravity, m, over which statements are tried."""


@dataclass(frozen=True)
class Drive:
    """A rover at the paper's slopes or tow forces on one row of Table 16."""

    rover: Rover
    model: str
    row: str
    values: FloatArray
    state: State
    greatest: Greatest

    @property
    def slip(self) -> FloatArray:
        """Of the wheels, NaN where nothing is held."""
        return self.state.slip[0, :, 1]

    @property
    def holds(self) -> bool:
        """Whether all values are held."""
        return bool(np.isin(self.state.outcome, (Outcome.HELD, Outcome.BRAKES)).all())


def printed_soil(row: str) -> FloatArray:
    """Thirteen parameters of (42), SI, from a row of Table 16; c1 = 0.5 and c2 = c3 = 0 are (42)'s own."""
    found = pd.read_csv(HERE / "printed-table-16.csv").set_index("case").loc[row]
    soil = [1e3 * found["Ks_kPa"], found["n0"], found["n1"], 1e3 * found["c_kPa"]]
    soil += [found["phi_deg"] * DEGREE, 1e-3 * found["K_mm"], 0.5, 0.0, 0.0]
    return np.array([[*soil, *(found[name] for name in ("cP1", "cP2", "cDP", "cM"))]])


def ground(rover: Rover, model: str, soil: FloatArray) -> SoftGround:
    """The soil through (42), or through M2, which leaves its last four parameters out."""
    soils = soil_array(dict(zip(M2L.parameters, soil.T, strict=True)))
    return rover.on(soils, M2L(mean_load=rover.mean_load) if model == "M2L" else M2())


def drive(rover: Rover, model: str, row: str, soil: FloatArray | None = None) -> Drive:
    """Up the paper's slopes, or against its tow forces on the flat."""
    on = ground(rover, model, printed_soil(row) if soil is None else soil)
    found = sweep(rover, on, 1, SOUGHT[row])
    values = SLOPES if row == "slope" else TOWS
    asked = states_at(rover, on, found, values * (DEGREE if row == "slope" else 1.0))
    return Drive(rover, model, row, values, asked, greatest(rover, on, found))


def el_dorado() -> Rover:
    """The assumed rover."""
    return read_rover(HERE / "el-dorado-ii.toml", {}, 35.8 * DEGREE)


def others(rover: Rover) -> list[Rover]:
    """Rovers of other weight, wheels and height; lengths that hang on the wheel scale with it."""
    made = []
    for weight, radius, height in product(WEIGHTS, RADII, HEIGHTS):
        plain = Wheel(radius, radius, 0.1 * radius, 24)
        arm = float(plain.shearing_radius(35.8 * DEGREE))
        wheel = replace(plain, shearing_radius_coefficient=(arm - radius) / plain.lug_height)
        lengths = {"wheelbase": 6 * radius, "centre_ahead": 3 * radius, "tow_height": 2 * radius}
        made.append(replace(rover, weight=weight, centre_height=height, wheels=(wheel, wheel), **lengths))
    return made


def printed_table(drives: list[Drive]) -> pd.DataFrame:
    """Every state, one row per model and value asked."""
    rows = []
    for one in drives:
        for k, value in enumerate(one.values):
            state = one.state
            rows.append(
                {
                    "table_16_row": one.row,
                    "model": one.model,
                    "slope_deg": value if one.row == "slope" else 0.0,
                    "tow_N": 0.0 if one.row == "slope" else value,
                    "outcome": OUTCOMES[Outcome(int(state.outcome[0, k]))],
                    "slip": state.slip[0, k, 1],
                    "load_front_N": state.load[0, k, 0],
                    "load_rear_N": state.load[0, k, 1],
                    "sinkage_front_mm": 1e3 * state.sinkage[0, k, 0],
                    "sinkage_rear_mm": 1e3 * state.sinkage[0, k, 1],
                    "moment_front_Nm": state.moment[0, k, 0],
                    "moment_rear_Nm": state.moment[0, k, 1],
                }
            )
    return pd.DataFrame(rows)


def geometry_table(rovers: list[Rover]) -> pd.DataFrame:
    """Greatest slope and tow force of every assumed rover, and the slip at the paper's largest."""
    rows = []
    for rover in rovers:
        row: dict[str, float] = {
            "weight_N": rover.weight,
            "radius_mm": 1e3 * rover.wheels[0].radius,
            "centre_height_m": rover.centre_height,
        }
        for model in MODELS:
            up, pulled = drive(rover, model, "slope"), drive(rover, model, "flat")
            row |= {
                f"{model}_greatest_slope_deg": float(up.greatest.value[0] / DEGREE),
                f"{model}_greatest_tow_N": float(pulled.greatest.value[0]),
                f"{model}_slip_at_9_deg": up.slip[3],
                f"{model}_slip_at_12_deg": up.slip[4],
                f"{model}_slip_at_15_deg": up.slip[-1],
                f"{model}_slip_at_70_N": pulled.slip[-1],
            }
        rows.append(row)
    return pd.DataFrame(rows)
