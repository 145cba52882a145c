"""Log Bayes factors of one value for all groups beside closed forms, and whether stated errors cover.

``python studies/calibration/groups/factors.py -n 20`` adds cases to ``factors.csv`` as they end until it
holds 20 of every true factor, and prints what is reported. ``--levels`` computes some only.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import default_rng

import bayesterra as bt
from bayesterra.pooling.degrees import Evidences, Level, judged_alone
from bayesterra.runtime.folders import write_text
from bayesterra.runtime.tables import csv_text
from bayesterra.study.groups import Pooling

HERE = Path(__file__).parent
sys.path.append(str(HERE.parents[1] / "support"))

from scripts import loaded  # noqa: E402

FORMS = HERE.parents[2] / "tests" / "pooling" / "gaussian.py"
"""The closed forms that the tests hold evidences against."""
SEED = 7
LEVELS = {-30: (3, 4000, 0.05), -6: (4, 400, 0.2), -3: (2, 1000, 0.1), 2: (12, 4000, 0.05)}
"""Groups, draws of each group's posterior and error of its reading, by true log Bayes factor."""
WHEEL = bt.Wheel(0.135, 0.165, 0.015, 24, shearing_radius_coefficient=0.75)
HELD = {"Ks": 2.5e6, "c": 268.0, "phi": 0.5, "K": 0.01, "c1": 0.339, "c2": -0.017}
STANDARD = {"dist": "norm", "loc": 0.0, "scale": 1.0}


def conditions() -> bt.Study:
    """A study of n0 and n1 of two wheels; its readings are replaced by conjugate ones."""
    rows = [{"wheel": name, "slip": slip, "load [N]": 80.0} for name in "ab" for slip in (0.1, 0.5)]
    return bt.Study(
        pd.DataFrame(rows).assign(**{"drawbar_pull [N]": 20.0}),
        {"a": WHEEL, "b": WHEEL},
        slip_reference="shearing",
        kind="simulated",
        model="M2",
        noise={"drawbar_pull": 1.0},
        priors={**HELD, "n0": STANDARD, "n1": STANDARD},
        pooling={"by": "wheel", "shared": ["n1"], "separate": ["n0"]},
    )


def replication(study: bt.Study, forms: ModuleType, level: int, number: int) -> dict[str, Any]:
    """One row of the table: groups with this true factor, and the one reported."""
    groups, draws, sd = LEVELS[level]
    rng, case = default_rng((SEED, level + 100, number)), None
    while case is None:
        try:
            case = forms.gaussian(groups, sd, rng).spread_to(float(level))
        except ValueError:  # these groups could not agree so well, others can
            continue
    joint = case.joint(study, Pooling("wheel", ("n1",), ("n0",)))
    own = Level(case.own, 0.0, True)
    found = judged_alone(Evidences(joint, case.chains(4, draws, rng), rng, own, own, own), ["n0"])
    return {
        "level": level,
        "number": number,
        "true": case.log_factor,
        "reported": found.log_factor,
        "error": found.error,
        "reliable": found.reliable,
        "common_off": found.common.log_z - case.common,
        "common_error": found.common.error,
        "population_off": found.population.log_z - case.population,
        "population_error": found.population.error,
    }


def judged(table: pd.DataFrame) -> pd.DataFrame:
    """One row per true factor: mean reported, rms of errors in stated ones, and how many lie within two.

    Also of the evidences of one value and of a population by themselves.
    """
    z = (table["reported"] - table["true"]) / table["error"]
    parts = {n: (table[f"{n}_off"] / table[f"{n}_error"]).abs() <= 2.0 for n in ("common", "population")}
    by = table.assign(squared=z**2, within=z.abs() <= 2.0, **parts).groupby("level")
    return pd.DataFrame(
        {
            "true": by["true"].mean(),
            "mean_reported": by["reported"].mean(),
            "mean_error": by["error"].mean(),
            "rms_over_error": np.sqrt(by["squared"].mean()),
            "within_two": by["within"].sum(),
            "common_within_two": by["common"].sum(),
            "population_within_two": by["population"].sum(),
            "of": by.size(),
            "reliable": by["reliable"].sum(),
        }
    ).reset_index(drop=True)


def main() -> None:
    """Add replications and print what they say."""
    parser = argparse.ArgumentParser()
    parser.add_argument("-n", type=int, default=20, help="replications of every true factor")
    parser.add_argument("--levels", type=int, nargs="*", default=list(LEVELS), choices=list(LEVELS))
    parser.add_argument("--out", type=Path, default=HERE / "factors.csv")
    given = parser.parse_args()
    study, forms = conditions(), loaded(FORMS)
    table = pd.read_csv(given.out) if given.out.is_file() else pd.DataFrame({"level": [], "number": []})
    done = set(zip(table["level"], table["number"], strict=True))
    for level in given.levels:
        for number in (i for i in range(1, given.n + 1) if (level, i) not in done):
            row = pd.DataFrame([replication(study, forms, level, number)])
            table = pd.concat([table, row], ignore_index=True) if len(table) else row
            write_text(given.out, csv_text(table.sort_values(["level", "number"]), "%.6g"))
    print(judged(table).to_string(index=False, float_format="%.3f"))


if __name__ == "__main__":
    main()
