"""A short simulated drive of wheel Wh32 with the linear model M2."""

from collections.abc import Callable
from types import ModuleType

import numpy as np
import pytest

import bayesterra as bt
from bayesterra.study.observations import Observations

ROWS = 24


@pytest.fixture(scope="session")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The script of the study of streams."""
    return study_script("streaming")


@pytest.fixture(scope="session")
def plan(script: ModuleType) -> bt.Study:
    """Slips and loads of a drive."""
    found: bt.Study = script.drive(ROWS, np.random.default_rng(7), "M2")
    return found


@pytest.fixture(scope="session")
def rows(script: ModuleType, plan: bt.Study) -> list[Observations]:
    """Simulated readings of that drive, row by row."""
    made = script.driven(plan, script.TRUTH, seed=7).observations
    return [script.row(made, index) for index in range(ROWS)]


@pytest.fixture(scope="session")
def streamed(plan: bt.Study, rows: list[Observations]) -> bt.Stream:
    """A stream that has learned these rows; tests copy it before they add any."""
    stream = bt.Stream(plan, seed=3, particles=200)
    for row in rows:
        stream.learn(row)
    return stream
