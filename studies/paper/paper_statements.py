"""What the paper says beside what is found: one row per statement, the same columns in every study."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import pandas as pd

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
        raise ValueError(
            f"'{folder.name}/{FILE}': 'verdict' must be one of {', '.join(VERDICTS)} (got {odd[0]!r})"
        )
    return table


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]], align: str = "") -> str:
    """A Markdown table; r in ``align`` is a column of numbers."""
    rule = ["---:" if letter == "r" else "---" for letter in align.ljust(len(head), "|")[: len(head)]]
    return "\n".join("| " + " | ".join(row) + " |" for row in [list(head), rule, *rows])


def filled(text: str, blocks: dict[str, str]) -> str:
    """A README with what stands between ``<!-- name -->`` and ``<!-- end -->`` replaced."""
    for name, block in blocks.items():
        before, opened, rest = text.partition(f"<!-- {name} -->\n")
        _, closed, after = rest.partition("<!-- end -->")
        if not (opened and closed):
            raise ValueError(f"the README must hold the comments of the table '{name}'")
        text = f"{before}{opened}{minus(block)}\n{closed}{after}"
    return text


def minus(text: str) -> str:
    """Minus signs in place of hyphens before numbers."""
    return re.sub(r"(?<=[ (\[])-(?=\d)", "−", text)


def mark(word: str) -> str:
    """The verdict as it stands in a README."""
    return f"**{word}**" if word == "differs" else word


def statement_rows(table: pd.DataFrame) -> str:
    """All statements of a study as a Markdown table."""
    head = ["where", "the paper says", "printed", "ours", "difference", "", "why"]
    rows = [
        [*(str(row[name]) for name in COLUMNS[:5]), mark(row["verdict"]), row["why"]]
        for row in table.to_dict("records")
    ]
    return markdown(head, rows)
