"""Yesterday's posterior as today's prior: the stored study, and its figures by weighing."""

from collections.abc import Callable
from copy import copy
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray
from bayesterra.study.priors import Prior
from bayesterra.study.study import load_study

STUDY = Path(__file__).parents[2] / "studies" / "streaming" / "sequential"
SHIFTS = ["shift05", "shift25", "shift50", "shift75", "shift95"]


def stored(way: str) -> pd.DataFrame:
    """Shifts (d, levels) of a way from the posterior of all rows, in sd."""
    table = pd.read_csv(STUDY / "quantiles-planetary.csv")
    return table.loc[table["way"] == way, SHIFTS]


def typical(shifts: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(shifts**2)))


def test_weighing_finds_the_stored_shifts_and_needs_the_correlations(study_script: Callable[[str], ModuleType]) -> None:
    """Draws of all rows, weighed by the joint prior over the first half, move as sampling moved them.

    Without correlations the same laws move them far more.
    """
    script, second = study_script("streaming/sequential"), load_study(STUDY / "second-half")
    draws = np.load(STUDY / "all-rows.npz")["draws"].astype(np.float64)
    joint = script.weighed(second, draws).T
    assert typical(joint - stored("joint prior").to_numpy()) < 0.12
    assert typical(joint) < 0.15
    alone = copy(second)
    object.__setattr__(alone, "prior", Prior(second.prior.entries, second.prior.width))
    assert typical(script.weighed(alone, draws)) > 0.25


def test_the_stored_study_holds() -> None:
    """All converged; correlations halve the error, and the evidence in two steps is nearer that in one."""
    ways = pd.read_csv(STUDY / "ways-planetary.csv").set_index("way")
    assert ways["converged"].all()
    joint, alone, whole = (ways.loc[way] for way in ("joint prior", "independent prior", "all rows"))
    assert joint["largest_median_shift"] < 0.15
    assert joint["largest_shift"] < 0.6 * alone["largest_shift"]
    evidence = "log_evidence_of_all_rows"
    assert abs(joint[evidence] - whole[evidence]) < 0.5 * abs(alone[evidence] - whole[evidence])
