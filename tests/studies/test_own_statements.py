"""Statements of studies that judge stored tables: made again from these tables now."""

import importlib.util
import sys
from pathlib import Path

import pandas as pd
import pytest

STUDIES = Path(__file__).parents[2] / "studies"


@pytest.mark.parametrize(
    ("study", "script"), [("soil-tests", "soil_statements"), ("misfit/leave-slip-out", "slip_statements")]
)
def test_statements_follow_from_the_tables(study: str, script: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is stored is what the tables beside it give."""
    monkeypatch.setattr(sys, "path", [str(STUDIES / "paper"), *sys.path])
    spec = importlib.util.spec_from_file_location(script, STUDIES / study / f"{script}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    stored = pd.read_csv(STUDIES / study / "statements.csv", dtype=str, keep_default_na=False)
    made = module.statements().astype(str)
    pd.testing.assert_frame_equal(made, stored, check_dtype=False)
    assert len(made) > 5
