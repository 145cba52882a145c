"""The stored search for narrow second modes: its claims, its README, and one run of it."""

from pathlib import Path
from types import ModuleType

import pandas as pd
import pytest
from scripts import loaded

STUDY = Path(__file__).parents[2] / "studies" / "benchmarks" / "modes"


@pytest.fixture(scope="module")
def script() -> ModuleType:
    """The study's script."""
    return loaded(STUDY / "run.py")


def test_the_readme_says_what_is_stored(script: ModuleType) -> None:
    """All runs of all widths are there."""
    text = (STUDY / "README.md").read_text(encoding="utf-8")
    assert script.table() in text
    assert script.table("before.csv") in text
    stored = pd.read_csv(STUDY / "modes.csv")
    runs = {(d, width, run) for d, widths in script.CASES.items() for width in widths for run in range(1, 11)}
    assert set(stored[["d", "width", "run"]].itertuples(index=False, name=None)) == runs


@pytest.mark.parametrize(("d", "width", "least"), [(4, 0.02, 9), (4, 0.01, 6), (6, 0.02, 9), (8, 0.03, 9)])
def test_modes_are_found_or_the_run_says_so(d: int, width: float, least: int) -> None:
    """In nine runs of ten at least; and ``least`` find it, as the README's answer says."""
    stored = pd.read_csv(STUDY / "modes.csv")
    runs = stored[(stored["d"] == d) & (stored["width"] == width)]
    assert (runs["found"] | ~runs["converged"]).sum() >= 9
    assert runs["found"].sum() >= least
    assert runs["converged"][runs["found"]].all()


@pytest.mark.slow
def test_a_narrow_mode_is_found_today(script: ModuleType) -> None:
    """One that no ensemble found without steps uphill; and each ensemble's own evidence counts it."""
    run = script.one(6, 0.02, 2)
    assert run["found"]
    assert run["converged"]
    assert abs(run["share"] - 0.3) < 0.03
    assert abs(run["log_evidence"]) < 0.05
