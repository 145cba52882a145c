"""A real result, small enough to make once for all tests that need one."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from fcntl import LOCK_EX, LOCK_SH, flock
from pathlib import Path
from tempfile import NamedTemporaryFile
from types import ModuleType
from typing import TYPE_CHECKING

import pytest
from scripts import STUDIES, loaded

from bayesterra.analysis.inference import run
from bayesterra.study.result import Result
from bayesterra.study.study import load_study
from tests.support.adaptation import HALF
from tests.support.adaptation import little_adaptation as with_little_adaptation
from tests.support.choice import within

if TYPE_CHECKING:
    from tests.support.shared import Shared

pytest_plugins = [f"tests.support.{name}" for name in ("one_wheel", "two_wheels", "folder", "followed", "shared")]
"""Fixtures of several rooms."""

HIT = STUDIES / "hit-wh32"


WARMING = "BAYESTERRA_TESTS_WARMING"
"""Variable that names the file locked while the models are compiled."""


def pytest_configure(config: pytest.Config) -> None:
    """Compile the models once, in two processes of their own, while test processes start and collect."""
    if hasattr(config, "workerinput"):
        return
    with NamedTemporaryFile(delete=False) as file:
        flock(file, LOCK_EX)  # the processes that inherit the file hold the lock until the last one ends
        commands = [f"from bayesterra.models import warm_up; warm_up({names})" for names in ("'M1'", "'M2', 'M2L'")]
        warming = [subprocess.Popen([sys.executable, "-c", each], pass_fds=[file.fileno()]) for each in commands]

    def ended() -> None:
        for process in warming:
            process.wait()

    config.add_cleanup(ended)
    os.environ[WARMING] = file.name
    config.add_cleanup(Path(file.name).unlink)


def slow(item: pytest.Item) -> bool:
    """Whether a test is marked as slow."""
    return item.get_closest_marker("slow") is not None


DEAR = (
    "analysis/test_soil_tests_page", "pooling/test_run", "likelihood/test_likelihood_latent_load", "files/test_files",
    "likelihood/test_correlated_limits", "identifiability/test_profiles_of_wheels", "analysis/test_export",
    "checking/test_validation_discrepancy", "analysis/test_page", "files/test_pages", "prediction/test_prediction",
    "design/test_recommendation", "package/test_commands_soil_tests", "follow/test_session",
)  # fmt: skip
"""Files that take longest: they come first, so that no process is left with one of them at the end."""


SHARE = "BAYESTERRA_SHARE"
"""Variable that names a share of the slow tests, ``2/4`` for the second of four: others are left out."""


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Order of files, in which processes take them; of slow tests the share that is asked for."""
    if share := os.environ.get(SHARE):
        left = [item for item in items if slow(item) and not within(item.nodeid, share)]
        config.hook.pytest_deselected(items=left)
        items[:] = [item for item in items if item not in left]
    items.sort(key=lambda item: not item.nodeid.startswith(tuple(f"tests/{name}.py" for name in DEAR)))


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> None:
    """Wait for the models, where tests run: else every process would compile them."""
    if hasattr(session.config, "workerinput") or not session.config.getoption("numprocesses", None):
        with Path(os.environ[WARMING]).open("rb") as file:
            flock(file, LOCK_SH)


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
    (folder / "study.toml").write_text(f"{study}\n[sampling]\ntarget_ess = 400\nwalkers = 32\n", encoding="utf-8")
    (folder / "measurements.csv").write_bytes((HIT / "measurements.csv").read_bytes())

    def made() -> Result:
        with with_little_adaptation(HALF):
            return run(load_study(folder), seed=1)

    return shared("small", made)
