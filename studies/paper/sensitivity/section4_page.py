"""The tables of the README, made from the stored files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import SimpleNamespace

import pandas as pd
from readme import mark, markdown, minus

Stored = Mapping[str, pd.DataFrame]
OUTCOMES = {"sinkage": "z", "drawbar_pull": "F_DP", "resistance_moment": "M_DR"}
BOXES = {"near G1": "20 % about G1", "planetary": "`planetary`", "paper-box": "`paper-box`"}


def blocks(stored: Stored) -> dict[str, str]:
    """Every table by the name of its comment."""
    return {name: make(stored) for name, make in BLOCKS.items()}


def _rows(table: pd.DataFrame) -> list[SimpleNamespace]:
    """Rows with a column's value as attribute."""
    return [SimpleNamespace(**{str(key): value for key, value in row.items()}) for row in table.to_dict("records")]


def index(stored: Stored) -> str:
    """Every statement with its verdict."""
    rows = [[row.place, row.statement, row.reading, row.ours, mark(row.verdict)] for row in _rows(stored["index"])]
    return _table(["where", "the paper says", "read as", "M1 gives", ""], rows)


def table_4(stored: Stored) -> str:
    """Printed and our shares."""
    rows = [
        [
            row.wheel, f"{row.load_N}", f"{row.share_percent:.1f}", f"{row.ours_percent:.2f}",
            f"{row.difference:+.2f}", f"{row.needed_mm:+.2f} of {row.sinkage_mm:.1f}", mark(row.verdict),
        ]
        for row in _rows(stored["table-4"])
    ]  # fmt: skip
    head = ["wheel", "W, N", "printed, %", "ours, %", "difference", "sinkage that would explain it, mm", ""]
    return _table(head, rows, "|rrrrr|")


def tables_6_to_8(stored: Stored) -> str:
    """Printed and our errors with the bounds, one row per group."""
    rows = []
    for (number, group), some in stored["tables-6-8"].groupby(["table", "group"], sort=False):
        cells = [
            f"{row.printed:.2f} / {row.ours:.2f} ({row.difference:+.2f}) [{row.low:.1f}, {row.high:.1f}]"
            for row in _rows(some)
        ]
        out = some[some["verdict"] == "differs"]
        word = "reproduced" if out.empty else "**differs**: " + ", ".join(OUTCOMES[o] for o in out["outcome"])
        rows.append([str(number), str(group), *cells, word])
    return _table(["table", "group", *OUTCOMES.values(), ""], rows)


def table_9(stored: Stored) -> str:
    """Words and influences beside first-order / total Sobol indices of whole curves."""
    sobol = stored["sobol"]
    whole = sobol[sobol["slip"].isna()].set_index(["box", "parameter_group", "outcome"])
    found = whole[["first", "total"]].to_dict("index")
    rows = []
    for row in _rows(stored["table-9"]):
        at = [found[box, row.parameter_group, row.outcome] for box in BOXES]
        cells = [f"{_share(each['first'])} / {_share(each['total'])}" for each in at]
        words = [OUTCOMES[row.outcome], row.printed, row.word, f"{row.influence:.2f}"]
        rows.append([row.parameter_group, *words, mark(row.verdict), *cells])
    head = ["", "", "printed", "our word", "influence", "", *(f"Sobol, {name}" for name in BOXES.values())]
    return _table(head, rows, "||||r|rrr")


def _share(value: float) -> str:
    """An index to two decimals; estimates below zero are zero."""
    return f"{max(value, 0.0):.2f}"


def _table(head: list[str], rows: list[list[str]], align: str = "") -> str:
    """A table with minus signs."""
    return minus(markdown(head, rows, align))


BLOCKS: Mapping[str, Callable[[Stored], str]] = {
    "index": index,
    "table-4": table_4,
    "tables-6-8": tables_6_to_8,
    "table-9": table_9,
}
