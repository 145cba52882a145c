"""Profiles traced by worker processes, where that is worth it: with loads that are integrated out."""

import numpy as np
import pytest

from bayesterra.identifiability.profiles import Profiles, profiles
from bayesterra.likelihood.posterior import posterior
from bayesterra.likelihood.target import Target, chart
from bayesterra.runtime.engines import Engine, in_process, local_pool

from .conftest import VARIANTS


def traced(variant: str, engine: Engine) -> Profiles:
    """Profiles of one of the small studies."""
    return profiles(posterior(VARIANTS[variant]()), rng=np.random.default_rng(1), engine=engine)


@pytest.mark.slow
def test_a_pool_traces_what_one_process_does() -> None:
    """Every point, to the last digit."""
    with local_pool(2) as pool:
        here, there = traced("unknown load", in_process()), traced("unknown load", pool)
        assert not pool.starting
    for kind in here.found:
        for one, other in zip(here.found[kind], there.found[kind], strict=True):
            np.testing.assert_array_equal(one.values, other.values)
            np.testing.assert_array_equal(one.rise, other.rise)
            np.testing.assert_array_equal(one.path, other.path)
            np.testing.assert_array_equal(one.agreeing, other.agreeing)


def test_workers_are_for_loads_that_are_integrated_out() -> None:
    """Where loads are given all profiles take less time than a worker needs to start."""
    with local_pool(2) as pool:
        traced("one parameter", pool)
        assert pool.starting
    for variant, long in (("one parameter", False), ("unknown load", True)):
        density = posterior(VARIANTS[variant]())
        target = Target(density, chart(density), False, np.zeros(len(density.names)))
        assert target.latent == long
