"""What the sampling of a default run costs against rows, free parameters, groups, ensembles and cores."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from measures import HERE
from problems import NAMES, TRUTH, Problem, simulated_study

import bayesterra as bt
from bayesterra.arrays import FloatArray
from bayesterra.likelihood.joint import joint_posterior
from bayesterra.models import M1
from bayesterra.report.figures import POSTERIOR, new_figure, styled
from bayesterra.sampling import joint, sampler

sys.path.append(str(HERE.parents[1] / "support"))

from paper_wheels import MEAN_COHESION, SOILS, WHEELS

SLIPS = (4, 8, 16, 64, 1000)
ENSEMBLES = (8, 16)
FREE = {2: ("n0", "phi"), 4: ("n0", "n1", "phi", "K"), 6: ("Ks", "n0", "n1", "c", "phi", "K")}
GROUPS = (2, 4, 8)
OF_EIGHT = {35: ("K", "n0", "n1"), 62: ("K", "n0", "n1", "Ks", "c1", "c2")}
"""Parameters of eight wheels by their number, and which of them differ from wheel to wheel."""
MOST = {62: 1200}
"""Sweeps that are kept at most, by the number of parameters: fifty autocorrelation times would take some 6000."""
GROUP_SLIPS = np.array([0.05, 0.15, 0.3, 0.45, 0.6])
SD = {"sinkage": 0.0005, "drawbar_pull": 1.0, "resistance_moment": 0.3}
ESTIMATED = {
    name: {"estimate": {"dist": "halfnorm", "scale": scale}}
    for name, scale in {"sinkage": "1 mm", "drawbar_pull": "1 N", "resistance_moment": "0.3 N m"}.items()
}
VARIED = ("rows", "free parameters", "groups", "parameters of 8 groups", "ensembles", "cores")


def slips(rows: int) -> FloatArray:
    """Slips from 0.05 to 0.6."""
    return np.linspace(0.05, 0.6, rows)


def held(free: tuple[str, ...]) -> dict[str, object]:
    """Priors with all other parameters held at the truth."""
    return {"set": "paper-box", **{name: TRUTH[name] for name in NAMES if name not in free}}


def of_groups(count: int, varying: tuple[str, ...] = ("K",)) -> bt.Study:
    """So many wheels on one soil, five slips each under 80 N: c and φ shared, others of one population each, M1."""
    kinds, frames, wheels = list(WHEELS), [], {}
    for number in range(count):
        kind, name = kinds[number % len(kinds)], f"W{number + 1}"
        soil, rng = bt.Soil(**{**SOILS[kind], **MEAN_COHESION}), np.random.default_rng(number)
        z = np.asarray(M1().sinkage(soil, WHEELS[kind], GROUP_SLIPS, 80.0))
        forces = M1().forces(soil, WHEELS[kind], GROUP_SLIPS, z)
        exact = {"sinkage": z, "drawbar_pull": forces.drawbar_pull, "resistance_moment": forces.resistance_moment}
        read = {of: values + SD[of] * rng.standard_normal(len(values)) for of, values in exact.items()}
        units = {"sinkage": "m", "drawbar_pull": "N", "resistance_moment": "N m"}
        columns: dict[str, Any] = {f"{of} [{units[of]}]": values for of, values in read.items()}
        frames.append(pd.DataFrame({"wheel": name, "slip": GROUP_SLIPS, "load [N]": 80.0, **columns}))
        wheels[name] = WHEELS[kind]
    return bt.Study(
        pd.concat(frames, ignore_index=True), wheels, model="M1", slip_reference="shearing", kind="simulated",
        source="studies/benchmarks/samplers/cost.py", noise=SD, priors={"set": "paper-box"},
        pooling={"shared": ["c", "phi"], "hierarchical": {name: {} for name in varying}},
    )  # fmt: skip


@dataclass(frozen=True)
class Cost:
    """One row of the table: what varies, its value, the study and how it is sampled."""

    varied: str
    value: int
    study: Callable[[], bt.Study]
    ensembles: int = 4
    cores: int | None = None
    most: int | None = None  # sweeps at most, where a run to the end takes too long

    def measure(self) -> dict[str, object]:
        """Processor and wall seconds of the sampling, per thousand effective draws too."""
        study = self.study()
        usual = study.sampling
        options = replace(usual, ensembles=self.ensembles, max_steps=self.most or usual.max_steps)
        if study.pooling is not None:
            target = joint_posterior(study)
            run: Callable[[np.random.SeedSequence], Any] = partial(joint.sample_joint, target, options)
        else:
            run = partial(sampler.sample, Problem(study).target.posterior, options)
        cores = self.cores or sampler.usable_processors()
        with patch.object(sampler, "usable_processors", lambda: cores):
            started, wall = time.process_time(), time.perf_counter()
            found = run(np.random.SeedSequence(1))
            seconds, wall = time.process_time() - started, time.perf_counter() - wall
        return {
            "varied": self.varied,
            "value": self.value,
            "parameters": found.chains.shape[-1],
            "cpu_seconds": round(seconds, 2),
            "wall_seconds": round(wall, 2),
            "ess": round(found.diagnosis.ess),
            "ms_per_effective_draw": round(1e3 * seconds / found.diagnosis.ess, 3),
            "steps": found.diagnosis.steps,
            "converged": found.diagnosis.converged,
        }


def cases() -> list[Cost]:
    """All rows of the table."""
    plain = partial(simulated_study, "load")
    rows = [Cost("rows", n, partial(plain, slips=slips(n))) for n in SLIPS]
    free = [Cost("free parameters", n, partial(plain, priors=held(names))) for n, names in FREE.items()]
    free += [Cost("free parameters", 8, plain), Cost("free parameters", 11, partial(plain, noise=ESTIMATED))]
    groups = [Cost("groups", n, partial(of_groups, n)) for n in GROUPS]
    eight = {n: partial(of_groups, 8, names) for n, names in OF_EIGHT.items()}
    groups += [Cost("parameters of 8 groups", n, study, most=MOST.get(n)) for n, study in eight.items()]
    ensembles = [Cost("ensembles", n, plain, ensembles=n) for n in (4, *ENSEMBLES)]
    return [*rows, *free, *groups, *ensembles, *(Cost("cores", n, plain, cores=n) for n in (1, 2))]


@styled
def draw(table: pd.DataFrame) -> Figure:
    """Seconds against each of what varies: processor seconds filled, wall seconds hollow."""
    figure = new_figure(len(VARIED) * 2.3, 2.6)
    for axes, varied in zip(figure.subplots(1, len(VARIED), sharey=True), VARIED, strict=True):
        part = table[table["varied"] == varied]
        axes.plot(part["value"], part["cpu_seconds"], marker="o", color=POSTERIOR, label="processor")
        axes.plot(part["value"], part["wall_seconds"], marker="o", color=POSTERIOR, mfc="white", ls=":", label="wall")
        axes.set(xscale="log", yscale="log", xlabel=varied)
        axes.set_xticks(part["value"], [f"{value}" for value in part["value"]])
        axes.minorticks_off()
    figure.axes[0].set(ylabel="seconds of sampling")
    figure.axes[0].legend()
    return figure


def main() -> None:
    """Measure all cases that cost.csv does not hold yet, store them there, and draw them."""
    path = HERE / "cost.csv"
    rows = pd.read_csv(path).to_dict("records") if path.exists() else []
    known = {(row["varied"], row["value"]) for row in rows}
    for case in (case for case in cases() if (case.varied, case.value) not in known):
        rows.append(case.measure())
        print(rows[-1], flush=True)
        pd.DataFrame(rows).to_csv(path, index=False)
    draw(pd.read_csv(path)).savefig(HERE / "cost.png", dpi=110)
