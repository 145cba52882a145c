"""Digests of the draws and tables of thirteen small studies: whether a change of code changed a result.

Run ``python studies/support/digests.py > before.csv`` before a change and again after it, on one machine
with the same libraries: the two files are equal, or name what differs. Seven minutes of a processor. The
studies go through every drive, model and noise law, and every way in which readings or parameters hang
together.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any

import pandas as pd
from paper_wheels import ABOUT_WH32
from paper_wheels import WHEELS as PAPER_WHEELS

import bayesterra as bt

STUDIES = Path(__file__).resolve().parents[1]
WHEELS = {name: PAPER_WHEELS[name] for name in ("Wh11", "Wh32")}
HELD = {name: ABOUT_WH32[name] for name in ("Ks", "n0", "n1", "c", "c1", "c2")}
TABLE = pd.DataFrame(
    {
        "wheel": ["Wh11"] * 4 + ["Wh32"] * 4,
        "slip": [0.1, 0.2, 0.35, 0.5] * 2,
        "load [N]": [80.0, 60.0, 80.0, 60.0] * 2,
        "sinkage [mm]": [6.1, 6.0, 12.0, 13.4, 4.9, 5.6, 12.1, 15.0],
        "drawbar_pull [N]": [14.5, 15.6, 23.0, 18.0, 14.0, 15.2, 22.4, 18.6],
        "resistance_moment [N m]": [3.3, 3.5, 5.2, 4.6, 3.9, 4.4, 6.1, 5.2],
    }
)
NOISE: dict[str, Any] = {"sinkage": 1e-3, "drawbar_pull": 1.0, "resistance_moment": 0.3}
ESTIMATED = {"estimate": {"dist": "halfnorm", "scale": 2.0, "lower": 0.2}}
FEW = {"target_ess": 400, "walkers": 32}
CASES: dict[str, dict[str, Any]] = {
    "M1, load": {"model": "M1"},
    "M2, sinkage": {"drive": "sinkage", "noise": {**NOISE, "normal_force": 2.0}},
    "M3, both": {"model": "M3", "drive": "both", "noise": {**NOISE, "normal_force": 2.0}},
    "M2L": {"model": "M2L", "model_options": {"mean_load": 70.0}},
    "estimated noise": {"noise": {**NOISE, "drawbar_pull": ESTIMATED}},
    "Student-t noise": {"noise": {**NOISE, "drawbar_pull": {"sd": 1.0, "dof": 4.0}}},
    "discrepancy": {"discrepancy": {"drawbar_pull": {"sd": 2.0, "length": 0.3}}},
    "ripple": {"ripple": {"drawbar_pull": {"sd": 1.0, "memory": 3}}},
    "slip errors": {"slip": {"sd": 0.005}},
    "correlated priors": {"correlation": {"phi, K": 0.7}},
    "groups": {"pooling": {"shared": ["phi"], "hierarchical": {"K": {}}}},
}
SOIL_TESTS = {"plates": "cmu.toml", "shear": "cullinan.toml"}


def study_of(case: dict[str, Any]) -> bt.Study:
    """A study of φ and K of two wheels; ``case`` has what it changes."""
    options: dict[str, Any] = {
        "slip_reference": "shearing",
        "kind": "simulated",
        "model": "M2",
        "noise": NOISE,
        "priors": dict(HELD),
        "sampling": FEW,
    }
    options |= {name: value for name, value in case.items() if name != "correlation"}
    if "correlation" in case:
        options["priors"] |= {"correlation": case["correlation"]}
    table = TABLE
    if options.get("drive") == "both":
        table = TABLE.rename(columns={"load [N]": "normal_force [N]"})
    return bt.Study(table, WHEELS, **options)


def digests(result: Any, tables: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Name and digest of the posterior draws and of every table that a result has."""
    posterior = result.draws["posterior"]
    content = b"".join(name.encode() + posterior[name].to_numpy().tobytes() for name in sorted(posterior))
    yield "posterior", sha256(content).hexdigest()[:16]
    for name in tables:
        if (table := getattr(result, name, None)) is not None:
            columns = {name: [column for column in table.columns if column != "mode"]}
            if "mode" in table.columns:  # which an optimiser finds, apart from what is counted off draws
                columns["mode"] = ["mode"]
            for part, chosen in columns.items():
                yield part, sha256(table[chosen].to_csv(float_format="%.17g").encode()).hexdigest()[:16]


def main() -> None:
    """Print a row for each study and table."""
    tables = ("summary", "least_squares", "identifiability", "predictive", "pooling", "sharing", "new_tests", "bands")
    print("study,table,digest")
    for name, case in CASES.items():
        for table, digest in digests(bt.run(study_of(case), seed=1), tables):
            print(f'"{name}",{table},{digest}', flush=True)
    for name, file in SOIL_TESTS.items():
        with tempfile.TemporaryDirectory() as folder:
            text = (STUDIES / "soil-tests" / file).read_text(encoding="utf-8")
            (Path(folder) / file).write_text(text + "\n[sampling]\ntarget_ess = 400\n", encoding="utf-8")
            data = file.replace(".toml", ".csv")
            (Path(folder) / data).write_bytes((STUDIES / "soil-tests" / data).read_bytes())
            result = bt.soil_test(Path(folder) / file)
        for table, digest in digests(result, tables):
            print(f'"{name}",{table},{digest}', flush=True)


if __name__ == "__main__":
    sys.exit(main())
