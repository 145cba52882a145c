"""Is the recommended drive the right one? Single additions, sets of slips, the estimator by brute force.

Run ``python studies/design/run.py additions``, ``slips`` or ``estimator``; each rewrites its table. One
process; about five, twenty and five minutes.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator, default_rng

import bayesterra as bt
from bayesterra.arrays import FloatArray
from bayesterra.design.candidates import Candidate, Situation, candidates, readings_of
from bayesterra.design.choosing import CRITERIA, Design, choose
from bayesterra.likelihood.posterior import draw_cut_prior
from bayesterra.models import M1
from bayesterra.sampling.adaptation import AdaptationOptions, adapt
from bayesterra.sampling.coordinates import coordinates
from bayesterra.sampling.sampler import Target
from bayesterra.stats.mixture import effective_number, normalised, systematic

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "support"))

from nested import Sizes, nested_gain  # noqa: E402
from paper_wheels import SOILS, WHEELS  # noqa: E402

ABOUT = ("c", "phi")
LOAD = 80.0
DRIVEN = (0.05, 0.2, 0.4, 0.6)
"""Slips of the rows that stand before a drive is recommended."""
GRID = tuple(np.linspace(0.05, 0.6, 12).round(3))
"""Candidate slips: none outside the driven range."""
MORE = 4
"""Rows that are added in the comparison of sets."""
ADDITIONS, SETS = 200, 54
"""Replications."""
NOISE = {"sinkage": 0.0005, "drawbar_pull": 0.5, "resistance_moment": 0.15}
PLAN = AdaptationOptions(particles=512, components=12, refinements=(4, 4), shores=12)
DRAWS = 8192


def simulated(name: str, slips: FloatArray, rng: Generator) -> bt.Study:
    """A study of one wheel at some slips under 80 N, its readings simulated with noise by M1."""
    wheel, truth = WHEELS[name], dict(SOILS[name])
    blank = pd.DataFrame({"slip": slips, "load [N]": LOAD, **{f"{n} [{u}]": 1e-3 for n, u in UNITS.items()}})
    blank["sinkage [m]"] = M1().sinkage(bt.Soil(**truth), wheel, slips, LOAD)
    tables: dict[str, Any] = {"model": "M1", "noise": NOISE, "truth": truth, "slip_reference": "shearing"}
    tables |= {"kind": "simulated", "source": "studies/design/run.py"}
    study = bt.Study(blank, {name: wheel}, **tables)
    return bt.Study(bt.simulate(study, truth, seed=int(rng.integers(2**32))), {name: wheel}, **tables)


UNITS = {"sinkage": "m", "drawbar_pull": "N", "resistance_moment": "N m"}


def joined(first: bt.Study, second: bt.Study) -> bt.Study:
    """The rows of both studies of one wheel."""
    rows = [_table(study) for study in (first, second)]
    ((name, wheel),) = first.wheels.items()
    tables: dict[str, Any] = {"model": "M1", "noise": NOISE, "slip_reference": "shearing"}
    tables |= {"kind": "simulated", "source": "studies/design/run.py"}
    return bt.Study(pd.concat(rows, ignore_index=True), {name: wheel}, **tables)


def _table(study: bt.Study) -> pd.DataFrame:
    rows = study.observations
    values = {f"{name} [{unit}]": rows.values[name] for name, unit in UNITS.items()}
    return pd.DataFrame({"slip": rows.slip, "load [N]": rows.load, **values})


@dataclass(frozen=True)
class Weighted:
    """A posterior as weighted draws (n, d)."""

    density: bt.Posterior
    x: FloatArray
    log_weights: FloatArray

    def spread(self, more: FloatArray | float = 0.0) -> FloatArray:
        """Standard deviations of c and φ and the area of their ellipse, after more log likelihood (n,)."""
        weights = normalised(self.log_weights + more)
        columns = [self.density.names.index(name) for name in ABOUT]
        covariance = np.cov(self.x[:, columns].T, aweights=weights)
        return np.array([*np.sqrt(np.diagonal(covariance)), np.sqrt(np.linalg.det(covariance))])

    def draws(self, n: int, rng: Generator) -> FloatArray:
        """Draws (n, d) without weights."""
        return self.x[rng.permutation(systematic(normalised(self.log_weights), n, rng))]

    @property
    def effective(self) -> float:
        """Effective number of draws."""
        return effective_number(normalised(self.log_weights))


def posterior_of(study: bt.Study, rng: Generator) -> Weighted:
    """Importance draws of a posterior from a proposal that was adapted to it from the prior."""
    density = bt.posterior(study)
    target = Target(density, coordinates(density))
    start = target.coordinates.from_physical(draw_cut_prior(density, PLAN.particles, rng).x)
    proposal = adapt(target.densities, start, PLAN, rng).proposal
    u = proposal.sample(DRAWS, rng)
    log_weights = target.log_density(u) - proposal.log_density(u)
    inside = np.isfinite(log_weights)
    return Weighted(density, target.coordinates.to_physical(u[inside])[0], log_weights[inside])


def recommended(study: bt.Study, known: Weighted, rng: Generator, *, slips: Sequence[float] = (), **how: Any) -> Design:
    """Rows recommended for c and φ."""
    situation = Situation(study, known.density, known.draws(1000, rng), "posterior")
    return choose(situation, candidates(study, slips), ABOUT, seed=int(rng.integers(2**31)), **how)


def addition(run: int) -> dict[str, Any]:
    """One replication: the spread of c and φ after the recommended row, and after every other candidate."""
    rng, name = default_rng((1, run)), list(WHEELS)[run % len(WHEELS)]
    study = simulated(name, np.array(DRIVEN), rng)
    known = posterior_of(study, rng)
    design = recommended(study, known, rng, slips=GRID)
    after = np.array([_after(study, known, one, rng) for one in design.candidates])
    best, middle = after[design.ranking.best], np.median(after, axis=0)
    gains = np.array([one.values[0] for one in design.ranking.estimates])
    return {
        "run": run,
        "wheel": name,
        "slip": float(design.chosen[0].slip[0]),
        **{f"{key}_ratio": best[i] / middle[i] for i, key in enumerate((*ABOUT, "area"))},
        "rank": int((after[:, 2] < best[2]).sum()) + 1,
        "rank_correlation": float(pd.Series(gains).corr(-pd.Series(np.log(after[:, 2])), method="spearman")),
        "effective": known.effective,
    }


def _after(study: bt.Study, known: Weighted, candidate: Candidate, rng: Generator) -> FloatArray:
    """Spread after one reading of the true soil at a candidate, by reweighting."""
    (name,) = study.wheels
    truth = SOILS[name]
    soil = np.array([[truth[parameter] for parameter in known.density.names]])
    true = readings_of(Situation(study, known.density, soil, "truth"), candidate)[0]
    reading = true.draw(rng.standard_normal(true.mean.shape))
    expected = readings_of(Situation(study, known.density, known.x, "posterior"), candidate)[0]
    log = expected.log_density(reading)[0]
    return known.spread(np.where(np.isfinite(log), log, -np.inf))


def sets(run: int) -> dict[str, Any]:
    """One replication: four more rows at slips recommended by either criterion, and at evenly spaced ones.

    All lie in the range of the command's default grid: the driven slips and a quarter of their range beyond.
    """
    rng, name = default_rng((2, run)), list(WHEELS)[run % len(WHEELS)]
    study = simulated(name, np.array(DRIVEN), rng)
    known = posterior_of(study, rng)
    designs = {by: recommended(study, known, rng, number=MORE, by=by) for by in CRITERIA}
    slips = {by: np.sort([float(one.slip[0]) for one in found.chosen]) for by, found in designs.items()}
    grid = [float(one.slip[0]) for one in designs["sd"].candidates]
    slips["even"] = np.linspace(min(grid), max(grid), MORE)
    found = {key: posterior_of(joined(study, simulated(name, at, rng)), rng) for key, at in slips.items()}
    row: dict[str, Any] = {"run": run, "wheel": name}
    for by in CRITERIA:
        ratios = found[by].spread() / found["even"].spread()
        row |= {f"{by}_slips": " ".join(f"{slip:.3g}" for slip in slips[by]), f"{by}_method": designs[by].method}
        row |= {f"{by}_{key}_ratio": ratios[i] for i, key in enumerate((*ABOUT, "area"))}
    return {**row, "effective": min(one.effective for one in found.values())}


def estimator(run: int) -> dict[str, Any]:
    """Gain about some of c, φ and K in M2 by the working estimator and by brute force."""
    slip, noise, about = [
        (slip, noise, about)
        for noise in (1.0, 5.0)
        for slip in (0.1, 0.5)
        for about in (("phi",), ("K",), ("c", "phi"), ("c", "K"), ("c", "phi", "K"))
    ][run]
    study = _three_parameters(noise)
    density = bt.posterior(study)
    (candidate,) = candidates(study, slips=[slip])
    gain, error = nested_gain(study, density, candidate, about, default_rng(run), Sizes(2000, 600))
    x = draw_cut_prior(density, 2000, default_rng((3, run))).x
    design = choose(Situation(study, density, x, "prior"), [candidate], about)
    ours = design.ranking.estimates[0]
    return {
        "slip": slip,
        "noise": noise,
        "about": " ".join(about),
        "brute_force": gain,
        "brute_force_error": error,
        "gain": ours.values[0],
        "gain_error": ours.errors[0],
    }


def _three_parameters(noise: float) -> bt.Study:
    """Wheel Wh32, all but c, φ and K known; nothing measured yet."""
    wheel, truth = WHEELS["Wh32"], SOILS["Wh32"]
    blank = pd.DataFrame({"slip": [0.1, 0.5], "load [N]": LOAD})
    priors: dict[str, Any] = {name: bt.Law("uniform", lower=low, upper=high) for name, low, high in BOX}
    tables: dict[str, Any] = {"model": "M2", "slip_reference": "shearing", "kind": "simulated"}
    tables["noise"] = {name: noise * sd for name, sd in NOISE.items()}
    tables["priors"] = {**truth, "c3": 0.0, **priors}
    return bt.Study(blank, {"Wh32": wheel}, source="studies/design/run.py", prior_only=True, **tables)


BOX = (("c", 0.0, 3000.0), ("phi", np.radians(20), np.radians(40)), ("K", 0.005, 0.03))

PARTS = {"additions": (addition, ADDITIONS), "slips": (sets, SETS), "estimator": (estimator, 20)}


def main(part: str) -> None:
    """Make one table."""
    one, number = PARTS[part]
    rows = []
    for run in range(number):
        rows.append(one(run))
        print(rows[-1], flush=True)
        pd.DataFrame(rows).round(4).to_csv(HERE / f"{part}.csv", index=False)


if __name__ == "__main__":
    main(sys.argv[1])
