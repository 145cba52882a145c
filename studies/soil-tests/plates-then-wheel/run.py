"""What does a wheel add to plate tests of the same sand? CMU plates, then the CMU grouser wheel.

Run it with ``python studies/soil-tests/plates-then-wheel/run.py``; some minutes. It samples the plate tests
of ``studies/soil-tests``, takes their posterior of k_c, k_φ and n (as n0), correlations kept, as the prior
of both geometries of ``studies/cmu-grouser``, and runs these with that prior and with their own; it
rewrites the tables beside this file.
"""

from __future__ import annotations

import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import bayesterra as bt

HERE = Path(__file__).parent
sys.path.append(str(HERE.parents[1] / "support"))

from shipped import FILES  # noqa: E402

GEOMETRIES = ("cmu-grouser", "cmu-grouser-wide")
PRIORS = ("plates", "box")
TAKEN = {"kc": "kc", "kphi": "kphi", "n0": "n"}
"""Parameter of the wheel = parameter of the plates. That b is the width of a wheel where it is the radius of
a plate, and that n0 is a plate's n, are assumptions of the paper's (4) and Section 3.2."""


def study(geometry: str, prior: str, plates: Path) -> bt.Study:
    """A shipped study with its own prior (``box``) or with that of the plates."""
    path = FILES[geometry]
    tables: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    described = tables.pop("data")
    data = pd.read_csv(path.parent / described.pop("file"))
    tables.pop("published", None)
    if prior == "plates":
        tables["priors"]["from"] = [{"result": str(plates), "take": TAKEN}]
    return bt.Study(data=data, **described, **tables)


def rows_of(geometry: str, prior: str, result: bt.Result) -> list[dict[str, Any]]:
    """Prior and posterior of every parameter in field units."""
    kept = ["parameter", "unit", "median", "sd", "hdi90_lo", "hdi90_hi", "prior_mean", "prior_sd"]
    table = result.summary[kept]
    return [{"geometry": geometry, "prior": prior, **row} for row in table.to_dict("records")]


def main() -> None:
    """Sample the plates, then both geometries with both priors; evidence is that of the cut prior."""
    parameters: list[dict[str, Any]] = []
    runs: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as work:
        plates = Path(work) / "plates"
        bt.soil_test(HERE.parent / "cmu.toml").save(plates)
        for geometry in GEOMETRIES:
            for prior in PRIORS:
                result = bt.run(study(geometry, prior, plates), seed=1)
                parameters += rows_of(geometry, prior, result)
                evidence = result.record["evidence"]
                runs.append(
                    {
                        "geometry": geometry,
                        "prior": prior,
                        "converged": result.converged,
                        "log_evidence": evidence["log_z"] - evidence["log_share"],
                        "error": float(np.hypot(evidence["error"], evidence["log_share_error"])),
                        "alarm": result.record["predictive_checks"]["alarm"],
                    }
                )
                for name, found in (("parameters", parameters), ("runs", runs)):
                    pd.DataFrame(found).to_csv(HERE / f"{name}.csv", index=False, float_format="%.5g")
                print(geometry, prior, "done", flush=True)


if __name__ == "__main__":
    main()
