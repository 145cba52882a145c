"""What ``identify`` says of six problems whose verdicts are known beforehand.

Usage: python run.py [SEEDS] (default: 20 noises of each). Writes verdicts.csv and combinations.csv beside
this file and goes on where they end; remove them to start anew.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

import bayesterra as bt
from bayesterra.identifiability.analysis import Identified, identify
from bayesterra.identifiability.verdicts import (
    COUPLED_TO_ALL,
    DETERMINED,
    EXCLUDED,
    STRUCTURAL,
    WEAK,
    Evidence,
    evidence,
    word,
)
from bayesterra.parameters import PARAMETERS
from bayesterra.stats.laws import Law
from bayesterra.study.result import COUPLED

HERE = Path(__file__).parent
sys.path.append(str(HERE.parents[1] / "support"))

from paper_wheels import ABOUT_WH32, WHEELS  # noqa: E402
from stored import append, done  # noqa: E402

SOIL = {**ABOUT_WH32, "c3": 0.0}
LOAD = 80.0
NOISE = {"sinkage": 0.5e-3, "drawbar_pull": 0.5, "resistance_moment": 0.1}
"""SI; a third to a half of what is assumed for the digitised readings of ``studies/hit-wh32``."""
KNOWN, COUPLED_WORD = "determined", "coupled"


def flat(low: float, high: float) -> Law:
    """A uniform law."""
    return Law("uniform", lower=low, upper=high)


N0, N1, PHI, K = flat(0.0, 2.0), flat(0.0, 2.0), flat(0.0, float(np.radians(50.0))), flat(0.002, 0.050)
"""Flat priors on the bounds of the paper."""


@dataclass(frozen=True)
class Problem:
    """A design, and the words that are right for it.

    Attributes
    ----------
    priors : laws of the free parameters; all others are held at the truth.
    words : the right verdict by parameter.
    open : inside these parameters lies the one combination that is not determined; two of them are joined
        in one that is. Empty if the data determine everything, None if no right answer is known.
    truth : what differs from ``SOIL``.
    slips : of the readings.
    unseen : what the structural analysis has to say, if anything.
    """

    priors: Mapping[str, Law]
    words: Mapping[str, str]
    open: frozenset[str] | None = frozenset()
    truth: Mapping[str, float] = field(default_factory=dict)
    slips: tuple[float, ...] = (0.05, 0.1, 0.2, 0.3, 0.4, 0.6)
    unseen: str = ""


PROBLEMS = {
    "all determined": Problem(
        {"n0": N0, "n1": N1, "phi": PHI, "K": K, "c1": flat(-1.0, 1.0)},
        dict.fromkeys(("n0", "n1", "phi", "K", "c1"), KNOWN),
    ),
    "c flat": Problem(
        {"n0": N0, "n1": N1, "c": flat(0.0, 30.0), "phi": PHI, "K": K},
        {**dict.fromkeys(("n0", "n1", "phi", "K"), KNOWN), "c": "repeats its prior"},
        open=frozenset({"c"}),
        truth={"c": 15.0},
    ),
    "K_s-n0 ridge": Problem(
        {"Ks": Law("loguniform", lower=5e5, upper=12.5e6), "n0": flat(0.4, 1.3), "phi": PHI, "K": K},
        {"Ks": COUPLED_WORD, "n0": COUPLED_WORD, "phi": KNOWN, "K": KNOWN},
        open=frozenset({"Ks", "n0"}),
        slips=(0.1, 0.15, 0.2, 0.25),
    ),
    "c1-c2 ridge": Problem(
        {"n0": N0, "phi": PHI, "c1": flat(-1.0, 1.0), "c2": flat(-1.0, 1.0)},
        {"n0": KNOWN, "phi": KNOWN, "c1": COUPLED_WORD, "c2": COUPLED_WORD},
        open=frozenset({"c1", "c2"}),
        slips=(0.29, 0.295, 0.305, 0.31),
    ),
    "only a sum": Problem(
        {"kc": flat(0.0, 2e5), "kphi": flat(0.0, 1.2e6), "n1": N1, "phi": PHI, "K": K},
        {"kc": STRUCTURAL, "kphi": STRUCTURAL, "n1": KNOWN, "phi": KNOWN, "K": KNOWN},
        open=frozenset({"kc", "kphi"}),
        truth={"kc": 1e5, "kphi": 0.6e6},
        slips=(0.05, 0.1, 0.2, 0.3, 0.4),
        unseen="only k_c + 0.165 k_φ is determined",
    ),
    "one-sided": Problem(
        {"Ks": flat(0.1e6, 2.5e6), "phi": PHI, "K": K},
        {"Ks": "one-sided", "phi": KNOWN, "K": KNOWN},
        open=None,
        truth={"Ks": 2.9e6},
    ),
}
"""The problems that are clear whatever the noise."""
PLATEAU = {
    "one-sided by a plateau": Problem(
        {"n0": N0, "n1": N1, "phi": PHI, "K": flat(0.5e-3, 10e-3)},
        {"n0": KNOWN, "n1": KNOWN, "phi": KNOWN, "K": "one-sided"},
        open=frozenset({"K"}),
        truth={"K": 1e-3},
        slips=(0.4, 0.5, 0.6, 0.7),
    )
}
"""Readings that cannot tell a small K from none: one noise in forty makes them seem to."""
EVERY = {**PROBLEMS, **PLATEAU}


def study(problem: Problem, seed: int) -> bt.Study:
    """The problem with readings simulated by M2, whose noise is that of ``seed``."""
    held = {name: value for name, value in SOIL.items() if name != "Ks" or "kc" not in problem.truth}
    soil = {**held, **problem.truth}
    readings = {"sinkage [m]": 0.01, "drawbar_pull [N]": 0.0, "resistance_moment [N m]": 0.0}
    blank = pd.DataFrame({"slip": problem.slips}).assign(**{"load [N]": LOAD}, **readings)
    tables = {
        "kind": "simulated",
        "source": "studies/identifiability/verdicts/run.py",
        "slip_reference": "shearing",
        "model": "M2",
        "noise": NOISE,
        "priors": {**soil, **problem.priors},
        "truth": soil,
        "sampling": {"target_ess": 1000, "walkers": 32},
    }
    made = bt.simulate(bt.Study(blank, {"Wh32": WHEELS["Wh32"]}, **tables), seed=seed)
    return bt.Study(made, {"Wh32": WHEELS["Wh32"]}, **tables)


def margin(found: Evidence) -> float:
    """Smallest change of one figure that changes the word; the two measures of coupling count as one."""
    return min(_distances(found, word(found)), default=np.inf)


def _distances(found: Evidence, verdict: str) -> Iterator[float]:
    thresholds = {"contraction": (DETERMINED, WEAK), "given_others": (WEAK,), "excluded": (EXCLUDED,)}
    for name, values in thresholds.items():
        for value in values:
            beside = [replace(found, **{name: value + step}) for step in (-1e-9, 1e-9)]
            if any(word(other) != verdict for other in beside):
                yield abs(getattr(found, name) - value)
    strength = abs(found.tie) - COUPLED, found.multiple - COUPLED_TO_ALL
    if word(replace(found, tie=float(max(strength) < 0), multiple=0.0)) != verdict:
        yield abs(max(strength))


def parameters(problem: Problem, made: Identified) -> pd.DataFrame:
    """One row per parameter: the words, right and found, the figures behind them, and the margin."""
    table = made.found.verdicts
    chosen = ["contraction", "tie", "multiple", "given_others", "bound", "profile", "excluded", "against"]
    rises = np.array([made.found.profiles.profile(name).rise[[0, -1]] for name in table["parameter"]])
    rows = table[["parameter", "verdict", *chosen]].assign(
        rise_low=rises[:, 0], rise_high=rises[:, 1], margin=[margin(each) for each in evidence(table)]
    )
    rows.insert(1, "expected", [problem.words[name] for name in rows["parameter"]])
    return rows


def combinations(problem: Problem, made: Identified) -> pd.DataFrame:
    """One row: what is left open, the contractions on both sides of the threshold, and what is unseen."""
    table = made.found.combinations
    unseen = table["contraction"].isna()
    known = table["verdict"] == KNOWN
    left = table[~known & ~unseen]
    row = {
        "open": "; ".join(left["combination"]),
        "right": _right(problem, table),
        "least_determined": table.loc[known, "contraction"].min(),
        "most_open": left["contraction"].max(),
        "unseen": "; ".join(table.loc[unseen, "combination"]),
        "weakest_seen": made.found.structure.least_seen,
        "strongest_unseen": made.found.structure.most_unseen,
        "converged": made.record["converged"],
        "seconds": sum(made.record["seconds"].values()),
    }
    return pd.DataFrame([row])


def _right(problem: Problem, table: pd.DataFrame) -> bool:
    """One combination inside ``open`` is not determined, one that joins it is, and the rest is known."""
    if problem.open is None:
        return True
    unseen = table["contraction"].isna()
    nulls = table.loc[unseen, "combination"].tolist()
    known, left = (
        [_parameters_in(text) for text in table.loc[~unseen & chosen, "combination"]]
        for chosen in (table["verdict"] == KNOWN, table["verdict"] != KNOWN)
    )
    one_left = len(left) == bool(problem.open) and all(parts <= problem.open for parts in left)
    joined = len(problem.open) < 2 or any(problem.open <= parts for parts in known)
    as_said = len(nulls) == bool(problem.unseen) and all(text.startswith(problem.unseen) for text in nulls)
    return one_left and joined and as_said


def _parameters_in(text: str) -> frozenset[str]:
    """Such as ``n0 − 0.7 K_s``."""
    return frozenset(name for name, one in PARAMETERS.items() if one.symbol in text.split())


def one(name: str, seed: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Rows of both tables for a problem and a seed."""
    problem = EVERY[name]
    made = identify(study(problem, seed), seed=seed)
    head = {"problem": name, "seed": seed}
    first, second = (
        pd.DataFrame(head, index=rows.index).join(rows)
        for rows in (parameters(problem, made), combinations(problem, made))
    )
    return first, second


def overview(found: pd.DataFrame, combined: pd.DataFrame) -> pd.DataFrame:
    """By problem: runs, runs in which every word is right, and the smallest margins."""
    right = (found["verdict"] == found["expected"]).groupby([found["problem"], found["seed"]]).all()
    by = combined.groupby("problem")
    return pd.DataFrame(
        {
            "runs": right.groupby("problem").size(),
            "words_right": right.groupby("problem").sum(),
            "combinations_right": by["right"].sum(),
            "margin": found.groupby("problem")["margin"].min(),
            "least_determined": by["least_determined"].min(),
            "most_open": by["most_open"].max(),
            "converged": by["converged"].sum(),
            "objections": found["against"].notna().groupby(found["problem"]).sum(),
        }
    ).loc[[name for name in EVERY if name in set(found["problem"])]]


def main(seeds: int = 20) -> None:
    """Make the runs that the tables do not hold yet and print the overview."""
    files = HERE / "verdicts.csv", HERE / "combinations.csv"
    made = done(files[1], "problem", "seed")
    for seed in range(1, seeds + 1):
        for name in EVERY:
            if (name, seed) in made:
                continue
            for file, rows in zip(files, one(name, seed), strict=True):
                append(file, rows)
    print(overview(*(pd.read_csv(file) for file in files)).to_string())


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:]))
