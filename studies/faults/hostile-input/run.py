"""Search anew for inputs that break something: ``python studies/faults/hostile-input/run.py [TARGET ...]``.

Four minutes for each target; needs atheris (extra ``fuzz``, Python 3.11). What breaks something goes to
``fuzz-findings/`` in the working directory, the figures to ``search.csv`` here and to the README.
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
SECONDS = 240
BEGIN, END = "<!-- search.csv -->\n", "<!-- end -->\n"
FOUND = Path("fuzz-findings").resolve()


def searched(target: str) -> dict[str, str]:
    """Search one target; figures of the search."""
    command = [sys.executable, "-m", "tests.files.fuzz", target, "--seconds", str(SECONDS)]
    subprocess.run([*command, "--out", str(FOUND)], cwd=HERE.parents[2], check=False)
    found = json.loads((FOUND / target / "figures.json").read_text(encoding="utf-8"))
    counts = {"inputs": found["inputs"], "seconds": found["seconds"], "failures": len(found["failures"])}
    return {key: str(value) for key, value in counts.items()}


def words(rows: list[dict[str, str]]) -> str:
    """The table of the README."""
    lines = ["| target | what | inputs | seconds | failures |", "|---|---|---|---|---|"]
    for row in rows:
        cells = (row["target"], row["what"], row["inputs"], f"{float(row['seconds']):.0f}", row["failures"])
        lines.append(f"| {' | '.join(cells)} |")
    total = sum(int(row["inputs"]) for row in rows)
    return "\n".join(lines) + f"\n\n{total} inputs in all.\n"


def write_readme(rows: list[dict[str, str]]) -> None:
    """Put the figures into the README."""
    file = HERE / "README.md"
    head, _, rest = file.read_text(encoding="utf-8").partition(BEGIN)
    file.write_text(head + BEGIN + words(rows) + END + rest.partition(END)[2], encoding="utf-8")


def main(names: list[str]) -> None:
    """Search the targets named, or all, and write the table."""
    with (HERE / "search.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        if not names or row["target"] in names:
            row.update(searched(row["target"]))
    with (HERE / "search.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
    write_readme(rows)


if __name__ == "__main__":
    main(sys.argv[1:])
