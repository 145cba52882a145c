"""What the paper says beside what is found: one row per statement, the same columns in every study."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import pandas as pd
from readme import mark, markdown, minus

FILE = "statements.csv"
COLUMNS = ("table_or_figure", "statement", "printed", "ours", "difference", "verdict", "why")
VERDICTS = ("reproduced", "differs", "cannot be checked")


@dataclass(frozen=True)
class Statement:
    """A statement of the paper that was checked.

    Attributes
    ----------
    table_or_figure : where it stands, e.g. ``Table 14`` or ``Table 6, Fig. 7``.
    statement : what is said, and how it was read where words have no number.
    printed, ours : both values; numbers as text with units.
    difference : ours less printed, empty where that has no meaning.
    holds : whether it was found again.
    why : for one that was not, what is behind it.
    """

    table_or_figure: str
    statement: str
    printed: str
    ours: str
    difference: str
    holds: bool
    why: str = ""


def table_of(found: Sequence[Statement]) -> pd.DataFrame:
    """Statements as a table with ``COLUMNS``."""
    rows = [{**asdict(each), "verdict": VERDICTS[not each.holds]} for each in found]
    rows = [{name: minus(str(value)) for name, value in row.items()} for row in rows]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def write(found: Sequence[Statement], folder: Path) -> pd.DataFrame:
    """Write the statements of a study into its folder."""
    table = table_of(found)
    table.to_csv(folder / FILE, index=False)
    return table


def read(folder: Path) -> pd.DataFrame:
    """The stored statements of a study; ValueError where columns or verdicts are not the common ones."""
    table = pd.read_csv(folder / FILE, keep_default_na=False, dtype=str)
    if tuple(table.columns) != COLUMNS:
        raise ValueError(f"'{folder.name}/{FILE}' must have the columns {', '.join(COLUMNS)}")
    odd = [word for word in table["verdict"] if word not in VERDICTS]
    if odd:
        raise ValueError(f"'{folder.name}/{FILE}': 'verdict' must be one of {', '.join(VERDICTS)} (got {odd[0]!r})")
    return table


def statement_rows(table: pd.DataFrame) -> str:
    """All statements of a study as a Markdown table."""
    head = ["where", "the paper says", "printed", "ours", "difference", "", "why"]
    rows = [
        [*(str(row[name]) for name in COLUMNS[:5]), mark(row["verdict"]), row["why"]]
        for row in table.to_dict("records")
    ]
    return markdown(head, rows)
