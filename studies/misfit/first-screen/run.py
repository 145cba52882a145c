"""What the first screen says of studies with a known fault, and of sound ones.

Usage: python run.py [--runs 30] [--workers K | --scheduler ADDRESS]. Writes results.csv beside this file and
goes on where that ends; remove it to start anew.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator, SeedSequence, default_rng

from bayesterra.analysis.inference import run
from bayesterra.models import MODELS, Soil, Wheel
from bayesterra.runtime.engines import chosen, completed
from bayesterra.study.study import Study

HERE = Path(__file__).parent
sys.path.append(str(HERE.parents[1] / "support"))

from paper_wheels import WHEELS  # noqa: E402
from stored import append, done  # noqa: E402

SLIPS = (0.05, 0.1, 0.2, 0.3, 0.45, 0.6)
NOISE = {"sinkage": 1e-3, "drawbar_pull": 1.0, "resistance_moment": 0.2}
SOILS = {
    "Ks": (1.5e6, 4e6), "n0": (0.7, 1.0), "n1": (0.7, 1.4), "c": (0.0, 1000.0),
    "phi": (np.radians(25.0), np.radians(38.0)), "K": (0.008, 0.020), "c1": (0.3, 0.5), "c2": (-0.1, 0.1),
}  # fmt: skip
"""True soils are drawn flat between these, around those of Ding et al. 2015, Tables 5 and 10."""
DEEPEST = 0.060
"""True soils in which a wheel sinks deeper, m, are drawn anew."""
GRAVITY = 9.81
Change = Callable[[pd.DataFrame], pd.DataFrame]


@dataclass(frozen=True)
class Case:
    """How readings are made and what the study says of them.

    Attributes
    ----------
    truth, model : that make the readings, and that the study names.
    wheels : of the readings, by name.
    loads, repeats : N, and readings of each slip and load.
    noise : of the readings, SI; in the study times ``stated``.
    dof : of Student-t noise in both; infinite for Gaussian noise.
    stated : wheels as the study states them, where otherwise.
    change : what is done to the table.
    options : of the study.
    """

    truth: str = "M1"
    model: str = "M1"
    wheels: tuple[str, ...] = ("Wh32",)
    loads: tuple[float, ...] = (80.0,)
    repeats: int = 1
    shrunk: float = 1.0
    dof: float = np.inf
    stated: Mapping[str, Wheel] = field(default_factory=dict)
    change: Change = lambda table: table
    options: Mapping[str, Any] = field(default_factory=dict)


def halved(table: pd.DataFrame) -> pd.DataFrame:
    """Half of the pull beyond slip 0.3."""
    pull = table["drawbar_pull [N]"]
    return table.assign(**{"drawbar_pull [N]": np.where(table["slip"] > 0.31, 0.5 * pull, pull)})


def in_kilograms(table: pd.DataFrame) -> pd.DataFrame:
    """Loads weighed in kilograms under a header that says newtons."""
    return table.assign(**{"load [N]": table["load [N]"] / GRAVITY})


def as_forces(table: pd.DataFrame) -> pd.DataFrame:
    """The load as a reading of the normal force, for the drive ``both``."""
    force = table.pop("load [N]") + 2.0 * default_rng(len(table)).standard_normal(len(table))
    return table.assign(**{"normal_force [N]": force})


def rounded(table: pd.DataFrame) -> pd.DataFrame:
    """Sinkages read to whole millimetres."""
    return table.assign(**{"sinkage [m]": table["sinkage [m]"].round(3)})


ESTIMATED = {name: {"estimate": {"dist": "halfnorm", "scale": 2 * sd, "lower": 0.2 * sd}} for name, sd in NOISE.items()}
WIDE = Wheel(0.15735, 0.0825, 0.010, 30, 0.65)
LOW = Wheel(0.15735, 0.165, 0.005, 30, 0.65)
FAULTS = {
    "pull halved beyond slip 0.3": Case(change=halved),
    "loads in kilograms": Case(loads=(60.0, 100.0), change=in_kilograms),
    "wheel half as wide": Case(loads=(60.0, 100.0), stated={"Wh32": WIDE}),
    "readings of M2 under M1": Case(truth="M2", loads=(60.0, 100.0)),
    "lugs twice as high": Case(loads=(60.0, 100.0), stated={"Wh32": LOW}),
    "noise stated at a third": Case(loads=(60.0, 100.0), shrunk=1 / 3),
}
SOUND = {
    "M1, one load": Case(),
    "M1, two loads": Case(loads=(60.0, 100.0)),
    "M2": Case("M2", "M2", loads=(60.0, 100.0)),
    "M3": Case("M3", "M3", loads=(60.0, 100.0)),
    "M2, replicates": Case("M2", "M2", repeats=3),
    "M2, two wheels": Case("M2", "M2", wheels=("Wh11", "Wh32")),
    "M2, estimated noise": Case("M2", "M2", loads=(60.0, 100.0), options={"noise": ESTIMATED}),
    "M2, Student-t noise": Case("M2", "M2", loads=(60.0, 100.0), dof=4.0),
    "M2, both": Case("M2", "M2", loads=(60.0, 100.0), change=as_forces,
                     options={"drive": "both", "load_range": [30.0, 150.0]}),
    "M2, rounded sinkages": Case("M2", "M2", loads=(60.0, 100.0), change=rounded),
}  # fmt: skip
CASES = {**FAULTS, **SOUND}


def readings(case: Case, rng: Generator) -> pd.DataFrame:
    """Readings of the wheels on a soil drawn at random; slip on the shearing radius."""
    model, sunk = MODELS[case.truth](), np.inf
    while not sunk <= DEEPEST:
        soil = Soil(**{name: rng.uniform(*ends) for name, ends in SOILS.items()})
        tables = [_made(model, soil, name, case) for name in case.wheels]
        sunk = max(table["sinkage [m]"].max() for table in tables)
    table = pd.concat(tables, ignore_index=True)
    for name, column in (
        ("sinkage", "sinkage [m]"), ("drawbar_pull", "drawbar_pull [N]"),
        ("resistance_moment", "resistance_moment [N m]"),
    ):  # fmt: skip
        heavy = rng.standard_t(case.dof, len(table)) if np.isfinite(case.dof) else rng.standard_normal(len(table))
        table[column] += NOISE[name] * heavy
    return table


def _made(model: Any, soil: Soil, name: str, case: Case) -> pd.DataFrame:
    slip, load = (np.repeat(grid.ravel(), case.repeats) for grid in np.meshgrid(SLIPS, case.loads))
    sinkage = np.asarray(model.sinkage(soil, WHEELS[name], slip, load))
    forces = model.forces(soil, WHEELS[name], slip, sinkage)
    return pd.DataFrame(
        {
            "wheel": name, "slip": slip, "load [N]": load, "sinkage [m]": sinkage,
            "drawbar_pull [N]": forces.drawbar_pull, "resistance_moment [N m]": forces.resistance_moment,
        }
    )  # fmt: skip


def study(case: Case, table: pd.DataFrame) -> Study:
    """The study that a user writes who knows of no fault."""
    noise: dict[str, Any] = {name: case.shrunk * sd for name, sd in NOISE.items()}
    if np.isfinite(case.dof):
        noise = {name: {"sd": sd, "dof": case.dof} for name, sd in noise.items()}
    if case.options.get("drive") == "both":
        noise["normal_force"] = 2.0
    stated = {name: case.stated.get(name, WHEELS[name]) for name in case.wheels}
    return Study(
        case.change(table), stated,
        **{
            "model": case.model, "slip_reference": "shearing", "kind": "simulated", "noise": noise,
            "priors": {"set": "paper-box"}, "sampling": {"target_ess": 1000, "walkers": 32}, **case.options,
        },
    )  # fmt: skip


def one(job: tuple[str, int]) -> dict[str, Any]:
    """One run of a case."""
    name, number = job
    making, seed = SeedSequence(number).spawn(2)
    started = time.process_time()
    asked = study(CASES[name], readings(CASES[name], default_rng(making)))
    result = run(asked, seed=int(seed.generate_state(1)[0]))
    grades = {verdict.name.lower(): verdict.grade for verdict in result.verdicts}
    figures = {key: value for verdict in result.verdicts[1:3] for key, value in verdict.figures.items()}
    strict = 3 if not result.converged else 4 if "bad" in grades.values() else 0
    return {
        "case": name, "run": number, **grades, "overall": figures.get("overall"), "few": figures.get("few"),
        "warnings": len(asked.warnings), "exit": strict, "sentence": result.sentence,
        "seconds": round(time.process_time() - started, 1),
    }  # fmt: skip


def table_of(results: pd.DataFrame) -> pd.DataFrame:
    """Runs of every case in which each verdict is doubtful or bad, and those that warn or end with 4."""
    rows = {}
    for name, own in results.groupby("case"):
        graded = {
            f"{verdict} {grade}": int((own[verdict] == grade).sum())
            for verdict in ("fit", "prediction", "soil") for grade in ("doubtful", "bad")
        }  # fmt: skip
        any_ = own[["fit", "prediction", "soil"]]
        rows[name] = {
            "runs": len(own), **graded, "bad": int((any_ == "bad").any(axis=1).sum()),
            "doubtful or bad": int(any_.isin(["doubtful", "bad"]).any(axis=1).sum()),
            "warned": int((own["warnings"] > 0).sum()), "exit 4": int((own["exit"] == 4).sum()),
            "not converged": int((own["sampling"] == "bad").sum()),
        }  # fmt: skip
    return pd.DataFrame(rows).T.reindex([name for name in CASES if name in rows])


def main() -> None:
    """Make the runs that results.csv does not hold yet, one line each as it ends, and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=30, help="of each case")
    parser.add_argument("--workers", type=int, help="processes; by default one per processor")
    parser.add_argument("--scheduler", help="address of a Dask scheduler, whose workers compute")
    given = parser.parse_args()
    file = HERE / "results.csv"
    made = done(file, "case", "run")
    jobs = [(name, number) for number in range(given.runs) for name in CASES]
    with chosen(given.workers, given.scheduler) as engine:
        for _, row in completed(one, [job for job in jobs if job not in made], engine):
            append(file, pd.DataFrame([row]))
    table = table_of(pd.read_csv(file))
    print(table.to_string())
    print(f"sound: {table.loc[[n for n in SOUND if n in table.index]].sum().to_dict()}")


if __name__ == "__main__":
    main()
