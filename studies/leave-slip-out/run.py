"""Readings at slips that the fit has not seen: M1, M2 and M3 beside regressions that know no terramechanics.

Run it with ``python studies/leave-slip-out/run.py [PART ...]``; it takes about a quarter of an hour on two
cores. PART is one of ``measured``, ``simulated``, ``figure``; without, all of them. The tables beside
this file go on where they end; remove them to start anew.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

import pandas as pd
from numpy.random import default_rng

import bayesterra as bt
from bayesterra.calibration import ShortRuns
from bayesterra.calibration.tasks import replicated
from bayesterra.figures.holdout import left_out_png
from bayesterra.holdout import leave_out

HERE = Path(__file__).parent
MEASURED = ("cmu-grouser", "cmu-grouser-wide", "hit-wh32")
ESTIMATED = {
    'sinkage = "0.55 mm"': 'sinkage = { estimate = { dist = "halfnorm", scale = "3 mm", lower = "0.3 mm" } }',
    'drawbar_pull = "0.34 N"': (
        'drawbar_pull = { estimate = { dist = "halfnorm", scale = "1 N", lower = "0.2 N" } }'
    ),
}
"""The noise of sinkage and pull as unknowns, which can take model error in."""
ESTIMATED_NAME = "M1, noise estimated"
CASES = [
    ("cmu-grouser", "M1", "M1", {}),
    ("hit-wh32", "M1", "M1", {}),
    ("cmu-grouser-wide", "M1", "M1", {}),
    *((name, model, model, {}) for model in ("M2", "M3") for name in MEASURED),
    *((name, "M1", ESTIMATED_NAME, ESTIMATED) for name in MEASURED[:2]),
]
"""Study, model, its name in the tables, and changes to the study file."""
TABLES = 10
"""Simulated tables, each of another soil of the prior."""


def study(name: str, model: str = "M1", changes: Mapping[str, str] | None = None) -> bt.Study:
    """A shipped study with another model and other lines in its file."""
    shipped = bt.load_study(HERE.parent / name)
    text = (HERE.parent / name / "study.toml").read_text(encoding="utf-8")
    file = (HERE.parent / "cmu-grouser" if "cmu" in name else HERE.parent / name) / "measurements.csv"
    own = next(line for line in text.splitlines() if line.startswith("file = "))
    for old, new in {
        'model = "M1"': f'model = "{model}"',
        own: f'file = "{file}"',
        **(changes or {}),
    }.items():
        if old not in text:
            raise ValueError(f"no {old} in the study file of {name}")
        text = text.replace(old, new)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "study.toml").write_text(text, encoding="utf-8")
        changed = bt.load_study(folder)
    assert len(changed.observations) == len(shipped.observations)
    return changed


def measured() -> None:
    """Every measured study and model that the tables do not hold yet: scores.csv, refits.csv, skills.csv."""
    for name, model, called, changes in CASES:
        if (name, called) in _done("refits.csv", ["study", "model"]):
            continue
        one = leave_out(study(name, model, changes))
        table, own = one.table, one.table["predictor"] == model
        table.loc[own, "predictor"] = called
        kept = table if called == "M1" else table[own]  # baselines are the same for every model
        for file, rows in {"scores": kept, "skills": one.skills, "refits": one.refits}.items():
            head = {"study": name, "data": one.study.kind, "model": called}
            _append(
                f"{file}.csv",
                pd.DataFrame(head, index=rows.index).join(rows.drop(columns="model", errors="ignore")),
            )
        print(name, called, one.refits["status"].value_counts().to_dict(), flush=True)


def _done(file: str, columns: list[str]) -> set[tuple[object, ...]]:
    """What a table holds already."""
    if not (HERE / file).exists():
        return set()
    return set(pd.read_csv(HERE / file)[columns].itertuples(index=False, name=None))


def _append(file: str, rows: pd.DataFrame) -> None:
    path = HERE / file
    rows.to_csv(path, mode="a", header=not path.exists(), index=False, float_format="%.5g")


def simulated_table(number: int) -> bt.Study:
    """Readings of M1 under the conditions of ``hit-wh32``, of a soil drawn from its cut prior."""
    _, made = replicated(bt.load_study(HERE.parent / "hit-wh32"), default_rng([2015, number]))
    return made


def simulated() -> None:
    """The same on tables that M1 made: simulated.csv."""
    columns = ["predictor", "level", "row", "slip", "channel", "unit", "extrapolated", "observed"]
    columns += ["q05", "q50", "q95", "pit", "crps", "covered50", "covered90", "no_answer", "status"]
    for number in range(1, TABLES + 1):
        if (number,) in _done("simulated.csv", ["table"]):
            continue
        one = leave_out(simulated_table(number), seed=number, fit=ShortRuns())
        rows = one.table.merge(one.refits[["level", "status"]], on="level")[columns]
        _append(
            "simulated.csv", pd.DataFrame({"data": "simulated", "table": number}, index=rows.index).join(rows)
        )
        print("simulated", number, one.refits["status"].value_counts().to_dict(), flush=True)


def figure() -> None:
    """Left-out rows of the narrower wheel and what M1 and the baselines said of them: leave-slip-out.png."""
    table = pd.read_csv(HERE / "scores.csv")
    shown = table[(table["study"] == "cmu-grouser") & (table["model"] == "M1")]
    (HERE / "leave-slip-out.png").write_bytes(left_out_png(shown, dpi=150))


def main(parts: list[str]) -> None:
    """Make the parts asked for."""
    known = {"measured": measured, "simulated": simulated, "figure": figure}
    for part in parts or known:
        known[part]()


if __name__ == "__main__":
    main(sys.argv[1:])
