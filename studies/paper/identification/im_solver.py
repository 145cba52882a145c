"""The paper's solver, emulated, on the same readings: values, noise, starts and truths; K_s free as in the paper."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd
from im_fits import HIT, METHODS, SEEDS, SHARES, noisy, row_of, study_of
from paper_data import FORCES, SLIPS, SOILS, TRANSITION, field_values
from paper_wheels import WHEELS

import bayesterra as bt
from bayesterra.least_squares.results import Fit
from bayesterra.models import M1

SOLVERS = ("converged", "lsqcurvefit")
PAPER = "lsqcurvefit"
START_C = (0.05, 0.2, 1.0, 3.0)
START_KS = (500.0, 2500.0, 8000.0)
"""Starts of c (kPa) and K_s (kPa/m^N); 0.2 and 2500 are those of Table 17."""
CURVE_C = (0.02, 0.05, 0.1, 0.2, 0.35, 0.6, 1.0, 1.5, 2.0, 3.0, 4.0)
TRUE_C = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0)
"""Cohesions (kPa) of soils that are otherwise those of Table 10."""
DRAWN = "Wh11"
"""Wheel of the figure."""


def fits(wheels: tuple[str, ...] = (*SOILS, HIT)) -> pd.DataFrame:
    """Every method by both solvers on noise-free readings and on HIT, K_s free, δ = 0.002."""
    rows = []
    for wheel in wheels:
        found = bt.fit(study_of(wheel, hold=False), METHODS, solvers=SOLVERS)
        rows += [{"data": wheel, **_named(f), **row_of(f), "evaluations": f.evaluations} for f in found.values()]
    return pd.DataFrame(rows)


def _named(fit: Fit) -> dict[str, str]:
    return {"method": fit.method, "solver": fit.solver}


def scatter(wheels: tuple[str, ...] = tuple(SOILS), seeds: int = SEEDS) -> pd.DataFrame:
    """Quantiles of what the methods return by the paper's solver over noise seeds, K_s free."""
    every = pd.DataFrame(_scattered(wheels, seeds))
    groups = every.groupby(["noise", "data", "method", "quantity"], sort=False)["value"]
    found = groups.quantile([0.05, 0.5, 0.95]).unstack().set_axis(["low", "median", "high"], axis=1)
    return found.assign(least=groups.min(), most=groups.max(), seeds=seeds).reset_index()


def _scattered(wheels: tuple[str, ...], seeds: int) -> Iterator[dict[str, object]]:
    for share, wheel, seed in product(SHARES, wheels, range(1, seeds + 1)):
        given = study_of(wheel, noisy(wheel, seed, share), hold=False)
        for method, fit in bt.fit(given, METHODS, solvers=(PAPER,)).items():
            values = {**field_values(fit.soil), **{f"error_{n}": fit.errors[n] for n in FORCES}}
            at = {"noise": share, "data": wheel, "method": method}
            yield from ({**at, "quantity": n, "value": v} for n, v in values.items())


def paths(wheels: tuple[str, ...] = tuple(SOILS)) -> pd.DataFrame:
    """Parameters after every pass of IM1 by the paper's solver."""
    rows = []
    for wheel in wheels:
        fit = bt.fit(study_of(wheel, hold=False), ("IM1",), solvers=(PAPER,))["IM1"]
        rows += [{"data": wheel, "pass": i + 1, **field_values(soil)} for i, soil in enumerate(fit.path)]
    return pd.DataFrame(rows)


def starts(wheels: tuple[str, ...] = (*SOILS, HIT)) -> pd.DataFrame:
    """Where IM1 ends from several starts of c and of K_s, by each solver: its c and its K_s."""
    rows = []
    for wheel in wheels:
        values = CURVE_C if wheel == DRAWN else START_C
        cases = [("c", v, 1e3 * v) for v in sorted({*values, *START_C})] + [("Ks", v, 1e3 * v) for v in START_KS]
        for name, value, start in cases:
            found = bt.fit(study_of(wheel, hold=False), ("IM1",), start={name: start}, solvers=SOLVERS)
            for fit in found.values():
                ends = field_values(fit.soil)
                at = {"data": wheel, "parameter": name, "start": value, "solver": fit.solver}
                rows.append({**at, "c": ends["c"], "phi": ends["phi"], "Ks": ends["Ks"]})
    return pd.DataFrame(rows)


def truths(wheels: tuple[str, ...] = ("Wh11", "Wh22", "Wh31")) -> pd.DataFrame:
    """The c that IM1 returns by each solver for soils of other true cohesions, noise-free readings."""
    rows = []
    model = M1(transition_slips=TRANSITION)
    for wheel, true in product(wheels, TRUE_C):
        soil, rig = replace(SOILS[wheel], c=1e3 * true), WHEELS[wheel]
        depth = np.asarray(model.sinkage(soil, rig, SLIPS, 80.0))
        forces = model.forces(soil, rig, SLIPS, depth)
        data = pd.DataFrame(
            {
                "slip": SLIPS, "load [N]": 80.0, "sinkage [m]": depth, "drawbar_pull [N]": forces.drawbar_pull,
                "resistance_moment [N m]": forces.resistance_moment,
            }
        )  # fmt: skip
        found = bt.fit(study_of(wheel, data, hold=False), ("IM1",), solvers=SOLVERS)
        rows.append({"data": wheel, "true": true, **{f.solver: field_values(f.soil)["c"] for f in found.values()}})
    return pd.DataFrame(rows)


def angles_held() -> pd.DataFrame:
    """IM2 by the paper's solver with c1 = 0.5 and c2 = 0 held, on noise-free readings and HIT."""
    rows = []
    for wheel in (*SOILS, HIT):
        found = bt.fit(study_of(wheel, hold=False), ("IM2",), hold={"c1": 0.5, "c2": 0.0}, solvers=(PAPER,))
        rows.append({"data": wheel, **row_of(found["IM2"])})
    return pd.DataFrame(rows)


def without_shear() -> pd.DataFrame:
    """IM3 by the paper's solver with the part of the normal force that σ carries put in place of the whole."""
    rows = []
    for wheel, soil in SOILS.items():
        data = study_of(wheel, hold=False).observations
        parts = M1(transition_slips=TRANSITION).components(soil, WHEELS[wheel], data.slip, data.values["sinkage"])
        table = pd.DataFrame(
            {
                "slip": data.slip, "load [N]": np.asarray(parts.F_Nsigma),
                **{f"{n} [{u}]": data.values[n] for n, u in UNITS.items()},
            }
        )  # fmt: skip
        rows.append(
            {"data": wheel, **row_of(bt.fit(study_of(wheel, table, hold=False), ("IM3",), solvers=(PAPER,))["IM3"])}
        )
    return pd.DataFrame(rows)


UNITS = {"sinkage": "m", "drawbar_pull": "N", "resistance_moment": "N m"}
