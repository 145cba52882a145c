"""A real result, small enough to make once for all tests that need one."""

from pathlib import Path

import pytest

from bayesterra.inference import run
from bayesterra.results import Result
from bayesterra.study import load_study

HIT = Path(__file__).parent.parent / "studies" / "hit-wh32"


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
