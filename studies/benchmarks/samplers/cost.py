"""What a default run costs against the number of observations, ensembles and free parameters."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pandas as pd
from measures import HERE
from problems import NAMES, TRUTH, Problem, simulated_study

import bayesterra as bt
from bayesterra.arrays import FloatArray
from bayesterra.sampling.sampler import sample

SLIPS = (4, 8, 16, 64)
ENSEMBLES = (8, 16)
FREE = {2: ("n0", "phi"), 4: ("n0", "n1", "phi", "K"), 6: ("Ks", "n0", "n1", "c", "phi", "K")}
ESTIMATED = {
    name: {"estimate": {"dist": "halfnorm", "scale": scale}}
    for name, scale in {"sinkage": "1 mm", "drawbar_pull": "1 N", "resistance_moment": "0.3 N m"}.items()
}


def slips(rows: int) -> FloatArray:
    """Slips from 0.05 to 0.6."""
    return np.linspace(0.05, 0.6, rows)


def held(free: tuple[str, ...]) -> dict[str, object]:
    """Priors with all other parameters held at the truth."""
    return {"set": "paper-box", **{name: TRUTH[name] for name in NAMES if name not in free}}


def cases() -> list[tuple[str, int, bt.Study, int]]:
    """What varies, its value, the study, and the number of ensembles."""
    plain = simulated_study("load")
    varied = [("outcomes", 3 * n, simulated_study("load", slips=slips(n)), 4) for n in SLIPS]
    varied += [("ensembles", n, plain, n) for n in ENSEMBLES]
    varied += [("free parameters", n, simulated_study("load", priors=held(free)), 4) for n, free in FREE.items()]
    return [*varied, ("free parameters", 11, simulated_study("load", noise=ESTIMATED), 4)]


def measure(study: bt.Study, ensembles: int) -> dict[str, object]:
    """Processor seconds of a default run, per thousand effective draws too, and of one density."""
    problem = Problem(study)
    target, options = problem.target, replace(study.sampling, ensembles=ensembles)
    u = target.coordinates.from_physical(problem.prior_draws(4096, np.random.default_rng(1)))
    target.log_density(u)
    started = time.process_time()
    target.log_density(u)
    each = (time.process_time() - started) / len(u)
    started = time.process_time()
    samples = sample(target.posterior, options, np.random.SeedSequence(1))
    seconds = time.process_time() - started
    return {
        "cpu_seconds": round(seconds, 2),
        "ess": round(samples.diagnosis.ess),
        "ms_per_effective_draw": round(1e3 * seconds / samples.diagnosis.ess, 3),
        "us_per_density": round(1e6 * each, 2),
        "steps": samples.diagnosis.steps,
        "converged": samples.diagnosis.converged,
    }


def main() -> None:
    """Measure all cases that cost.csv does not hold yet, and store them there."""
    path = HERE / "cost.csv"
    rows = pd.read_csv(path).to_dict("records") if path.exists() else []
    known = {(row["varied"], row["value"]) for row in rows}
    for what, value, study, ensembles in cases():
        if (what, value) in known:
            continue
        rows.append({"varied": what, "value": value, **measure(study, ensembles)})
        print(rows[-1], flush=True)
        pd.DataFrame(rows).to_csv(path, index=False)
