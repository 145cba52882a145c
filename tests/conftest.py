"""A real result, small enough to make once for all tests that need one."""

import importlib.util
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from bayesterra.analysis.inference import run
from bayesterra.models import warm_up
from bayesterra.study.result import Result
from bayesterra.study.study import load_study

pytest_plugins = ["tests.support.one_wheel", "tests.support.folder", "tests.support.followed"]
"""Fixtures of several rooms."""

STUDIES = Path(__file__).parent.parent / "studies"
HIT = STUDIES / "hit-wh32"


def pytest_configure(config: pytest.Config) -> None:
    """Compile the models once, before test processes start that would each do it."""
    if not hasattr(config, "workerinput"):
        warm_up()


@pytest.fixture(scope="session")
def study_script() -> Callable[[str], ModuleType]:
    """Import the script of a study by the name of its folder."""

    def load(name: str) -> ModuleType:
        spec = importlib.util.spec_from_file_location(re.sub(r"\W", "_", name), STUDIES / name / "run.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module  # dataclasses look for their module there
        spec.loader.exec_module(module)
        return module

    return load


@pytest.fixture(scope="session")
def small_result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """A short run on the shipped HIT study: 400 effective draws of ensembles of 32 walkers."""
    folder = tmp_path_factory.mktemp("small")
    study = (HIT / "study.toml").read_text(encoding="utf-8")
    (folder / "study.toml").write_text(
        f"{study}\n[sampling]\ntarget_ess = 400\nwalkers = 32\n", encoding="utf-8"
    )
    (folder / "measurements.csv").write_bytes((HIT / "measurements.csv").read_bytes())
    return run(load_study(folder), seed=1)
