"""Left-out levels of a simulated study with one free parameter, whose posterior is known on a grid."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import SeedSequence, default_rng

from bayesterra.analysis.simulation import simulate
from bayesterra.checking.short_runs import Fitted
from bayesterra.likelihood.posterior import posterior
from bayesterra.models import Wheel
from bayesterra.study.study import Study

HELD = {"Ks": 2.5e6, "n0": 0.85, "n1": 1.06, "c": 268.0, "K": 0.0101, "c1": 0.339, "c2": -0.017}
SLIPS = (0.1, 0.11, 0.2, 0.3, 0.31, 0.4, 0.5)
"""Five levels; the last row is not in the fit."""
MakeStudy = Callable[..., Study]


def make(drive: str = "load", **options: Any) -> Study:
    """Rows of one wheel, made by M2 with φ = 30°; φ is free, all else is held."""
    table = pd.DataFrame(
        {
            "slip": SLIPS,
            "load [N]" if drive == "load" else "normal_force [N]": 80.0,
            "sinkage [mm]": [6.0, 6.2, 8.0, 10.0, 10.3, 14.0, 20.0],
            "drawbar_pull [N]": 15.0,
            "use": [1, 1, 1, 1, 1, 1, 0],
        }
    )
    noise = {"sinkage": 5e-4, "drawbar_pull": 1.0, **({} if drive == "load" else {"normal_force": 1.0})}
    phi = {"dist": "uniform", "lower": np.radians(15.0), "upper": np.radians(45.0)}
    tables: dict[str, Any] = {"model": "M2", "drive": drive, "slip_reference": "shearing", "noise": noise}
    tables |= {"kind": "simulated", "title": "<b>made</b>", "priors": {**HELD, "phi": phi}, **options}
    wheels = {"Wh32": Wheel(0.15735, 0.165, 0.010, 30, 0.65)}
    study = Study(table, wheels, **tables)
    return Study(simulate(study, {"phi": np.radians(30.0)}, seed=3), wheels, **tables)


def on_grid(study: Study, seed: SeedSequence, points: int = 800) -> Fitted:
    """Independent draws of the only free parameter from its posterior on a fine grid."""
    target = posterior(study)
    (law,) = study.prior.laws.values()
    edges = np.linspace(*law.range, points + 1)
    density = target.log_density(0.5 * (edges[1:] + edges[:-1])[:, None])
    below = np.cumsum(np.exp(density - density.max()))
    u = default_rng(seed).random(400)
    return Fitted(np.interp(u, np.append(0.0, below / below[-1]), edges)[:, None], 400.0, 1.0, True)
