"""A quick fit for studies with one free parameter; importable by worker processes."""

import time

import numpy as np
from numpy.random import SeedSequence, default_rng

from bayesterra.checking.short_runs import Fitted
from bayesterra.likelihood.posterior import posterior
from bayesterra.study.study import Study


def on_a_grid(study: Study, seed: SeedSequence) -> Fitted:
    """Independent draws of the only free parameter from its posterior on a grid; not at once."""
    time.sleep(0.05)
    (law,) = study.prior.laws.values()
    edges = np.linspace(*law.range, 301)
    density = posterior(study).log_density(0.5 * (edges[1:] + edges[:-1])[:, None])
    below = np.cumsum(np.exp(density - density.max()))
    u = default_rng(seed).random(500)
    return Fitted(np.interp(u, np.append(0.0, below / below[-1]), edges)[:, None], 500.0, 1.0, True)
