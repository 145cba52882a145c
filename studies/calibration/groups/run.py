"""Calibration of a hierarchical posterior of three wheels: ranks of known values among its draws.

``python studies/calibration/groups/run.py -n 200`` adds replications to ``ranks.csv`` as they end until it
holds 200, so that it can be stopped at any time and goes on where it was; then it rewrites ``tests.csv``.
``--workers K`` and ``--scheduler ADDRESS`` say who computes; the ranks are the same.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator, SeedSequence, default_rng

import bayesterra as bt
from bayesterra.arrays import FloatArray
from bayesterra.checking.calibration import spaced
from bayesterra.checking.ranks import CONVERGED, UNCONVERGED, Calibration, normalised_rank
from bayesterra.likelihood.joint import JointPosterior, draw_joint_prior, joint_posterior
from bayesterra.runtime.engines import chosen, completed
from bayesterra.runtime.folders import write_text
from bayesterra.runtime.tables import csv_text
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.sampling.joint import JointSamples, PoolingOptions, sample_joint
from bayesterra.sampling.sampler import thin
from bayesterra.stats.diagnostics import R_HAT_LIMIT, Diagnosis
from bayesterra.study.schema import SamplingOptions

HERE = Path(__file__).parent
sys.path.append(str(HERE.parents[1] / "support"))

from paper_wheels import WHEELS as PAPER_WHEELS  # noqa: E402

SEED = 7
WHEELS = {name: PAPER_WHEELS[name] for name in ("Wh11", "Wh22", "Wh32")}
SLIPS = (0.05, 0.15, 0.3, 0.45, 0.6)
ENOUGH = 400
"""Effective draws of a fit."""


@dataclass(frozen=True)
class Sizes:
    """Options of a small fit: two ensembles are fewer than a user may ask for, and enough for ranks."""

    target_ess: float = ENOUGH
    ensembles: int = 2
    walkers: int = 32
    max_steps: int = 80


FITS = (Sizes(), Sizes(max_steps=400))
"""A fit, and a longer one where that was not enough."""
SMALL = PoolingOptions(
    (15, 30, 60), AdaptationOptions(particles=256, components=6, refinements=(4, 4), more=(), shores=4)
)
LONG_FITS = SamplingOptions(target_ess=ENOUGH, walkers=64, max_steps=4000)
"""A last one, with the usual adaptation."""


def conditions() -> bt.Study:
    """The study that is simulated: c and φ shared, K from a population, n0, c1 and c2 of each wheel."""
    rows = [{"wheel": name, "slip": slip, "load [N]": 80.0} for name in WHEELS for slip in SLIPS]
    readings = {"sinkage [mm]": 10.0, "drawbar_pull [N]": 0.0, "resistance_moment [N m]": 0.0}
    return bt.Study(
        pd.DataFrame(rows).assign(**readings),
        WHEELS,
        slip_reference="shearing",
        kind="simulated",
        title="Three wheels, calibration",
        model="M2",
        noise={"sinkage": 0.001, "drawbar_pull": 1.5, "resistance_moment": 0.3},
        priors={"Ks": 2.5e6, "n1": 1.0},
        pooling={
            "by": "wheel",
            "shared": ["c", "phi"],
            "separate": ["n0", "c1", "c2"],
            "hierarchical": {"K": {"spread": {"dist": "halfnorm", "scale": 0.005}}},
        },
    )


def replicated(study: bt.Study, rng: Generator) -> tuple[FloatArray, JointPosterior]:
    """True values (1, d) from the cut joint prior, and the joint posterior of readings that they make."""
    joint = joint_posterior(study)
    truth = draw_joint_prior(joint, 1, rng, batch=512, most=100_000)
    D, L = joint.split(truth)
    values = {name: column.copy() for name, column in study.observations.values.items()}
    for own, posterior in zip(L, joint.groups.values(), strict=True):
        likelihood = posterior.likelihood
        x = joint.of_group(D, own)
        outcomes = likelihood.forward(posterior.prior.soil_values(x))
        drawn = likelihood.draw(outcomes, posterior.noise_values(x), rng)[0]
        rows = np.isin(study.observations.rows, likelihood.observations.rows)
        for i, name in enumerate(likelihood.channels):
            values[name][rows] = drawn[:, i]
    return truth, joint_posterior(study.with_data(values))


def sufficient(found: Diagnosis) -> bool:
    """Whether a fit has converged, and has draws enough to rank among."""
    return found.ess >= ENOUGH and found.worst_r_hat < R_HAT_LIMIT


def fitted(joint: JointPosterior, seed: SeedSequence, last: SeedSequence) -> JointSamples:
    """Sample a joint posterior, longer where need be."""
    for sizes, stream in zip(FITS, (seed, *seed.spawn(len(FITS) - 1)), strict=True):
        samples = sample_joint(joint, sizes, stream, plan=SMALL)
        if sufficient(samples.diagnosis):
            return samples
    return sample_joint(joint, LONG_FITS, last)


def replication(study: bt.Study, number: int) -> dict[str, Any]:
    """One row of the table: ranks of all parameters and of the log density."""
    started = time.process_time()
    making, fitting, again, ranking = SeedSequence(SEED, spawn_key=(number,)).spawn(4)
    truth, joint = replicated(study, default_rng(making))
    samples = fitted(joint, fitting, again)
    found = samples.diagnosis
    good = sufficient(found)
    rng = default_rng(ranking)
    both = np.concatenate([truth, spaced(thin(samples.chains).flat, rng)])
    columns = dict(zip(joint.names, both.T, strict=True)) | {"log_density": joint.log_density(both)}
    return {
        "task": number,
        "status": CONVERGED if good else UNCONVERGED,
        "ess": found.ess,
        "r_hat": found.worst_r_hat,
        "seconds": time.process_time() - started,
        "note": "",
        **{name: normalised_rank(values[0], values[1:], rng) for name, values in columns.items()},
    }


def main() -> None:
    """Add replications and judge them all."""
    parser = argparse.ArgumentParser()
    parser.add_argument("-n", type=int, default=200, help="number of the last replication")
    parser.add_argument("--out", type=Path, default=HERE / "ranks.csv")
    parser.add_argument("--workers", type=int, help="processes; by default one per processor")
    parser.add_argument("--scheduler", help="address of a Dask scheduler, whose workers compute")
    given = parser.parse_args()
    study = conditions()
    table = pd.read_csv(given.out) if given.out.is_file() else pd.DataFrame({"task": []})
    numbers = [number for number in range(1, given.n + 1) if number not in set(table["task"])]
    with chosen(given.workers, given.scheduler) as engine:
        for _, row in completed(partial(replication, study), numbers, engine):
            table = pd.concat([table, pd.DataFrame([row])] if len(table) else [pd.DataFrame([row])])
            write_text(given.out, csv_text(table.sort_values("task"), "%.6g"))
    made = Calibration(study, table.sort_values("task").assign(note=""), {})
    made.tests.to_csv(given.out.with_name("tests.csv"), index=False, float_format="%.4g")
    print(made.tests.to_string(index=False))


if __name__ == "__main__":
    main()
