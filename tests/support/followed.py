"""Two short runs on the HIT wheel: four free parameters; then with phi known beforehand and K_s held."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from bayesterra.analysis.run import run
from bayesterra.study.result import Result
from bayesterra.study.study import Study, load_study
from tests.support.adaptation import little_adaptation
from tests.support.pages import plain_pages

if TYPE_CHECKING:
    from tests.support.shared import Shared

HIT = Path(__file__).parents[2] / "studies" / "hit-wh32"
HELD = """\
n0 = 0.85
n1 = 1.06
K = "10 mm"
c = "0.3 kPa"
"""
SHORT = """
[sampling]
target_ess = 400
walkers = 32
"""


def short_study(folder: Path, priors: str = "") -> Study:
    """The HIT study with model M2, few free parameters and a small sample, and more lines of priors."""
    text = (HIT / "study.toml").read_text(encoding="utf-8")
    changes = {
        'model = "M1"': 'model = "M2"',
        'set = "paper-box"\n': f'set = "paper-box"\n{HELD}{priors}',
        'hold = { Ks = "2500 kPa" }': 'methods = ["joint"]',
    }
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    (folder / "study.toml").write_text(text + SHORT, encoding="utf-8")
    shutil.copy(HIT / "measurements.csv", folder)
    return load_study(folder)


def _result(folder: Path, priors: str, seed: int) -> Result:
    with little_adaptation():
        return run(short_study(folder, priors), seed=seed)


@pytest.fixture(scope="session")
def wide(tmp_path_factory: pytest.TempPathFactory, shared: Shared) -> Result:
    """Flat priors on K_s, phi, c1 and c2."""
    return shared("wide", lambda: _result(tmp_path_factory.mktemp("wide"), "", 1))


@pytest.fixture(scope="session")
def narrow(tmp_path_factory: pytest.TempPathFactory, shared: Shared) -> Result:
    """The same readings with phi known to 0.3 deg and K_s held."""
    known = 'phi = { dist = "norm", loc = "30 deg", scale = "0.3 deg" }\nKs = "2500 kPa"\n'
    return shared("narrow", lambda: _result(tmp_path_factory.mktemp("narrow"), known, 2))


@pytest.fixture(scope="session")
def saved(wide: Result, narrow: Result, shared: Shared, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with both results, whose pages are one line."""

    def fill(folder: Path) -> None:
        with plain_pages():
            wide.save(folder / "wide-result")
            narrow.save(folder / "narrow-result")

    return shared.folder_of("saved-runs", fill, tmp_path_factory.mktemp("saved"))
