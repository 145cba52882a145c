"""A study with one or two free parameters, and a sampler that is quick because it is asked for little."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.random import SeedSequence, default_rng

from bayesterra.checking.short_runs import Fitted, ShortRuns
from bayesterra.likelihood.posterior import posterior
from bayesterra.models import Wheel
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study
from tests.support.one_wheel import TRUTH as HELD

TABLE = pd.DataFrame(
    {
        "slip": [0.1, 0.2, 0.3, 0.4],
        "load [N]": 80.0,
        "sinkage [mm]": [5.0, 7.5, np.nan, 14.0],
        "drawbar_pull [N]": [14.0, np.nan, 20.0, 22.0],
        "use": [1, 1, 0, 1],
    }
)
"""One reading is missing in each channel, one row is not in the fit."""

MakeStudy = Callable[..., Study]


def make(*free: str, noise: Mapping[str, float] | None = None, data: pd.DataFrame = TABLE, **options: Any) -> Study:
    """Study of one wheel; ``free`` names the free parameters, all others are held."""
    held = {name: value for name, value in HELD.items() if name not in free}
    return Study(
        data,
        {"Wh32": Wheel(0.15735, 0.165, 0.010, 30, 0.65)},
        **{"model": "M2", "slip_reference": "shearing", "priors": {"set": "paper-box", **held}, **options},
        noise={"sinkage": 1e-3, "drawbar_pull": 1.5, "normal_force": 2.0} | dict(noise or {}),
    )


@pytest.fixture(scope="session")
def make_small() -> MakeStudy:
    """See :func:`make`."""
    return make


@pytest.fixture(scope="session")
def quick() -> ShortRuns:
    """The sampler of calibrations with settings that suit one or two parameters."""
    small = AdaptationOptions(particles=64, sweeps=1, components=2, refinements=(2,), climbs=10)
    return ShortRuns(
        short=SamplingOptions(target_ess=100, walkers=32, max_steps=40),
        adaptation=small,
        long=SamplingOptions(target_ess=100, walkers=32, max_steps=600),
        long_adaptation=small,
    )


def exact(study: Study, seed: SeedSequence) -> Fitted:
    """Independent draws of the only free parameter from its posterior on a fine grid."""
    target = posterior(study)
    (law,) = study.prior.laws.values()
    edges = np.linspace(*law.range, 1001)
    middles = 0.5 * (edges[1:] + edges[:-1])
    density = target.log_density(middles[:, None])
    below = np.cumsum(np.exp(density - density.max()))
    u = default_rng(seed).random(500)
    return Fitted(np.interp(u, np.append(0.0, below / below[-1]), edges)[:, None], 500.0, 1.0, True)
