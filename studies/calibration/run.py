"""Is the posterior right over the whole prior? Simulation-based calibration of the default configuration.

Usage: python run.py [CASE ...]. Cases: m2, m1, m2-estimated-noise, m2-intervals, m2-groups, m2-both-discrepancy,
m2-soil-tests, m2-noise-halved, m2-jacobian-dropped, m2-rounding-ignored, m2-curve-ignored (default: all). Every case
takes its replications one by one in this process, M2 and some others in one for each processor, goes on
where an interrupted run ended, and leaves its ranks, record and report in a folder of its name, and the
memory of this process in ``memory.csv`` there.
"""

from __future__ import annotations

import json
import resource
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
import pandas as pd

import bayesterra as bt
from bayesterra.arrays import FloatArray
from bayesterra.checking.calibration import CalibrationRequest, Progress, calibrate_study
from bayesterra.checking.ranks import Calibration
from bayesterra.checking.short_runs import Fit, Fitted, ShortRuns
from bayesterra.sampling.coordinates import Coordinates, coordinates
from bayesterra.study.noise import Noise

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "support"))

from paper_wheels import ABOUT_WH32  # noqa: E402
from paper_wheels import WHEELS as PAPER_WHEELS  # noqa: E402

WHEELS = {name: PAPER_WHEELS[name] for name in ("Wh11", "Wh32")}
SLIPS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.6)
NOISE = {"sinkage": 1e-3, "drawbar_pull": 1.5, "resistance_moment": 0.3}
"""Standard deviations, SI."""
UNKNOWN = {"dist": "lognorm", "s": 0.5}
"""Law of a standard deviation that is estimated; its scale is the known one."""
STEPS = {"sinkage": 4e-3, "resistance_moment": 1.0}
"""Steps, SI, to which the readings of the cases with intervals are rounded."""
LIMITS = ("<4", "", "", "", "", ">18")
"""Pulls, N, of which these cases know a limit only: in the first row below 4 N, in the last above 18 N."""
GROUP_SLIPS = (0.1, 0.25, 0.5)
COHESION = {"dist": "norm", "loc": "1 kPa", "scale": "0.3 kPa", "lower": "0 kPa"}
FRICTION = {"dist": "norm", "loc": "30 deg", "scale": "4 deg", "lower": "0 deg", "upper": "60 deg"}
BOTH_SLIPS = (0.1, 0.2, 0.35, 0.5)
FORCE = 3.0
"""Noise, N, of the normal force where the load is known by its readings only."""
CURVES = {"drawbar_pull": {"sd": "2 N", "length": 0.3}, "sinkage": {"sd": "1 mm", "length": 0.3}}
DOF, SLIP_ERROR = 3.0, 0.02
"""Of the noise, and standard deviation of the slips, in the cases with heavy tails."""
EXPONENT = {"dist": "norm", "loc": 0.8, "scale": 0.1, "lower": 0.3, "upper": 1.3}
MODULUS = {"dist": "norm", "loc": "11 mm", "scale": "3 mm", "lower": "3 mm", "upper": "40 mm"}
PATHS_MM = (1.0, 2.0, 4.0, 8.0, 16.0)
"""Sinkages of plates and displacements of rings, mm."""
CORRELATION = 0.8
"""Prior correlation of c and φ in the cases with groups."""
WHEEL = bt.Wheel(0.15735, 0.165, 0.010, 30, shearing_radius_coefficient=0.65)


def study(model: str, noise: float = 1.0, *, intervals: bool = False, estimated: bool = False) -> bt.Study:
    """Six slips under 80 N, all eight parameters free in the paper's box; the readings only hold places."""
    table = pd.DataFrame(
        {
            "slip": SLIPS,
            "load [N]": 80.0,
            "sinkage [mm]": 5.0,
            "drawbar_pull [N]": [limit or "10" for limit in LIMITS] if intervals else 10.0,
            "resistance_moment [N m]": 3.0,
        }
    )
    steps = STEPS if intervals else {}
    laws: dict[str, Any] = {name: {"estimate": {**UNKNOWN, "scale": sd}} for name, sd in NOISE.items()}
    known = {name: Noise(name, sd=noise * sd, resolution=steps.get(name, 0.0)) for name, sd in NOISE.items()}
    tables: dict[str, Any] = {"noise": laws if estimated else known}
    return bt.Study(
        table,
        {"Wh32": WHEEL},
        title=f"Calibration of {model}",
        model=model,
        slip_reference="shearing",
        kind="simulated",
        source="studies/calibration/run.py",
        priors={"set": "paper-box"},
        **tables,
    )


def groups() -> bt.Study:
    """Two wheels at three slips each: c and φ shared, with a prior correlation, K from a population."""
    rows = [{"wheel": name, "slip": slip, "load [N]": 80.0} for name in WHEELS for slip in GROUP_SLIPS]
    held = {name: ABOUT_WH32[name] for name in ("Ks", "n0", "n1", "c1", "c2")}
    tables: dict[str, Any] = {"noise": {name: NOISE[name] for name in ("drawbar_pull", "resistance_moment")}}
    return bt.Study(
        pd.DataFrame(rows).assign(**{"drawbar_pull [N]": 10.0, "resistance_moment [N m]": 3.0}),
        WHEELS,
        title="Calibration of two wheels in one posterior",
        model="M2",
        slip_reference="shearing",
        kind="simulated",
        source="studies/calibration/run.py",
        priors={**held, "c": COHESION, "phi": FRICTION, "correlation": {"c, phi": CORRELATION}},
        pooling={"shared": ["c", "phi"], "hierarchical": {"K": {}}},
        **tables,
    )


def latent_loads(*, curves: bool = True) -> bt.Study:
    """Four slips whose loads are known by their readings only, and two curves of discrepancy over slip."""
    readings = {"normal_force [N]": 80.0, "sinkage [mm]": 5.0, "drawbar_pull [N]": 10.0}
    noise: dict[str, Any] = {**NOISE, "normal_force": FORCE}
    held = {name: ABOUT_WH32[name] for name in ("Ks", "n1", "c", "c1", "c2")}
    errors: dict[str, Any] = {"discrepancy": CURVES} if curves else {}
    return bt.Study(
        pd.DataFrame({"slip": BOTH_SLIPS}).assign(**readings, **{"resistance_moment [N m]": 3.0}),
        {"Wh32": WHEEL},
        title="Calibration of latent loads beside a discrepancy",
        model="M2",
        drive="both",
        load_range=["40 N", "120 N"],
        slip_reference="shearing",
        kind="simulated",
        source="studies/calibration/run.py",
        noise=noise,
        priors={**held, "n0": EXPONENT, "phi": FRICTION, "K": MODULUS},
        **errors,
    )


def heavy_tails(*, known: bool = True) -> bt.Study:
    """Five slips that are read with an error, and Student-t noise on every channel, or Gaussian noise."""
    readings = {"load [N]": 80.0, "sinkage [mm]": 5.0, "drawbar_pull [N]": 10.0}
    noise: dict[str, Any] = {name: {"sd": sd, **({"dof": DOF} if known else {})} for name, sd in NOISE.items()}
    held = {name: ABOUT_WH32[name] for name in ("Ks", "n1", "c", "c1", "c2")}
    return bt.Study(
        pd.DataFrame({"slip": SLIPS[1:]}).assign(**readings, **{"resistance_moment [N m]": 3.0}),
        {"Wh32": WHEEL},
        title="Calibration of heavy tails beside errors of slip",
        model="M2",
        slip_reference="shearing",
        kind="simulated",
        source="studies/calibration/run.py",
        noise=noise,
        slip={"sd": SLIP_ERROR},
        priors={**held, "n0": EXPONENT, "phi": FRICTION, "K": MODULUS},
    )


def with_soil_tests() -> bt.Study:
    """Three slips of a wheel, three plates and two rings on one soil, which share n0, φ and K."""
    wheel = pd.DataFrame({"slip": BOTH_SLIPS[:3], "load [N]": 80.0, "sinkage [mm]": 5.0, "drawbar_pull [N]": 10.0})
    depth, turn = (pd.DataFrame({name: PATHS_MM}) for name in ("sinkage [mm]", "displacement [mm]"))
    plates = [depth.assign(test=str(d), **{"plate_diameter [mm]": d, "pressure [kPa]": 1.0}) for d in (60, 80, 100)]
    rings = [turn.assign(test=str(s), **{"normal_stress [kPa]": s, "shear_stress [kPa]": 1.0}) for s in (5, 10)]
    known = {"memory": 2.0, "seating": "0.1 mm", "sinkage_offset": "0 mm"}
    held = {"kc": 0.0, "kphi": ABOUT_WH32["Ks"], **{name: ABOUT_WH32[name] for name in ("n1", "c", "c1", "c2")}}
    return bt.Study(
        wheel,
        {"Wh32": WHEEL},
        title="Calibration of a wheel, plates and rings in one posterior",
        model="M2",
        slip_reference="shearing",
        kind="simulated",
        source="studies/calibration/run.py",
        noise={name: NOISE[name] for name in ("sinkage", "drawbar_pull")},
        priors={**held, "n0": EXPONENT, "phi": FRICTION, "K": MODULUS},
        soil_tests={
            "plates": {"test": "plate", "table": pd.concat(plates), "tie": {"n": "n0"}, "noise": known},
            "rings": {"test": "shear", "table": pd.concat(rings), "noise": {"scatter": 0.1, "memory": 2.0}},
        },
    )


@dataclass(frozen=True)
class NoiseHalved:
    """A wrong posterior: it believes in half of the noise that the readings have."""

    fit: ShortRuns = field(default_factory=ShortRuns)

    def __call__(self, simulated: bt.Study, seed: np.random.SeedSequence) -> Fitted:
        """Sample the posterior of a study with its noise halved."""
        wrong = study(simulated.model.name, noise=0.5)
        return self.fit(wrong.with_data(simulated.observations.values), seed)


@dataclass(frozen=True)
class RoundingIgnored:
    """A wrong posterior: it takes steps and limits for readings of which every digit counts."""

    fit: ShortRuns = field(default_factory=ShortRuns)

    def __call__(self, simulated: bt.Study, seed: np.random.SeedSequence) -> Fitted:
        """Sample the posterior of a study as though nothing were rounded."""
        return self.fit(study(simulated.model.name).with_data(simulated.observations.values), seed)


@dataclass(frozen=True)
class CurveIgnored:
    """A wrong posterior: it takes the model for exact where readings have a discrepancy."""

    fit: ShortRuns = field(default_factory=ShortRuns)

    def __call__(self, simulated: bt.Study, seed: np.random.SeedSequence) -> Fitted:
        """Sample the posterior of a study as though there were no discrepancy."""
        return self.fit(latent_loads(curves=False).with_data(simulated.observations.values), seed)


@dataclass(frozen=True)
class TailsIgnored:
    """A wrong posterior: it takes heavy-tailed noise for Gaussian noise of the same scale."""

    fit: ShortRuns = field(default_factory=ShortRuns)

    def __call__(self, simulated: bt.Study, seed: np.random.SeedSequence) -> Fitted:
        """Sample the posterior of a study as though its noise were Gaussian."""
        return self.fit(heavy_tails(known=False).with_data(simulated.observations.values), seed)


@dataclass(frozen=True)
class WithoutJacobianOfK:
    """Coordinates that forget dK/d(log K): they move in log K as though the prior were flat there."""

    right: Coordinates
    column: int

    def from_physical(self, x: FloatArray) -> FloatArray:
        """See :class:`bayesterra.sampling.coordinates.Coordinates`."""
        return self.right.from_physical(x)

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`bayesterra.sampling.coordinates.Coordinates`."""
        x, log_jacobian = self.right.to_physical(u)
        with np.errstate(all="ignore"):
            return x, log_jacobian - np.log(x[:, self.column])


@dataclass(frozen=True)
class JacobianDropped:
    """A wrong sampler: the Jacobian of log K is missing."""

    fit: ShortRuns = field(default_factory=ShortRuns)

    def __call__(self, simulated: bt.Study, seed: np.random.SeedSequence) -> Fitted:
        """Sample the posterior of a study in coordinates without the Jacobian of log K."""

        def wrong(posterior: bt.Posterior) -> WithoutJacobianOfK:
            return WithoutJacobianOfK(coordinates(posterior), posterior.names.index("K"))

        with patch("bayesterra.sampling.sampler.coordinates", wrong):
            return self.fit(simulated, seed)


class Case(NamedTuple):
    """A model, number and sampling of its replications, the noise (1: ``NOISE``), and what is special."""

    model: str
    n: int
    fit: Fit | None = None
    noise: float = 1.0
    intervals: bool = False
    groups: bool = False
    latent: bool = False
    tails: bool = False
    tests: bool = False
    estimated: bool = False

    @property
    def study(self) -> bt.Study:
        """What is calibrated."""
        if self.tests:
            return with_soil_tests()
        if self.latent or self.tails:
            return latent_loads() if self.latent else heavy_tails()
        if self.groups:
            return groups()
        return study(self.model, self.noise, intervals=self.intervals, estimated=self.estimated)


CASES = {
    "m2": Case("M2", 1000),
    "m1": Case("M1", 300),
    "m2-estimated-noise": Case("M2", 300, estimated=True),
    "m2-intervals": Case("M2", 200, intervals=True),
    "m2-groups": Case("M2", 200, groups=True),
    "m2-both-discrepancy": Case("M2", 200, latent=True),
    "m2-slip-student": Case("M2", 200, tails=True),
    "m2-soil-tests": Case("M2", 200, tests=True),
    "m2-noise-halved": Case("M2", 20, NoiseHalved()),
    "m2-jacobian-dropped": Case("M2", 80, JacobianDropped(), noise=4.0),
    "m2-rounding-ignored": Case("M2", 40, RoundingIgnored(), intervals=True),
    "m2-curve-ignored": Case("M2", 40, CurveIgnored(), latent=True),
    "m2-tails-ignored": Case("M2", 40, TailsIgnored(), tails=True),
}


def resident() -> tuple[float, float]:
    """Resident memory of this process now and at its peak, MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def run(case: str) -> Calibration:
    """Run one case, or what is missing of it; a finished one is only judged again."""
    todo = CASES[case]
    out, rows = HERE / case, []
    if (out / "ranks.csv").is_file():
        return judged(case)

    def note(progress: Progress) -> None:
        if progress.done % 20 == 0:
            rows.append((progress.done, *resident()))
            print(case, *rows[-1], f"{progress.unsettled} not converged", flush=True)

    alone = case != "m2" and not (todo.groups or todo.latent or todo.tails or todo.estimated)
    engine = None if alone else bt.local_pool()
    request = CalibrationRequest(todo.study, todo.n, engine=engine, fit=todo.fit)
    found = calibrate_study(request, out, resume=True, quiet=True, watch=note)
    table = pd.DataFrame(rows, columns=["replications", "resident_mb", "peak_mb"])
    table.to_csv(out / "memory.csv", index=False, float_format="%.1f")
    return found


def judged(case: str) -> Calibration:
    """The verdict on stored ranks; record and report are written anew."""
    out = HERE / case
    table = pd.read_csv(out / "ranks.csv", dtype={"note": object}, keep_default_na=True)
    table["note"] = table["note"].where(table["note"].notna(), "")
    record = json.loads((out / "calibration.json").read_text(encoding="utf-8"))
    origin = {name: record[name] for name in ("seed", "model", "drive", "fingerprints", "settings", "versions")}
    found = Calibration(CASES[case].study, table, origin)
    memory = out / "memory.csv"
    kept = memory.read_bytes() if memory.is_file() else None
    found.save(out, overwrite=True)
    if kept is not None:
        memory.write_bytes(kept)
    return found


def line(case: str, found: Calibration) -> str:
    """One row of the table in the README."""
    worst = found.tests.sort_values("p_value").to_dict("records")[0]
    columns = (found.power["one"], found.power["all"])
    power = [(f"{one:.2f}", f"{every:.2f}") for one, every in zip(*columns, strict=True)]
    (ten, tens), (twenty, twenties), (little, _), (more, _) = power
    cells = (
        case,
        f"{len(found.table)}",
        f"{found.unsettled}",
        f"**{found.verdict}**",
        f"{worst['p_value']:.2g} ({worst['quantity']})",
        f"{found.threshold:.2g}",
        f"{ten}, {twenty}",
        f"{tens}, {twenties}",
        f"{little}, {more}",
        f"{found.table['seconds'].mean():.1f}",
    )
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    for name in sys.argv[1:] or CASES:
        print(line(name, run(name)), flush=True)
