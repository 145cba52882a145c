"""Groups that are quick to sample."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from bayesterra.pooling.sampler import PoolingOptions
from bayesterra.sampling.adaptation import AdaptationOptions
from tests.support.two_wheels import MakeStudy, made


@pytest.fixture(scope="session")
def make() -> MakeStudy:
    """See :func:`made`."""
    return made


@pytest.fixture(scope="session")
def small() -> PoolingOptions:
    """A small adaptation."""
    lone = AdaptationOptions(particles=256, components=4, refinements=(2, 2), more=(), shores=0)
    return PoolingOptions((10, 20, 40), lone)


@pytest.fixture(scope="session")
def grid() -> Callable[[float, float, int], np.ndarray[Any, Any]]:
    """Middles of equal cells of an interval."""
    return lambda low, high, n: low + (high - low) * (np.arange(n) + 0.5) / n
