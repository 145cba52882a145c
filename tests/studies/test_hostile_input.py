"""The stored search for hostile input: its figures are those of the README, and what it found is kept."""

import csv
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

from tests.files import targets

HERE = Path(__file__).parents[1] / "files"
STUDY = HERE.parents[1] / "studies" / "faults" / "hostile-input"


def _rows(name: str) -> list[dict[str, str]]:
    with (STUDY / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_every_target_was_searched_without_a_failure(study_script: Callable[[str], ModuleType]) -> None:
    """Tens of thousands of inputs; the README says the same."""
    rows = _rows("search.csv")
    assert {row["target"] for row in rows} == set(targets.TARGETS)
    assert all(row["failures"] == "0" for row in rows)
    assert min(int(row["inputs"]) for row in rows) >= 100
    assert sum(int(row["inputs"]) for row in rows) >= 50_000
    assert study_script("faults/hostile-input").words(rows) in (STUDY / "README.md").read_text(encoding="utf-8")


def test_every_failure_that_was_found_is_tried_again() -> None:
    """As a seed or in a test; the README lists it."""
    rows, text = _rows("failures.csv"), (STUDY / "README.md").read_text(encoding="utf-8")
    kept = {path.name for path in (HERE / "seeds").glob("*/once-*")} | {p.name for p in HERE.glob("test_*.py")}
    assert {row["kept as"] for row in rows} <= kept
    assert {path.name for path in (HERE / "seeds").glob("*/once-*")} <= {row["kept as"] for row in rows}
    assert all(" | ".join(row.values()) in text for row in rows)
