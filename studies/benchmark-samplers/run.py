"""Remake this study: ``python run.py reference | compare | cost | divide``, each on its own or in this order.

``compare`` needs the environment of requirements.lock; the others need bayesterra only.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import pandas as pd  # noqa: E402  threads are limited before NumPy starts

HERE = Path(__file__).parent
DRIVES, SPACES = ("load", "sinkage"), ("raw", "ours")
SEEDS = (1, 2)
"""Ours is run with each, before and after the peers; the mean counts."""
BUDGETS = {"emcee": 12, "zeus": 12, "dynesty": 12, "nautilus": 15, "nuts": 35}
"""Processor seconds that each peer is given; dynesty runs until it stops by itself."""
LONG = {("emcee", "raw"): 30}


def one(name: str, drive: str, space: str, seed: int) -> dict[str, object]:
    """Run one sampler in this process; one row of results.csv."""
    import peers
    from problems import Problem, simulated_study

    budget = LONG.get((name, space), BUDGETS.get(name, 0))
    found = peers.run(name, Problem(simulated_study(drive)), space, seed, budget)
    measured = found.measured
    return {
        "drive": drive,
        "sampler": name,
        "space": space,
        "seed": seed,
        "cpu_seconds": round(found.seconds, 2),
        "ess_bulk": round(measured.bulk, 1),
        "ess_tail": round(measured.tail, 1),
        "per_second": round(min(measured.bulk, measured.tail) / found.seconds, 3),
        "r_hat": round(measured.r_hat, 4),
        "worst_error": round(measured.worst, 2),
        "right": measured.right,
        "note": found.note,
    }


def jobs(drive: str) -> list[tuple[str, str, str, int]]:
    """Sampler, drive, space and seed of every row; ours before and after the peers."""
    first, last = [("bayesterra", drive, "ours", seed) for seed in SEEDS]
    return [first, *((name, drive, space, 1) for name in BUDGETS for space in SPACES), last]


def compare(drive: str) -> None:
    """Run all samplers one after another, each in a process of its own, and store results-<drive>.csv.

    Rows that the file holds already are kept, so that an interrupted comparison goes on.
    """
    path = HERE / f"results-{drive}.csv"
    rows = pd.read_csv(path).to_dict("records") if path.exists() else []
    done_before = {(row["sampler"], row["drive"], row["space"], row["seed"]) for row in rows}
    for job in (job for job in jobs(drive) if job not in done_before):
        command = [sys.executable, __file__, "one", *map(str, job)]
        done = subprocess.run(command, check=False, capture_output=True, text=True)
        if done.returncode:
            last = done.stderr.strip().splitlines()[-1] if done.stderr.strip() else "killed"
            known = dict(zip(("sampler", "drive", "space", "seed"), job, strict=True))
            rows.append({**known, "right": False, "note": last})
        else:
            rows.append(json.loads(done.stdout.strip().splitlines()[-1]))
        print(rows[-1], flush=True)
        pd.DataFrame(rows).to_csv(path, index=False)


def main(words: list[str]) -> None:
    """Do what the command line says."""
    match words:
        case ["one", name, drive, space, seed]:
            print(json.dumps(one(name, drive, space, int(seed))))
        case ["compare", *drives]:
            for drive in drives or DRIVES:
                compare(drive)
        case ["reference"]:
            import reference

            reference.main()
        case ["cost"]:
            import cost

            cost.main()
        case ["divide", *rest]:
            import divide

            divide.main(*rest)
        case _:
            print(__doc__)


if __name__ == "__main__":
    main(sys.argv[1:])
