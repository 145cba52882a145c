"""Search anew for inputs that break something: ``python studies/hostile-input/run.py [TARGET ...]``.

Four minutes for each target; needs atheris (extra ``fuzz``, Python 3.11). What breaks something goes to
``fuzz-findings/`` in the working directory, the figures to ``search.csv`` here.
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
SECONDS = 240
FOUND = Path("fuzz-findings").resolve()


def searched(target: str) -> dict[str, str]:
    """Search one target; figures of the search."""
    command = [sys.executable, "-m", "tests.hostile.fuzz", target, "--seconds", str(SECONDS)]
    subprocess.run([*command, "--out", str(FOUND)], cwd=HERE.parents[1], check=False)
    found = json.loads((FOUND / target / "figures.json").read_text(encoding="utf-8"))
    counts = {"inputs": found["inputs"], "seconds": found["seconds"], "failures": len(found["failures"])}
    return {key: str(value) for key, value in counts.items()}


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


if __name__ == "__main__":
    main(sys.argv[1:])
