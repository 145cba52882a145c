"""Small problems whose gains are known."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest

import bayesterra as bt
from bayesterra.study.study import Study

WHEEL = bt.Wheel(0.15735, 0.165, 0.010, 30, shearing_radius_coefficient=0.65)
SOIL = {"Ks": 2.5e6, "n0": 0.85, "n1": 1.06, "c": 268.0, "phi": 0.511, "K": 0.0101, "c1": 0.339, "c2": -0.017}
LAWS = {
    "c": bt.Law("uniform", lower=0.0, upper=3000.0),
    "phi": bt.Law("uniform", lower=float(np.radians(20)), upper=float(np.radians(40))),
    "K": bt.Law("uniform", lower=0.005, upper=0.03),
}
NOISE = {"sinkage": 0.002, "drawbar_pull": 3.0, "resistance_moment": 0.8}


def unmeasured(free: tuple[str, ...] = ("phi", "K"), **changes: Any) -> Study:
    """Wheel Wh32 through M2, all but a few parameters known, nothing measured yet."""
    table = pd.DataFrame({"slip": [0.1, 0.3, 0.5], "load [N]": 80.0})
    priors = {**SOIL, "c3": 0.0, **{name: LAWS[name] for name in free}}
    tables: dict[str, Any] = {"model": "M2", "noise": NOISE, "priors": priors, "slip_reference": "shearing"}
    tables |= {"kind": "simulated", "source": "a test", **changes}
    return bt.Study(tables.pop("data", table), {"Wh32": WHEEL}, prior_only=True, **tables)


@pytest.fixture(scope="session", name="unmeasured")
def _unmeasured() -> Callable[..., Study]:
    """Makes studies of wheel Wh32 with nothing measured yet."""
    return unmeasured


@pytest.fixture(scope="session")
def two_free() -> Study:
    """φ and K free."""
    return unmeasured()
