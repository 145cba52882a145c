"""Plates and a wheel of one sand in one posterior, and plates and a ring of another.

Run it with ``python studies/soil-tests/together/run.py [CASE ...]``. Cases: ``cmu-grouser`` and
``cmu-grouser-wide`` (two geometries of the wheel, each with the plates of ``studies/soil-tests/cmu.toml``),
``plates`` (these alone), ``cullinan`` (plates of ``studies/logs`` and the shear tests of ``cullinan.toml``),
``cullinan-plates`` and ``cullinan-ring`` (each alone). A case writes its rows into the tables beside this file.
"""

from __future__ import annotations

import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import SeedSequence, default_rng

import bayesterra as bt
from bayesterra.likelihood.posterior import INSIDE
from bayesterra.parameters import PARAMETERS
from bayesterra.sampling.adaptation import OF_SOIL_TESTS
from bayesterra.sampling.evidence import ensembles_evidence
from bayesterra.sampling.sampler import sample, thin
from bayesterra.stats.diagnostics import hdi

HERE = Path(__file__).parent
STUDIES = HERE.parents[1]
sys.path.append(str(STUDIES / "support"))

from shipped import FILES  # noqa: E402

PLATES = STUDIES / "soil-tests" / "cmu.toml"
RING = STUDIES / "soil-tests" / "cullinan.toml"
CULLINAN = STUDIES / "logs" / "cullinan.toml"


def tables(path: Path) -> dict[str, Any]:
    """A file of TOML."""
    return tomllib.loads(path.read_text(encoding="utf-8"))


def series(path: Path, **more: Any) -> dict[str, Any]:
    """The series of tests of a soil-test file, as a table of a study."""
    content = tables(path)
    described = {key: value for key, value in content["data"].items() if key != "file"}
    readings = pd.read_csv(path.parent / content["data"]["file"])
    return {"test": content["test"], "table": readings, **described, "noise": content.get("noise", {}), **more}


def wheel_and_plates(geometry: str) -> bt.Study:
    """A shipped study of the wheel with the plates of its sand: moduli and n0 are one."""
    path = FILES[geometry]
    content = tables(path)
    described = content.pop("data")
    data = pd.read_csv(path.parent / described.pop("file"))
    content.pop("published", None)
    laws = tables(PLATES)["priors"]
    content["priors"] |= {**{name: laws[name] for name in ("reference_sinkage", "kc", "kphi")}, "n0": laws["n"]}
    content["soil_tests"] = {"plates": series(PLATES, tie={"n": "n0"})}
    return bt.Study(data, **described, **content)


def tests_alone(*files: Path) -> bt.Study:
    """Soil tests without a wheel; parameters of one name are one."""
    priors = {name: law for path in files for name, law in tables(path)["priors"].items()}
    return bt.Study(priors=priors, soil_tests={tables(path)["test"]: series(path) for path in files})


CASES = {
    "cmu-grouser": lambda: wheel_and_plates("cmu-grouser"),
    "cmu-grouser-wide": lambda: wheel_and_plates("cmu-grouser-wide"),
    "plates": lambda: tests_alone(PLATES),
    "cullinan": lambda: tests_alone(CULLINAN, RING),
    "cullinan-plates": lambda: tests_alone(CULLINAN),
    "cullinan-ring": lambda: tests_alone(RING),
}


def sampled(case: str) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Posterior of every parameter in field units, and log evidence under the stated prior."""
    started, target = time.perf_counter(), bt.posterior(CASES[case]())
    size = None if target.driven else OF_SOIL_TESTS
    samples = sample(target, bt.load_study(FILES["cmu-grouser"]).sampling, SeedSequence(1), adaptation=size)
    densities = samples.target.densities
    found = ensembles_evidence(densities, samples.adaptations, default_rng(2))
    rows = []
    for name, x in zip(target.names, thin(samples.chains).flat.T, strict=True):
        values = x / PARAMETERS[name].scale
        low, high = hdi(values, 0.9)
        figures = {"median": np.median(values), "sd": values.std(), "hdi90_lo": low, "hdi90_hi": high}
        rows.append({"case": case, "parameter": name, "unit": PARAMETERS[name].unit, **figures})
    run = {
        "case": case, "converged": samples.diagnosis.converged, "ess": samples.diagnosis.ess, "log_z": found.log_z,
        "error": found.error, "reliable": found.reliable, "seconds": time.perf_counter() - started,
    }  # fmt: skip
    return pd.DataFrame(rows), pd.DataFrame([run])


def log_shares() -> pd.DataFrame:
    """Log share of the wheel's prior that its physical cut leaves, with moduli and exponent as the plates have them."""
    plates = bt.posterior(CASES["plates"]())
    samples = sample(plates, bt.load_study(FILES["cmu-grouser"]).sampling, SeedSequence(1), adaptation=OF_SOIL_TESTS)
    draws, rows = thin(samples.chains).spaced(8000), []
    for case in ("cmu-grouser", "cmu-grouser-wide"):
        target = bt.posterior(CASES[case]())
        x = target.prior.sample(len(draws), default_rng(3))
        for column, name in enumerate(plates.names):
            there = "n0" if name == "n" else name.replace(".plate", ".plates")
            x[:, target.names.index(there)] = draws[:, column]
        inside = target.reasons(x) == INSIDE
        rows.append({"case": case, "log_share": np.log(inside.mean()), "error": (~inside).mean() / inside.sum() ** 0.5})
    return pd.DataFrame(rows)


def main() -> None:
    """Sample the cases; rows of others stay."""
    for case in sys.argv[1:] or CASES:
        for name, made in zip(("parameters", "runs"), sampled(case), strict=True):
            path = HERE / f"{name}.csv"
            kept = [pd.read_csv(path).query("case != @case")] if path.is_file() else []
            pd.concat([*kept, made], ignore_index=True).to_csv(path, index=False, float_format="%.6g")
        print(case, "done", flush=True)
    if not sys.argv[1:]:
        log_shares().to_csv(HERE / "shares.csv", index=False, float_format="%.4g")


if __name__ == "__main__":
    main()
