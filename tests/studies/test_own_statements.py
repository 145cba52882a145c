"""Statements of studies that judge stored tables: made again from these tables now."""

import pandas as pd
import pytest
from scripts import STUDIES, loaded


@pytest.mark.parametrize(
    ("study", "script"), [("soil-tests", "soil_statements"), ("misfit/leave-slip-out", "slip_statements")]
)
def test_statements_follow_from_the_tables(study: str, script: str) -> None:
    """What is stored is what the tables beside it give."""
    stored = pd.read_csv(STUDIES / study / "statements.csv", dtype=str, keep_default_na=False)
    made = loaded(STUDIES / study / f"{script}.py").statements().astype(str)
    pd.testing.assert_frame_equal(made, stored, check_dtype=False)
    assert len(made) > 5
