"""Readings at slips that the fit has not seen: M1, M2 and M3 beside regressions that know no terramechanics.

Run it with ``python studies/leave-slip-out/run.py [PART ...]``; it takes about a quarter of an hour on two
cores. PART is one of ``measured``, ``simulated``, ``figure``; without, all of them. It writes the tables and
the figure beside this file and prints the tables of the README.
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
from bayesterra.holdout import Holdout, leave_out

HERE = Path(__file__).parent
MODELS = ("M1", "M2", "M3")
MEASURED = ("cmu-grouser", "cmu-grouser-wide", "hit-wh32")
ESTIMATED = {
    'sinkage = "0.55 mm"': 'sinkage = { estimate = { dist = "halfnorm", scale = "3 mm", lower = "0.3 mm" } }',
    'drawbar_pull = "0.34 N"': (
        'drawbar_pull = { estimate = { dist = "halfnorm", scale = "1 N", lower = "0.2 N" } }'
    ),
}
"""The noise of sinkage and pull as unknowns, which can take model error in."""
ESTIMATED_NAME = "M1, noise estimated"
TABLES = 12
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
    """Every measured study and model: scores.csv, refits.csv, summary.csv, skills.csv."""
    cases = [(name, model, model, {}) for name in MEASURED for model in MODELS]
    cases += [(name, "M1", ESTIMATED_NAME, ESTIMATED) for name in MEASURED[:2]]
    found: dict[str, list[pd.DataFrame]] = {"scores": [], "refits": [], "skills": []}
    for name, model, called, changes in cases:
        one = leave_out(study(name, model, changes))
        table, own = one.table, one.table["predictor"] == model
        table.loc[own, "predictor"] = called
        keep = own if called != "M1" else own | ~own  # baselines are the same for every model
        found["scores"].append(_headed(table[keep], name, one))
        found["refits"].append(_headed(one.refits, name, one).assign(model=called))
        found["skills"].append(_headed(one.skills, name, one).assign(model=called))
        print(name, called, one.refits["status"].value_counts().to_dict(), flush=True)
    for file, parts in found.items():
        pd.concat(parts).to_csv(HERE / f"{file}.csv", index=False, float_format="%.5g")


def _headed(table: pd.DataFrame, name: str, one: Holdout) -> pd.DataFrame:
    headed = table.copy()
    headed.insert(0, "study", name)
    headed.insert(1, "data", one.study.kind)
    return headed


def simulated_table(number: int) -> bt.Study:
    """Readings of M1 under the conditions of ``cmu-grouser``, of a soil drawn from its cut prior."""
    _, made = replicated(bt.load_study(HERE.parent / "cmu-grouser"), default_rng([2015, number]))
    return made


def simulated() -> None:
    """The same on tables that M1 made: simulated.csv."""
    parts = []
    for number in range(1, TABLES + 1):
        one = leave_out(simulated_table(number), seed=number, fit=ShortRuns())
        parts.append(one.table.assign(table=number, data="simulated"))
        print("simulated", number, one.refits["status"].value_counts().to_dict(), flush=True)
    columns = ["data", "table", "predictor", "level", "row", "slip", "channel", "unit", "extrapolated"]
    scores = ["observed", "q05", "q50", "q95", "pit", "crps", "covered50", "covered90", "no_answer"]
    pd.concat(parts)[columns + scores].to_csv(HERE / "simulated.csv", index=False, float_format="%.5g")


def figure() -> None:
    """Predictions of left-out rows: leave-slip-out.png."""
    one = leave_out(study("cmu-grouser"))
    (HERE / "leave-slip-out.png").write_bytes(left_out_png(one, dpi=150))


def main(parts: list[str]) -> None:
    """Make the parts asked for."""
    known = {"measured": measured, "simulated": simulated, "figure": figure}
    for part in parts or known:
        known[part]()


if __name__ == "__main__":
    main(sys.argv[1:])
