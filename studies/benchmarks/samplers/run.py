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
BUDGETS = {"emcee": 60, "zeus": 40, "nuts": 60, "dynesty": 120, "dynesty-rwalk": 240, "nautilus": 100}
"""Processor seconds that each peer is given; NUTS has a number of draws instead."""
LONG = {("emcee", "raw"): 300, ("zeus", "raw"): 80}
REPEATED = {"dynesty-rwalk": 3}
"""Peers whose draws are now right and now wrong are run with several seeds."""
PATIENCE = 2400
"""Wall seconds after which a run is given up."""


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
    """Sampler, drive, space and seed of every row; ours first, last and between any two peers."""
    found = [("bayesterra", drive, "ours", 1)]
    for number, name in enumerate(BUDGETS, start=2):
        seeds = range(1, REPEATED.get(name, 1) + 1)
        found += [(name, drive, space, seed) for space in SPACES for seed in seeds]
        found.append(("bayesterra", drive, "ours", number))
    return found


def compare(drive: str) -> None:
    """Run all samplers one after another, each in a process of its own, and store results-<drive>.csv.

    Rows that the file holds already are kept, so that an interrupted comparison goes on.
    """
    path = HERE / f"results-{drive}.csv"
    rows = pd.read_csv(path).to_dict("records") if path.exists() else []
    done_before = {(row["sampler"], row["drive"], row["space"], row["seed"]) for row in rows}
    for job in (job for job in jobs(drive) if job not in done_before):
        command = [sys.executable, __file__, "one", *map(str, job)]
        known = dict(zip(("sampler", "drive", "space", "seed"), job, strict=True))
        try:
            done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=PATIENCE)
            rows.append(json.loads(done.stdout.strip().splitlines()[-1]))
        except subprocess.TimeoutExpired:
            rows.append({**known, "right": False, "note": f"given up after {PATIENCE} s"})
        except subprocess.CalledProcessError as error:
            last = error.stderr.strip().splitlines()[-1] if error.stderr.strip() else "killed"
            rows.append({**known, "right": False, "note": last})
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
