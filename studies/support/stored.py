"""Stored tables that grow: what they hold already, and rows that are added as they are made."""

from __future__ import annotations

from pathlib import Path

import pandas as pd


def done(path: Path, *columns: str) -> set[tuple[object, ...]]:
    """Values of some columns in every row of a table; none where there is no table."""
    if not path.is_file():
        return set()
    return set(pd.read_csv(path)[list(columns)].itertuples(index=False, name=None))


def append(path: Path, rows: pd.DataFrame, form: str = "%.4g") -> None:
    """Add rows to the end of a table, or begin it."""
    rows.to_csv(path, mode="a", header=not path.exists(), index=False, float_format=form)
