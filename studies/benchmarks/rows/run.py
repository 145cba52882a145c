"""What a default run costs from ten readings to ten thousand, and whether many rows leave its posterior right.

Usage: python run.py [cost | exact | long] (default: all, one after another). ``cost`` runs every study as a
person does, in a process of its own; ``exact`` weighs draws by the model run at every row; ``long`` compares
10 000 rows with a long run. Rows that a table holds already are kept.
"""

from __future__ import annotations

import os
import re
import sys
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd

import bayesterra as bt
from bayesterra.likelihood.forward import Nodes
from bayesterra.sampling.sampler import Samples, sample, thin
from bayesterra.study.canonical import write_study

HERE = Path(__file__).parent
sys.path.append(str(HERE.parents[1] / "support"))

from paper_wheels import SOILS, WHEELS  # noqa: E402
from readme import markdown  # noqa: E402
from stored import append, done  # noqa: E402

ROWS = (10, 100, 1000, 10_000)
LOADS = {"one load": (80.0,), "three loads": (50.0, 80.0, 110.0)}
"""Loads, N, of the two kinds of table; the second also has its three standard deviations estimated."""
NOISE = {"sinkage": 1e-3, "drawbar_pull": 1.5, "resistance_moment": 0.3}
"""Standard deviations, SI."""
ESTIMATED = {name: {"estimate": {"dist": "halfnorm", "scale": sd}} for name, sd in NOISE.items()}
QUANTILES = (0.05, 0.5, 0.95)
LONG = 40_000
"""Effective draws of the long run."""


COSTS = {
    "table": "kind",
    "rows": "rows",
    "CPU s": "cpu_seconds",
    "wall s": "wall_seconds",
    "peak GB": "peak_gb",
    "`draws.nc` MB": "draws_mb",
    "effective draws": "ess",
}
EXACT = {"table": "kind", "rows": "rows", "spread against every row": "spread", "greatest move, sd": "moved"}
LONGEST = {"table": "kind", "rows": "rows", "statistics": "statistics", "rms error": "rms", "worst": "worst"}
"""Columns of the README's tables, and of the stored ones behind them."""
FORMS = {
    "cpu_seconds": ".0f",
    "wall_seconds": ".0f",
    "peak_gb": ".2f",
    "draws_mb": ".0f",
    "spread": ".1e",
    "moved": ".1e",
}


def study(kind: str, rows: int) -> bt.Study:
    """Wheel Wh32 by M1 on its soil of Table 10 (Ding et al. 2015): slips from 0.05 to 0.6, loads in turn."""
    wheel, loads = WHEELS["Wh32"], np.resize(LOADS[kind], rows)
    table = pd.DataFrame({"slip": np.linspace(0.05, 0.6, rows), "load [N]": loads})
    blank = table.assign(**{"sinkage [mm]": 10.0, "drawbar_pull [N]": 10.0, "resistance_moment [N m]": 3.0})
    about: dict[str, Any] = {"model": "M1", "drive": "load", "priors": {"set": "paper-box"}, "kind": "simulated"}
    about |= {"source": "studies/benchmarks/rows/run.py", "title": f"{rows} rows, {kind}", "slip_reference": "shearing"}
    readings = bt.simulate(bt.Study(blank, {"Wh32": wheel}, noise=NOISE, **about), SOILS["Wh32"], seed=rows)
    return bt.Study(readings, {"Wh32": wheel}, noise=ESTIMATED if kind == "three loads" else NOISE, **about)


def cost(kind: str, rows: int) -> dict[str, object]:
    """Processor and wall seconds, peak memory and size of the draws of ``bayesterra run``."""
    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        write_study(study(kind, rows), folder)
        command = [sys.executable, "-m", "bayesterra", "run", str(folder / "study.toml"), "--out", str(folder / "out")]
        started = time.perf_counter()
        process = os.posix_spawn(sys.executable, [*command, "--quiet"], dict(os.environ))
        _, status, used = os.wait4(process, 0)
        wall = time.perf_counter() - started
        said = bt.load_result(folder / "out").record["verdict"]
        return {
            "kind": kind,
            "rows": rows,
            "exit": os.waitstatus_to_exitcode(status),
            "cpu_seconds": round(used.ru_utime + used.ru_stime, 1),
            "wall_seconds": round(wall, 1),
            "peak_gb": round(used.ru_maxrss / 1e6, 2),
            "draws_mb": round((folder / "out" / "draws.nc").stat().st_size / 1e6, 1),
            "ess": round(said["ess"]),
            "converged": said["converged"],
        }


def sampled(problem: bt.Study, seed: int, ess: int | None = None) -> Samples:
    """Samples of a study by the default settings, of as many effective draws."""
    options = problem.sampling if ess is None else replace(problem.sampling, target_ess=ess, max_steps=200_000)
    return sample(bt.posterior(problem), options, np.random.SeedSequence(seed))


def exact(kind: str, rows: int) -> dict[str, object]:
    """How far the log likelihood of draws is from that of the model run at every row, and what this moves.

    ``spread`` is the standard deviation of the differences of 400 draws; ``moved`` the greatest move of a mean or of
    the log of a standard deviation, in standard deviations, when draws are weighed by them.
    """
    problem = study(kind, rows)
    x = thin(sampled(problem, 1).chains).flat
    x = x[np.linspace(0, len(x) - 1, 400).astype(int)]
    told = bt.posterior(problem).log_density(x)
    with patch.object(Nodes, "of", lambda *_, **__: None):
        whole = bt.posterior(problem).log_density(x)
    change = whole - told
    weights = np.exp(change - change.max())
    weights /= weights.sum()
    centre, spread = x.mean(axis=0), x.std(axis=0)
    means = weights @ x
    spreads = np.sqrt(weights @ (x - means) ** 2)
    moved = max(np.abs((means - centre) / spread).max(), np.abs(np.log(spreads / spread)).max())
    return {"kind": kind, "rows": rows, "draws": len(x), "spread": float(np.std(change)), "moved": float(moved)}


def long_run(kind: str, rows: int) -> dict[str, object]:
    """By how many Monte Carlo errors means and 5, 50, 95 % points of a default run are from those of a long one."""
    problem = study(kind, rows)
    usual, many = sampled(problem, 1), sampled(problem, 2, LONG)
    a, b = (thin(each.chains).flat for each in (usual, many))
    points = np.quantile(b, QUANTILES, axis=0)
    errors = [(a.mean(axis=0) - b.mean(axis=0)) / (b.std(axis=0) * _error(usual, many))]
    for share, point in zip(QUANTILES, points, strict=True):
        below = (a < point).mean(axis=0) - share
        errors.append(below / (np.sqrt(share * (1 - share)) * _error(usual, many)))
    found = np.stack(errors)
    return {
        "kind": kind,
        "rows": rows,
        "ess": round(usual.diagnosis.ess),
        "ess_long": round(many.diagnosis.ess),
        "statistics": found.size,
        "rms": round(float(np.sqrt((found**2).mean())), 2),
        "worst": round(float(np.abs(found).max()), 2),
    }


def _error(a: Samples, b: Samples) -> float:
    """Monte Carlo error of the difference of two means, in standard deviations."""
    return float(np.sqrt(1 / a.diagnosis.ess + 1 / b.diagnosis.ess))


def table() -> str:
    """The README's tables."""
    cost, exact, long = (pd.read_csv(HERE / f"{part}.csv") for part in PARTS)
    tables = []
    for columns, part in ((COSTS, cost), (EXACT, exact), (LONGEST, long)):
        rows = [[f"{row[name]:{FORMS.get(name, '')}}" for name in columns.values()] for row in part.to_dict("records")]
        tables.append(markdown(tuple(columns), rows, "|" + "r" * len(columns)))
    return "\n\n".join(tables)


PARTS = {"cost": (cost, ROWS), "exact": (exact, ROWS[:3]), "long": (long_run, ROWS[3:])}


def main(words: list[str]) -> None:
    """Measure what the tables do not hold yet; say all of them in the end."""
    for part in words or PARTS:
        measure, sizes = PARTS[part]
        path = HERE / f"{re.sub(r'_run$', '', part)}.csv"
        known = done(path, "kind", "rows")
        for kind in LOADS:
            for rows in (rows for rows in sizes if (kind, rows) not in known):
                found = measure(kind, rows)
                print(found, flush=True)
                append(path, pd.DataFrame([found]))
    if not words:
        print(table())


if __name__ == "__main__":
    main(sys.argv[1:])
