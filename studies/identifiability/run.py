"""How many directions of each parameter group wheel tests determine, beside what the source paper says.

Usage: python run.py [SEEDS] (default: 1 noise of each simulated case). Writes groups.csv, directions.csv and
verdicts.csv beside this file, goes on where they end (remove them to start anew), and draws directions.png.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

import bayesterra as bt
from bayesterra.identifiability.analysis import Identified, identify
from bayesterra.identifiability.verdicts import DETERMINED
from bayesterra.parameters import PARAMETERS
from bayesterra.stats.laws import Law

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "support"))

from cloning import cloned_words, cloning_objection  # noqa: E402
from paper_wheels import SOILS, WHEELS  # noqa: E402
from stored import append, done  # noqa: E402

SLIPS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.6)
LOAD = 80.0
NOISE = {"sinkage": 1e-3, "drawbar_pull": 1.5, "resistance_moment": 0.3}
"""SI; what ``studies/hit-wh32`` assumes for the digitised readings."""
C3 = Law("uniform", lower=-0.5, upper=0.5)
"""Prior of c3 where it is free; the paper varies it by 0.2 about 0 (Ding et al. 2015, Table 8)."""
GROUPS = {"P_I": "K_s, n0, n1", "P_II": "c, φ, K", "P_III": "c1, c2 (c3)"}


@dataclass(frozen=True)
class Case:
    """Simulated readings of a wheel and what is free.

    Attributes
    ----------
    wheel : name of the wheel, and of its soil.
    free_c3 : whether c3 is free; else it is held at 0.
    noise : all noise in units of ``NOISE``.
    true_c3 : the value that the readings are made with.
    """

    wheel: str
    free_c3: bool = False
    noise: float = 1.0
    true_c3: float = 0.0


CASES = {
    **{wheel: Case(wheel) for wheel in SOILS},
    **{f"{wheel}, c3 free": Case(wheel, free_c3=True) for wheel in SOILS},
    "Wh32, half the noise": Case("Wh32", noise=0.5),
    "Wh32, twice the noise": Case("Wh32", noise=2.0),
    "Wh32, a tenth of the noise": Case("Wh32", noise=0.1),
    "Wh32, c3 = 0.2 held at 0": Case("Wh32", true_c3=0.2),
    "Wh32, c3 = -0.2 held at 0": Case("Wh32", true_c3=-0.2),
}
HIT = "HIT Wh32, digitised"
SHOWN = ["parameter", "unit", "verdict", "contraction", "partner", "correlation", "multiple", "given_others"]
SHOWN += ["bound", "profile", "lower_95", "upper_95", "excluded", "cloned", "against"]


def truth(case: Case) -> dict[str, float]:
    """The soil, SI."""
    values = SOILS[case.wheel]
    return {**values, "K": round(values["K"], 6), "c3": case.true_c3}  # K: the digits that are printed


def study(case: Case, seed: int) -> bt.Study:
    """Readings simulated by M1 with the noise of ``seed``, under the flat priors of the paper's bounds."""
    readings = {"sinkage [m]": 0.01, "drawbar_pull [N]": 0.0, "resistance_moment [N m]": 0.0}
    blank = pd.DataFrame({"slip": SLIPS}).assign(**{"load [N]": LOAD}, **readings)
    wheels = {case.wheel: WHEELS[case.wheel]}
    tables = {
        "title": f"Simulated: {case.wheel} on the soil of Table 10",
        "kind": "simulated",
        "source": "studies/identifiability/run.py",
        "slip_reference": "shearing",
        "noise": {name: case.noise * sd for name, sd in NOISE.items()},
        "priors": {"set": "paper-box", "c3": C3 if case.free_c3 else 0.0},
    }
    made = bt.simulate(_of_the_truth(blank, wheels, tables, case), truth(case), seed=seed)
    return bt.Study(made, wheels, **tables)


def _of_the_truth(blank: pd.DataFrame, wheels: dict[str, bt.Wheel], tables: dict[str, object], case: Case) -> bt.Study:
    """The same study with c3 as it is in truth."""
    return bt.Study(blank, wheels, **{**tables, "priors": {"set": "paper-box", "c3": case.true_c3}})


def verdicts(made: Identified, seed: int) -> pd.DataFrame:
    """Verdicts of an analysis, with the words of data cloning and what these say against a verdict."""
    words = cloned_words(made.study, seed)
    table = made.verdicts.assign(cloned=words)
    said = [cloning_objection(*each) for each in zip(table["verdict"], words, strict=True)]
    return table.assign(against=["; ".join(filter(None, each)) for each in zip(table["against"], said, strict=True)])


def tables(name: str, seed: int) -> dict[str, pd.DataFrame]:
    """Rows of every file for a case."""
    made = identify(bt.load_study(HERE.parent / "hit-wh32") if name == HIT else study(CASES[name], seed), seed=seed)
    found, information = made.found, made.found.information
    head = {"case": name, "kind": made.study.kind, "seed": seed}
    columns = ["scope", "view", "rank", "combination", "contraction", "error"]
    fit = {"converged": made.record["converged"], "log_likelihood": found.profiles.log_density["likelihood"]}
    parts = {
        "groups": information.counts.assign(**fit),
        "directions": information.directions[columns],
        "verdicts": verdicts(made, seed)[SHOWN].assign(truth=_truths(name, found.names)),
    }
    return {file: pd.DataFrame(head, index=rows.index).join(rows) for file, rows in parts.items()}


def _truths(name: str, names: tuple[str, ...]) -> list[float]:
    """True values in field units, NaN for measured readings."""
    values = {} if name == HIT else truth(CASES[name])
    return [values.get(one, np.nan) / PARAMETERS[one].scale for one in names]


def main(seeds: int = 1) -> None:
    """Make the cases that the tables do not hold yet, then draw them."""
    file = HERE / "groups.csv"
    made = done(file, "case", "seed")
    jobs = [(HIT, 1), *((name, seed) for seed in range(1, seeds + 1) for name in CASES)]
    for name, seed in (job for job in jobs if job not in made):
        for stem, rows in tables(name, seed).items():
            append(HERE / f"{stem}.csv", rows)
    print(overview(pd.read_csv(file)).to_string())
    draw(pd.read_csv(HERE / "directions.csv")).savefig(HERE / "directions.png", dpi=80)


def overview(groups: pd.DataFrame) -> pd.DataFrame:
    """Determined directions by case, group and view, one number for every noise."""
    chosen = groups[groups["scope"] != "all"]
    texts = chosen.assign(text=chosen["determined"].astype(str))
    wide = texts.groupby(["case", "scope", "view"], sort=False)["text"].agg(" ".join)
    return wide.unstack(["scope", "view"]).loc[[name for name in (HIT, *CASES) if name in set(chosen["case"])]]


def draw(directions: pd.DataFrame) -> Figure:
    """Spread left along every direction of every group, beside the threshold of ``determined``."""
    cases = [name for name in (HIT, *CASES) if name in set(directions["case"])]
    figure = Figure(figsize=(10, 0.8 + 0.24 * len(cases)), layout="constrained")
    axes = figure.subplots(1, len(GROUPS), sharex=True, sharey=True)
    for axis, (group, parameters) in zip(axes, GROUPS.items(), strict=True):
        for view, fill in (("others known", "none"), ("marginal", "C0")):
            rows = directions[(directions["scope"] == group) & (directions["view"] == view)]
            left = np.sqrt(np.clip(1.0 - rows["contraction"], 0.0, None))
            places = [cases.index(case) + (0.18 if fill == "none" else -0.18) for case in rows["case"]]
            axis.scatter(left, places, s=14, facecolors=fill, edgecolors="C0", linewidths=0.8, label=view)
        axis.axvline(np.sqrt(1.0 - DETERMINED), color="0.3", linewidth=0.8, linestyle="--")
        axis.set(xscale="log", title=f"{group}: {parameters}", xlabel="sd after / sd before, by direction")
        axis.grid(axis="y", color="0.92")
        axis.set_axisbelow(True)
    axes[0].set_yticks(range(len(cases)), [_labelled(name) for name in cases])
    axes[0].set_ylim(len(cases) - 0.4, -0.6)
    words = {"others known": "other groups known", "marginal": "other groups unknown"}
    handles, names = axes[0].get_legend_handles_labels()
    labels = [words[name] for name in names]
    figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize="small", frameon=False)
    return figure


def _labelled(name: str) -> str:
    return name if name == HIT else f"simulated {name}".replace("-", "−")


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:]))
