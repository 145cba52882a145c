"""Two wheels with few free parameters, quick to sample and small enough for a grid."""

from collections.abc import Callable
from typing import Any

import pandas as pd

from bayesterra.models import Wheel
from bayesterra.study.study import Study

WHEELS = {
    "Wh11": Wheel(0.135, 0.165, 0.015, 24, shearing_radius_coefficient=0.75),
    "Wh32": Wheel(0.15735, 0.165, 0.010, 30, shearing_radius_coefficient=0.65),
}
HELD = {"Ks": 2.5e6, "n0": 0.85, "n1": 1.06, "c": 268.0, "c1": 0.339, "c2": -0.017}
TABLE = pd.DataFrame(
    {
        "wheel": ["Wh11"] * 3 + ["Wh32"] * 3,
        "site": ["a", "a", "b", "b", "a", "a"],
        "slip": [0.1, 0.25, 0.5] * 2,
        "load [N]": 80.0,
        "drawbar_pull [N]": [14.5, 21.5, 24.0, 14.0, 20.5, 24.5],
        "resistance_moment [N m]": [3.3, 4.6, 5.6, 3.9, 5.6, 6.7],
    }
)

MakeStudy = Callable[..., Study]


def made(**tables: Any) -> Study:
    """A study of φ and K; ``pooling`` and others as keywords of :class:`Study`."""
    options: dict[str, Any] = {
        "slip_reference": "shearing",
        "kind": "simulated",
        "model": "M2",
        "noise": {"drawbar_pull": 1.0, "resistance_moment": 0.3},
        "priors": HELD,
        "sampling": {"target_ess": 1000, "walkers": 32},
        "pooling": {"shared": ["phi"], "hierarchical": {"K": {}}},
    }
    return Study(tables.pop("data", TABLE), WHEELS, **{**options, **tables})
