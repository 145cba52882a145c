"""Small studies on model data: one wheel, known soil, a choice of free parameters."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd
import pytest
from paper_wheels import ABOUT_WH32, WHEELS

from bayesterra.models import MODELS, Soil, Wheel
from bayesterra.stats.laws import Law
from bayesterra.study.noise import Noise
from bayesterra.study.study import Study

WHEEL, TRUTH = WHEELS["Wh32"], dict(ABOUT_WH32)
SLIPS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.6)
NOISE = {"sinkage": 1e-3, "drawbar_pull": 1.5, "resistance_moment": 0.3, "normal_force": 2.0}

MakeStudy = Callable[..., Study]
MakeTable = Callable[..., pd.DataFrame]


def _table(model: str = "M2", slips: tuple[float, ...] = SLIPS, load: float = 80.0) -> pd.DataFrame:
    slip, soil, chosen = np.array(slips), Soil(**TRUTH), MODELS[model]()
    sinkage = chosen.sinkage(soil, WHEEL, slip, load)
    forces = chosen.forces(soil, WHEEL, slip, sinkage)
    return pd.DataFrame(
        {
            "slip": slip,
            "load [N]": np.full(slip.shape, load),
            "sinkage [m]": sinkage,
            "drawbar_pull [N]": forces.drawbar_pull,
            "resistance_moment [N m]": forces.resistance_moment,
        }
    )


@pytest.fixture(scope="session")
def truth() -> Mapping[str, float]:
    """The soil that all tables are made with."""
    return TRUTH


@pytest.fixture(scope="session")
def wheel() -> Wheel:
    """Wh32."""
    return WHEEL


@pytest.fixture(scope="session")
def make_table() -> MakeTable:
    """Noise-free readings of the wheel under 80 N, by model and slips."""
    return _table


@pytest.fixture(scope="session")
def make_study() -> MakeStudy:
    """Study of one wheel; ``free`` names the free parameters, all others are held at the truth."""

    def make(
        *,
        model: str = "M2",
        slips: tuple[float, ...] = SLIPS,
        data: pd.DataFrame | None = None,
        free: tuple[str, ...] = tuple(TRUTH),
        priors: Mapping[str, Law | float] | None = None,
        noise: Mapping[str, float | Noise] | None = None,
        **options: Any,
    ) -> Study:
        moduli = any(name in (priors or {}) for name in ("kc", "kphi"))
        held = {name: value for name, value in TRUTH.items() if name not in free}
        held = {name: value for name, value in held.items() if not (moduli and name == "Ks")}
        return Study(
            _table(model, slips) if data is None else data,
            {"Wh32": WHEEL},
            model=model,
            slip_reference="shearing",
            noise={**NOISE, **(noise or {})},
            priors={"set": "paper-box", **held, **(priors or {})},
            **options,
        )

    return make
