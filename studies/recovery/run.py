"""Does the posterior find the soil that made the data? Every model, both drives, three wheels.

Run it with ``python studies/recovery/run.py``; it takes a few minutes and rewrites ``recovery.csv``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd

import bayesterra as bt
from bayesterra.least_squares.results import locate
from bayesterra.models import MODELS
from bayesterra.sampling.sampler import sample, thin

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "support"))

from paper_wheels import SOILS, WHEELS  # noqa: E402

SLIPS = np.array([0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6])
LOAD = 80.0
NOISE = {"sinkage": 0.0005, "normal_force": 1.6, "drawbar_pull": 0.5, "resistance_moment": 0.1}
"""Standard deviations, SI: half a millimetre, 2 % of the load, 2 to 3 % of the pull and of the moment."""


def simulated_study(name: str, model: str, drive: str, rng: np.random.Generator, blur: float = 0.0) -> bt.Study:
    """Data made by ``model`` with the soil of ``name``; ``blur`` (m) is noise on a sinkage taken as exact."""
    wheel, truth = WHEELS[name], dict(SOILS[name])
    exact = MODELS[model]().sinkage(bt.Soil(**truth), wheel, SLIPS, LOAD)
    blank = pd.DataFrame(
        {
            "slip": SLIPS,
            "load [N]": LOAD,
            "sinkage [m]": exact,
            "normal_force [N]": LOAD,
            "drawbar_pull [N]": 0.0,
            "resistance_moment [N m]": 0.0,
        }
    )
    tables = {"model": model, "drive": drive, "noise": NOISE, "truth": truth, "slip_reference": "shearing"}
    tables |= {"kind": "simulated", "source": "studies/recovery/run.py"}
    study = bt.Study(blank.drop(columns="normal_force [N]") if drive == "load" else blank, {name: wheel}, **tables)
    table = bt.simulate(study, truth, seed=int(rng.integers(2**32)))
    if blur:
        table["sinkage [mm]"] = np.maximum(table["sinkage [mm]"] + 1e3 * blur * rng.standard_normal(8), 0.1)
    return bt.Study(table, {name: wheel}, **tables)


def credible_level(study: bt.Study, seed: int) -> tuple[float, bool]:
    """Share of draws denser than the truth, and whether the sampling converged."""
    density = bt.posterior(study)
    samples = sample(density, study.sampling, np.random.SeedSequence(seed))
    draws = thin(samples.chains).flat
    assert study.truth is not None
    points = {"truth": study.truth.values}
    standing = locate(density, draws, density.log_density(draws), points)["truth"]
    return standing.credible_level, samples.diagnosis.converged


def recover(cases: list[tuple[str, str, str, float]], seed: int = 1) -> pd.DataFrame:
    """One row per case (wheel, model, drive, noise on the sinkage that the sinkage drive takes as exact)."""
    rows = []
    for (wheel, model, drive, blur), stream in zip(cases, np.random.SeedSequence(seed).spawn(len(cases)), strict=True):
        study = simulated_study(wheel, model, drive, np.random.default_rng(stream), blur)
        level, converged = credible_level(study, seed)
        rows.append(
            {
                "wheel": wheel,
                "model": model,
                "drive": drive,
                "sinkage_noise_mm": 1e3 * (NOISE["sinkage"] if drive == "load" else blur),
                "denser_draws": round(level, 4),
                "inside_999": level < 0.999,
                "converged": converged,
            }
        )
        print(rows[-1], flush=True)
    return pd.DataFrame(rows)


def all_cases() -> list[tuple[str, str, str, float]]:
    """Three wheels, every model and drive, and the sinkage drive with noise on its sinkage."""
    drives = (("load", 0.0), ("sinkage", 0.0), ("sinkage", NOISE["sinkage"]))
    wheels = ("Wh11", "Wh22", "Wh32")
    return [(wheel, model, drive, blur) for drive, blur in drives for model in MODELS for wheel in wheels]


if __name__ == "__main__":
    table = recover(all_cases())
    table.to_csv(HERE / "recovery.csv", index=False)
    groups = table.groupby(["drive", "sinkage_noise_mm", "model"])
    print(groups[["inside_999", "converged"]].agg(["sum", "size"]).to_string())
