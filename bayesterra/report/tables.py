"""Rows of a table as dictionaries, for cells that need several of their columns."""

from __future__ import annotations

from typing import Any, TypeAlias

import pandas as pd

Record: TypeAlias = dict[str, Any]


def records(table: pd.DataFrame) -> list[Record]:
    """One dictionary per row, by column."""
    return [{str(name): value for name, value in row.items()} for row in table.to_dict("records")]
