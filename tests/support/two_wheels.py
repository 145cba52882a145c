"""Two wheels with few free parameters, quick to sample and small enough for a grid."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pandas as pd
import pytest
from paper_wheels import ABOUT_WH32
from paper_wheels import WHEELS as PAPER_WHEELS

from bayesterra.pooling import degrees
from bayesterra.sampling import joint
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.sampling.joint import PoolingOptions
from bayesterra.study.study import Study

WHEELS = {name: PAPER_WHEELS[name] for name in ("Wh11", "Wh32")}
HELD = {name: ABOUT_WH32[name] for name in ("Ks", "n0", "n1", "c", "c1", "c2")}
FREE = {name: value for name, value in HELD.items() if name != "c"}
COHESION = {"dist": "norm", "loc": 1000.0, "scale": 300.0, "lower": 0.0}
FRICTION = {"dist": "norm", "loc": np.radians(30.0), "scale": np.radians(4.0), "lower": 0.0, "upper": 1.0}
SHEAR = {"dist": "norm", "loc": 0.012, "scale": 0.003, "lower": 0.002, "upper": 0.05}
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
    return Study(tables.pop("data", TABLE), tables.pop("wheels", WHEELS), **{**options, **tables})


@contextmanager
def few_walkers(sweeps: int = 40, draws: int = 2048, inner: int = 32) -> Iterator[None]:
    """Runs with groups in short rounds, whose evidences for other roles come from few walkers."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(joint, "ROUND_SWEEPS", 50)
        patch.setattr(degrees, "WALKERS", 32)
        patch.setattr(degrees, "WARM_UPS", (sweeps // 5, 2 * sweeps // 5))
        patch.setattr(degrees, "SWEEPS", (sweeps,))
        patch.setattr(degrees, "OUTER", draws)
        patch.setattr(degrees, "INNER", inner)
        yield


@pytest.fixture(scope="session")
def make() -> MakeStudy:
    """See :func:`made`."""
    return made


@pytest.fixture(scope="session")
def small() -> PoolingOptions:
    """A small adaptation."""
    lone = AdaptationOptions(particles=256, components=4, refinements=(2, 2), more=(), shores=0, climbs=10)
    return PoolingOptions((10, 20, 40), lone)


@pytest.fixture(scope="session")
def grid() -> Callable[[float, float, int], np.ndarray[Any, Any]]:
    """Middles of equal cells of an interval."""
    return lambda low, high, n: low + (high - low) * (np.arange(n) + 0.5) / n
