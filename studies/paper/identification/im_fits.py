"""IM1, IM2 and IM3 on readings made from Table 10 and on those of HIT: values, errors, paths, times."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from time import perf_counter

import numpy as np
import pandas as pd
from paper_data import FORCES, NAMES, OUTCOMES, SOILS, field_values, hit_readings, printed, readings, soil_of, study

import bayesterra as bt
from bayesterra.least_squares.results import Fit
from bayesterra.parameters import soil_array

METHODS = ("IM1", "IM2", "IM3")
DELTAS = (0.002, 1e-3, 1e-4, 1e-5, 1e-6)
"""Tolerances of IM1; the first is the paper's."""
SHARES = (0.25, 0.5, 1.0)
"""Noise, in parts of the standard deviations of studies/hit-wh32."""
SEEDS = 10
HIT = "HIT"
KS = 2.5e6
"""Pa/m^N, at which K_s is held for the readings of HIT: the start of Table 17."""


def noisy(wheel: str, seed: int, share: float) -> pd.DataFrame:
    """Readings made from Table 10 with a share of the full noise; the same random numbers for every share."""
    clean, full = readings(wheel), readings(wheel, seed)
    return clean + share * (full - clean)


def held(wheel: str) -> float:
    """K_s (Pa/m^N) where it is held: that of Table 10, or the start value for HIT."""
    return KS if wheel == HIT else float(SOILS[wheel].Ks)


def study_of(wheel: str, data: pd.DataFrame | None = None, *, hold: bool, **tables: object) -> bt.Study:
    """Study on noise-free readings of a wheel, on ``data``, or on the readings of HIT."""
    fixed = {"Ks": held(wheel)} if hold else None
    if wheel == HIT:
        return study("Wh32", hit_readings(), kind="digitised", hold=fixed, **tables)  # type: ignore[arg-type]
    return study(wheel, readings(wheel) if data is None else data, hold=fixed, **tables)  # type: ignore[arg-type]


def row_of(fit: Fit) -> dict[str, object]:
    """Values in field units, fit errors (16) in percent, and how the fit went."""
    errors = {f"error_{name}": fit.errors[name] for name in FORCES}
    went = {"passes": fit.passes, "converged": fit.converged, "clipped": fit.clipped}
    return {**field_values(fit.soil), **errors, **went, "at_bound": " ".join(fit.at_bound)}


def fits(wheels: tuple[str, ...] = (*SOILS, HIT), holds: tuple[bool, ...] = (True, False)) -> pd.DataFrame:
    """Every method on noise-free readings of each wheel and on HIT, K_s held and free, with the paper's δ."""
    rows = []
    for wheel in wheels:
        for hold in holds:
            found = bt.fit(study_of(wheel, hold=hold), METHODS)
            rows += [{"data": wheel, "Ks_held": hold, "method": m, **row_of(f)} for m, f in found.items()]
    return pd.DataFrame(rows)


def scatter(wheels: tuple[str, ...] = tuple(SOILS), seeds: int = SEEDS) -> pd.DataFrame:
    """Quantiles of what the methods return over noise seeds, K_s held, and the lowest and highest value."""
    every = pd.DataFrame(_scattered(wheels, seeds))
    keys = ["noise", "data", "method", "quantity"]
    groups = every.groupby(keys, sort=False)["value"]
    found = groups.quantile([0.05, 0.5, 0.95]).unstack().set_axis(["low", "median", "high"], axis=1)
    return found.assign(least=groups.min(), most=groups.max(), seeds=seeds).reset_index()


def _scattered(wheels: tuple[str, ...], seeds: int) -> Iterator[dict[str, object]]:
    for share, wheel, seed in product(SHARES, wheels, range(1, seeds + 1)):
        given = study_of(wheel, noisy(wheel, seed, share), hold=True)
        for method, fit in bt.fit(given, METHODS).items():
            values = {**field_values(fit.soil), **{f"error_{n}": fit.errors[n] for n in FORCES}}
            at = {"noise": share, "data": wheel, "method": method}
            yield from ({**at, "quantity": n, "value": v} for n, v in values.items())


def paths(wheels: tuple[str, ...] = (*SOILS, HIT)) -> pd.DataFrame:
    """Parameters after every pass of IM1 with the smallest δ, K_s held; noise-free readings and HIT."""
    rows = []
    for wheel in wheels:
        fit = bt.fit(study_of(wheel, hold=True), ("IM1",), delta=min(DELTAS))["IM1"]
        rows += [{"data": wheel, "pass": i + 1, **field_values(soil)} for i, soil in enumerate(fit.path)]
    return pd.DataFrame(rows)


def stops(path: pd.DataFrame) -> pd.DataFrame:
    """Where IM1 stops with each δ: passes, values, and their largest change in the last pass, percent.

    A smaller δ follows the same path, so that one path tells all; a δ that is never met has no row.
    """
    rows = []
    for wheel, steps in path.groupby("data", sort=False):
        values = steps[list(NAMES)].to_numpy()
        moved = np.abs(np.diff(steps[["c1", "c2"]].to_numpy(), axis=0)).max(axis=1)
        for delta in DELTAS:
            if not (moved < delta).any():
                continue
            last = int(np.argmax(moved < delta)) + 1
            change = 100 * np.abs(values[last] - values[last - 1]) / values[last]
            found = dict(zip(NAMES, values[last], strict=True))
            named = dict(zip([f"last_change_{name}" for name in ("c", "phi", "K")], change[3:6], strict=True))
            rows.append({"data": wheel, "delta": delta, "passes": last + 1, **found, **named})
    return pd.DataFrame(rows)


def times(repeats: int = 3) -> pd.DataFrame:
    """Shortest of some times per method, ms, on noise-free readings and HIT, after a first run."""
    rows = []
    for wheel in (*SOILS, HIT):
        given = study_of(wheel, hold=True)
        found = {method: min(_milliseconds(given, method) for _ in range(repeats)) for method in METHODS}
        rows.append({"data": wheel, **found})
    return pd.DataFrame(rows)


def _milliseconds(given: bt.Study, method: str) -> float:
    began = perf_counter()
    bt.fit(given, (method,))
    return 1e3 * (perf_counter() - began)


def predictions(wheels: tuple[str, ...] = tuple(SOILS)) -> pd.DataFrame:
    """Errors (16), percent, of M2 under 80 N with what IM2 found in noise-free readings, K_s held."""
    rows = []
    for wheel in wheels:
        given = study_of(wheel, hold=True, model="M2")
        soil = bt.fit(given, ("IM2",))["IM2"].soil
        density = bt.posterior(given)
        values = density.likelihood.forward(soil_array(vars(soil))).values[0]
        measured = density.likelihood.measured
        errors = 100 * np.abs(values - measured).max(axis=0) / np.abs(measured).max(axis=0)
        rows.append({"data": wheel, **dict(zip(OUTCOMES, errors, strict=True))})
    return pd.DataFrame(rows)


def angles_held() -> pd.DataFrame:
    """IM2 with c1 = 0.5 and c2 = 0 held, K_s held, on noise-free readings and HIT."""
    rows = []
    for wheel in (*SOILS, HIT):
        given = study_of(wheel, hold=True)
        fit = bt.fit(given, ("IM2",), hold={"Ks": held(wheel), "c1": 0.5, "c2": 0.0})["IM2"]
        rows.append({"data": wheel, **row_of(fit)})
    return pd.DataFrame(rows)


def without_shear() -> pd.DataFrame:
    """IM3 with the part of the normal force that σ carries put in place of the whole, K_s held.

    M3 leaves the shear stress out of the normal force; this is what it finds where there is none.
    """
    from paper_wheels import WHEELS

    from bayesterra.models import M1

    rows = []
    for wheel, soil in SOILS.items():
        data = readings(wheel)
        parts = M1(transition_slips=(0.1, 0.5)).components(
            soil, WHEELS[wheel], data["slip"].to_numpy(), data["sinkage [m]"].to_numpy()
        )
        carried = np.asarray(parts.F_Nsigma)
        given = study_of(wheel, data.assign(**{"load [N]": carried}), hold=True)
        rows.append({"data": wheel, **row_of(bt.fit(given, ("IM3",))["IM3"])})
    return pd.DataFrame(rows)


def printed_judged() -> pd.DataFrame:
    """Errors (16), percent, of printed values, all held: equations of IM1 and IM3 on all readings."""
    rows = []
    for wheel, (method, number) in product((*SOILS, HIT), (("IM1", 10), ("IM3", 14))):
        soil = soil_of(printed(number).loc["Wh32" if wheel == HIT else wheel].to_dict())
        values = {name: float(getattr(soil, name)) for name in NAMES}
        fit = bt.fit(study_of(wheel, hold=False), (method,), hold=values)[method]
        rows.append({"data": wheel, "table": number, "method": method, **fit.errors})
    return pd.DataFrame(rows)
