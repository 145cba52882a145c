"""A real result, small enough to make once for all tests that need one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import ModuleType
from typing import TYPE_CHECKING

import pytest
from scripts import STUDIES, loaded

from bayesterra.analysis.inference import run
from bayesterra.models import warm_up
from bayesterra.study.result import Result
from bayesterra.study.study import load_study
from tests.support.adaptation import HALF
from tests.support.adaptation import little_adaptation as with_little_adaptation

if TYPE_CHECKING:
    from tests.support.shared import Shared

pytest_plugins = [
    f"tests.support.{name}" for name in ("one_wheel", "two_wheels", "folder", "followed", "shared")
]
"""Fixtures of several rooms."""

HIT = STUDIES / "hit-wh32"


def pytest_configure(config: pytest.Config) -> None:
    """Compile the models once, before test processes start that would each do it."""
    if not hasattr(config, "workerinput"):
        warm_up()


@pytest.fixture(scope="session")
def study_script() -> Callable[[str], ModuleType]:
    """Import the script of a study by the name of its folder."""
    return lambda name: loaded(STUDIES / name / "run.py")


@pytest.fixture(scope="module")
def little_adaptation() -> Iterator[None]:
    """All runs of a file adapt little."""
    with with_little_adaptation():
        yield


@pytest.fixture(scope="session")
def small_result(tmp_path_factory: pytest.TempPathFactory, shared: Shared) -> Result:
    """A short run on the shipped HIT study: 400 effective draws of ensembles of 32 walkers."""
    folder = tmp_path_factory.mktemp("small")
    study = (HIT / "study.toml").read_text(encoding="utf-8")
    (folder / "study.toml").write_text(
        f"{study}\n[sampling]\ntarget_ess = 400\nwalkers = 32\n", encoding="utf-8"
    )
    (folder / "measurements.csv").write_bytes((HIT / "measurements.csv").read_bytes())

    def made() -> Result:
        with with_little_adaptation(HALF):
            return run(load_study(folder), seed=1)

    return shared("small", made)
