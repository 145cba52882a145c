"""Runs whose ensembles adapt little: enough for a few free parameters, and in a fraction of the time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest

from bayesterra.checking import loo
from bayesterra.checking import soil_tests as checks
from bayesterra.sampling import sampler
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.study.schema import SamplingOptions

LITTLE = AdaptationOptions(particles=256, sweeps=2, components=6, refinements=(2, 4), more=(), shores=4, climbs=10)


HALF = AdaptationOptions(particles=512, components=12, refinements=(4, 4, 8), more=(8,), shores=8, climbs=20)
"""Enough for eight free parameters."""


@contextmanager
def little_adaptation(plan: AdaptationOptions = LITTLE) -> Iterator[None]:
    """Runs that state no size of their adaptation have this one: tests of the sampler state theirs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sampler, "AdaptationOptions", lambda: plan)
        yield


@contextmanager
def little_leaving_out() -> Iterator[None]:
    """Soil tests of which each is left out by a small sampling, enough for tables and pages.

    Their whole posterior keeps the adaptation that it has: with less its ensembles disagree on the scatter, whose
    law has a long ridge along the memory, and go on without end.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(checks, "ANEW", SamplingOptions(target_ess=100, walkers=32, max_steps=200))
        patch.setattr(checks, "OF_SOIL_TESTS", replace(LITTLE, sweeps=4))
        yield


@contextmanager
def rows_left_out_by_few() -> Iterator[None]:
    """Rows are left out by few weighted draws, enough for runs whose subject is another."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loo, "START_DRAWS", 256)
        patch.setattr(loo, "FINAL_DRAWS", (1024, 2048))
        yield
