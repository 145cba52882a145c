"""How often the predictive checks find a planted misfit, and how often they cry wolf.

Usage: python run.py [--runs 50] [--workers K | --scheduler ADDRESS]. Writes results.csv beside this file and
goes on where that ends; remove it to start anew.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator, SeedSequence, default_rng

from bayesterra.arrays import FloatArray
from bayesterra.checking.predictive_checks import DOUBT, predictive_checks
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior, posterior
from bayesterra.models import M1, Soil, Wheel
from bayesterra.runtime.engines import chosen, completed
from bayesterra.sampling.adaptation import AdaptationOptions, adapt
from bayesterra.sampling.coordinates import coordinates
from bayesterra.sampling.sampler import Target
from bayesterra.stats.mixture import normalised, systematic
from bayesterra.study.study import Study

HERE = Path(__file__).parent
sys.path.append(str(HERE.parents[1] / "support"))

from paper_wheels import WHEELS  # noqa: E402
from stored import append, done  # noqa: E402

WHEEL = WHEELS["Wh11"]
SMOOTH = Wheel(0.135, 0.165)
SLIPS = (0.0, 0.1, 0.2, 0.3, 0.45, 0.6)
LOADS = (40.0, 80.0, 120.0)
NOISE = {"sinkage": 1e-3, "drawbar_pull": 1.0, "resistance_moment": 0.2}
SOILS = {
    "Ks": (1.5e6, 4e6),
    "n0": (0.7, 1.0),
    "n1": (0.7, 1.4),
    "c": (0.0, 1000.0),
    "phi": (np.radians(25.0), np.radians(38.0)),
    "K": (0.008, 0.020),
    "c1": (0.3, 0.5),
    "c2": (-0.1, 0.1),
}
"""True soils are drawn flat between these, around those of Ding et al. 2015, Tables 5 and 10."""
DEEPEST = 0.060
"""True soils in which the wheel sinks deeper, m, are drawn anew."""


@dataclass(frozen=True)
class Case:
    """What is done to the readings or to the study.

    Attributes
    ----------
    shift : added to readings, SI, by column.
    wheel : the wheel that the study states.
    options : model options of the study.
    """

    shift: dict[str, float] = field(default_factory=dict)
    wheel: Wheel = WHEEL
    options: dict[str, Any] = field(default_factory=dict)


CASES = {
    "nothing": Case(),
    "exponent held constant": Case(options={"constant_exponent": True}),
    "lugs ignored": Case(wheel=SMOOTH),
    "pull offset 5 N": Case(shift={"drawbar_pull [N]": 5.0}),
    "sinkage offset 15 mm": Case(shift={"sinkage [m]": 0.015}),
    "pull offset 2 N": Case(shift={"drawbar_pull [N]": 2.0}),
    "sinkage offset 5 mm": Case(shift={"sinkage [m]": 0.005}),
}


def readings(rng: Generator) -> pd.DataFrame:
    """Readings of the lugged wheel on a soil drawn at random; slip on the rim, as tachometers give it."""
    slip, load = (grid.ravel() for grid in np.meshgrid(SLIPS, LOADS))
    shearing = 1 - WHEEL.radius / float(WHEEL.shearing_radius()) * (1 - slip)
    sinkage = np.full(1, np.inf)
    while sinkage.max() > DEEPEST:
        soil = Soil(**{name: rng.uniform(*ends) for name, ends in SOILS.items()})
        sinkage = np.asarray(M1().sinkage(soil, WHEEL, shearing, load))
    forces = M1().forces(soil, WHEEL, shearing, sinkage)
    noise = {name: sd * rng.standard_normal(len(slip)) for name, sd in NOISE.items()}
    return pd.DataFrame(
        {
            "slip": slip,
            "load [N]": load,
            "sinkage [m]": sinkage + noise["sinkage"],
            "drawbar_pull [N]": forces.drawbar_pull + noise["drawbar_pull"],
            "resistance_moment [N m]": forces.resistance_moment + noise["resistance_moment"],
        }
    )


def study(case: Case, table: pd.DataFrame) -> Study:
    """The study that a user who does not know of the misfit would write."""
    shifted = table.assign(**{name: table[name] + shift for name, shift in case.shift.items()})
    return Study(
        shifted,
        {"Wheel": case.wheel},
        slip_reference="rim",
        noise=NOISE,
        priors={"set": "paper-box"},
        model_options=case.options,
    )


def posterior_draws(density: Posterior, rng: Generator) -> FloatArray:
    """Draws (2000, d): one tempered run from the prior, then importance resampling from its proposal."""
    target = Target(density, coordinates(density))
    plan = AdaptationOptions(particles=512, components=8, refinements=(4, 4, 8))
    start = target.coordinates.from_physical(draw_cut_prior(density, plan.particles, rng).x)
    proposal = adapt(target.densities, start, plan, rng).proposal
    u = proposal.sample(4096, rng)
    weights = normalised(target.log_density(u) - proposal.log_density(u))
    return target.coordinates.to_physical(u[systematic(weights, 2000, rng)])[0]


def one(job: tuple[str, int]) -> dict[str, Any]:
    """One run of a case: the same number has the same soil and the same noise in every case."""
    name, number = job
    making, sampling, judging = SeedSequence(number).spawn(3)
    density = posterior(study(CASES[name], readings(default_rng(making))))
    found = predictive_checks(density, posterior_draws(density, default_rng(sampling)), judging)
    strangest = asdict(found.checks[0])
    return {"case": name, "run": number, "overall_p": found.overall, "alarm": int(found.overall < DOUBT), **strangest}


def main() -> None:
    """Make the runs that results.csv does not hold yet, one line each as it ends, and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=50, help="of each case")
    parser.add_argument("--workers", type=int, help="processes; by default one per processor")
    parser.add_argument("--scheduler", help="address of a Dask scheduler, whose workers compute")
    given = parser.parse_args()
    file = HERE / "results.csv"
    made = done(file, "case", "run")
    jobs = [(name, number) for number in range(given.runs) for name in CASES]
    with chosen(given.workers, given.scheduler) as engine:
        for _, row in completed(one, [job for job in jobs if job not in made], engine):
            append(file, pd.DataFrame([row]))
    table = pd.read_csv(file)
    counts = table.groupby("case")["alarm"].agg(["size", "sum", "mean"]).loc[list(CASES)]
    print(f"alarm: overall p below {DOUBT:g}\n{counts.to_string()}")


if __name__ == "__main__":
    main()
